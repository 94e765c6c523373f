"""Costs of exact derivatives, and of central differences, in units of a simulation."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import flexman_gym as fm
from flexman_gym.common.arrays import Array
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.evaluation.rollouts import TEST_SEEDS
from flexman_gym.kernels.layout import ARMS_PER_GROUP, OFFSET, OUTPUTS, StepGrid
from flexman_gym.scene.signals import signal_table
from flexman_gym.simulation.batch_integrators import LaneIntegrator
from flexman_gym.simulation.integrator import Integrator, find_method
from flexman_gym.simulation.methods import IteratedGauss
from flexman_gym.simulation.period_map import PeriodMap, TangentIntegrator
from studies.stopwatch import Timer, in_turns, repeated, timer

ROUNDS = 60
ROLLED, SEVEN = "rollout of 1 s", "rollout with seven derivatives"
PERIOD, JACOBIANS = "control period of a rollout", "control period with its Jacobians A and B"
DIFFERENCES = "central differences of a {}, eight arms at once"
EPISODE, GAINS = "episode of a PD", "episode with its derivatives by six gains"


def _timers() -> dict[str, tuple[Timer, str]]:
    """Return timers of motions of the arm of FlexRRR-v0 with and without derivatives, each with its peer.

    A rollout starts with initial speeds. The Jacobians of a control period are those by the state and the torques.
    """
    setup, periods = Configuration(), 50
    model, name, step, _ = resolve_fidelity(setup)
    method, size, n = find_method(name), 2 * model.n_dof, model.n_joints
    assert isinstance(method, IteratedGauss)  # the default method
    grid = 0.0, step, round(setup.control_period / step)
    table = signal_table([None] * (n + 6))
    table[OFFSET, :n] = 0.3 * np.array(setup.torque_limit)
    start = np.append(model.initial_state((0.3, -0.2, 0.5), (0.2, 0.1, -0.1)), (0.0, 0.0))

    def plain(rows: int) -> Callable[[], object]:
        integrator, states, outputs = Integrator(model, method, None, ()), *_records(1, rows, size)
        return lambda: integrator(table, grid, start.copy(), states[0], outputs[0])

    def lanes(arms: int, rows: int, tangents: bool) -> Callable[[], object]:
        period, (states, outputs) = (setup.control_period, grid[2]), _records(arms, rows, size)
        tables, begun, status = np.tile(table, (arms, 1, 1)), np.tile(start, (arms, 1)), np.zeros(arms, dtype=np.int64)
        integrator = LaneIntegrator(model.constants, method, period, arms, 1)
        if tangents:
            integrator = TangentIntegrator(model.constants, method, period, arms // ARMS_PER_GROUP)
            begun[1:], tables[1:] = np.eye(arms - 1, size + 2), np.zeros_like(table)
        return lambda: integrator.run(tables, StepGrid(*grid), rows, (begun.copy(), states, outputs), status)

    directions = np.eye(size + n, size + 2), np.eye(size + n, n + 6, -size)
    mapped = PeriodMap(model, method, (setup.control_period, grid[2]), [{}] * (size + n))
    calls = {
        ROLLED: (plain(periods), 1, ROLLED), SEVEN: (lanes(ARMS_PER_GROUP, periods, True), 1, ROLLED),
        DIFFERENCES.format(ROLLED): (lanes(2 * (ARMS_PER_GROUP - 1), periods, False), 1, ROLLED),
        PERIOD: (plain(periods), periods, PERIOD),
        JACOBIANS: (repeated(lambda: mapped.advance(start, table[OFFSET], *directions), periods), periods, PERIOD),
        DIFFERENCES.format(PERIOD): (repeated(lanes(2 * (size + n), 1, False), periods), periods, PERIOD),
    }  # fmt: skip
    return {name: (timer(call, count), peer) for name, (call, count, peer) in calls.items()}


def _records(arms: int, rows: int, size: int) -> tuple[Array, Array]:
    """Return empty records of states with energy ledgers, and of outputs, of a number of rows."""
    return np.zeros((arms, rows, size + 2)), np.zeros((arms, rows, OUTPUTS))


def _episode_timers() -> dict[str, tuple[Timer, str]]:
    """Return timers of an episode with and without the derivatives by the six gains of its PD."""
    world, to = Configuration(), ("stiffness", "damping")
    return {
        EPISODE: (timer(lambda: fm.rollout("pd", world, TEST_SEEDS[:1]), 1), EPISODE),
        GAINS: (timer(lambda: fm.sensitivities(world, "return", to, agent="pd"), 1), EPISODE),
    }


@dataclass(frozen=True)
class CostRow:
    """Cost of a computation.

    Attributes:
        name: computation.
        peer: simulation to which it is compared.
        least, median: CPU time, s; least and median of the rounds.
        times_least: ratio of the least CPU time to that of the peer.
        times_median: median over the rounds of the ratio of CPU times.
    """

    name: str
    peer: str
    least: float
    median: float
    times_least: float
    times_median: float


def cost_rows(rounds: int = ROUNDS) -> list[CostRow]:
    """Measure derivatives and differences in turns with simulations, and return their rows."""
    timers = _timers() | _episode_timers()
    every = in_turns({name: each for name, (each, _) in timers.items()}, rounds)
    costs, result = {name: each[:, 0] for name, each in every.items()}, []
    for name, (_, peer) in timers.items():
        own, other = costs[name], costs[peer]
        ratios = float(own.min() / other.min()), float(np.median(own / other))
        result.append(CostRow(name, peer, float(own.min()), float(np.median(own)), *ratios))
    return result
