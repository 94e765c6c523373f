"""Integrator of one arm: a method bound to a model and its work space, with the checks of step and tolerance."""

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import one_of, positive, value_error
from flexman_gym.kernels import implicit, layout, outputs, runge_kutta
from flexman_gym.kernels.arguments import address_table, aligned_zeros
from flexman_gym.kernels.lanes import SEQUENCES
from flexman_gym.kernels.layout import Constants, GeneralisedAlpha, IntArray, Tableau, TimeGrid, Work, make_work
from flexman_gym.model.model import Model
from flexman_gym.scene.signals import signal_table
from flexman_gym.simulation.methods import (
    METHODS,
    Explicit,
    Implicit,
    IteratedGauss,
    LinearlyImplicit,
    Method,
    ScipyMethod,
)

MAX_CALL_COST = 1e8  # of one call, in entries of matrices to the power of 3 / 2: a tenth of a second at most
LANE_COST_RATIO = 4  # times as long takes an evaluation of ARMS_ABREAST arms, at most, as one of one arm


def evaluations_per_call(constants: Constants) -> int:
    """Gives after how many evaluations of a model's accelerations a call ends or pauses.

    An evaluation costs about as much as the matrices of its links have entries, to the power of 3 / 2.
    """
    sides = np.diff(constants.elastic_start) + 6.0
    return max(1, int(MAX_CALL_COST / (sides**3).sum()))


def chunks(count: int, most: int) -> Iterator[tuple[int, int]]:
    """Gives the first and the number of each piece, of at most `most`, of a count."""
    for first in range(0, count, most):
        yield first, min(most, count - first)


MAX_STEPS = 100_000  # between two outputs, and in a control period
DEFAULT_MAX_STEP = 0.005  # s, where none is named
# The kernel of each family; SciPy runs the others.
KERNELS: dict[type, Callable[..., tuple[int, int, int]]] = {
    Explicit: runge_kutta.run_explicit,
    LinearlyImplicit: runge_kutta.run_linearly_implicit,
    Implicit: implicit.run_implicit,
    IteratedGauss: implicit.run_fixed_newton,
}
# Sequences of an extrapolation from which on it pays to run them side by side, of an arm that bends and of a rigid one.
MIN_SEQUENCES, MIN_SEQUENCES_RIGID = 4, 6


def find_method(method: object) -> Method:
    """Gives the method of a name, or the method itself.

    Raises:
        ValueError: for another name; it lists the names.
    """
    return method if isinstance(method, Method) else METHODS[one_of("method", method, METHODS)]


def find_tolerance(method: Method, step: float | None, rtol: float, atol: float) -> tuple[float, float] | None:
    """Gives rtol and atol of a method that chooses its steps, or None for a method with fixed steps.

    Args:
        method: the method.
        step: s; None lets the method choose.
        rtol: relative local error.
        atol: absolute local error.

    Raises:
        ValueError: for a tolerance that is not > 0, and for no step where the method takes fixed steps.
    """
    given = positive("rtol", rtol), positive("atol", atol)
    if step is None and not method.estimates:
        raise value_error("step", None, f"a number > 0 (s): {method.name} takes fixed steps")
    return given if step is None or method.adaptive else None


def default_step(control_period: float, longest: float = DEFAULT_MAX_STEP) -> float:
    """Gives the longest step (s) up to a `longest` one that divides a control period (s)."""
    return control_period / max(1, math.ceil(control_period / longest - 1e-9))


def prescribed_flags(joints: int, prescribed: Collection[int]) -> IntArray:
    """Gives 1 where the motion of a joint's motor is prescribed and 0 elsewhere, (joints,)."""
    return np.isin(np.arange(joints), list(prescribed)).astype(np.int64)


def extrapolation_schedule(sequence: Sequence[int], lanes: int) -> IntArray:
    """Gives what each lane does of an extrapolated step in each round (r, lanes, 2): a sequence, and its next part.

    A lane that is free takes the longest sequence that is left; when none is left it goes past the end of its last.

    Args:
        sequence: ascending numbers of parts.
        lanes: how many there are.
    """
    left, lane = list(range(len(sequence))), [(0, sequence[0])] * lanes
    rounds: list[list[tuple[int, int]]] = []
    while left or any(part < sequence[number] for number, part in lane):
        for k, (number, part) in enumerate(lane):
            if left and part >= sequence[number]:
                lane[k] = left.pop(), 0
        rounds.append(lane)
        lane = [(number, part + 1) for number, part in lane]
    return np.array(rounds, dtype=np.int64)


class Integrator:
    """A method bound to a model, as a call that advances a state in place and fills rows and outputs.

    The arguments of a call are the table of the drive (7, n + 6), time, step and substeps, a state with its ledger (2 d
    + 2,), rows (r, 2 d + 2) and outputs (r, OUTPUTS). It returns the status, the number of valid rows and the number of
    evaluations.

    Attributes:
        constants: of the model, with the prescribed motions.
        work: the work space of the kernels.
        method: the method.
        tolerance: (rtol, atol) by which the method chooses its steps; zeros hold it to the given step.
    """

    def __init__(
        self, model: Model, method: Method, tolerance: tuple[float, float] | None, prescribed: Collection[int]
    ) -> None:
        self.constants = model.constants._replace(prescribed=prescribed_flags(model.n_joints, prescribed))
        self.work: Work = make_work(model.constants)
        self.method = method
        self.tolerance = tolerance or (0.0, 0.0)
        self._most = evaluations_per_call(model.constants)
        self._at_rest = signal_table([None] * (model.n_joints + 6))
        self._coefficients: Tableau | GeneralisedAlpha | tuple[int, int | None] | None = None
        if isinstance(method, Implicit):
            self._coefficients = method.averages
        elif isinstance(method, IteratedGauss):
            self._coefficients = method.counts
        elif not isinstance(method, ScipyMethod):
            self._coefficients = method.tableau
        self._lanes: tuple[Constants, tuple[IntArray, ...]] | None = None
        least = MIN_SEQUENCES if model.n_elastic else MIN_SEQUENCES_RIGID
        if isinstance(method, LinearlyImplicit) and len(method.sequence) >= least:
            self._abreast = make_work(model.constants, partial(aligned_zeros, lanes=SEQUENCES.width))
            tables = address_table(self.constants, SEQUENCES), address_table(self._abreast, SEQUENCES)
            self._lanes = self.constants, (*tables, extrapolation_schedule(method.sequence, SEQUENCES.width))

    def __call__(
        self, drive: Array, moment: tuple[float, float, int], state: Array, rows: Array, result: Array
    ) -> tuple[int, int, int]:
        """Integrate the state by the method; return the status, the valid rows and the evaluations."""
        clock = TimeGrid(*moment, *self.tolerance)
        if isinstance(self.method, ScipyMethod):
            return self._by_scipy(drive, clock, state, rows, result)
        return self._in_calls(drive, clock, state, rows, result)

    def _in_calls(
        self, drive: Array, clock: TimeGrid, state: Array, rows: Array, result: Array
    ) -> tuple[int, int, int]:
        """Calls the kernel, a long run in parts: Python looks for Ctrl-C between two calls only."""
        valid, evaluations, status = 0, 0, layout.PAUSED
        self.work.progress[:] = 0.0  # of a run that Ctrl-C ended
        while status == layout.PAUSED:
            part = clock._replace(first_step=valid * clock.substeps, max_evaluations=self._most)
            status, good, more = self._called(drive, part, state, rows[valid:], result[valid:])
            valid, evaluations = valid + good, evaluations + more
        return status, valid, evaluations

    def _called(self, *rest: Any) -> tuple[int, int, int]:
        """Calls the kernel of the method; one of many sequences has them side by side in the lanes."""
        rest = self._coefficients, *rest
        if self._lanes is None:
            return KERNELS[type(self.method)](self.constants, self.work, *rest)
        if self._lanes[0] is not self.constants:
            self._lanes = self.constants, (address_table(self.constants, SEQUENCES), *self._lanes[1][1:])
        return runge_kutta.run_extrapolation(self.constants, self.work, self._lanes[1], *rest)

    def forget(self) -> None:
        """Forgets what the method remembers from step to step."""
        self.work.next_step[0] = self.work.stages[:] = 0.0

    def start(self, state: Array, row: Array, result: Array) -> None:
        """Records the state as it is, by a run of no steps, which also loads or compiles the kernels."""
        self.forget()
        self(self._at_rest, (0.0, 0.0, 0), state, row[None], result[None])

    def _by_scipy(
        self, drive: Array, clock: TimeGrid, state: Array, rows: Array, result: Array
    ) -> tuple[int, int, int]:
        """Advances the state by SciPy's Radau method, which differentiates the slopes numerically."""
        from scipy.integrate import solve_ivp  # its import takes long, and few use this method

        d, times = len(state) // 2 - 1, clock.time + clock.step * clock.substeps * np.arange(1.0, len(rows) + 1.0)
        valid, evaluations = len(rows), 0
        if clock.substeps > 0:

            def slope(time: float, values: Array) -> Array:
                out = np.zeros(len(values))
                runge_kutta.state_derivative(self.constants, self.work, drive, time, values, out)
                return out

            span = (clock.time, times[-1])
            done = solve_ivp(slope, span, state, "Radau", times, rtol=clock.rtol, atol=clock.atol)
            valid, evaluations = len(done.t), done.nfev
            rows[:valid] = done.y.T
        else:
            rows[:] = state
        for row, out in zip(rows[:valid], result, strict=False):
            outputs.compute_outputs(self.constants, self.work, row[:d], row[d : 2 * d], out)
        if valid:
            state[:] = rows[valid - 1]
        bounded = bool((np.abs(state[: 2 * d]) <= layout.LARGEST_STATE).all())
        status = layout.OK if valid == len(rows) else layout.NOT_CONVERGED
        return (status if bounded else layout.DIVERGED), valid, evaluations
