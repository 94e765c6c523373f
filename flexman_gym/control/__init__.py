"""Control: controllers with one call signature."""

from flexman_gym.control.bases import BASES
from flexman_gym.control.controller import Controller, Episode
from flexman_gym.control.lqr import LQR, TrackingLQR
from flexman_gym.control.optimised import Optimised
from flexman_gym.control.pd import PD
from flexman_gym.control.policy import Policy
from flexman_gym.control.shaped import Shaped

__all__ = ["BASES", "LQR", "PD", "Controller", "Episode", "Optimised", "Policy", "Shaped", "TrackingLQR"]
