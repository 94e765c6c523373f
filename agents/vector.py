"""Adapter from vector environments of Gymnasium to the VecEnv interface of Stable-Baselines3."""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from flexman_gym.common.errors import value_error

Infos = dict[str, Any]


class SB3VecEnv(VecEnv):
    """Vector environment of Gymnasium as a VecEnv of Stable-Baselines3.

    The info of an arm is empty during an episode, which saves time. At the end of the episode it contains the final
    info of the environment, "terminal_observation" and "TimeLimit.truncated". `reset_infos` stay empty. All arms share
    one environment: `get_attr` returns its attribute once per arm, and `set_attr` and `env_method` raise ValueError.

    Args:
        env: vector environment made with autoreset_mode="SameStep".
    """

    def __init__(self, env: gym.vector.VectorEnv[Any, Any, Any]) -> None:
        mode = env.metadata.get("autoreset_mode")
        if mode != AutoresetMode.SAME_STEP:
            raise value_error("autoreset_mode", mode, "an environment made with AutoresetMode.SAME_STEP")
        self.env = env
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> NDArray[np.float32]:
        """Return observations (b, size) of new episodes, with the seeds of `seed` and the options of `set_options`."""
        if any(options != self._options[0] for options in self._options):
            raise value_error("options", self._options, "the same options for all environments")
        seeds = None if None in self._seeds else self._seeds
        observations, _ = self.env.reset(seed=seeds, options=self._options[0] or None)  # type: ignore[arg-type]
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Store the actions (b, n) for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Step all arms; return observations (b, size), rewards (b,), ends of episodes (b,) and infos."""
        observations, rewards, terminations, truncations, infos = self.env.step(self._actions)
        dones = terminations | truncations
        arm_infos: list[Infos] = [{} for _ in range(self.num_envs)]
        for arm in np.flatnonzero(dones).tolist():
            arm_infos[arm] = _info_of_arm(infos["final_info"], arm)
            arm_infos[arm]["terminal_observation"] = infos["final_obs"][arm]
            arm_infos[arm]["TimeLimit.truncated"] = bool(truncations[arm] and not terminations[arm])
        return observations, rewards, dones, arm_infos

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def get_images(self) -> list[Any]:
        """Return a frame of each arm."""
        return list(self.env.render() or ())

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of the environment, once per arm."""
        return [getattr(self.env.unwrapped, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Raise ValueError: the arms share one environment."""
        raise value_error("set_attr", attr_name, "the attribute as a keyword of gym.make_vec, as all arms share it")

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **named: Any) -> list[Any]:
        """Raise ValueError: the arms share one environment."""
        raise value_error("env_method", method_name, "a call of the method of `env`, which all arms share")

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper], indices: VecEnvIndices = None) -> list[bool]:
        """Return False once per arm, as no arm has its own wrapper."""
        return [False for _ in self._get_indices(indices)]

    def get_state(self) -> Any:
        """Return the state of all episodes."""
        return self.env.unwrapped.get_state()  # type: ignore[attr-defined]

    def set_state(self, state: Any) -> None:
        """Restore the state of all episodes."""
        self.env.unwrapped.set_state(state)  # type: ignore[attr-defined]


class JoinedVecEnv(VecEnv):
    """Vector environments of different arms, with equal observations and actions, as one.

    Args:
        parts: the vector environments.
    """

    def __init__(self, parts: Sequence[SB3VecEnv]) -> None:
        self.parts = tuple(parts)
        ends = np.cumsum([part.num_envs for part in parts]).tolist()
        self._slices = [slice(first, end) for first, end in zip([0, *ends], ends, strict=False)]
        super().__init__(ends[-1], parts[0].observation_space, parts[0].action_space)

    def reset(self) -> NDArray[np.float32]:
        """Return observations (b, size) of new episodes, with the seeds of `seed`."""
        for part, rows in zip(self.parts, self._slices, strict=True):
            if self._seeds[rows.start] is not None:
                part.seed(self._seeds[rows.start])
        self._reset_seeds()
        return np.concatenate([part.reset() for part in self.parts])

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Store the actions (b, n) for `step_wait`."""
        for part, rows in zip(self.parts, self._slices, strict=True):
            part.step_async(actions[rows])

    def step_wait(self) -> VecEnvStepReturn:
        """Step all arms; return observations (b, size), rewards (b,), ends of episodes (b,) and infos."""
        steps = [part.step_wait() for part in self.parts]
        observations, rewards, ends = (np.concatenate([step[i] for step in steps]) for i in range(3))
        return observations, rewards, ends, [info for step in steps for info in step[3]]

    def close(self) -> None:
        """Close the environments."""
        for part in self.parts:
            part.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of the environments, once per arm."""
        values = [value for part in self.parts for value in part.get_attr(attr_name)]
        return [values[i] for i in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Raise ValueError, as for each part."""
        self.parts[0].set_attr(attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **named: Any) -> list[Any]:
        """Raise ValueError, as for each part."""
        return self.parts[0].env_method(method_name)

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper], indices: VecEnvIndices = None) -> list[bool]:
        """Return False once per arm, as no arm has its own wrapper."""
        return [False for _ in self._get_indices(indices)]

    def get_state(self) -> list[Any]:
        """Return the states of all episodes, one of each part."""
        return [part.get_state() for part in self.parts]

    def set_state(self, state: list[Any]) -> None:
        """Restore the states of all episodes."""
        for part, each in zip(self.parts, state, strict=True):
            part.set_state(each)


def _info_of_arm(infos: Infos, arm: int) -> Infos:
    """Return the info of one arm from the infos of all arms."""
    info: Infos = {}
    for key, value in infos.items():
        if not key.startswith("_"):
            info[key] = _info_of_arm(value, arm) if isinstance(value, dict) else value[arm]
    return info
