"""Specification: what a controller is told of an environment for which it is made."""

from typing import Any

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.control.plant import Plant
from flexman_gym.envs.catalog import NAMED
from flexman_gym.envs.sensors.array import measured_names
from flexman_gym.envs.sensors.instrument import Instrument
from flexman_gym.envs.sensors.measured import measuring_ranges
from flexman_gym.model.model import Model
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.parameters import PARAMETERS
from flexman_gym.simulation.run import default_step
from flexman_gym.simulation.view import View

ROUNDING = 12.0**-0.5  # standard deviation of the error of a number that is rounded, as a part of the step


def make_plant(setup: Any, model: Model) -> Plant:
    """Says of a Setup what an engineer who builds its controller may know; the model is that of the controller."""
    drawn = setup.disturbed.ranges if setup.disturbed else {}
    fewest, most = drawn.get("delay", (0, 0))
    return Plant(
        model,
        setup.torque_limit,
        setup.control_period,
        lambda: setup.pd_gains,
        {name: span for name, span in drawn.items() if name in PARAMETERS},
        (int(fewest), int(most)),
        (setup.method, setup.step or default_step(setup.control_period, NAMED[setup.name].longest_step)),
        float(drawn.get("tip_load", (0.0, 0.0))[1]),
        lambda: _measured(setup, model, drawn.get("sensor_noise", (0.0, 0.0))[1]),
        setup.drive_bandwidth,
    )


def _measured(setup: Any, model: Model, noise: float) -> dict[str, Array]:
    """Range and standard deviation (2, size) of each measured quantity, of the worst instrument that measures it."""
    ranges = measuring_ranges(View(Batch(model)), setup.limits)
    parts = dict.fromkeys(ranges, noise)
    for part in setup.sensors:
        if isinstance(part, Instrument):
            own = np.hypot(part.flaws.noise, ROUNDING * part.flaws.quantisation)
            for name in measured_names([part]):
                parts[name] = max(parts[name], float(np.hypot(noise, own)))
    return {name: np.array([span, parts[name] * span]) for name, span in ranges.items()}
