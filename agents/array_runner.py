"""Array runner: rolls the arms of a vector environment out for RLlib as whole arrays, and scales what they see."""

import uuid
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray
from ray.rllib.connectors.connector_v2 import ConnectorV2
from ray.rllib.core.columns import Columns
from ray.rllib.env.single_agent_env_runner import SingleAgentEnvRunner
from ray.rllib.env.single_agent_episode import SingleAgentEpisode
from ray.rllib.env.utils.infinite_lookback_buffer import InfiniteLookbackBuffer

from flexman_gym.envs.description import Description
from flexman_gym.envs.scales import Scales

MOST = 10.0  # magnitude of what is normalised


class Moments(ConnectorV2):
    """Scales of observations and returns: those that all runners share, and what this one has seen since."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.shared, self.own = self._new(size), self._new(size)

    @staticmethod
    def _new(size: int) -> dict[str, Scales]:
        return {"seen": Scales((size,)), "returns": Scales()}

    def now(self, name: str) -> Scales:
        """Both together."""
        result = Scales(self.own[name].mean.shape)
        result.merge(self.shared[name])
        result.merge(self.own[name])
        return result

    def __call__(self, *, batch: Any, **named: Any) -> Any:
        return batch  # the runner has normalised what it gives

    def get_state(self, *parts: Any, **named: Any) -> dict[str, Any]:
        """Both, as arrays and numbers."""
        return {part: {name: each.get_state() for name, each in getattr(self, part).items()}
                for part in ("shared", "own")}  # fmt: skip

    def set_state(self, state: dict[str, Any]) -> None:
        """Takes what `get_state` or `merge_states` gave."""
        for part, scales in state.items():
            for name, each in scales.items():
                getattr(self, part)[name].set_state(each)

    def merge_states(self, states: list[dict[str, Any]]) -> dict[str, Any]:
        """What all runners have seen, counted once."""
        result = Moments(len(self.own["seen"].mean))
        for part, several in (("shared", states[:1]), ("own", states)):
            for name, scales in result.shared.items():
                for state in several:
                    other = Scales(scales.mean.shape)
                    other.set_state(state[part][name])
                    scales.merge(other)
        return result.get_state()


class ArrayRunner(SingleAgentEnvRunner):
    """Rolls all arms out as arrays and cuts them into episodes once; the stock runner handles arm after arm."""

    _needs_initial_reset: bool
    _seen: NDArray[Any]
    _return: NDArray[Any]
    _score: NDArray[Any]
    _length: NDArray[Any]

    def _sample(self, *, num_timesteps: int | None = None, force_reset: bool = False, **named: Any) -> list[Any]:
        assert num_timesteps is not None, "the algorithm asks for steps"
        steps = -(-num_timesteps // self.num_envs)
        if self._needs_initial_reset or force_reset:
            self._begin()
        moments = next(each for each in self._env_to_module if isinstance(each, Moments))
        seen, spread = moments.now("seen"), moments.now("returns").deviation
        scale = spread if self.config.env_config["normalise_reward"] else 1.0
        rows: dict[str, list[Any]] = {name: [] for name in ("raw", "acts", "logits", "logp", "rewards", "returns")}
        ends: list[tuple[int, int, Any, bool]] = []
        for step in range(1, steps + 1):
            with torch.no_grad():
                batch = {Columns.OBS: torch.from_numpy(seen.apply(self._seen, MOST))}
                logits = self.module.forward_exploration(batch)[Columns.ACTION_DIST_INPUTS]
                chance = self.module.get_exploration_action_dist_cls().from_logits(logits)
                acts = chance.sample()
                logp = chance.logp(acts)
            rows["raw"].append(self._seen)
            self._seen, reward, ended, cut, infos = self.env.env.step(acts.clamp(-1.0, 1.0).numpy())
            self._return = self._return * self.config.gamma + reward
            self._score += reward
            self._length += 1
            reward = np.clip(reward / scale, -MOST, MOST)
            for name, each in zip(("acts", "logits", "logp", "rewards", "returns"),
                                  (acts.numpy(), logits.numpy(), logp.numpy(), reward, self._return.copy()),
                                  strict=True):  # fmt: skip
                rows[name].append(each)
            for arm in np.flatnonzero(ended | cut).tolist():
                ends.append((arm, step, seen.apply(infos["final_obs"][arm], MOST), bool(ended[arm])))
                self._log_episode_metrics(int(self._length[arm]), float(self._score[arm]), 0.0)
                self._return[arm] = self._score[arm] = self._length[arm] = 0
        moments.own["seen"].add(np.array(rows["raw"]))
        moments.own["returns"].add(np.array(rows.pop("returns")))
        arrays = {name: np.stack(values, 1) for name, values in rows.items()}
        arrays["obs"] = np.concatenate([seen.apply(arrays.pop("raw"), MOST), seen.apply(self._seen, MOST)[:, None]], 1)
        self._log_env_steps(metric=self._metrics_num_env_steps_sampled, num_steps=self.num_envs * steps)
        self._increase_sampled_metrics(self.num_envs * steps, len(ends))
        return self._episodes(arrays, ends, steps)

    def _begin(self) -> None:
        """Starts all arms with seeds that no other runner has."""
        first = self.config.env_config["first_seed"] + max(0, self.worker_index - 1) * self.num_envs
        self._seen, _ = self.env.env.reset(seed=first)
        self._return, self._score, self._length = np.zeros((3, self.num_envs))
        self._names = [uuid.uuid4().hex for _ in range(self.num_envs)]
        self._needs_initial_reset = False

    def _episodes(self, arrays: dict[str, NDArray[Any]], ends: list[Any], steps: int) -> list[Any]:
        """Cuts arrays (arms, steps, ...) into episodes; `ends` are arm, step, last observation, and whether it failed.

        Those that go on are cut where the arrays end.
        """
        starts, result = np.zeros(self.num_envs, dtype=int), []
        open_ends = [(arm, steps, None, False) for arm in range(self.num_envs)]
        for arm, stop, last, failed in ends + open_ends:
            part = slice(starts[arm], stop)
            starts[arm], length = stop, stop - starts[arm]
            if length == 0:
                continue
            seen = arrays["obs"][arm, part.start : stop + 1].copy()
            if last is not None:
                seen[-1] = last
            episode = SingleAgentEpisode(
                self._names[arm], observations=_buffer(seen), infos=_buffer([{}] * (length + 1)), t_started=0,
                actions=_buffer(arrays["acts"][arm, part]), rewards=_buffer(arrays["rewards"][arm, part]),
                extra_model_outputs={Columns.ACTION_DIST_INPUTS: _buffer(arrays["logits"][arm, part]),
                                     Columns.ACTION_LOGP: _buffer(arrays["logp"][arm, part])},
                terminated=failed, truncated=last is not None and not failed, len_lookback_buffer=0,
            )  # fmt: skip
            episode.t = length
            result.append(episode)
            if last is not None:
                self._names[arm] = uuid.uuid4().hex
        return result

    def get_metrics(self) -> Any:
        """Figures of what was sampled since."""
        return self.metrics.reduce()


def _buffer(values: Any) -> Any:
    """What an episode of RLlib keeps, already as arrays."""
    result = InfiniteLookbackBuffer(data=values, lookback=0)
    result.finalized = not isinstance(values, list)
    return result


def make_arms(context: Any) -> Any:
    """The vector environment of a runner."""
    torch.set_num_threads(1)
    described = Description.from_dict(dict(context["environment"]))
    return gym.make_vec(described.id, context.get("num_envs", 1), "vector_entry_point", autoreset_mode="SameStep",
                        infos="at end", **described.keywords())  # fmt: skip
