"""Plug-in of somebody else: a controller, a task, a sensor and a metric."""

import numpy as np

from flexman_gym.envs.sensors import Entry
from flexman_gym.envs.tasks import Goal
from flexman_gym.evaluation.metrics import MEAN, Metric


class Damper:
    """Controller that damps the motors."""

    sensors = ("motor_encoders",)

    def __init__(self, gain):
        self.gain = gain

    def reset(self, arms, episode, count):
        """Nothing is kept between periods."""

    def act(self, readings, applied=None, active=None):
        """Return the actions (b, n)."""
        return np.clip(-self.gain * readings["motor_rates"], -1.0, 1.0)


def make_damper(plant, gain=0.2):
    """Damping of the motor rates."""
    return Damper(gain)


class ErrorSize:
    """Sensor of the distance to the target, m."""

    def entries(self, view, limits):
        """Return one entry."""
        return [Entry("error_size", 1, "m", 2.5 * float(view.reach))]

    def read(self, view, out):
        """Write the distance."""
        out[:, 0] = view.tip_error


class Reach:
    """Task: one posture for all episodes."""

    sensors, moves = (), False

    def __init__(self, angle=0.3):
        self.angle = angle

    def draw(self, random, view):
        """Return the start."""
        return {"start": np.zeros(view.n_joints)}

    def goal(self, parameters, time, view):
        """Return the goal."""
        angles = np.full_like(parameters["start"], self.angle)
        return Goal(view.rest_tips(angles), angles)

    def reward_terms(self, view):
        """Return the terms of the reward."""
        return {"error": -view.tip_error / view.reach}

    def info(self, view):
        """Return no entries."""
        return {}


LARGEST_TORQUE = Metric(
    "largest_torque", "largest torque", "", "low", lambda record: float(np.abs(record.actions).max()), MEAN
)
