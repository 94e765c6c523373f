"""Specification for controller design: plant model, limits, delays, uncertainty and sensor noise of an environment."""

import warnings

import numpy as np

from flexman_gym.agent.action_modes import ActionMode, make_action_mode
from flexman_gym.agent.base_controllers import make_base
from flexman_gym.agent.controller import Controller, Plant
from flexman_gym.agent.pd import PD
from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import warn_caller
from flexman_gym.common.registry import load_entry
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.config.randomisation import Randomisation
from flexman_gym.envs.limits import MODEL_LIMITS, UNITS, Limits
from flexman_gym.envs.sensors.instrument import Instrument
from flexman_gym.envs.sensors.sensor import measurement_ranges
from flexman_gym.envs.sensors.sensor_array import measured_names
from flexman_gym.envs.view import View
from flexman_gym.model.model import Model
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.integrator import default_step
from flexman_gym.simulation.parameters import PARAMETERS, UNMODELLED

ROUNDING = 12.0**-0.5  # standard deviation of a rounding error, as a fraction of the quantisation step


def make_plant(configuration: Configuration, model: Model) -> Plant:
    """Return the specification of an environment for the design of a controller.

    Args:
        configuration: configuration of the environment.
        model: model from which the controller is designed.
    """
    ranges = configuration.disturbances.ranges if configuration.disturbances else {}
    fewest, most = ranges.get("delay", (0, 0))
    longest_step = NAMED_ENVIRONMENTS[configuration.id].longest_step
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
        (configuration.method, configuration.step or default_step(configuration.control_period, longest_step)),
        float(ranges.get("tip_load", (0.0, 0.0))[1]),
        lambda: _measurement_errors(configuration, model),
        configuration.drive_bandwidth,
    )


def make_base_and_mode(configuration: Configuration, model: Model) -> tuple[Controller | None, ActionMode]:
    """Return base controller (or None) and action mode of an environment, designed from a model of its arm.

    A UserWarning is issued for a PD controller whose sampled loop is unstable with the largest delay.
    """
    base, plant = configuration.base, make_plant(configuration, model)
    if isinstance(base, str | dict):
        base = make_base(base, plant)
        if isinstance(base, PD) and (text := base.unstable(model, plant.period, configuration.max_delay)):
            warnings.warn(text, stacklevel=2)
    return base, make_action_mode(configuration.actions, plant, base)


def make_safe(configuration: Configuration, model: Model, base: Controller | None, mode: ActionMode) -> ActionMode:
    """Return an action mode with the safety filter of the setting `safety`; without the setting the mode itself.

    A UserWarning is issued if no limit is tighter than those of the model, which do not protect the arm.
    """
    if not configuration.safety:
        return mode
    limits, usual = configuration.limits, NAMED_ENVIRONMENTS[configuration.id].limits
    wide = {name: min(getattr(usual, name), getattr(Limits, name)) for name in MODEL_LIMITS}
    if not limits.recorded and all(getattr(limits, name) >= value for name, value in wide.items()):
        kept = ", ".join(f"{name} {getattr(limits, name):g} {UNITS[name]}" for name in MODEL_LIMITS)
        warn_caller(
            f"safety: the filter keeps only the wide limits of the model ({kept}); give limits of strain, "
            "spring_torque or workspace, such as limits={'strain': 1e-4}"
        )
    make_safe_mode = load_entry("flexman_gym.toolbox.safety.safety_filter:make_safe_mode")
    safe: ActionMode = make_safe_mode(mode, make_plant(configuration, model), limits.predicted(model), base)
    return safe


def _measurement_errors(configuration: Configuration, model: Model) -> dict[str, Array]:
    """Return quantity -> (4, size): range, and errors of its worst instrument; see `Plant.measured`."""
    drawn = configuration.disturbances.ranges if configuration.disturbances else {}
    noise, bias = drawn.get("sensor_noise", (0.0, 0.0))[1], max(map(abs, drawn.get("sensor_bias", (0.0, 0.0))))
    gain = max(abs(1.0 - factor) for factor in drawn.get("gauge_gain", (1.0, 1.0)))
    ranges = measurement_ranges(View(Batch(model)), configuration.limits)
    deviations, biases = dict.fromkeys(ranges, noise), dict.fromkeys(ranges, bias)
    for sensor in configuration.sensors:
        if isinstance(sensor, Instrument):
            own = np.hypot(sensor.flaws.noise, ROUNDING * sensor.flaws.quantisation)
            for name in measured_names([sensor]):
                deviations[name] = max(deviations[name], float(np.hypot(noise, own)))
                biases[name] = max(biases[name], bias + sensor.flaws.bias)
    gains = {name: np.full_like(span, gain if name == "root_strains" else 0.0) for name, span in ranges.items()}
    return {
        name: np.array([span, deviations[name] * span, biases[name] * span, gains[name]])
        for name, span in ranges.items()
    }
