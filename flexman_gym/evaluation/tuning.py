"""Tuning: gains of a PD controller for an environment, by a random search among those with margins."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import gymnasium as gym
import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import refusal
from flexman_gym.control.margins import Loop, Margins, has_margins, margins, sampled_loops
from flexman_gym.control.pd import PD, stability_limit
from flexman_gym.envs.description import Description
from flexman_gym.envs.setup import build
from flexman_gym.evaluation.entrants import parted
from flexman_gym.evaluation.grid import Workers, gathered
from flexman_gym.evaluation.rollout import find_environment, rollout

LEAST = Margins(2.0, 30.0)  # of all gains that are tried
POSTURES = 4  # of goals, at which they have these margins
STIFF, WEAK = (0.01, 25.0), 0.05  # torque limits a radian, and part of the largest damping
NEAR = np.geomspace(0.5, 0.1, 8)  # standard deviations of the rounds around the best, in logarithms
CELL = 15  # gains that are judged side by side
DRAWS = 1000  # for each of the gains that are looked for, before the search gives up


@dataclass(frozen=True)
class Tuned:
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
    environment: str | Description, first: int = 60, around: int = 30, episodes: int = 8, seed: int = 0,
    margin: bool = True, workers: Workers | int = 1,
) -> Tuned:  # fmt: skip
    """Tune the PD controller of an environment: the best of random gains, then rounds of gains around the best so far.

    All candidates act side by side on the same episodes. Stiffness is drawn between 0.01 and 25 torque limits a radian,
    damping between 0.05 and 1 of the most, evenly on a logarithmic scale; the most is where the motors are half as
    damped as the sampled loop bears with the largest delay of the environment.

    Args:
        environment: whose PD is tuned: an id, an id and a condition, a file, or a Description.
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
    random, setup, loops = np.random.default_rng(seed), environment.setup(), environment_loops(environment)
    limits = np.array(setup.torque_limit)
    rotors = np.array([joint.rotor_inertia for joint in setup.arm.joints])
    most = stability_limit(setup.latest_delay) * rotors / (LEAST.gain * setup.control_period)
    low = np.log(np.concatenate([STIFF[0] * limits, WEAK * most]))
    high = np.log(np.concatenate([STIFF[1] * limits, most]))
    wanted = loops if margin else []
    gains = _drawn(wanted, first, lambda: random.uniform(low, high))
    rewards = _rewards(environment, gains, episodes, workers)
    for deviation in NEAR:
        best = np.log(gains[np.argmax(rewards)])
        spread = partial(_near, random, best, float(deviation), low, high)
        near = _drawn(wanted, around, spread)
        gains, rewards = np.vstack([gains, near]), np.append(rewards, _rewards(environment, near, episodes, workers))
    stiffness, damping = np.split(gains[np.argmax(rewards)], 2)
    reached = margins(loops, stiffness, damping)
    return Tuned(tuple(stiffness.tolist()), tuple(damping.tolist()), float(rewards.max()), reached)


def _near(random: np.random.Generator, best: Array, deviation: float, low: Array, high: Array) -> Array:
    return np.clip(best + deviation * random.standard_normal(len(best)), low, high)


def environment_loops(environment: Description) -> list[Loop]:
    """Return the loops of the motors of an environment, with its largest delay, at goals of its first episodes.

    Motors with Coulomb friction slide or stick, see `control.margins`: a posture has a loop for each set of these.
    """
    moved = parted(environment)[0]  # without what acts, which may need the gains that are looked for
    venv = gym.make_vec(environment.id, POSTURES, "vector_entry_point", **moved.keywords())
    venv.reset(seed=list(range(POSTURES)))  # type: ignore[arg-type]
    episodes, setup = venv.unwrapped.episodes, environment.setup()  # type: ignore[attr-defined]
    postures, model = episodes.view.goal_angles.copy(), episodes.batch.model
    venv.close()
    drive = setup.control_period, setup.latest_delay, setup.drive_bandwidth
    return [loop for posture in postures for loop in sampled_loops(model, posture, *drive)]


def _drawn(loops: Sequence[Loop], count: int, draw: Callable[[], Array]) -> Array:
    """Gains (count, 2 n) of drawn logarithms, all of which have the least margins in the loops."""
    result: list[Array] = []
    for _ in range(DRAWS * count):
        gains = np.exp(draw())
        stiffness, damping = np.split(gains, 2)
        if has_margins(loops, stiffness, damping, LEAST):
            result.append(gains)
            if len(result) == count:
                return np.array(result)
    allowed = f"{count} with a gain margin of {LEAST.gain:g} and a phase margin of {LEAST.phase:g} degrees"
    raise refusal("gains", f"{len(result)} of {DRAWS * count} drawn", allowed)


def _rewards(environment: Description, gains: Array, episodes: int, workers: Workers | int = 1) -> Array:
    """Mean reward (c,) of the first episodes with each of the gains (c, 2 n)."""
    parts = [(environment, gains[i : i + CELL], episodes) for i in range(0, len(gains), CELL)]
    return np.concatenate(gathered(rewards_of, parts, workers))


def rewards_of(cell: tuple[Description, Array, int]) -> Array:
    """The same of some of the gains, which act side by side."""
    environment, gains, episodes = cell
    n = gains.shape[1] // 2
    stiffness, damping = np.split(np.repeat(gains, episodes, axis=0), 2, axis=1)
    setup, still = environment.setup(), [0.0] * n
    base = setup.controller({"kind": "pd", "stiffness": still, "damping": still}, build(setup).model)
    assert isinstance(base, PD)
    base.stiffness, base.damping = stiffness, damping  # of each candidate its own, which no list of gains has
    rewards = rollout(base, environment, np.tile(np.arange(episodes), len(gains)).tolist()).rewards
    return np.nansum(rewards, axis=1).reshape(len(gains), episodes).mean(axis=1)
