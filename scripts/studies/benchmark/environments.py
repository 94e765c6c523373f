"""Environments: steps a second of one arm and of many, of training, of Gymnasium's own and of MuJoCo's rollout."""

from dataclasses import dataclass
from importlib.util import find_spec
from typing import NamedTuple

import gymnasium as gym
import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.setup import Setup, build
from flexman_gym.simulation.batch import Batch
from studies.benchmark.rows import ENVIRONMENTS, Row, Timer, in_turns, timer

REACHER, PENDULUM, OURS = "Reacher-v5", "Pendulum-v1", "FlexRRR-v0"
VECTOR, PHYSICS = f"{OURS}, vector environment", "control period, physics only"
ALONE, PPO = f"Simulator.step of {OURS}", f"{OURS}, PPO, learning included"
ROLLOUT = "MuJoCo's rollout, 4 rigid pieces a link, {} steps of Euler"


class Entry(NamedTuple):
    """A row in the making."""

    name: str
    arms: int
    threads: int
    timer: Timer


@dataclass(frozen=True)
class Grid:
    """What is timed.

    Attributes:
        arms: numbers of them in a vector environment.
        steps: of a vector environment in a round; 500 hold one end of each episode.
        singles: steps of a single environment in a round.
        training: arms and rollouts of PPO in a round.
        physics: arms and control periods in a round where only the physics is timed.
        parts: of a control period that are one step of MuJoCo; None looks for the fewest that are stable.
        rounds: of all rows in turns.
    """

    arms: tuple[int, ...] = (1, 16, 64, 256, 1024)
    steps: int = 500
    singles: int = 2000
    training: tuple[int, int] = (64, 4)
    physics: tuple[int, int] = (64, 5)
    parts: int | None = None
    rounds: int = 7


QUICK = Grid(arms=(1, 9), steps=20, singles=20, training=(2, 1), physics=(2, 1), parts=400, rounds=2)


def single(name: str, steps: int) -> Timer:
    """Steps of an environment from gym.make under random actions; episodes that end start anew."""
    env = gym.make(name)
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(steps)]
    return timer(lambda: [env.reset() for action in actions if any(env.step(action)[2:4])], steps)


def vector(arms: int, threads: int, steps: int) -> Timer:
    """Steps of a vector environment under random actions, with its resets."""
    env = gym.make_vec(OURS, arms, "vector_entry_point", threads=threads)
    env.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (steps, *(env.action_space.shape or ()))).astype(np.float32)
    return timer(lambda: [env.step(action) for action in actions], arms * steps)


def physics(setup: Setup, arms: int, periods: int) -> Timer:
    """Control periods of arms that begin at rest, under random torques."""
    model, method, step, _ = build(setup)
    batch = Batch(model, method, step, setup.control_period, arms=arms)
    drives = np.zeros((periods, arms, setup.arm.n_joints + 6))
    torques = drives[..., : setup.arm.n_joints]
    torques[:] = np.array(setup.torque_limit) * np.random.default_rng(0).uniform(-1.0, 1.0, torques.shape)
    rest = batch.state.copy()

    def run() -> None:
        batch.reset(np.arange(arms), rest)
        for drive in drives:
            batch.step(drive)

    return timer(run, arms * periods)


def alone(steps: int) -> Timer:
    """Control periods of the environment's simulator, called from Python."""
    simulator, torque = FlexManEnv().simulator, np.ones(3)
    return timer(lambda: [simulator.step(torque) for _ in range(steps)], steps)


def entries(grid: Grid) -> list[Entry]:
    """All that is timed but for what needs a package that is missing."""
    result = [Entry(name, 1, 1, single(name, grid.singles)) for name in (OURS, PENDULUM)]
    for threads in (1, 2):  # an arm alone has no work for a second thread
        result += [Entry(VECTOR, n, threads, vector(n, threads, grid.steps)) for n in grid.arms if n >= threads]
    setup, (arms, periods) = Setup(), grid.physics
    result.append(Entry(ALONE, 1, 1, alone(grid.singles)))
    result.append(Entry(f"{OURS}, {PHYSICS}", arms, 1, physics(setup, arms, 20 * periods)))
    return [*result, *_training(grid), *_of_mujoco(grid, setup)]


def _training(grid: Grid) -> list[Entry]:
    if not find_spec("stable_baselines3"):
        print("Stable-Baselines3 is missing, so training is left out: pip install 'flexman_gym[train]'")
        return []
    from studies.benchmark.training import ppo

    return [Entry(PPO, grid.training[0], 1, ppo(*grid.training))]


def _of_mujoco(grid: Grid, setup: Setup) -> list[Entry]:
    """Reacher-v5, and the rollout of rigid pieces; the former also needs imageio."""
    (arms, periods), result = grid.physics, []
    try:
        from studies.benchmark.mujoco import control_periods, longest_step

        result.append(Entry(REACHER, 1, 1, single(REACHER, grid.singles)))
    except (ImportError, gym.error.DependencyNotInstalled) as error:
        print(f"MuJoCo or a part of it is missing, so its rows are left out: pip install 'gymnasium[mujoco]' ({error})")
        return []
    parts = grid.parts or longest_step(setup)
    name = f"{ROLLOUT.format(parts)}, {PHYSICS}"
    return [*result, Entry(name, arms, 1, control_periods(setup, arms, periods, parts))]


def rows(grid: Grid) -> list[Row]:
    """A row of each, its speed compared with that of Reacher-v5 in the same rounds."""
    timed = entries(grid)
    costs = list(in_turns({str(i): entry.timer for i, entry in enumerate(timed)}, grid.rounds).values())
    peer = next((cost for entry, cost in zip(timed, costs, strict=True) if entry.name == REACHER), None)
    return [_row(entry, cost, peer) for entry, cost in zip(timed, costs, strict=True)]


def _row(entry: Entry, cost: Array, peer: Array | None) -> Row:
    cpu, share = (float(each) for each in np.median(cost[:, ::2], axis=0))
    wall, name, times = float(cost[:, 1].min()), "", None
    if peer is not None:
        name, times = REACHER, float(np.median(peer[:, 0] / cost[:, 0]))
        if entry.threads > 1:
            times = float(peer[:, 1].min() / wall)
    part = None if np.isnan(share) else share
    return Row(ENVIRONMENTS, entry.name, entry.arms, entry.threads, cpu, wall, name, times, share=part)
