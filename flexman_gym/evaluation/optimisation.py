"""Optimisation for an environment: PD gains with stability margins, and minimum-time slews."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import gymnasium as gym
import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import value_error
from flexman_gym.common.parallel import Workers, parallel_map
from flexman_gym.control.lqr import LQR
from flexman_gym.control.margins import Margins, SampledLoop, has_margins, margins, sampled_loops
from flexman_gym.control.pd import PD, stability_limit
from flexman_gym.control.references.optimised_slews import (
    OptimisedController,
    SingleShooting,
    SlewTable,
    arm_fingerprint,
)
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.specification import make_controller
from flexman_gym.evaluation.agent import split_interface
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.rollout import compile_kernels, find_environment, rollout
from flexman_gym.simulation.batch import Batch

MIN_MARGINS = Margins(2.0, 30.0)  # of all gains that are tried
POSTURES = 4  # of goals, at which they have these margins
STIFFNESS_RANGE, MIN_DAMPING_SHARE = (0.01, 25.0), 0.05  # torque limits a radian, and part of the largest damping
LOCAL_DEVIATIONS = np.geomspace(0.5, 0.1, 8)  # standard deviations of the rounds around the best, in logarithms
CELL = 15  # gains that are judged side by side
DRAWS = 1000  # for each of the gains that are looked for, before the search gives up


@dataclass(frozen=True)
class TunedGains:
    """Gains of a PD controller for n joints.

    Attributes:
        stiffness: (n,) N m/rad.
        damping: (n,) N m s/rad.
        reward: mean of an episode with them.
        margins: gain margin (1) and phase margin (degrees).
    """

    stiffness: tuple[float, ...]
    damping: tuple[float, ...]
    reward: float
    margins: Margins

    @property
    def gains(self) -> dict[str, tuple[float, ...]]:
        """Stiffness and damping by name, for `gym.make(..., base="pd", gains=...)`."""
        return {"stiffness": self.stiffness, "damping": self.damping}


def tune(
    environment: str | Configuration, first: int = 60, around: int = 30, episodes: int = 8, seed: int = 0,
    margin: bool = True, workers: Workers | int = 1,
) -> TunedGains:  # fmt: skip
    """Tune the PD controller of an environment: the best of random gains, then rounds of gains around the best so far.

    All candidates act side by side on the same episodes. Stiffness is drawn between 0.01 and 25 torque limits a radian,
    damping between 0.05 and 1 of the most, evenly on a logarithmic scale; the most is where the motors are half as
    damped as the sampled loop bears with the largest delay of the environment.

    Args:
        environment: whose PD is tuned: an id, an id and a condition, a file, or a Configuration.
        first: how many gains the first round draws.
        around: how many gains each further round draws.
        episodes: for which they are judged.
        seed: of the search.
        margin: whether only gains count that have a gain margin of 2 and a phase margin of 30 degrees in the sampled
            loop, with the largest delay, at goals of the environment.
        workers: who judges the gains, see `grid.Workers`, or so many processes.

    Returns:
        Stiffness (n,) N m/rad, damping (n,) N m s/rad, margins (1 and degrees) and the mean reward of an episode.

    Raises:
        ValueError: for an environment for which too few gains with these margins are drawn.

    Examples:
        >>> found = fm.tune("FlexOne-v0", first=2, around=1, episodes=1)
        >>> found.margins.gain >= 2.0, found.margins.phase >= 30.0
        (True, True)
        >>> env = gym.make("FlexOne-v0", base="pd", gains=found.gains)
    """
    environment = find_environment(environment)
    random, setup, loops = np.random.default_rng(seed), environment, motor_loops(environment)
    limits = np.array(setup.torque_limit)
    rotors = np.array([joint.rotor_inertia for joint in setup.arm.joints])
    most = stability_limit(setup.max_delay) * rotors / (MIN_MARGINS.gain * setup.control_period)
    low = np.log(np.concatenate([STIFFNESS_RANGE[0] * limits, MIN_DAMPING_SHARE * most]))
    high = np.log(np.concatenate([STIFFNESS_RANGE[1] * limits, most]))
    wanted = loops if margin else []
    gains = _draw_gains(wanted, first, lambda: random.uniform(low, high))
    rewards = _rewards(environment, gains, episodes, workers)
    for deviation in LOCAL_DEVIATIONS:
        best = np.log(gains[np.argmax(rewards)])
        spread = partial(_draw_near, random, best, float(deviation), low, high)
        near = _draw_gains(wanted, around, spread)
        gains, rewards = np.vstack([gains, near]), np.append(rewards, _rewards(environment, near, episodes, workers))
    stiffness, damping = np.split(gains[np.argmax(rewards)], 2)
    reached = margins(loops, stiffness, damping)
    return TunedGains(tuple(stiffness.tolist()), tuple(damping.tolist()), float(rewards.max()), reached)


def _draw_near(random: np.random.Generator, best: Array, deviation: float, low: Array, high: Array) -> Array:
    return np.clip(best + deviation * random.standard_normal(len(best)), low, high)


def motor_loops(environment: Configuration) -> list[SampledLoop]:
    """Return the loops of the motors of an environment, with its largest delay, at goals of its first episodes.

    Motors with Coulomb friction slide or stick, see `control.margins`: a posture has a loop for each set of these.
    """
    moved = split_interface(environment)[0]  # without what acts, which may need the gains that are looked for
    venv = gym.make_vec(environment.id, POSTURES, "vector_entry_point", **moved.keywords())
    venv.reset(seed=list(range(POSTURES)))  # type: ignore[arg-type]
    episodes, setup = venv.unwrapped.episodes, environment  # type: ignore[attr-defined]
    postures, model = episodes.view.goal_angles.copy(), episodes.batch.model
    venv.close()
    drive = setup.control_period, setup.max_delay, setup.drive_bandwidth
    return [loop for posture in postures for loop in sampled_loops(model, posture, *drive)]


def _draw_gains(loops: Sequence[SampledLoop], count: int, draw: Callable[[], Array]) -> Array:
    """Gains (count, 2 n) of drawn logarithms, all of which have the least margins in the loops."""
    result: list[Array] = []
    for _ in range(DRAWS * count):
        gains = np.exp(draw())
        stiffness, damping = np.split(gains, 2)
        if has_margins(loops, stiffness, damping, MIN_MARGINS):
            result.append(gains)
            if len(result) == count:
                return np.array(result)
    allowed = f"{count} with a gain margin of {MIN_MARGINS.gain:g} and a phase margin of {MIN_MARGINS.phase:g} degrees"
    raise value_error("gains", f"{len(result)} of {DRAWS * count} drawn", allowed)


def _rewards(environment: Configuration, gains: Array, episodes: int, workers: Workers | int = 1) -> Array:
    """Mean reward (c,) of the first episodes with each of the gains (c, 2 n)."""
    parts = [(environment, gains[i : i + CELL], episodes) for i in range(0, len(gains), CELL)]
    return np.concatenate(parallel_map(_cell_rewards, parts, workers, prepare=compile_kernels))


def _cell_rewards(cell: tuple[Configuration, Array, int]) -> Array:
    """The same of some of the gains, which act side by side."""
    environment, gains, episodes = cell
    n = gains.shape[1] // 2
    stiffness, damping = np.split(np.repeat(gains, episodes, axis=0), 2, axis=1)
    setup, still = environment, [0.0] * n
    base = make_controller(setup, {"kind": "pd", "stiffness": still, "damping": still}, resolve_fidelity(setup).model)
    assert isinstance(base, PD)
    base.stiffness, base.damping = stiffness, damping  # of each candidate its own, which no list of gains has
    rewards = rollout(base, environment, np.tile(np.arange(episodes), len(gains)).tolist()).rewards
    return np.nansum(rewards, axis=1).reshape(len(gains), episodes).mean(axis=1)


SETTLING = METRICS["settling_time"]


class _SlewResult(NamedTuple):
    """Settling times (s) of the slew of an episode and of the tracking LQR, and CPU seconds of the search."""

    seed: int
    time: float
    tracking: float
    seconds: float


def empty_slew_table(environment: Configuration) -> SlewTable:
    """Gives a table without slews, which says what it is for."""
    setup = environment
    model, method, step, _ = resolve_fidelity(setup)
    about = {
        "environment": environment.to_plain(),
        "model": f"{model.n_dof} coordinates, method {getattr(method, 'name', method)}, step {step:.9g} s",
    }
    return SlewTable(about, arm_fingerprint(model, np.array(setup.torque_limit), setup.control_period))


def optimise_slews(environment: Configuration, seeds: Sequence[int], table: SlewTable) -> Iterator[_SlewResult]:
    """Puts the slews of the episodes that a table does not have yet into it, and tells of each.

    A slew counts with the settling time of its replay in the environment.

    Args:
        environment: whose slews are optimised; its arms must be the model.
        seeds: of the episodes.
        table: of this arm.

    Raises:
        ValueError: one line, for an environment that disturbs its arms or moves its goals, and for a table of another.
    """
    setup, left = environment, [seed for seed in seeds if seed not in table.found]
    if setup.task.moves or setup.disturbances is not None:
        raise value_error(
            "environment", environment.id, "one whose goals stay, with no randomisation and no disturbance"
        )
    if table.about.get("environment") != environment.to_plain():
        raise value_error("table", table.about.get("environment"), "a table of this environment, or a new file")
    model, method, step, _ = resolve_fidelity(setup)
    regulator = LQR(model, setup.torque_limit, setup.control_period)
    player = OptimisedController(table, model, setup.torque_limit, setup.control_period)

    def arms(count: int) -> Batch:
        return Batch(model, method, step, setup.control_period, arms=count)

    draws: list[Array] = []
    tracked = rollout(
        "lqr-tracking", environment, left, lambda episodes: _record_start_and_goal(draws, episodes.view.plan)
    )
    for seed, ends, record in zip(left, draws, tracked.records, strict=True):
        begun = time.process_time()
        slew = SingleShooting(regulator, arms, record.band, setup.limits.rate, *ends).search()
        seconds, reached = time.process_time() - begun, np.inf
        if slew is not None:
            table.found[seed] = ends, slew, reached
            reached = SETTLING.sum_up(rollout(player, environment, [seed]).records)
            table.found[seed] = ends, slew, reached
        yield _SlewResult(seed, reached, SETTLING.sum_up([record]), seconds)


def _record_start_and_goal(draws: list[Array], plan: Mapping[str, Array]) -> None:
    """Keeps starts and goals (2, n) rad of the first episodes."""
    if not draws:
        draws += list(np.stack([plan["start"], plan["goal_angles"]], axis=1))
