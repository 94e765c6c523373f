"""Specification for controller design: plant model, limits, delays, uncertainty and sensor noise of an environment."""

import warnings

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.control.actions import ActionMode, make_action_mode
from flexman_gym.control.base_controllers import make_base
from flexman_gym.control.controller import Controller, Plant
from flexman_gym.control.pd import PD
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.config.randomisation import range_name
from flexman_gym.envs.sensors.instrument import Instrument
from flexman_gym.envs.sensors.sensor import measurement_ranges
from flexman_gym.envs.sensors.sensor_array import measured_names
from flexman_gym.envs.view import View
from flexman_gym.model.model import Model
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.integrator import default_step
from flexman_gym.simulation.parameters import PARAMETERS

ROUNDING = 12.0**-0.5  # standard deviation of a rounding error, as a fraction of the quantisation step


def make_plant(configuration: Configuration, model: Model) -> Plant:
    """Return the specification for controller design of an environment.

    Args:
        configuration: configuration of the environment.
        model: model of the design.
    """
    drawn = configuration.disturbances.ranges if configuration.disturbances else {}
    fewest, most = drawn.get("delay", (0, 0))
    longest_step = NAMED_ENVIRONMENTS[configuration.id].longest_step
    return Plant(
        model,
        configuration.torque_limit,
        configuration.control_period,
        lambda: configuration.pd_gains,
        {range_name(name): span for name, span in drawn.items() if name in PARAMETERS},
        (int(fewest), int(most)),
        (configuration.method, configuration.step or default_step(configuration.control_period, longest_step)),
        float(drawn.get("tip_load", (0.0, 0.0))[1]),
        lambda: _measured(configuration, model, drawn.get("sensor_noise", (0.0, 0.0))[1]),
        configuration.drive_bandwidth,
    )


def make_controller(configuration: Configuration, base: object, model: Model) -> Controller:
    """Return the controller of a name in BASES, or of a mapping with arguments, for a model of the arm."""
    return make_base(base, make_plant(configuration, model))


def _make_base_controller(configuration: Configuration, model: Model) -> Controller | None:
    """Return the base controller of an environment for its model; None without one.

    A PD controller that sampling and delay make unstable causes a UserWarning.
    """
    base = configuration.base
    if not isinstance(base, str | dict):
        return base
    result = make_controller(configuration, base, model)
    period, delay = configuration.control_period, configuration.max_delay
    message = result.unstable(model, period, delay) if isinstance(result, PD) else ""
    if message:
        warnings.warn(message, stacklevel=2)
    return result


def make_base_and_mode(configuration: Configuration, model: Model) -> tuple[Controller | None, ActionMode]:
    """Return base controller and action mode of the agent of an environment, designed for a model of its arm."""
    base = _make_base_controller(configuration, model)
    return base, make_action_mode(configuration.actions, make_plant(configuration, model), base)


def _measured(configuration: Configuration, model: Model, noise: float) -> dict[str, Array]:
    """Return range and standard deviation (2, size) of each measured quantity, of the worst instrument."""
    ranges = measurement_ranges(View(Batch(model)), configuration.limits)
    deviations = dict.fromkeys(ranges, noise)
    for sensor in configuration.sensors:
        if isinstance(sensor, Instrument):
            own = np.hypot(sensor.flaws.noise, ROUNDING * sensor.flaws.quantisation)
            for name in measured_names([sensor]):
                deviations[name] = max(deviations[name], float(np.hypot(noise, own)))
    return {name: np.array([span, deviations[name] * span]) for name, span in ranges.items()}
