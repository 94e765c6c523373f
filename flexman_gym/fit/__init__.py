"""Fit: physical parameters of an arm from what was measured of a machine."""

from flexman_gym.fit.fit import Fit, fit
from flexman_gym.fit.measurement import Filter, Measurement
from flexman_gym.fit.ringing import Ringing

__all__ = ["Filter", "Fit", "Measurement", "Ringing", "fit"]
