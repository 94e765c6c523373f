"""Plant of an environment for controller design: model, limits, delays, uncertainty and sensor noise."""

from typing import Any

import numpy as np

from flexman_gym.agent.controller import Plant
from flexman_gym.common.arrays import Array
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.config.randomisation import Randomisation
from flexman_gym.envs.sensors.instrument import Instrument
from flexman_gym.envs.sensors.sensor import column_units, encoder_turns, measurement_ranges
from flexman_gym.envs.sensors.sensor_array import measured_names
from flexman_gym.envs.view import View
from flexman_gym.model.model import Model
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.physical_parameters import PARAMETERS, UNMODELLED

ROUNDING = 12.0**-0.5  # standard deviation of a rounding error, as a fraction of the quantisation step


def make_plant(configuration: Configuration, model: Model) -> Plant:
    """Return the plant of an environment, from which a controller is designed.

    Args:
        configuration: configuration of the environment.
        model: model from which the controller is designed.
    """
    ranges = configuration.disturbances.ranges if configuration.disturbances else {}
    fewest, most = ranges.get("delay", (0, 0))
    named = NAMED_ENVIRONMENTS[configuration.id]
    return Plant(
        model,
        configuration.torque_limit,
        configuration.control_period,
        lambda: configuration.pd_gains,
        {
            Randomisation.range_name(name): span
            for name, span in ranges.items()
            if name in PARAMETERS.keys() - UNMODELLED
        },
        (int(fewest), int(most)),
        (configuration.method, configuration.integration_step),
        float(ranges.get("tip_load", (0.0, 0.0))[1]),
        lambda: _measurement_errors(configuration, model),
        configuration.drive_bandwidth,
        configuration.limits.rate,
        named.control_period if configuration.has_named_motors else None,
        configuration.foundation if getattr(configuration.foundation, "names", ()) else None,
        any("joint_angles" in measured_names([sensor]) for sensor in configuration.sensors),
    )


def _measurement_errors(configuration: Configuration, model: Model) -> dict[str, Array]:
    """Return quantity -> (4, size): range, and errors of its worst instrument; see `Plant.measured`."""
    drawn = configuration.disturbances.ranges if configuration.disturbances else {}
    noise, bias = drawn.get("sensor_noise", (0.0, 0.0))[1], max(map(abs, drawn.get("sensor_bias", (0.0, 0.0))))
    gain = max(abs(1.0 - factor) for factor in drawn.get("gauge_gain", (1.0, 1.0)))
    view = View(Batch(model))
    ranges = measurement_ranges(view, configuration.limits)
    deviations: dict[str, Any] = dict.fromkeys(ranges, noise)
    biases: dict[str, Any] = dict.fromkeys(ranges, bias)
    for sensor in configuration.sensors:
        if isinstance(sensor, Instrument):
            for name in measured_names([sensor]):
                place = column_units(view, name), ranges[name], encoder_turns(view, name)
                own, steps, largest = (
                    sensor.flaws.fraction(each, *place) for each in ("noise", "quantisation", "bias")
                )
                deviations[name] = np.maximum(deviations[name], np.hypot(noise, np.hypot(own, ROUNDING * steps)))
                biases[name] = np.maximum(biases[name], bias + largest)
    gains = {name: np.full_like(span, gain if name == "root_strains" else 0.0) for name, span in ranges.items()}
    return {
        name: np.array([span, deviations[name] * span, biases[name] * span, gains[name]])
        for name, span in ranges.items()
    }
