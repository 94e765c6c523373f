"""Specification for controller design: plant model, limits, delays, uncertainty and sensor noise of an environment."""

from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.control.controller import Plant
from flexman_gym.envs.config.named_environments import NAMED
from flexman_gym.envs.config.randomisation import range_name
from flexman_gym.envs.sensors.instrument import Instrument
from flexman_gym.envs.sensors.sensor import measurement_ranges
from flexman_gym.envs.sensors.sensor_array import measured_names
from flexman_gym.envs.view import View
from flexman_gym.model.model import Model
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.integrator import default_step
from flexman_gym.simulation.parameters import PARAMETERS

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
        {range_name(name): span for name, span in drawn.items() if name in PARAMETERS},
        (int(fewest), int(most)),
        (setup.method, setup.step or default_step(setup.control_period, NAMED[setup.name].longest_step)),
        float(drawn.get("tip_load", (0.0, 0.0))[1]),
        lambda: _measured(setup, model, drawn.get("sensor_noise", (0.0, 0.0))[1]),
        setup.drive_bandwidth,
    )


def _measured(setup: Any, model: Model, noise: float) -> dict[str, Array]:
    """Range and standard deviation (2, size) of each measured quantity, of the worst instrument that measures it."""
    ranges = measurement_ranges(View(Batch(model)), setup.limits)
    parts = dict.fromkeys(ranges, noise)
    for part in setup.sensors:
        if isinstance(part, Instrument):
            own = np.hypot(part.flaws.noise, ROUNDING * part.flaws.quantisation)
            for name in measured_names([part]):
                parts[name] = max(parts[name], float(np.hypot(noise, own)))
    return {name: np.array([span, parts[name] * span]) for name, span in ranges.items()}
