"""Optimisation of PD gains with stability margins, and of minimum-time slews, for an environment."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from flexman_gym.agent.base_controllers import make_base
from flexman_gym.agent.pd import PD
from flexman_gym.common.arrays import Array
from flexman_gym.common.errors import value_error
from flexman_gym.common.parallel import Workers, parallel_map
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.envs.episodes import Episodes
from flexman_gym.envs.vector_env import compile_kernels
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.rollouts import rollout
from flexman_gym.simulation.batch import Batch
from flexman_gym.toolbox.controllers.arm_scales import ArmScales
from flexman_gym.toolbox.controllers.lqr import LQR
from flexman_gym.toolbox.controllers.margins import MIN_MARGINS, Margins, SampledLoop, has_margins, margins
from flexman_gym.toolbox.controllers.pd_design import PDDesign, joint_gains
from flexman_gym.toolbox.controllers.references.optimised_slews import OptimisedController, SlewTable
from flexman_gym.toolbox.controllers.references.single_shooting import SingleShooting, SlewTorques
from flexman_gym.toolbox.controllers.references.slew_regression import SlewRegression

LEARN_FROM, LEARN_AGAIN = 50, 50  # numbers of slews
NEXT_FACTOR = 0.96  # duration tried after a success from a predicted slew / that of the success
LOCAL_DEVIATIONS = np.geomspace(0.5, 0.1, 8)  # standard deviation of log(gains) in each round around the best gains
BLOCK_CANDIDATES = 15  # number of candidates evaluated in one rollout
DRAWS = 100  # largest number of draws for each candidate


@dataclass(frozen=True)
class TunedGains:
    """Gains of a PD controller for n joints.

    Attributes:
        stiffness: (n,) N m/rad.
        damping: (n,) N m s/rad.
        reward: mean return of the episodes; the return of an episode is the undiscounted sum of its rewards.
        margins: stability margins: gain margin (dimensionless) and phase margin (degrees).
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
    environment: str | Configuration, around: int = 30, episodes: int = 8, seed: int = 0,
    margin: bool = True, workers: Workers | int = 1,
) -> TunedGains:  # fmt: skip
    """Tune the gains of the PD controller of an environment by random search for the largest mean return.

    The search starts from the gains of `design_pd`, which needs no simulation. Eight rounds draw candidates around the
    best gains so far, within the bounds of the design. All candidates are evaluated on the same episodes.

    Args:
        environment: id, id and condition such as "FlexRRR-v0/delay", path of a file, or Configuration.
        around: number of candidates of each round; 0 for the gains of `design_pd`.
        episodes: number of episodes on which each candidate is evaluated.
        seed: seed of the search.
        margin: True to require of each candidate a gain margin of 2 and a phase margin of 30 degrees, for the sampled
            loop with the largest delay at goals of the environment.
        workers: processes or cluster for the simulations, see `common.parallel.Workers`, or a number of processes.

    Returns:
        Stiffness (n,) N m/rad, damping (n,) N m s/rad, margins (1 and degrees) and the mean return of the episodes.

    Raises:
        ValueError: for an unknown environment, and for one whose control period is too long for a PD with these
            margins; the message has a shorter period.

    Examples:
        >>> import gymnasium as gym
        >>> found = fm.tune("FlexOne-v0", around=1, episodes=1)
        >>> found.margins.gain >= 2.0, found.margins.phase >= 30.0
        (True, True)
        >>> env = gym.make("FlexOne-v0", base="pd", gains=found.gains)
    """
    environment = Configuration.find(environment)
    random, design = np.random.default_rng(seed), PDDesign(environment)
    gains = design.gains(margin)[None]
    returns = _gain_returns(environment, gains, episodes, workers)
    for deviation in LOCAL_DEVIATIONS if around else ():
        draw = partial(_draw_near, random, gains[np.argmax(returns)], float(deviation), design)
        if len(near := _draw_gains(design.loops if margin else [], around, draw)):
            returns = np.append(returns, _gain_returns(environment, near, episodes, workers))
            gains = np.vstack([gains, near])
    stiffness, damping = np.split(gains[np.argmax(returns)], 2)
    reached = margins(design.loops, stiffness, damping)
    stiffness, damping = joint_gains(environment, np.array([stiffness, damping]))
    return TunedGains(tuple(stiffness.tolist()), tuple(damping.tolist()), float(returns.max()), reached)


def _draw_near(random: np.random.Generator, best: Array, deviation: float, design: PDDesign) -> Array:
    """Return gains (2 m,) of the motors near the best ones, within the bounds of the design."""
    return design.bounded(best * np.exp(deviation * random.standard_normal(len(best))))


def _draw_gains(loops: Sequence[SampledLoop], count: int, draw: Callable[[], Array]) -> Array:
    """Return at most `count` drawn gains (count, 2 m), those with MIN_MARGINS in all loops."""
    result: list[Array] = []
    for _ in range(DRAWS * count):
        gains = draw()
        stiffness, damping = np.split(gains, 2)
        if has_margins(loops, stiffness, damping, MIN_MARGINS):
            result.append(gains)
            if len(result) == count:
                break
    return np.array(result)


def _gain_returns(environment: Configuration, gains: Array, episodes: int, workers: Workers | int = 1) -> Array:
    """Return the mean returns (c,) of c gains (c, 2 m) of the motors over the episodes of seeds 0 to `episodes` - 1."""
    parts = [(environment, gains[i : i + BLOCK_CANDIDATES], episodes) for i in range(0, len(gains), BLOCK_CANDIDATES)]
    return np.concatenate(parallel_map(_block_returns, parts, workers, prepare=compile_kernels))


def _block_returns(block: tuple[Configuration, Array, int]) -> Array:
    """Return the mean returns (c,) in one rollout of environment, candidate gains (c, 2 m) and number of episodes."""
    environment, gains, episodes = block
    of_motors = np.split(np.repeat(gains, episodes, axis=0), 2, axis=1)
    stiffness, damping = (joint_gains(environment, each) for each in of_motors)
    zeros, model = [0.0] * environment.arm.n_joints, resolve_fidelity(environment).model
    base = make_base({"kind": "pd", "stiffness": zeros, "damping": zeros}, make_plant(environment, model))
    assert isinstance(base, PD)
    base.stiffness, base.damping = stiffness, damping  # (b, n) gains of each arm, which settings cannot express
    rewards = rollout(base, environment, np.tile(np.arange(episodes), len(gains)).tolist()).rewards
    return np.nansum(rewards, axis=1).reshape(len(gains), episodes).mean(axis=1)


SETTLING = METRICS["settling_time"]


class _SlewResult(NamedTuple):
    """Result of the optimisation of one slew.

    Attributes:
        seed: seed of the episode.
        settling_time: settling time of the optimised slew, s.
        tracking: settling time of the agent "lqr-tracking" in the same episode, s.
        cpu_time: CPU time of the optimisation, s.
    """

    seed: int
    settling_time: float
    tracking: float
    cpu_time: float


def empty_slew_table(environment: Configuration) -> SlewTable:
    """Return a table without slews for the arm of an environment."""
    model, method, step, _ = resolve_fidelity(environment)
    metadata = {
        "environment": environment.to_plain(),
        "model": f"{model.n_dof} coordinates, method {getattr(method, 'name', method)}, step {step:.9g} s",
    }
    fingerprint = SlewTable.fingerprint(model, np.array(environment.torque_limit), environment.control_period)
    return SlewTable(metadata, fingerprint)


def optimise_slews(
    environment: Configuration, seeds: Sequence[int], table: SlewTable, learn: bool = False
) -> Iterator[_SlewResult]:
    """Optimise the slews of episodes that a table lacks, and add them to the table.

    The settling time of a slew is measured by simulating its torques in the environment.

    Args:
        environment: environment of the slews, without randomisation and disturbances.
        seeds: seeds of the episodes.
        table: table of slews of this environment.
        learn: True to begin each search with the slew that a regression of the table predicts (expert iteration,
            Anthony, Tian and Barber, NIPS 2017). The regression begins with LEARN_FROM slews, and is fitted again after
            every LEARN_AGAIN slews.

    Yields:
        _SlewResult: seed, settling times (s) and CPU time (s) of a slew.

    Raises:
        ValueError: for an environment with moving goals, randomisation or disturbances, and for the table of a
            different environment.
    """
    missing = [seed for seed in seeds if seed not in table.found]
    _check_slews(environment, table)
    if not missing:
        return
    limits, period = environment.torque_limit, environment.control_period
    model, method, step, _ = resolve_fidelity(environment)
    scales = ArmScales.of_design_named(model)
    regulator, replay = LQR(model, limits, period, scales=scales), OptimisedController(table, model, limits, period)

    def make_batch(arms: int) -> Batch:
        return Batch(model, method, step, period, arms=arms)

    episodes: list[Episodes] = []
    tracked = rollout("lqr-tracking", environment, missing, episodes.append)
    parameters = episodes[0].view.episode_parameters
    draws = np.stack([parameters["start"], parameters["goal_angles"]], axis=1)
    regression: SlewRegression | None = None
    for seed, start_and_goal, record in zip(missing, draws, tracked.records, strict=True):
        if learn and len(table.found) >= LEARN_FROM and (regression is None or len(table.found) % LEARN_AGAIN == 0):
            regression = SlewRegression.of_model(table, model, np.array(limits))
        start = time.process_time()
        shooting = SingleShooting(regulator, make_batch, record.band, environment.limits.rate, tuple(start_and_goal))
        slew = _fastest_slew(shooting, regression, start_and_goal)
        cpu_time, settling = time.process_time() - start, np.inf
        if slew is not None:
            table.found[seed] = start_and_goal, slew, settling
            settling = SETTLING.evaluate(rollout(replay, environment, [seed]).records)
            table.found[seed] = start_and_goal, slew, settling
        yield _SlewResult(seed, settling, SETTLING.evaluate([record]), cpu_time)


def _check_slews(environment: Configuration, table: SlewTable) -> None:
    """Raise ValueError for an environment whose slews cannot be optimised, and for the table of another one."""
    if environment.task.moves or environment.disturbances is not None:
        raise value_error("environment", environment.id, "one with fixed goals, without randomisation and disturbances")
    if table.about.get("environment") != environment.to_plain():
        raise value_error("table", table.about.get("environment"), "a table of this environment, or a new file")


def _fastest_slew(shooting: SingleShooting, regression: SlewRegression | None, ends: Array) -> SlewTorques | None:
    """Return the fastest slew found between ends (2, n), rad, from a predicted slew, or else from a planned one."""
    slew = None
    if regression is not None:
        guess = regression.predict(*ends)
        slew = shooting.improve(guess, guess.arrival, NEXT_FACTOR)
    return slew or shooting.search()
