"""Fidelity: the smallest model and the longest step that a tolerance allows."""

from flexman_gym.fidelity.model_selection import Choice, assembled_modes, choose_model

__all__ = ["Choice", "assembled_modes", "choose_model"]
