"""Control: controllers with one call signature."""

from flexman_gym.control.controller import Controller, Episode
from flexman_gym.control.lqr import LQR, TrackingLQR
from flexman_gym.control.pd import PD

__all__ = ["LQR", "PD", "Controller", "Episode", "TrackingLQR"]
