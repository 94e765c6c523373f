"""Identification: estimation of the physical parameters of an arm from measurements."""

from flexman_gym.identification.fit import Fit, fit
from flexman_gym.identification.measurement import Filter, Measurement
from flexman_gym.identification.ringing import Ringing

__all__ = ["Filter", "Fit", "Measurement", "Ringing", "fit"]
