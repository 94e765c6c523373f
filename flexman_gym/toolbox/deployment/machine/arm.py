"""Simulated arm with the drives of a machine."""

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from flexman_gym.agent.controller import EpisodeInfo
from flexman_gym.agent.pd import PD
from flexman_gym.common.arrays import Array
from flexman_gym.common.errors import value_error
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.episodes import Episodes
from flexman_gym.envs.foundation import check_fixed
from flexman_gym.evaluation.agent_spec import split_interface

ROUNDING = 1e-9  # relative excess of a torque over its limit that is clipped
BRAKED, RUNNING, STOPPING = range(3)


def check_torques(environment: Configuration) -> None:
    """Raise ValueError for an environment whose commands are not torques of motors at each joint."""
    check_fixed(environment.foundation, "the commands of a machine are torques of the motors")
    for i, joint in enumerate(environment.arm.joints):
        if joint.passive:
            raise value_error(f"arm.joints[{i}].passive", True, "an arm with a motor at each joint, for a machine")


class SimulatedArm:
    """Arm of an environment with the drives of a machine: brakes, limits of the commands, and a stop.

    Args:
        environment: environment; its randomisation and the flaws of its sensors act on the arm.
        seed: seed of the episode.
        options: options of the reset, such as start.

    Attributes:
        mode: BRAKED until the first step, RUNNING, or STOPPING.
        reason: why the arm stops; "" if it does not.
        episodes: the episode of the arm.
        limits: (n,) torque limits, N m.
        torques: (n,) torques of the last control period, N m.
    """

    def __init__(self, environment: Configuration, seed: int, options: Mapping[str, Any] | None = None) -> None:
        check_torques(environment)
        bare = split_interface(environment)[0].replace(sensors=environment.sensors, actions="torque")
        venv: Any = gym.make_vec(bare.id, 1, "vector_entry_point", **bare.keywords())
        venv.reset(seed=[seed], options=dict(options or {}) or None)
        self.episodes: Episodes = venv.unwrapped.episodes
        self.limits, self.mode, self.reason = np.array(bare.torque_limit), BRAKED, ""
        self.torques, self._posture = np.zeros_like(self.limits), np.zeros_like(self.limits)
        gains, model = bare.gains or NAMED_ENVIRONMENTS[bare.id].pd, self.episodes.batch.model
        weight = model if self.episodes.view.has_gravity else None
        self._pd = PD(gains["stiffness"], gains["damping"], bare.torque_limit, weight)

    def readings(self, names: Sequence[str]) -> dict[str, Array]:
        """Return the quantities (size,) of these names, as the sensors of the environment measure them."""
        view, shared = self.episodes.view, self.episodes.sensors.shared
        own = {"torques": self.torques, "state": view.state[0]}
        return {name: np.array(own[name] if name in own else getattr(shared, name)[0]) for name in names}

    def stop(self, reason: str) -> None:
        """Hold the motors where they are now by the PD controller of the environment; the torques stay limited."""
        if self.mode == RUNNING:
            self.mode, self.reason = STOPPING, reason
            self._posture = self.episodes.view.motor_angles.copy()
            self._pd.reset(
                np.array([0]), EpisodeInfo(self._posture, self._posture, self.episodes.view.control_period), 1
            )

    def step(self, torques: Array) -> None:
        """Simulate a control period under torques (n,), N m; a torque that is not allowed stops the arm."""
        if self.mode == BRAKED:
            self.mode = RUNNING
        if self.mode == RUNNING and not (np.abs(torques) <= self.limits * (1.0 + ROUNDING)).all():
            self.stop(f"torques {torques.tolist()} N m are not within the limits {self.limits.tolist()} N m")
        view = self.episodes.view
        if self.mode == STOPPING:
            readings = {"angle_errors": self._posture - view.motor_angles, "motor_rates": view.motor_rates}
            torques = self._pd.act(readings)[0] * self.limits
        self.episodes.step(np.clip(torques / self.limits, -1.0, 1.0)[None])
        self.torques = self.episodes.motors.torques[0].copy()
        if failure := self.episodes.failures.get(0):
            self.stop(failure)
