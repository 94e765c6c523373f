"""Fidelity: selection of the smallest model and the longest step within a tolerance."""

from typing import TYPE_CHECKING

from flexman_gym.common.lazy import lazy_names

if TYPE_CHECKING:
    from flexman_gym.fidelity.model_selection import Choice, assembled_modes, choose_model

__all__ = ["Choice", "assembled_modes", "choose_model"]

__getattr__, __dir__ = lazy_names(__name__)
