"""Fidelity: selection of the smallest model and the longest step within a tolerance."""

from flexman_gym.fidelity.model_selection import Choice, assembled_modes, choose_model

__all__ = ["Choice", "assembled_modes", "choose_model"]
