"""Vector environment behind the VecEnv interface of Stable-Baselines3."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from flexman_gym.common.checks import value_error
from flexman_gym.common.renamed import deprecated_names

Infos = dict[str, Any]


class SB3VecEnv(VecEnv):
    """A vector environment of Gymnasium, with autoreset_mode="SameStep", for algorithms of Stable-Baselines3.

    The infos of arms whose episode goes on are empty, so that they cost nothing. Those of an arm whose episode ended
    hold all that the environment said at its end, "terminal_observation" and "TimeLimit.truncated". `reset_infos` are
    not filled. The arms share one environment: `get_attr` gives its attribute for each, and nothing can be set or
    called for some of them alone.

    Raises:
        ValueError: for an environment with another autoreset mode.
    """

    def __init__(self, env: gym.vector.VectorEnv[Any, Any, Any]) -> None:
        mode = env.metadata.get("autoreset_mode")
        if mode != AutoresetMode.SAME_STEP:
            raise value_error("autoreset_mode", mode, "an environment made with AutoresetMode.SAME_STEP")
        self.env = env
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> NDArray[np.float32]:
        """Observations (b, size) of new episodes, with the seeds of `seed` and the options of `set_options`."""
        if any(options != self._options[0] for options in self._options):
            raise value_error("options", self._options, "the same options for all environments")
        seeds = None if None in self._seeds else self._seeds
        observations, _ = self.env.reset(seed=seeds, options=self._options[0] or None)  # type: ignore[arg-type]
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Keeps the actions (b, n) for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Observations, rewards, whether an episode has ended, and infos, of all arms."""
        observations, rewards, terminations, truncations, infos = self.env.step(self._actions)
        dones = terminations | truncations
        told: list[Infos] = [{} for _ in range(self.num_envs)]
        for arm in np.flatnonzero(dones).tolist():
            told[arm] = _of_arm(infos["final_info"], arm)
            told[arm]["terminal_observation"] = infos["final_obs"][arm]
            told[arm]["TimeLimit.truncated"] = bool(truncations[arm] and not terminations[arm])
        return observations, rewards, dones, told

    def close(self) -> None:
        """Closes the environment."""
        self.env.close()

    def get_images(self) -> list[Any]:
        """A frame of each arm."""
        return list(self.env.render() or ())

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The attribute of the environment, once for each of the arms."""
        return [getattr(self.env.unwrapped, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Refused: the arms share one environment."""
        raise value_error("set_attr", attr_name, "arguments to the environment as it is made: its arms share them")

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **named: Any) -> list[Any]:
        """Refused: the arms share one environment."""
        raise value_error("env_method", method_name, "a call of a method of `env`, which all arms share")

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper], indices: VecEnvIndices = None) -> list[bool]:
        """False for each of the arms: none has a wrapper of its own."""
        return [False for _ in self._get_indices(indices)]


def _of_arm(infos: Infos, arm: int) -> Infos:
    """The info of one arm from those of all."""
    info: Infos = {}
    for key, value in infos.items():
        if not key.startswith("_"):
            info[key] = _of_arm(value, arm) if isinstance(value, dict) else value[arm]
    return info


__getattr__ = deprecated_names(__name__)
