"""Models of arms: discretisation, equations of motion at a state, linearisation, vibration and deformation."""

from typing import TYPE_CHECKING

from flexman_gym.common.lazy import lazy_names

if TYPE_CHECKING:
    from flexman_gym.model.deformation import Curves, curvature, curves, strain
    from flexman_gym.model.dynamics import (
        acceleration,
        damping_matrix,
        frequencies,
        inverse_dynamics,
        mass_matrix,
        stiffness_matrix,
        tip_acceleration,
    )
    from flexman_gym.model.model import Model, build_model, scene_model
    from flexman_gym.model.state_space import LinearModel
    from flexman_gym.model.statics import holding_torques, rest_state
    from flexman_gym.model.vibration import Modes, modes

__all__ = [
    "Curves",
    "LinearModel",
    "Model",
    "Modes",
    "acceleration",
    "build_model",
    "curvature",
    "curves",
    "damping_matrix",
    "frequencies",
    "holding_torques",
    "inverse_dynamics",
    "mass_matrix",
    "modes",
    "rest_state",
    "scene_model",
    "stiffness_matrix",
    "strain",
    "tip_acceleration",
]

__getattr__, __dir__ = lazy_names(__name__)
