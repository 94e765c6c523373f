"""Integrator of one arm: an integration method with a model and scratch arrays, and checks of step and tolerances."""

import math
from collections.abc import Collection, Iterator, Sequence
from functools import partial

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import one_of, positive
from flexman_gym.common.errors import value_error
from flexman_gym.kernels import batch, layout, outputs, runge_kutta
from flexman_gym.kernels.arguments import SequenceTables, address_tables, aligned_zeros
from flexman_gym.kernels.lanes import SEQUENCES
from flexman_gym.kernels.layout import Constants, IntArray, StepGrid, TimeGrid, Work, make_work, step_method
from flexman_gym.model.model import Model
from flexman_gym.scene.signals import signal_table
from flexman_gym.simulation.methods import METHODS, FixedStepMethod, LinearlyImplicit, Method, ScipyMethod

MAX_CALL_COST = 1e8  # flops, roughly; largest cost of a kernel call, at most 0.1 s
LANE_COST_RATIO = 4  # upper bound of the cost of an evaluation of ARMS_PER_GROUP arms relative to a single arm
MAX_STEPS = 100_000  # largest number of steps between two outputs, or in a control period
DEFAULT_MAX_STEP = 0.005  # s; longest step selected automatically


def evaluations_per_call(constants: Constants) -> int:
    """Return the number of evaluations of the accelerations after which a kernel call ends or pauses.

    The cost of an evaluation is estimated as the sum over the links of (k_i + 6)^3 for k_i elastic coordinates.
    """
    sides = np.diff(constants.elastic_start) + 6.0
    return max(1, int(MAX_CALL_COST / (sides**3).sum()))


def step_ranges(method: FixedStepMethod, count: int, most: int) -> Iterator[tuple[int, int]]:
    """Yield first and end index of the steps of kernel calls of at most `most` steps, for `count` fixed steps.

    Zero steps are one call, which computes the outputs at the start, see `kernels.batch.run_steps`.
    """
    first, end = (method.first_step, count) if count else (0, 1)
    for start in range(first, end, most):
        yield start, min(start + most, end)


# Least numbers of sequences of an extrapolation method for which SIMD lanes are faster: flexible and rigid arms.
MIN_SEQUENCES, MIN_SEQUENCES_RIGID = 4, 6


def find_method(method: object) -> Method:
    """Return the method of a name, or the method itself."""
    return method if isinstance(method, Method) else METHODS[one_of("method", method, METHODS)]


def find_tolerance(method: Method, step: float | None, rtol: float, atol: float) -> tuple[float, float] | None:
    """Return rtol and atol for adaptive steps, or None for fixed steps.

    Args:
        method: the method.
        step: s; None lets the method choose.
        rtol: relative tolerance of the local error.
        atol: absolute tolerance of the local error, in the unit of each coordinate or speed.

    Raises:
        ValueError: for a tolerance <= 0, and for step None if the method has fixed steps only.
    """
    given = positive("rtol", rtol), positive("atol", atol)
    if step is None and not method.estimates:
        raise value_error("step", None, f"a number > 0 (s): {method.name} has fixed steps only")
    return given if step is None or method.adaptive else None


def default_step(control_period: float, longest: float = DEFAULT_MAX_STEP) -> float:
    """Return the longest step (s), up to `longest`, of which the control period (s) is a whole multiple."""
    return control_period / max(1, math.ceil(control_period / longest - 1e-9))


def with_prescribed(constants: Constants, joints: Collection[int], rotates: bool = False) -> Constants:
    """Return the constants of an arm with prescribed motions.

    Args:
        constants: constants of the arm.
        joints: indices, from 0, of the joints whose motors follow prescribed accelerations.
        rotates: True for a base with prescribed rotation.
    """
    flags = np.isin(np.arange(len(constants.prescribed)), list(joints))
    return constants._replace(prescribed=flags.astype(np.int64), rotating=np.array([int(rotates)]))


def _extrapolation_schedule(sequence: Sequence[int], lanes: int) -> IntArray:
    """Return the schedule (r, lanes, 2) of an extrapolated step: sequence and substep of each lane in each of r rounds.

    An idle SIMD lane receives the longest remaining sequence. If none remains, it repeats steps whose results are
    discarded.

    Args:
        sequence: ascending numbers of substeps.
        lanes: number of lanes.
    """
    remaining, lane = list(range(len(sequence))), [(0, sequence[0])] * lanes
    rounds: list[list[tuple[int, int]]] = []
    while remaining or any(part < sequence[number] for number, part in lane):
        for k, (number, part) in enumerate(lane):
            if remaining and part >= sequence[number]:
                lane[k] = remaining.pop(), 0
        rounds.append(lane)
        lane = [(number, part + 1) for number, part in lane]
    return np.array(rounds, dtype=np.int64)


class Integrator:
    """Integration method with a model: a callable that advances a state in place and fills rows and outputs.

    d is the number of coordinates, n the number of joints; see `kernels.layout`.

    Args:
        model: the model.
        method: the method.
        tolerance: (rtol, atol) of adaptive steps; None for fixed steps.
        prescribed: indices, from 0, of the joints whose motors follow prescribed accelerations instead of torques.
        rotates: True for a base with prescribed rotation.

    Attributes:
        constants: constants of the model, with flags of the motors with prescribed motion and of a rotating base.
        work: scratch arrays of the kernels.
        method: the method.
        tolerance: (rtol, atol) of adaptive steps; zeros for fixed steps.
    """

    def __init__(
        self, model: Model, method: Method, tolerance: tuple[float, float] | None, prescribed: Collection[int],
        rotates: bool = False,
    ) -> None:  # fmt: skip
        self.constants = with_prescribed(model.constants, prescribed, rotates)
        self.work: Work = make_work(self.constants)
        self.method = method
        self.tolerance = tolerance or (0.0, 0.0)
        self._max_evaluations = evaluations_per_call(model.constants)
        self._at_rest = signal_table([None] * (model.n_joints + 6))
        self._method = step_method() if isinstance(method, ScipyMethod) else method.kernel_arguments
        self._tableau = self._method[0] or self._method[1]
        fewest = MIN_SEQUENCES if model.n_elastic else MIN_SEQUENCES_RIGID
        self._lane_work: Work | None = None
        if isinstance(method, LinearlyImplicit) and len(method.sequence) >= fewest:
            zeros = partial(aligned_zeros, lanes=SEQUENCES.width)
            self._lane_work = make_work(self.constants, zeros)._replace(foundation=zeros((0,)))  # drive is copied
            self._schedule = _extrapolation_schedule(method.sequence, SEQUENCES.width)
        self._bound: Constants | None = None  # constants of the sequences of an extrapolation in SIMD lanes

    def __call__(
        self, drive: Array, grid: tuple[float, float, int], state: Array, rows: Array, result: Array
    ) -> tuple[int, int, int]:
        """Integrate a state over r intervals, and fill the rows and outputs at their ends.

        Args:
            drive: drive table (7, n + 6) of `kernels.layout`.
            grid: start (s), step (s), and number of steps in an interval.
            state: (2 d + 2,) state (2 d), then work and dissipation since the start, J (energy ledger), overwritten by
                the values at the end.
            rows: (r, 2 d + 2) states and energy ledgers, overwritten.
            result: (r, OUTPUTS) outputs, overwritten.

        Returns:
            Status, number of valid rows, and number of evaluations of the accelerations.
        """
        if isinstance(self.method, ScipyMethod):
            return self._by_scipy(drive, TimeGrid(*grid, *self.tolerance), state, rows, result)
        if self._lane_work is not None and self._bound is not self.constants:
            self._bound, tables = self.constants, address_tables(SequenceTables, self.constants, self._lane_work)
            self._method = step_method(sequences=(self._tableau, tables, self._schedule))
        if self.tolerance[0] > 0.0:
            return self._by_adaptive_steps(drive, TimeGrid(*grid, *self.tolerance), state, rows, result)
        return self._by_fixed_steps(self.method, drive, StepGrid(*grid), state, rows, result)

    # Integration takes several kernel calls of bounded length: Python handles Ctrl-C only between two calls.
    def _by_fixed_steps(
        self, method: FixedStepMethod, drive: Array, grid: StepGrid, state: Array, rows: Array, result: Array
    ) -> tuple[int, int, int]:
        """Integrate by fixed steps."""
        status, counts = np.zeros(1, dtype=np.int64), np.zeros((1, 2), dtype=np.int64)
        given = (self.constants, self.work), self._method, drive[None], grid
        moved, most = (state[None], rows[None], result[None]), max(1, self._max_evaluations // method.evaluations)
        for steps in step_ranges(method, len(rows) * grid.substeps, most):
            batch.run_steps(*given, steps, moved, status, counts)
            if status[0] != layout.OK:
                break
        valid = int(counts[0, 0]) // grid.substeps if grid.substeps else len(rows)
        return int(status[0]), valid, int(counts[0, 1])

    def _by_adaptive_steps(
        self, drive: Array, clock: TimeGrid, state: Array, rows: Array, result: Array
    ) -> tuple[int, int, int]:
        """Integrate by steps whose lengths follow the estimated error."""
        valid, evaluations, status = 0, 0, layout.PAUSED
        self.work.progress[:] = 0.0  # an integration interrupted by Ctrl-C leaves it set
        while status == layout.PAUSED:
            part = clock._replace(first_row=valid, max_evaluations=self._max_evaluations)
            status, good, more = runge_kutta.run_adaptive(
                self.constants, self.work, self._method, self._tableau, drive, part, state, rows[valid:], result[valid:]
            )
            valid, evaluations = valid + good, evaluations + more
        return status, valid, evaluations

    def forget(self) -> None:
        """Clear the step size and stages that the method keeps between steps."""
        self.work.next_step[0] = self.work.stages[:] = 0.0

    def start(self, state: Array, row: Array, result: Array, drive: Array | None = None) -> None:
        """Set a row and its outputs to values for a state, by zero steps; this also loads or compiles the kernels.

        `drive` is the drive table of a rotating base, else None.
        """
        self.forget()
        self(self._at_rest if drive is None else drive, (0.0, 0.0, 0), state, row[None], result[None])

    def _by_scipy(
        self, drive: Array, clock: TimeGrid, state: Array, rows: Array, result: Array
    ) -> tuple[int, int, int]:
        """Integrate by SciPy's Radau method, which computes the Jacobian by finite differences."""
        from scipy.integrate import solve_ivp  # slow import for a rarely used method

        d, times = len(state) // 2 - 1, clock.time + clock.step * clock.substeps * np.arange(1.0, len(rows) + 1.0)
        valid, evaluations = len(rows), 0
        if clock.substeps > 0:

            def derivative(time: float, values: Array) -> Array:
                out, values = np.zeros(len(values)), np.ascontiguousarray(values)  # columns in differences
                runge_kutta.state_derivative(self.constants, self.work, drive, time, values, out)
                return out

            span = (clock.time, times[-1])
            done = solve_ivp(derivative, span, state, "Radau", times, rtol=clock.rtol, atol=clock.atol)
            valid, evaluations = len(done.t), done.nfev
            rows[:valid] = done.y.T
        else:
            rows[:] = state
        rates = np.zeros(len(state))
        for time, row, out in zip(times, rows[:valid], result, strict=False):
            if self.constants.rotating[0]:  # sets the motion of the base
                runge_kutta.state_derivative(self.constants, self.work, drive, time, row, rates)
            outputs.compute_outputs(self.constants, self.work, row[:d], row[d : 2 * d], out)
        if valid:
            state[:] = rows[valid - 1]
        bounded = bool((np.abs(state[: 2 * d]) <= layout.LARGEST_STATE).all())
        status = layout.OK if valid == len(rows) else layout.NOT_CONVERGED
        return (status if bounded else layout.DIVERGED), valid, evaluations
