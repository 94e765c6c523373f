"""Control period of an environment with a single arm in one call of a kernel."""

from typing import Any

import numpy as np

from flexman_gym.agent.action_modes import TorqueMode
from flexman_gym.agent.agent import Agent
from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.sensors import FullState
from flexman_gym.envs.sensors.ideal import NEARNESS_LENGTH
from flexman_gym.envs.sensors.sensor_array import SensorArray
from flexman_gym.envs.tasks import Hold, Slew
from flexman_gym.envs.tasks.rewards import REWARDS
from flexman_gym.envs.view import Number, View
from flexman_gym.kernels.control_period import REWARD_TERMS
from flexman_gym.kernels.layout import Period
from flexman_gym.simulation.batch import Batch


class CompiledPeriod:
    """Arrays of a single arm that a kernel changes in a control period, see `Batch.step_period`.

    Args:
        configuration: configuration of the environment; its reward may be computed from the view.
        batch: batch of the arm.
        view: view of the arm.
        sensors: sensors of the agent, the full state.
        agent: agent without a base.
        motors: torque limits (1, n), N m, and inputs `drive` (1, n + 6) of `Batch.step`: n motor torques (N m), tip
            force (3, N) and base acceleration (3, m/s^2).
        ends: limits of the motion (m,), flag of their violation (1,), and number of periods of the episode (1,).

    Attributes:
        command: (1, n) last action.
        arguments: arguments of `Batch.step_period`; () if the batch has no kernel of a single arm.
    """

    def __init__(
        self,
        configuration: Configuration,
        batch: Batch,
        view: View,
        sensors: SensorArray,
        agent: Agent,
        motors: tuple[Array, Array],
        ends: tuple[Array, BoolArray, IntArray],
    ) -> None:
        n, (limits, violated, ages) = view.n_joints, ends
        reward = _compiled_reward(configuration)
        compiled = REWARDS[reward or "distance"]
        self._action, self.command, terms = np.zeros((1, n)), np.zeros((1, n)), np.zeros((REWARD_TERMS + 1, 1))
        self._terms, self._names = (
            terms[: len(compiled.names) + 1, 0],
            (*compiled.names, "failure"),
        )  # the last one stays 0
        self._given, self._shape = reward is not None, (n,)
        own: dict[str, Any] = {
            "action": self._action, "command": self.command, "torque_limits": motors[0], "drive": motors[1],
            "active": np.ones(1, dtype=bool), "readings": sensors.observations, "bound": sensors.bound,
            "observations": agent.observations, "nearness_offset": np.array([NEARNESS_LENGTH * view.reach]),
            "limits": limits, "violated": violated, "ages": ages, "reward": np.array([compiled.kind]),
            "reward_terms": terms, "reward_parameters": compiled.parameters(view.reach, view.slew_time),
        }  # fmt: skip
        self._arrays = Period(**own, **view.period_arrays(), **batch.period_arrays())  # kept alive for the kernel
        self.arguments = batch.bind_period(motors[1], self._arrays) or ()

    @staticmethod
    def supports(configuration: Configuration, sensors: list[object], mode: Any) -> bool:
        """Return True if a control period of an environment needs no Python code.

        That needs actions that are torques without base and lag, the full state as the only sensor, no history, an
        action for each control period, a goal at rest, and no limits that are recorded.

        Args:
            configuration: configuration of the environment.
            sensors: sensors of the agent and of the task.
            mode: action mode.
        """
        return (
            type(mode) is TorqueMode
            and len(mode.names) == mode.joints
            and not isinstance(mode.strength, np.ndarray)
            and configuration.base is None
            and configuration.lag is None
            and [type(each) for each in sensors] == [FullState]
            and configuration.history == 1
            and configuration.action_repeat == 1
            and not configuration.task.moves
            and not configuration.limits.recorded
        )

    def set_action(self, action: object) -> bool:
        """Set the action of the next period; return False for an object other than an array (n,) of floats."""
        if not isinstance(action, np.ndarray) or action.shape != self._shape or action.dtype.kind != "f":
            return False
        self._action[0] = action
        return True

    def terms(self) -> dict[str, Number] | None:
        """Return the reward terms of a period without a failure; None if they are computed from the view."""
        if not self._given:
            return None
        return dict(zip(self._names, self._terms.tolist(), strict=True))


def _compiled_reward(configuration: Configuration) -> str | None:
    """Return the name of the built-in reward of an environment; None for a reward of the user."""
    task = configuration.task
    if configuration.reward is not None or type(task) not in (Slew, Hold):
        return None
    return getattr(task, "reward", "distance")
