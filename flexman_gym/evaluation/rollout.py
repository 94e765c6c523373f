"""Rollout: the only loop that runs episodes; the same ones for whoever acts in them."""

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass

import gymnasium as gym
import numpy as np

from flexman_gym.arrays import Array, IntArray
from flexman_gym.control.controller import Controller
from flexman_gym.envs.description import Description
from flexman_gym.envs.episodes import Episodes
from flexman_gym.envs.motors import checked_actions
from flexman_gym.evaluation.entrants import Entrant, find_entrant, parted
from flexman_gym.metrics import BAND


@dataclass(frozen=True, eq=False)
class Record:
    """What happened in an episode of T control periods.

    Attributes:
        tips: (T + 1, 3) m, base frame, from the reset on.
        errors: (T + 1,) m, distances of tip and target.
        actions: (T, n) what the motors were asked for, parts of the torque limits.
        rewards: (T,).
        failure: "" or what ended the episode.
        period: of control, s.
        band: m around the target, in which a tip has settled.
    """

    tips: Array
    errors: Array
    actions: Array
    rewards: Array
    failure: str
    period: float
    band: float


@dataclass(frozen=True, eq=False)
class Rollout:
    """Episodes side by side, as arrays with an axis for them in front; after the end of an episode they are nan.

    Attributes:
        tips, errors, actions, rewards: (b, ...) as of a Record, T periods of the longest episode.
        lengths: (b,) control periods of each episode.
        failures: (b,) texts.
        period, band: as of a Record.
    """

    tips: Array
    errors: Array
    actions: Array
    rewards: Array
    lengths: IntArray
    failures: tuple[str, ...]
    period: float
    band: float

    @property
    def records(self) -> list[Record]:
        """What happened in each of the episodes, to its end."""
        return [
            Record(self.tips[i, : end + 1], self.errors[i, : end + 1], self.actions[i, :end], self.rewards[i, :end],
                   self.failures[i], self.period, self.band)
            for i, end in enumerate(self.lengths)
        ]  # fmt: skip


def rollout(
    entrant: str | Entrant | Controller,
    environment: str | Description,
    seeds: Sequence[int],
    watch: Callable[[Episodes], None] | None = None,
) -> Rollout:
    """Runs an episode from each seed, side by side.

    The environment takes sensors, history, base and hold of the entrant: it holds actions, and every control period is
    recorded.

    Args:
        entrant: a name or the folder of a run, see `find_entrant`, or a Controller.
        environment: an id, an id and a condition, a file, or a Description.
        seeds: of the episodes.
        watch: called after the reset and after every control period.

    Raises:
        FileNotFoundError, ValueError: one line with what is wrong and what is allowed.
    """
    player, described = find_entrant(entrant), find_environment(environment)
    keywords = parted(described)[0].keywords() | deepcopy(player.interface)  # which may have acted elsewhere
    venv = gym.make_vec(described.id, len(seeds), "vector_entry_point", **keywords)
    episodes, size = venv.unwrapped.episodes, venv.action_space.shape or ()  # type: ignore[attr-defined]
    recorder = _Recorder(episodes, watch)
    observations, _ = venv.reset(seed=list(seeds))  # type: ignore[arg-type]
    recorder.begin()
    episodes.watch = recorder.record
    while not recorder.ends.all():
        # not by a step of `venv`, which would draw an episode anew for each arm whose own has ended
        acted = player.act(observations, size).astype(np.float32)
        episodes.step(checked_actions("actions", acted, size, "a number from -1 to 1 for each motor of each arm"))
        observations = episodes.sight.seen.copy()
    venv.close()
    return recorder.rollout()


def find_environment(environment: str | Description) -> Description:
    """Gives the description of an id, an id and a condition, or a file, or the description itself."""
    return environment if isinstance(environment, Description) else Description.find(environment)


class _Recorder:
    """Records control periods of arms, and the ends of their first episodes; what they do afterwards does not count."""

    def __init__(self, episodes: Episodes, watch: Callable[[Episodes], None] | None) -> None:
        self._episodes, self._watch = episodes, watch
        self._rows: dict[str, list[Array]] = {name: [] for name in ("tips", "errors", "actions", "rewards")}
        self.ends = np.zeros(len(episodes.over), dtype=np.int64)
        self._failures = [""] * len(self.ends)

    def begin(self) -> None:
        """Records what a reset leaves."""
        view = self._episodes.view
        self._keep({"tips": view.tip.copy(), "errors": view.tip_error.copy()})

    def record(self) -> None:
        """Records a control period."""
        episodes, view = self._episodes, self._episodes.view
        self._keep({"tips": view.tip.copy(), "errors": view.tip_error.copy(), "actions": view.action.copy(),
                    "rewards": episodes.rewards(view)})  # fmt: skip
        for arm in np.flatnonzero(episodes.over & (self.ends == 0)).tolist():
            self.ends[arm], self._failures[arm] = len(self._rows["actions"]), episodes.failures.get(arm, "")

    def _keep(self, now: Mapping[str, Array]) -> None:
        for name, values in now.items():
            self._rows[name].append(values)
        if self._watch is not None:
            self._watch(self._episodes)

    def rollout(self) -> Rollout:
        """Gives all of it, nothing where an episode was over."""
        arrays = {name: np.array(rows).swapaxes(0, 1).copy() for name, rows in self._rows.items()}
        for name, values in arrays.items():
            for arm, end in enumerate(self.ends):
                values[arm, end + (name in ("tips", "errors")) :] = np.nan
        view = self._episodes.view
        return Rollout(**arrays, lengths=self.ends, failures=tuple(self._failures), period=view.control_period,
                       band=BAND * view.reach)  # fmt: skip
