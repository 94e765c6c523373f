"""Circle: the task of docs/own_task.md, in which the tip of a two-link arm follows a circle."""

import numpy as np

from flexman_gym.envs.sensors import Entry
from flexman_gym.envs.tasks import Goal

TURN = 2.0 * np.pi / 6.0  # rad/s


class Phase:
    """A sensor of the goal: cosine and sine of its angle on the circle."""

    def entries(self, view, limits):
        return [Entry("phase", 2, "1", 1.0)]

    def read(self, view, out):
        angle = view.episode_parameters["phase"][:, 0] + TURN * view.time
        out[:, 0], out[:, 1] = np.cos(angle), np.sin(angle)


class Circle:
    """The tip follows a circle; lengths are parts of the reach of the arm."""

    sensors = (Phase(),)  # observed beside the sensors of the environment
    moves = True  # `goal` is asked again after every control period

    def __init__(self, centre=0.7, radius=0.15):
        self.centre, self.radius = centre, radius

    def draw(self, random, view):
        phase = random.uniform(0.0, 2.0 * np.pi, 1)
        return {"start": self.posture(self.place(phase, view), view)[0], "phase": phase}

    def goal(self, parameters, time, view):
        target = self.place(parameters["phase"][:, 0] + TURN * time, view)
        return Goal(target, self.posture(target, view))

    def reward_terms(self, view):
        near = 1.0 / (1.0 + (view.tip_error / (0.05 * view.reach)) ** 2)
        return {"near": near, "effort": -0.01 * view.effort, "failure": -1.0 * view.failed}

    def info(self, view):
        return {"height": view.tip[..., 2] / view.reach}

    def place(self, angle, view):
        x, z = self.centre + self.radius * np.cos(angle), self.radius * np.sin(angle)
        return view.reach * np.stack([x, 0.0 * x, z], axis=-1)

    def posture(self, target, view):
        """The joint angles of the rigid arm: two links and the law of cosines."""
        (first, second), (x, _, z) = view.lengths, target.T
        elbow = np.arccos((x**2 + z**2 - first**2 - second**2) / (2.0 * first * second))
        ahead = np.arctan2(second * np.sin(elbow), first + second * np.cos(elbow))
        return np.stack([np.arctan2(z, x) + ahead, -elbow], axis=-1)
