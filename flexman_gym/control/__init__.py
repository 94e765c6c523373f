"""Control: controllers with one call signature, and the observers and laws that some are made of."""

from flexman_gym.control.bases import BASES
from flexman_gym.control.controller import Controller, Episode
from flexman_gym.control.estimator import Estimator
from flexman_gym.control.feedback import OutputFeedback
from flexman_gym.control.kalman import KalmanFilter
from flexman_gym.control.lqr import LQR, TrackingLQR
from flexman_gym.control.observer import Estimate, Observer
from flexman_gym.control.optimised import Optimised
from flexman_gym.control.pd import PD
from flexman_gym.control.plant import Plant
from flexman_gym.control.policy import Policy
from flexman_gym.control.shaped import Shaped
from flexman_gym.control.tracking import Tracking
from flexman_gym.control.truth import Truth

__all__ = [
    "BASES",
    "LQR",
    "PD",
    "Controller",
    "Episode",
    "Estimate",
    "Estimator",
    "KalmanFilter",
    "Observer",
    "Optimised",
    "OutputFeedback",
    "Plant",
    "Policy",
    "Shaped",
    "Tracking",
    "TrackingLQR",
    "Truth",
]
