"""Evaluation: episodes of policies on one environment, and what they are worth, in figures and one table."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from typing import Any

import gymnasium as gym
import numpy as np
from rich.console import Console
from rich.table import Table

from flexman_agents.policies import INTERFACE, Policy, parted
from flexman_gym.arrays import Array
from flexman_gym.checks import refusal
from flexman_gym.envs.description import Description
from flexman_gym.envs.tasks import Slew
from flexman_gym.metrics import BAND, effort, final_error, median_interval, peak_to_peak, rms, stabilisation_time


@dataclass(frozen=True)
class Episode:
    """Figures of one episode; one that failed never settles and vibrates without end.

    Attributes:
        reward: sum of the rewards of its control periods.
        stabilisation_time: s, after which the tip stays within the band of the target; infinite if it does not.
        vibration: m, largest peak-to-peak motion of the tip along an axis in the last 3 s.
        error: m, median over the last second.
        effort: mean square of what the motors were asked for, parts of their limits.
        failure: "" or what ended the episode.
        rms_error: m, root mean square over all of the episode.
    """

    reward: float
    stabilisation_time: float
    vibration: float
    error: float
    effort: float
    failure: str
    rms_error: float = np.nan


@dataclass(frozen=True, eq=False)
class Record:
    """What happened in an episode, T control periods: tips (T + 1, 3) m, errors (T + 1,) m, actions (T, n)."""

    tips: Array
    errors: Array
    actions: Array
    rewards: Array
    failure: str


def run_episodes(policy: Policy, environment: Description, seeds: Sequence[int]) -> tuple[list[Record], float]:
    """Runs an episode from each seed, side by side; gives what happened and the control period (s).

    The environment takes the policy's sensors, history, base and hold, and every control period is recorded.
    """
    venv = gym.make_vec(environment.id, len(seeds), "vector_entry_point", **environment.keywords() | policy.interface)
    episodes, size = venv.unwrapped.episodes, venv.action_space.shape or ()  # type: ignore[attr-defined]
    view, (observations, infos) = episodes.view, venv.reset(seed=list(seeds))  # type: ignore[arg-type]
    rows: dict[str, list[Array]] = {name: [] for name in ("tips", "errors", "actions", "rewards")}
    rows["tips"].append(infos["tip"])
    rows["errors"].append(infos["tip_error"])
    ends, failures = np.zeros(len(seeds), dtype=np.int64), [""] * len(seeds)

    def watch() -> None:
        """Records a control period, and the ends of episodes; what an arm does after its first does not count."""
        happened = view.tip.copy(), view.tip_error.copy(), view.action.copy(), episodes.rewards(view)
        for values, now in zip(rows.values(), happened, strict=True):
            values.append(now)
        for arm in np.flatnonzero(episodes.over & (ends == 0)):
            ends[arm], failures[arm] = len(rows["actions"]), episodes.failures.get(arm, "")

    episodes.watch = watch
    while not ends.all():
        observations, *_ = venv.step(policy.act(observations, size).astype(np.float32))
    venv.close()
    columns = {name: np.array(values) for name, values in rows.items()}
    return [_record(columns, arm, int(ends[arm]), text) for arm, text in enumerate(failures)], view.control_period


def _record(columns: Mapping[str, Array], arm: int, end: int, failure: str) -> Record:
    """What happened to an arm until its episode ended; tips and errors begin before the first period."""
    own = {name: values[: end + (name in ("tips", "errors")), arm] for name, values in columns.items()}
    return Record(**own, failure=failure)


def figures(record: Record, period: float, band: float) -> Episode:
    """Gives the figures of an episode for a band (m) around the target."""
    settled, vibration = np.inf, np.inf
    if not record.failure:
        settled = stabilisation_time(record.errors, band, period)
        vibration = peak_to_peak(record.tips, period)
    error, asked = final_error(record.errors, period), effort(record.actions)
    whole = rms(record.errors)
    return Episode(float(record.rewards.sum()), settled, vibration, error, asked, record.failure, whole)


def evaluate(policy: Policy, environment: Description, seeds: Sequence[int]) -> list[Episode]:
    """Gives the figures of an episode from each seed; the same episodes for every policy."""
    records, period = run_episodes(policy, environment, seeds)
    arm = environment.setup().arm
    band = BAND * sum(link.length for link in arm.links)
    return [figures(record, period, band) for record in records]


def common_environment(policies: Sequence[Policy], named: Description | None) -> Description:
    """Gives the environment on which all policies are evaluated: the named one, or that of the trained ones.

    Its PD, which is a baseline, has the gains of the first of them that has any.

    Raises:
        ValueError: for policies that were trained on different ones, when none is named.
    """
    if named is not None:
        return parted(named)[0]
    trained = {policy.name: policy.environment for policy in policies if policy.environment is not None}
    wholes = {name: environment.whole() for name, environment in trained.items()}
    for first, name in zip([*trained][:1] * len(trained), trained, strict=True):
        if {**wholes[name], "gains": None} != {**wholes[first], "gains": None}:
            allowed = f"policies of one environment, or name one with --env: {first} knows another"
            raise refusal("policy", name, allowed)
    with_gains = [trained[name] for name, whole in wholes.items() if whole.get("gains")]
    return next(iter([*with_gains, *trained.values()]), Description())


def changed_environment(environment: Description, changes: Sequence[str]) -> Description:
    """Gives an environment with settings of "name=value" changed.

    Raises:
        ValueError: for those that belong to what acts, and what `Description.changed` refuses.
    """
    for change in changes:
        if change.split("=")[0].split(".")[0] in INTERFACE:
            allowed = f"a setting of what is moved: {', '.join(INTERFACE)} are those that a policy was trained with"
            raise refusal("--set", change, allowed)
    return environment.changed(changes)


def summary(episodes: Sequence[Episode]) -> dict[str, Any]:
    """Gives the figures of many episodes: shares, and medians with bootstrap intervals."""
    settled = np.array([episode.stabilisation_time for episode in episodes])
    return {
        "reward": float(np.mean([episode.reward for episode in episodes])),
        "settled": float(np.mean(np.isfinite(settled))),
        "stabilisation_time": median_interval(settled),
        "vibration": median_interval(np.array([episode.vibration for episode in episodes])),
        "error": median_interval(np.array([episode.error for episode in episodes])),
        "rms_error": median_interval(np.array([episode.rms_error for episode in episodes])),
        "effort": float(np.mean([episode.effort for episode in episodes])),
        "failed": float(np.mean([episode.failure != "" for episode in episodes])),
    }


def table(results: Mapping[str, Sequence[Episode]], environment: Description) -> str:
    """Draws a table with a row for each policy; its head says on which environment all of them were run."""
    reach = sum(link.length for link in environment.setup().arm.links)
    changes = ", ".join(sorted(name for name in environment.settings or {})) or "as it is"
    count = len(next(iter(results.values())))
    title = f"{count} episodes of {environment.id} ({changes}), the same for all"
    drawn = Table(title=title, title_justify="left", caption_justify="left", box=None, pad_edge=False)
    drawn.add_column("policy")
    band = f"in {_length(BAND * reach)}"
    slew = isinstance(environment.setup().task, Slew)
    heads = ("stabilised, s", "p-p, mm", "error, mm") if slew else ("p-p, mm", "RMS error, mm")
    for head in ("reward", band, *heads, "effort", "failed"):
        drawn.add_column(head, justify="right", no_wrap=True)
    for name, episodes in results.items():
        found = summary(episodes)
        lengths = [_interval(found[key], 1e3) for key in ("vibration", "error" if slew else "rms_error")]
        time = [_interval(found["stabilisation_time"], 1.0)] if slew else []
        shares = f"{found['settled']:.0%}", f"{found['failed']:.0%}"
        drawn.add_row(name, f"{found['reward']:.1f}", shares[0], *time, *lengths, f"{found['effort']:.3f}", shares[1])
    drawn.caption = "medians with 95 % bootstrap intervals; reward and effort are means"
    text = StringIO()
    Console(width=160, file=text).print(drawn)
    return "\n".join(line.rstrip() for line in text.getvalue().rstrip().splitlines())


def _length(metres: float) -> str:
    return f"{1e3 * metres:.3g} mm"


def _interval(values: tuple[float, float, float], scale: float) -> str:
    middle, low, high = (f"{scale * value:.3g}" if np.isfinite(value) else "-" for value in values)
    return f"{middle} ({low}-{high})"
