"""Model: an arm turned into numbers, and its dynamics at an instant."""

from flexman_gym.model.instant import (
    acceleration,
    frequencies,
    inverse_dynamics,
    mass_matrix,
    tip_acceleration,
)
from flexman_gym.model.linear import LinearModel, linearize
from flexman_gym.model.model import Model, build_model, scene_model
from flexman_gym.model.statics import holding_torques, rest_state
from flexman_gym.model.strain import curvature, strain

__all__ = [
    "LinearModel",
    "Model",
    "acceleration",
    "build_model",
    "curvature",
    "frequencies",
    "holding_torques",
    "inverse_dynamics",
    "linearize",
    "mass_matrix",
    "rest_state",
    "scene_model",
    "strain",
    "tip_acceleration",
]
