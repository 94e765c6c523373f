"""Controllers with one protocol, observers, reference trajectories and action modes."""

from typing import TYPE_CHECKING

from flexman_gym.common.lazy import lazy_names

if TYPE_CHECKING:
    from flexman_gym.agent.agent import Agent
    from flexman_gym.agent.base_controllers import BASES
    from flexman_gym.agent.controller import Controller, EpisodeInfo, Plant
    from flexman_gym.agent.pd import PD
    from flexman_gym.toolbox.controllers.input_shaping.shaped_controller import InputShapedController
    from flexman_gym.toolbox.controllers.lqr import LQR, TrackingLQR
    from flexman_gym.toolbox.controllers.observers.estimator import Estimator
    from flexman_gym.toolbox.controllers.observers.kalman_filter import KalmanFilter
    from flexman_gym.toolbox.controllers.observers.observer import Estimate, Observer
    from flexman_gym.toolbox.controllers.observers.oracle import Oracle
    from flexman_gym.toolbox.controllers.output_feedback import OutputFeedback
    from flexman_gym.toolbox.controllers.pd_design import design_pd
    from flexman_gym.toolbox.controllers.range_check import RangeCheckedController
    from flexman_gym.toolbox.controllers.references.optimised_slews import OptimisedController
    from flexman_gym.toolbox.controllers.tracking import Tracking

__all__ = [
    "BASES",
    "LQR",
    "PD",
    "Agent",
    "Controller",
    "EpisodeInfo",
    "Estimate",
    "Estimator",
    "InputShapedController",
    "KalmanFilter",
    "Observer",
    "OptimisedController",
    "Oracle",
    "OutputFeedback",
    "Plant",
    "RangeCheckedController",
    "Tracking",
    "TrackingLQR",
    "design_pd",
]

__getattr__, __dir__ = lazy_names(__name__)
