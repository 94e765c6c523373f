"""Base controller, action mode and safety filter of an environment, designed from a model of its arm."""

import warnings

from flexman_gym.agent.action_modes import ActionMode, make_action_mode
from flexman_gym.agent.base_controllers import make_base
from flexman_gym.agent.controller import Controller
from flexman_gym.agent.pd import PD
from flexman_gym.common.errors import warn_caller
from flexman_gym.common.registry import load_entry
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.envs.limits import MODEL_LIMITS, UNITS, Limits
from flexman_gym.model.model import Model


def make_base_and_mode(configuration: Configuration, model: Model) -> tuple[Controller | None, ActionMode]:
    """Return base controller (or None) and action mode of an environment, designed from a model of its arm.

    A UserWarning is issued for a PD controller whose sampled loop is unstable with the largest delay.
    """
    base, plant = configuration.base, make_plant(configuration, model)
    if isinstance(base, str | dict):
        base = make_base(base, plant)
        if isinstance(base, PD) and (text := base.unstable(model, plant.period, configuration.max_delay)):
            warnings.warn(text, stacklevel=2)
    mode = make_action_mode(configuration.actions, plant, base)
    if configuration.foundation is not None and not hasattr(mode, "commands"):  # a designed mode may command it already
        mode = configuration.foundation.make_mode(mode, base)
    return base, mode


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
