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
from flexman_gym.control.base_controllers import make_base
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
from flexman_gym.envs.config.specification import make_plant
from flexman_gym.envs.vector_env import compile_kernels
from flexman_gym.evaluation.agent import split_interface
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.rollout import rollout
from flexman_gym.simulation.batch import Batch

MIN_MARGINS = Margins(2.0, 30.0)  # 1, degrees; margins of all candidate gains
POSTURES = 4  # number of goals at which the margins are checked
STIFFNESS_RANGE = (0.01, 25.0)  # torque limits per radian; range of the drawn stiffness
MIN_DAMPING_SHARE = 0.05  # smallest drawn damping as a fraction of the largest
LOCAL_DEVIATIONS = np.geomspace(0.5, 0.1, 8)  # standard deviation of the logarithms in each round around the best
CELL = 15  # candidates evaluated side by side
DRAWS = 1000  # draws for each candidate before the search fails


@dataclass(frozen=True)
class TunedGains:
    """Gains of a PD controller for n joints.

    Attributes:
        stiffness: (n,) N m/rad.
        damping: (n,) N m s/rad.
        reward: mean reward of an episode.
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
    """Tune the gains of the PD controller of an environment by random search.

    A first round draws gains at random; eight further rounds draw them around the best so far. All candidates are
    evaluated on the same episodes. Stiffness is drawn between 0.01 and 25 torque limits per radian and damping between
    0.05 and 1 of the largest, both uniformly on a logarithmic scale. The largest damping is half the stability limit of
    the sampled loop with the largest delay of the environment.

    Args:
        environment: id, id and condition such as "FlexRRR-v0/delay", path of a file, or Configuration.
        first: number of candidates of the first round.
        around: number of candidates of each further round.
        episodes: number of episodes on which each candidate is evaluated.
        seed: seed of the search.
        margin: whether each candidate must have a gain margin of 2 and a phase margin of 30 degrees in the sampled
            loop with the largest delay, at goals of the environment.
        workers: processes or cluster for the simulations, see `common.parallel.Workers`, or a number of processes.

    Returns:
        Stiffness (n,) N m/rad, damping (n,) N m s/rad, margins (1 and degrees) and the mean reward of an episode.

    Raises:
        ValueError: also if too few draws have these margins.

    Examples:
        >>> import gymnasium as gym
        >>> found = fm.tune("FlexOne-v0", first=2, around=1, episodes=1)
        >>> found.margins.gain >= 2.0, found.margins.phase >= 30.0
        (True, True)
        >>> env = gym.make("FlexOne-v0", base="pd", gains=found.gains)
    """
    environment = Configuration.find(environment)
    random, setup, loops = np.random.default_rng(seed), environment, motor_loops(environment)
    limits = np.array(setup.torque_limit)
    rotors = np.array([joint.rotor_inertia for joint in setup.arm.joints])
    most = stability_limit(setup.max_delay) * rotors / (MIN_MARGINS.gain * setup.control_period)
    low = np.log(np.concatenate([STIFFNESS_RANGE[0] * limits, MIN_DAMPING_SHARE * most]))
    high = np.log(np.concatenate([STIFFNESS_RANGE[1] * limits, most]))
    wanted = loops if margin else []
    gains = _draw_gains(wanted, first, lambda: random.uniform(low, high))
    rewards = gain_rewards(environment, gains, episodes, workers)
    for deviation in LOCAL_DEVIATIONS:
        best = np.log(gains[np.argmax(rewards)])
        spread = partial(_draw_near, random, best, float(deviation), low, high)
        near = _draw_gains(wanted, around, spread)
        rewards = np.append(rewards, gain_rewards(environment, near, episodes, workers))
        gains = np.vstack([gains, near])
    stiffness, damping = np.split(gains[np.argmax(rewards)], 2)
    reached = margins(loops, stiffness, damping)
    return TunedGains(tuple(stiffness.tolist()), tuple(damping.tolist()), float(rewards.max()), reached)


def _draw_near(random: np.random.Generator, best: Array, deviation: float, low: Array, high: Array) -> Array:
    return np.clip(best + deviation * random.standard_normal(len(best)), low, high)


def motor_loops(environment: Configuration) -> list[SampledLoop]:
    """Return the sampled loops of the motors of an environment, with its largest delay, at goals of its first episodes.

    Motors with Coulomb friction slide or stick, see `control.margins`: a posture has a loop for each combination.
    """
    moved = split_interface(environment)[0]  # a base controller may need the gains to be found
    venv = gym.make_vec(environment.id, POSTURES, "vector_entry_point", **moved.keywords())
    venv.reset(seed=list(range(POSTURES)))  # type: ignore[arg-type]
    episodes, setup = venv.unwrapped.episodes, environment  # type: ignore[attr-defined]
    postures, model = episodes.view.goal_angles.copy(), episodes.batch.model
    venv.close()
    drive = setup.control_period, setup.max_delay, setup.drive_bandwidth
    return [loop for posture in postures for loop in sampled_loops(model, posture, *drive)]


def _draw_gains(loops: Sequence[SampledLoop], count: int, draw: Callable[[], Array]) -> Array:
    """Return gains (count, 2 n) with MIN_MARGINS in the loops; `draw` returns their logarithms (2 n,)."""
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


def gain_rewards(environment: Configuration, gains: Array, episodes: int, workers: Workers | int = 1) -> Array:
    """Return the mean reward (c,) of the first episodes with each of the gains (c, 2 n)."""
    parts = [(environment, gains[i : i + CELL], episodes) for i in range(0, len(gains), CELL)]
    return np.concatenate(parallel_map(_cell_rewards, parts, workers, prepare=compile_kernels))


def _cell_rewards(cell: tuple[Configuration, Array, int]) -> Array:
    """Return the mean reward (c,) of gains evaluated side by side."""
    environment, gains, episodes = cell
    n = gains.shape[1] // 2
    stiffness, damping = np.split(np.repeat(gains, episodes, axis=0), 2, axis=1)
    setup, zeros = environment, [0.0] * n
    base = make_base(
        {"kind": "pd", "stiffness": zeros, "damping": zeros}, make_plant(setup, resolve_fidelity(setup).model)
    )
    assert isinstance(base, PD)
    base.stiffness, base.damping = stiffness, damping  # (b, n): one row for each arm, which settings cannot give
    rewards = rollout(base, environment, np.tile(np.arange(episodes), len(gains)).tolist()).rewards
    return np.nansum(rewards, axis=1).reshape(len(gains), episodes).mean(axis=1)


SETTLING = METRICS["settling_time"]


class _SlewResult(NamedTuple):
    """Result of one optimised slew.

    Attributes:
        seed: seed of the episode.
        time: settling time of the optimised slew, s.
        tracking: settling time of the tracking LQR, s.
        seconds: CPU time of the search, s.
    """

    seed: int
    time: float
    tracking: float
    seconds: float


def empty_slew_table(environment: Configuration) -> SlewTable:
    """Return a table without slews for the arm of an environment."""
    setup = environment
    model, method, step, _ = resolve_fidelity(setup)
    about = {
        "environment": environment.to_plain(),
        "model": f"{model.n_dof} coordinates, method {getattr(method, 'name', method)}, step {step:.9g} s",
    }
    return SlewTable(about, arm_fingerprint(model, np.array(setup.torque_limit), setup.control_period))


def optimise_slews(environment: Configuration, seeds: Sequence[int], table: SlewTable) -> Iterator[_SlewResult]:
    """Optimise the slews of episodes missing in a table, add them to it, and yield the result of each.

    The settling time of a slew is measured in its replay in the environment.

    Args:
        environment: environment of the slews, without randomisation and disturbances.
        seeds: seeds of the episodes.
        table: table of this environment, which is extended.

    Yields:
        _SlewResult: seed, settling times (s) and CPU time (s) of a slew.

    Raises:
        ValueError: also for moving goals, for randomisation or disturbances, and for the table of another environment.
    """
    setup, missing = environment, [seed for seed in seeds if seed not in table.found]
    if setup.task.moves or setup.disturbances is not None:
        raise value_error("environment", environment.id, "one with fixed goals, without randomisation and disturbances")
    if table.about.get("environment") != environment.to_plain():
        raise value_error("table", table.about.get("environment"), "a table of this environment, or a new file")
    model, method, step, _ = resolve_fidelity(setup)
    regulator = LQR(model, setup.torque_limit, setup.control_period)
    replay = OptimisedController(table, model, setup.torque_limit, setup.control_period)

    def arms(count: int) -> Batch:
        return Batch(model, method, step, setup.control_period, arms=count)

    draws: list[Array] = []
    tracked = rollout(
        "lqr-tracking",
        environment,
        missing,
        lambda episodes: _record_start_and_goal(draws, episodes.view.episode_parameters),
    )
    for seed, ends, record in zip(missing, draws, tracked.records, strict=True):
        begun = time.process_time()
        slew = SingleShooting(regulator, arms, record.band, setup.limits.rate, *ends).search()
        seconds, reached = time.process_time() - begun, np.inf
        if slew is not None:
            table.found[seed] = ends, slew, reached
            reached = SETTLING.evaluate(rollout(replay, environment, [seed]).records)
            table.found[seed] = ends, slew, reached
        yield _SlewResult(seed, reached, SETTLING.evaluate([record]), seconds)


def _record_start_and_goal(draws: list[Array], parameters: Mapping[str, Array]) -> None:
    """Append start and goal (2, n), rad, of each of the first episodes."""
    if not draws:
        draws += list(np.stack([parameters["start"], parameters["goal_angles"]], axis=1))
