"""Benchmark measurements: environment steps, their parts, evaluations of the dynamics."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import NamedTuple

import gymnasium as gym
import numpy as np

import flexman_gym as fm
from flexman_gym.common.arrays import Array
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.vector_env import FlexManVectorEnv
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.worker_thread import WorkerThread
from studies.stopwatch import Timer, in_turns, repeated, timer

EVALUATIONS, ENVIRONMENTS, PARTS = "evaluations", "environments", "parts"


@dataclass(frozen=True)
class BenchmarkRow:
    """Row of the benchmark.

    Attributes:
        table: table of the page to which the row belongs.
        name: timed operation.
        arms, threads: number of arms and threads; None where not applicable.
        cpu, wall: CPU and wall-clock time per operation, s; medians over the rounds, but `wall` of environments is that
            of the fastest round.
        peer: name of the row with which this one is compared, "" for none.
        times_peer: cost (evaluations) or speed (environments) relative to the peer: median over the rounds of the CPU
            time ratio, or the ratio of wall-clock times for several threads.
        share: share of the CPU time spent in the steps of the environment.
    """

    table: str
    name: str
    arms: float | None
    threads: float | None
    cpu: float
    wall: float
    peer: str = ""
    times_peer: float | None = None
    share: float | None = None


REACHER, PENDULUM, OURS = "Reacher-v5", "Pendulum-v1", "FlexRRR-v0"
VECTOR, PHYSICS = f"{OURS}, vector environment", "control period, physics only"
ALONE, PPO = f"Simulator.step of {OURS}", f"{OURS}, PPO, learning included"
ROLLOUT = "MuJoCo's rollout, 4 rigid pieces a link, {} steps of Euler"


class _BenchmarkEntry(NamedTuple):
    """Timer of a future row with its name, number of arms and threads."""

    name: str
    arms: int
    threads: int
    timer: Timer


@dataclass(frozen=True)
class Grid:
    """Sizes of the benchmark.

    Attributes:
        arms: numbers of arms of the vector environments.
        steps: steps of a vector environment per round; 500 steps include one end of each episode.
        singles: steps of a single environment per round.
        training: number of arms and of rollouts of PPO per round.
        physics: number of arms and of control periods per round of the physics alone.
        parts: MuJoCo steps per control period; None searches for the smallest stable number.
        rounds: number of interleaved rounds.
    """

    arms: tuple[int, ...] = (1, 16, 64, 256, 1024)
    steps: int = 500
    singles: int = 2000
    training: tuple[int, int] = (64, 4)
    physics: tuple[int, int] = (64, 5)
    parts: int | None = None
    rounds: int = 7


QUICK = Grid(arms=(1, 9), steps=20, singles=20, training=(2, 1), physics=(2, 1), parts=400, rounds=2)


def _single(name: str, steps: int) -> Timer:
    """Return a timer of steps of a single environment under random actions, including resets."""
    env = gym.make(name)
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(steps)]
    return timer(lambda: [env.reset() for action in actions if any(env.step(action)[2:4])], steps)


def _vector(arms: int, threads: int, steps: int) -> Timer:
    """Return a timer of steps of the vector environment under random actions, including resets."""
    env = gym.make_vec(OURS, arms, "vector_entry_point", threads=threads)
    env.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (steps, *(env.action_space.shape or ()))).astype(np.float32)
    return timer(lambda: [env.step(action) for action in actions], arms * steps)


def _physics(setup: Configuration, arms: int, periods: int) -> Timer:
    """Return a timer of control periods of arms that start at rest, under random torques."""
    model, method, step, _ = resolve_fidelity(setup)
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


def _alone(steps: int) -> Timer:
    """Return a timer of control periods of the environment's simulator, called from Python."""
    simulator, torque = FlexManEnv().simulator, np.ones(3)
    return timer(lambda: [simulator.step(torque) for _ in range(steps)], steps)


def _entries(grid: Grid) -> list[_BenchmarkEntry]:
    """Return all timers whose packages are installed."""
    result = [_BenchmarkEntry(name, 1, 1, _single(name, grid.singles)) for name in (OURS, PENDULUM)]
    for threads in (1, 2):  # one arm cannot use a second thread
        result += [
            _BenchmarkEntry(VECTOR, n, threads, _vector(n, threads, grid.steps)) for n in grid.arms if n >= threads
        ]
    setup, (arms, periods) = Configuration(), grid.physics
    result.append(_BenchmarkEntry(ALONE, 1, 1, _alone(grid.singles)))
    result.append(_BenchmarkEntry(f"{OURS}, {PHYSICS}", arms, 1, _physics(setup, arms, 20 * periods)))
    return [*result, *_training(grid), *_of_mujoco(grid, setup)]


def _training(grid: Grid) -> list[_BenchmarkEntry]:
    if not find_spec("stable_baselines3"):
        print("Stable-Baselines3 is missing, so training is left out: pip install 'flexman_gym[train]'")
        return []
    from studies.benchmark.training import ppo

    return [_BenchmarkEntry(PPO, grid.training[0], 1, ppo(*grid.training))]


def _of_mujoco(grid: Grid, setup: Configuration) -> list[_BenchmarkEntry]:
    """Return the timers of Reacher-v5 (which also needs imageio) and of MuJoCo's rollout with rigid pieces."""
    (arms, periods), result = grid.physics, []
    try:
        from studies.benchmark.mujoco import control_periods, longest_step

        result.append(_BenchmarkEntry(REACHER, 1, 1, _single(REACHER, grid.singles)))
    except (ImportError, gym.error.DependencyNotInstalled) as error:
        print(f"MuJoCo or a part of it is missing, so its rows are left out: pip install 'gymnasium[mujoco]' ({error})")
        return []
    parts = grid.parts or longest_step(setup)
    name = f"{ROLLOUT.format(parts)}, {PHYSICS}"
    return [*result, _BenchmarkEntry(name, arms, 1, control_periods(setup, arms, periods, parts))]


def environment_rows(grid: Grid) -> list[BenchmarkRow]:
    """Measure all environments and return their rows, with the speed relative to Reacher-v5 in the same rounds."""
    timed = _entries(grid)
    costs = list(in_turns({str(i): entry.timer for i, entry in enumerate(timed)}, grid.rounds).values())
    peer = next((cost for entry, cost in zip(timed, costs, strict=True) if entry.name == REACHER), None)
    return [_row(entry, cost, peer) for entry, cost in zip(timed, costs, strict=True)]


def _row(entry: _BenchmarkEntry, cost: Array, peer: Array | None) -> BenchmarkRow:
    cpu, share = (float(each) for each in np.median(cost[:, ::2], axis=0))
    wall, name, times = float(cost[:, 1].min()), "", None
    if peer is not None:
        name, times = REACHER, float(np.median(peer[:, 0] / cost[:, 0]))
        if entry.threads > 1:
            times = float(peer[:, 1].min() / wall)
    part = None if np.isnan(share) else share
    return BenchmarkRow(ENVIRONMENTS, entry.name, entry.arms, entry.threads, cpu, wall, name, times, share=part)


BATCHES, STEPS = 3, 250
ABA, PLAIN = "Pinocchio aba, rigid arm, from Python", "evaluation, 12 coordinates a link"
I3 = tuple(map(tuple, np.eye(3)))


def _evaluation(model: fm.Model, **drive: tuple[float, ...]) -> Timer:
    """Return a timer of accelerations in the compiled simulation; the short steps do not leave the random state."""
    held = [0] if "acceleration" in drive else []
    simulator = fm.Simulator(model, "rk4", step=1e-8, control_period=STEPS * 1e-8, prescribed=held)
    simulator.reset(state=np.random.default_rng(0).normal(0.0, 0.02, 2 * model.n_dof))
    torque = np.where(np.isin(np.arange(model.n_joints), held), 0.0, 100.0)
    return timer(lambda: simulator.step(torque, **drive), 4 * STEPS, BATCHES)


def _switches(arm: fm.Arm) -> dict[str, Timer]:
    """Return timers of evaluations with 12 coordinates per link and one additional modelling option."""
    halves = []
    for link in arm.links:
        (whole,) = link.sections
        halves.append(fm.NonUniformLink([replace(whole, length=link.length / 2, orientation=I3)] * 2, link.orientation))
    joints = [replace(joint, viscous_friction=5.0, coulomb_friction=20.0) for joint in arm.joints]
    body = fm.Payload(5.0, inertia=I3, offset=(0.1, 0.0, 0.0))
    models = {
        "with foreshortening": fm.build_model(arm, stiffening=True),
        "without rotary inertia": fm.build_model(arm, rotary_inertia=False),
        "with spinning rotors": fm.build_model(arm, spinning_rotors=True),
        "with joint friction": fm.build_model(replace(arm, joints=joints)),
        "with a payload of inertia and offset": fm.build_model(replace(arm, payload=body)),
        "with links of two sections": fm.build_model(replace(arm, links=halves), elements=1),
    }
    plain, pushed = fm.build_model(arm), (1.0, 2.0, 3.0)
    timers = {name: _evaluation(model) for name, model in models.items()}
    timers["with a force on the tip"] = _evaluation(plain, tip_force=pushed)
    timers["with an accelerated base"] = _evaluation(plain, base_acceleration=pushed)
    timers["with a prescribed joint"] = _evaluation(plain, acceleration=(1.0, 0.0, 0.0))
    return {f"  {name}": each for name, each in timers.items()}


def _pinocchio_aba(arm: fm.Arm, rigid: fm.Model, count: int = 500) -> Timer:
    """Return a timer of Pinocchio's ABA of the rigid arm with rotors, after a check of its accelerations."""
    from flexman_gym.toolbox.precision.peers.pinocchio import pin, rigid_model

    model = rigid_model(arm)
    q, v, torque = np.random.default_rng(0).uniform(-1.0, 1.0, (3, arm.n_joints))
    data, ours = model.createData(), fm.acceleration(rigid, rigid.initial_state(q, v), torque)
    assert np.allclose(pin.aba(model, data, q, v, torque), ours, rtol=1e-9), "the rigid arms accelerate differently"
    return timer(lambda: [pin.aba(model, data, q, v, torque) for _ in range(count)], count, BATCHES)


def timers() -> dict[str, Timer]:
    """Return the timers of all evaluations of the dynamics, after a warm-up."""
    arm, result = fm.catalog.paper_rrr(link1_area="corrected"), {}
    rigid, modal = fm.build_model(arm, flexible_links=False, flexible_joints=False), fm.build_model(arm, modes=5)
    try:
        result[ABA] = _pinocchio_aba(arm, rigid)
    except ImportError:
        print("Pinocchio is missing, so evaluations have no peer: pip install pin")
    models = {"rigid links": rigid, "5 modes a link": modal, "12 coordinates a link": fm.build_model(arm)}
    result |= {f"evaluation, {name}": _evaluation(model) for name, model in models.items()}
    result |= _switches(arm)
    state, torque = modal.initial_state((0.1, 0.2, 0.3)), np.ones(3)
    result["fm.acceleration, 5 modes, from Python"] = timer(lambda: fm.acceleration(modal, state, torque), 1, BATCHES)
    return result


def evaluation_rows(rounds: int) -> list[BenchmarkRow]:
    """Measure the evaluations of the dynamics and return their rows."""
    costs, result = in_turns(timers(), rounds), []
    for name, cost in costs.items():
        cpu, wall, _ = np.median(cost, axis=0)
        peer = PLAIN if name.startswith(" ") else ABA
        times = float(np.median(cost[:, 0] / costs[peer][:, 0])) if peer in costs else None
        compared = peer if times else "", times
        result.append(BenchmarkRow(EVALUATIONS, name.strip(), None, None, float(cpu), float(wall), *compared))
    return result


ARMS, CALLS = (1, 64), 400
WHOLE, HANDED = "a step of the vector environment", "an empty task for another thread, and back"


def part_rows(rounds: int, arms: Sequence[int] = ARMS, calls: int = CALLS) -> list[BenchmarkRow]:
    """Measure the parts of a step for each number of arms, each repeated in isolation, and return their rows.

    The remaining parts of a step check actions and limits and copy results. The last row is the overhead of a second
    thread, for which the wall-clock time is relevant.
    """
    parts = {(name, count): call for count in arms for name, call in _calls(count).items()}
    helper = WorkerThread()

    def handed() -> None:
        helper.begin(_nothing)
        helper.finish()

    timers = {f"{name} {count}": timer(repeated(call, calls), calls) for (name, count), call in parts.items()}
    timers[HANDED] = timer(repeated(handed, calls), calls)
    costs = [np.median(cost, axis=0) for cost in in_turns(timers, rounds).values()]
    heads = [*((name, float(count), 1.0) for name, count in parts), (HANDED, None, 2.0)]
    return [BenchmarkRow(PARTS, *head, float(cost[0]), float(cost[1])) for head, cost in zip(heads, costs, strict=True)]


def _calls(arms: int) -> dict[str, Callable[[], object]]:
    """Return the calls that make up a step of a vector environment whose arms are at rest, by name."""
    env = FlexManVectorEnv(arms)
    env.reset(seed=0)
    episodes, view = env.episodes, env.episodes.view
    action, drive = np.zeros(env.action_space.shape or ()), np.zeros((arms, episodes.batch.model.n_joints + 6))

    def info() -> None:
        episodes.clear_cache()
        episodes.info()

    return {
        WHOLE: lambda: env.step(action),
        "moving the arms": lambda: episodes.batch.step(drive),
        "reading the motion": view.read,
        "sensors": episodes.sensors.read,
        "rewards and info": info,
    }


def _nothing() -> None:
    pass
