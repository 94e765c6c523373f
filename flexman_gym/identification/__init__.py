"""Identification: estimation of the physical parameters of an arm from measurements."""

from typing import TYPE_CHECKING

from flexman_gym.common.lazy import lazy_names

if TYPE_CHECKING:
    from flexman_gym.identification.fit import Fit, fit
    from flexman_gym.identification.measurement import Filter, Measurement
    from flexman_gym.identification.ringing import Ringing

__all__ = ["Filter", "Fit", "Measurement", "Ringing", "fit"]

__getattr__, __dir__ = lazy_names(__name__)
