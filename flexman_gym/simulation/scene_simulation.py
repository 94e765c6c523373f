"""Simulation of scenes: one scene, or several scenes of one model together.

The inputs of a scene (torques, prescribed motions, tip force, base acceleration) are smooth within pieces, such as the
time between two samples; no integration step crosses the boundary of two pieces.
"""

import math
import time as clock
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, IntArray
from flexman_gym.common.checks import (
    RATIO_TOLERANCE,
    check_magnitudes,
    instance,
    positive,
    sequence,
    vector,
    whole_number,
    whole_ratio,
)
from flexman_gym.common.errors import value_error
from flexman_gym.kernels import layout
from flexman_gym.kernels.layout import STATUS, StepGrid
from flexman_gym.kernels.outputs import tip_accelerations as compute_tip_accelerations
from flexman_gym.kernels.runge_kutta import state_derivative
from flexman_gym.model.loads import FrameMotion
from flexman_gym.model.model import Model, check_model, scene_model
from flexman_gym.scene.scene import Scene
from flexman_gym.scene.signals import PiecewiseSignals
from flexman_gym.simulation.batch import MAX_ARMS, MAX_THREADS
from flexman_gym.simulation.batch_integrators import LaneIntegrator
from flexman_gym.simulation.diagnostics import explain_bending, explain_energy, explain_failure
from flexman_gym.simulation.foundation import base_rotation, scene_pieces
from flexman_gym.simulation.integrator import MAX_STEPS, Integrator, find_method, find_tolerance, with_prescribed
from flexman_gym.simulation.methods import DEFAULT_METHOD, Method, ScipyMethod
from flexman_gym.simulation.physical_parameters import varied_constants
from flexman_gym.simulation.trajectory import Trajectory

TIP_ACCELERATIONS = {  # name of a component -> column of `tip_accelerations`
    f"{name}_{axis}": part.start + i
    for name, part in (("tip_acceleration", layout.TIP_ACCELERATION), ("specific_force", layout.SPECIFIC_FORCE))
    for i, axis in enumerate("xyz")
}


class _Interval(NamedTuple):
    """Time interval of a simulation within one piece of the drive.

    Attributes:
        piece: index of the piece.
        row: number of whole output intervals before its start.
        rows: number of whole output intervals in this interval; 0 where it is shorter than an output interval.
        grid: start (s), step (s), and number of steps in an output interval, or in this interval where `rows` is 0.
        complete: True if an output is due at the end of the interval.
    """

    piece: int
    row: int
    rows: int
    grid: tuple[float, float, int]
    complete: bool


def _integration_intervals(
    pieces: PiecewiseSignals, interval: float, substeps: int, rows: range
) -> Iterator[_Interval]:
    """Divide a range of output intervals at the boundaries of the pieces of a drive.

    A part shorter than an output interval has equal steps, none longer than the steps of a whole output interval.

    Args:
        pieces: the drive.
        interval: time between outputs, s.
        substeps: steps in an output interval.
        rows: indices of the output intervals, from 0 at time 0.

    Yields:
        The intervals in order.
    """
    ends = pieces.times / interval  # in intervals; whole numbers at outputs
    whole = np.round(ends)
    ends = np.where(np.abs(ends - whole) <= RATIO_TOLERANCE * np.maximum(whole, 1.0), whole, ends)
    for piece, (start, end) in enumerate(pairwise(np.minimum(ends, rows.stop).tolist())):
        now = max(start, float(rows.start))
        while now < end:
            row = math.floor(now)
            count = math.floor(end) - row if now == row else 0
            then = row + count if count else min(end, row + 1.0)
            if count:
                grid = row * interval, interval / substeps, substeps
            else:
                steps = max(1, math.ceil(substeps * (then - now) * (1.0 - RATIO_TOLERANCE)))
                grid = now * interval, (then - now) * interval / steps, steps
            yield _Interval(piece, row, count, grid, then == math.floor(then))
            now = then


def _run_pieces(
    integrator: Integrator,
    pieces: PiecewiseSignals,
    spacing: tuple[float, int],
    state: Array,
    rows: Array,
    outputs: Array,
    first: int = 0,
) -> tuple[int, int, int, tuple[Array, tuple[float, float, int], Array]]:
    """Integrate a state piece by piece, and fill rows and outputs.

    Args:
        integrator: the integrator.
        pieces: pieces of the drive.
        spacing: time between rows (s), and number of steps in this time.
        state: (2 d + 2,) state and energy ledger (work and dissipation since the start, J), overwritten by the values
            at the end.
        rows: (r, 2 d + 2) states and energy ledgers after each interval, overwritten.
        outputs: (r, OUTPUTS) columns of `kernels.layout`, overwritten.
        first: number of output intervals before the start.

    Returns:
        Status, number of valid rows, number of evaluations, and the arguments of the last call of the integrator: drive
        table, time grid and state.
    """
    row, result = np.zeros((1, len(state))), np.zeros((1, layout.OUTPUTS))
    status, valid, evaluations, last_call = layout.OK, 0, 0, (pieces.table(), (0.0, *spacing), state.copy())
    for call in _integration_intervals(pieces, *spacing, range(first, first + len(rows))):
        last_call, at = (pieces.table(call.piece), call.grid, state.copy()), call.row - first
        some = slice(at, at + call.rows)
        new_rows, new_outputs = (rows[some], outputs[some]) if call.rows else (row, result)
        status, valid_rows, more = integrator(last_call[0], call.grid, state, new_rows, new_outputs)
        evaluations += more
        valid = at + valid_rows if call.rows or call.complete else valid
        if call.complete and not call.rows and status == layout.OK:
            rows[at], outputs[at] = row[0], result[0]
        if status != layout.OK:
            break
    return status, valid, evaluations, last_call


def simulate(
    scene: Scene,
    model: Model | None = None,
    method: str | Method = "auto",
    step: float | None = None,
    rtol: float = 1e-6,
    atol: float = 1e-9,
) -> Trajectory:
    """Simulate a scene.

    Args:
        scene: arm, inputs, initial state and duration.
        model: a model of the scene's arm; None builds the model specified by the scene.
        method: a Method or a name from `METHODS`. "auto" selects "midpoint_corrected_3" if a step is given and the
            reference method "dop853" otherwise.
        step: integration step, s. It divides the output step of the scene into at most 100000 steps, or is a multiple
            of the output step; then there is an output after every step. Steps that contain a sample of an input are
            divided there. None lets a method with an error estimate choose its steps. A reference method always chooses
            its steps, and `step` is its first guess.
        rtol: relative tolerance of the local error of adaptive steps.
        atol: absolute tolerance of the local error of adaptive steps, in the unit of each coordinate or speed.

    Returns:
        The trajectory at the output times. After a failure its status is not "ok"; no exception is raised.

    Examples:
        >>> trajectory = fm.simulate(fm.catalog.paper_scene("ff"), method="midpoint_corrected_3", step=0.005)
        >>> trajectory.status, trajectory.tip.shape, trajectory.tip[-1].round(1)
        ('ok', (201, 3), array([ 1.1,  2.1, -0.6]))
    """
    return _SceneRun(scene, scene_settings(scene, model, method, step, rtol, atol), {}).simulate()


class _Settings(NamedTuple):
    """Model, method and steps of the simulation of a scene.

    Attributes:
        model, method: the model and the Method.
        tolerance: (rtol, atol), or None for fixed steps.
        interval: time between outputs, s.
        substeps: number of steps between outputs.
        rows: number of outputs after the output at time 0.
    """

    model: Model
    method: Method
    tolerance: tuple[float, float] | None
    interval: float
    substeps: int
    rows: int


def scene_settings(
    scene: Scene, model: Model | None, method: str | Method, step: float | None, rtol: float, atol: float
) -> _Settings:
    """Check the arguments of `simulate` and return its settings."""
    instance("scene", scene, Scene, "a Scene")
    model = scene_model(scene) if model is None else check_model(model)
    if model.n_joints != scene.arm.n_joints:
        raise value_error(
            "model", f"{model.n_joints} joints", f"a model of the scene's arm, {scene.arm.n_joints} joints"
        )
    automatic = "dop853" if step is None else DEFAULT_METHOD
    chosen = find_method(automatic if isinstance(method, str) and method == "auto" else method)
    interval, substeps = _output_interval(chosen, step, scene.output_step)
    rows = whole_ratio("step", interval, scene.duration, "a number of seconds that divides the duration")
    return _Settings(model, chosen, find_tolerance(chosen, step, rtol, atol), interval, substeps, rows)


def initial_row(scene: Scene, model: Model) -> Array:
    """Return the initial state (2 d) of a scene, followed by zero work and dissipation, as an array (2 d + 2,)."""
    state = scene.initial.state
    if state is None:
        state = model.initial_state(scene.initial.joint_angles, scene.initial.joint_rates)
    else:
        check_magnitudes("Initial.state", vector("Initial.state", state, 2 * model.n_dof), layout.LARGEST_STATE)
    return np.append(state, [0.0, 0.0])


class _SceneRun(NamedTuple):
    """Scene with the settings of its simulation, and constants that replace those of the model, by name."""

    scene: Scene
    settings: _Settings
    constants: Mapping[str, Any]

    def simulate(self) -> Trajectory:
        """Simulate the scene."""
        (model, _, _, interval, substeps, rows), pieces = self.settings, scene_pieces(self.scene)
        integrator, state = self.integrator(), initial_row(self.scene, model)
        states, outputs = np.zeros((rows + 1, len(state))), np.zeros((rows + 1, layout.OUTPUTS))
        integrator.start(state, states[0], outputs[0], pieces.table() if self.scene.rotates else None)
        started = clock.perf_counter()
        status, valid, evaluations, _ = _run_pieces(
            integrator, pieces, (interval, substeps), state, states[1:], outputs[1:]
        )
        outcome = STATUS[status], evaluations, clock.perf_counter() - started
        return self.trajectory(states[: valid + 1], outputs[: valid + 1], outcome)

    def integrator(self) -> Integrator:
        """Return a new integrator of the scene."""
        model, method, tolerance, *_ = self.settings
        integrator = Integrator(model, method, tolerance, self.scene.prescribed_joints, self.scene.rotates)
        integrator.constants = integrator.constants._replace(**self.constants)
        return integrator

    def trajectory(self, states: Array, outputs: Array, outcome: tuple[str, int, float]) -> Trajectory:
        """Return the trajectory of a simulation; arguments as in `Trajectory.from_rows`."""
        settings = self.settings
        return Trajectory.from_rows(
            settings.model, settings.interval, states, outputs, outcome, self.explanation, self.kinetics
        )

    def explanation(self, result: Trajectory) -> str:
        """Return lines on a failure, an energy alarm and large bending of a trajectory; "" without any of them."""
        integrator, (model, _, _, interval, substeps, _) = self.integrator(), self.settings
        if result.status != STATUS[layout.OK]:
            last = np.append(result.states[-1], [result.work[-1], result.dissipation[-1]])
            row, rows, outputs = len(result.time) - 1, np.zeros((1, len(last))), np.zeros((1, layout.OUTPUTS))
            again = _run_pieces(integrator, scene_pieces(self.scene), (interval, substeps), last, rows, outputs, row)
            return explain_failure(self.integrator(), model, *again[3], result.status)
        alarm = result.energy_alarm()
        before = result.states[result.time <= (alarm or 0.0)]
        energy = "" if alarm is None else explain_energy(model, integrator, interval / substeps, alarm, before)
        return "\n".join(filter(None, (energy, explain_bending(model, result.states))))

    def kinetics(self, result: Trajectory) -> FrameMotion:
        """Return the motion of the frames in a trajectory of the scene; at a jump of the inputs, after the jump."""
        integrator, size, pieces = self.integrator(), result.states.shape[1], scene_pieces(self.scene)
        rates, accelerations, drives = np.zeros(size + 2), [], []
        for time, state in zip(result.time, result.states, strict=True):
            piece = min(int(np.searchsorted(pieces.times, time, side="right")), len(pieces.times) - 1) - 1
            row = np.append(state, [0.0, 0.0])
            state_derivative(integrator.constants, integrator.work, pieces.table(piece), time, row, rates)
            accelerations.append(rates[size // 2 : size].copy())
            drives.append(integrator.work.drive.copy())
        model = replace(self.settings.model, constants=integrator.constants)
        return FrameMotion(model, result.states, np.array(accelerations), np.array(drives))


def _output_interval(method: Method, step: float | None, output_step: float) -> tuple[float, int]:
    """Return the time between outputs (s) and the number of steps in this time, for a step (s) or None."""
    if step is None:
        return output_step, 1
    allowed = "a number of seconds that divides, or is a multiple of, the output step"
    step = positive("step", step, "s")
    if method.adaptive:
        return output_step, max(1, round(min(1e15, output_step / step)))
    if step <= output_step:
        return output_step, whole_ratio("step", step, output_step, allowed, MAX_STEPS)
    multiple = step / output_step
    if not multiple < 1e15 or abs(multiple - round(multiple)) > RATIO_TOLERANCE * multiple:
        raise value_error("step", step, f"{allowed}, {output_step} s")
    return step, 1


def simulate_all(
    scenes: Sequence[Scene],
    model: Model | None = None,
    method: str | Method = "auto",
    step: float | None = None,
    *,
    rtol: float = 1e-6,
    atol: float = 1e-9,
    threads: int = 1,
    **parameters: Array,
) -> list[Trajectory]:
    """Simulate b scenes of one model that may differ in torques, disturbances and initial state.

    Explicit and linearly implicit methods with fixed steps integrate eight scenes at once, in about twice the time of
    one. Other methods integrate one scene after the other, as does any method if the sample times of the scenes differ.
    Each trajectory equals the result of `simulate`, bit for bit.

    Args:
        scenes: b scenes of equal duration, output step and prescribed joints.
        model: the model of all scenes; None builds the model specified by the scenes, which must then have equal arms
            and model settings.
        method: see `simulate`.
        step: see `simulate`.
        rtol: see `simulate`.
        atol: see `simulate`.
        threads: largest number of threads, 1 to 256.
        **parameters: values (b,) or (b, n) of physical parameters that replace the values of the model, see
            `Batch.vary`.

    Examples:
        >>> scene = fm.catalog.paper_scene("rr")
        >>> both = fm.simulate_all([scene, scene], step=0.01, payload_mass=[0.0, 2.0])
        >>> [trajectory.status for trajectory in both]
        ['ok', 'ok']
    """
    scenes = list(sequence("scenes", scenes))
    if not 0 < len(scenes) <= MAX_ARMS:
        raise value_error("scenes", f"{len(scenes)} scenes", f"1 to {MAX_ARMS}")
    whole_number("threads", threads, 1, MAX_THREADS)
    settings = scene_settings(scenes[0], model, method, step, rtol, atol)
    for i, scene in enumerate(scenes):
        _check_compatible(f"scenes[{i}]", scene, scenes[0], model is None)
    varied = varied_constants(settings.model, len(scenes), parameters)
    lanes = settings.method.in_lanes and settings.tolerance is None
    lanes = lanes and len(scenes) > 1
    drives = [scene_pieces(scene) for scene in scenes] if lanes else []
    if not lanes or not all(np.array_equal(each.times, drives[0].times) for each in drives):
        return [_SceneRun(scene, settings, _constants_of(varied, i)).simulate() for i, scene in enumerate(scenes)]
    return _simulate_in_lanes(scenes, settings, varied, drives, threads)


def _check_compatible(name: str, scene: object, first: Scene, built: bool) -> None:
    """Check that a scene fits the first one; `built` means that the model is built from the scenes."""
    scene = instance(name, scene, Scene, "a Scene")
    for part in ("duration", "output_step"):
        if getattr(scene, part) != getattr(first, part):
            raise value_error(f"{name}.{part}", getattr(scene, part), f"that of scenes[0], {getattr(first, part)}")
    for part in ("arm", "model") if built else ():
        if getattr(scene, part) != getattr(first, part):
            raise value_error(f"{name}.{part}", "different", "that of scenes[0], or a model for all scenes")
    joints = first.prescribed_joints
    if scene.arm.n_joints != first.arm.n_joints or scene.prescribed_joints != joints:
        raise value_error(name, "a scene of different joints", f"{first.arm.n_joints} joints, with {joints} prescribed")
    if scene.rotates != first.rotates:
        raise value_error(f"{name}.rotates", scene.rotates, f"that of scenes[0], {first.rotates}")


def _simulate_in_lanes(
    scenes: list[Scene], settings: _Settings, varied: dict[str, Array], drives: list[PiecewiseSignals], threads: int
) -> list[Trajectory]:
    """Simulate scenes by fixed steps, several at once; the pieces of all drives have equal boundaries."""
    model, method, interval, last = settings.model, settings.method, settings.interval, settings.rows
    assert not isinstance(method, ScipyMethod)
    shared = with_prescribed(model.constants, scenes[0].prescribed_joints, scenes[0].rotates)
    integrator = LaneIntegrator(shared, method, (interval, settings.substeps), len(scenes), threads)
    integrator.set_constants(np.arange(len(scenes)), varied)
    starts = np.array([initial_row(scene, model) for scene in scenes])
    rows, outputs = (np.zeros((len(scenes), last + 1, size)) for size in (starts.shape[1], layout.OUTPUTS))
    rows[:, 0] = starts
    started = clock.perf_counter()
    ends = run_in_lanes(integrator, drives, settings, rows, outputs)
    seconds = (clock.perf_counter() - started) / len(scenes)
    result = []
    for i, (states, read, (status, valid, evaluations)) in enumerate(zip(rows, outputs, ends.tolist(), strict=True)):
        outcome = STATUS[status], evaluations, seconds
        run = _SceneRun(scenes[i], settings, _constants_of(varied, i))
        result.append(run.trajectory(states[: valid + 1], read[: valid + 1], outcome))
    return result


def run_in_lanes(
    integrator: LaneIntegrator, drives: list[PiecewiseSignals], settings: _Settings, rows: Array, outputs: Array
) -> IntArray:
    """Fill the rows and outputs of b arms from their first rows on, piece by piece.

    Returns:
        (b, 3) status, number of valid rows after the first, and number of evaluations of the accelerations.
    """
    status, valid, evaluations = result = np.zeros((3, len(rows)), dtype=np.int64)
    states, tables = rows[:, 0].copy(), np.array([each.table() for each in drives])
    integrator.run(tables, StepGrid(0.0, 0.0, 0), 1, (states, rows, outputs), status)
    for call in _integration_intervals(drives[0], settings.interval, settings.substeps, range(settings.rows)):
        moving, tables = status == layout.OK, np.array([each.table(call.piece) for each in drives])
        if call.rows:
            moved, grid = (states, rows, outputs), StepGrid(*call.grid, row=call.row + 1)
        else:
            moved, grid = (states, np.zeros_like(rows[:, :1]), np.zeros_like(outputs[:, :1])), StepGrid(*call.grid)
        counts = integrator.run(tables, grid, call.rows or 1, moved, status)
        if call.complete and not call.rows:
            rows[:, call.row + 1], outputs[:, call.row + 1] = moved[1][:, 0], moved[2][:, 0]
        valid[moving] = call.row + counts[moving, 0] // grid.substeps  # the last part of an interval decides
        evaluations += counts[:, 1]
    return result.T


def _constants_of(varied: dict[str, Array], scene: int) -> dict[str, Array]:
    """Return the changed constants of one scene."""
    return {name: values[scene] for name, values in varied.items()}


def tip_accelerations(scene: Scene, runs: Sequence[Trajectory], model: Model, parameters: Mapping[str, Array]) -> Array:
    """Return the tip accelerations of simulations of one scene, with the torques just before each output time.

    Args:
        scene: the scene.
        runs: b trajectories of the scene.
        model: model of the arm.
        parameters: values (b, ...) of the parameters of the trajectories, see `simulate_all`.

    Returns:
        (b, T, 6) m/s^2, columns as in TIP_ACCELERATIONS, see `Batch.tip_accelerations`; NaN after a failure.
    """
    own, size = varied_constants(model, len(runs), parameters), round(scene.duration / scene.output_step) + 1
    shared = with_prescribed(model.constants, scene.prescribed_joints, scene.rotates)
    pieces, d = scene_pieces(scene), model.n_dof
    times = scene.output_step * np.arange(size)
    drives = np.array([pieces.table(p) for p in range(len(pieces.times) - 1)])
    before = np.clip(np.searchsorted(pieces.times, times - 1e-9 * times[-1]) - 1, 0, len(drives) - 1)
    applied = drives[before, layout.OFFSET] + drives[before, layout.SLOPE] * times[:, None]
    if scene.rotates:
        applied = np.hstack([applied[:, : model.n_joints + 6], base_rotation(scene).motion(times)])
    result = np.full((len(runs), size, layout.TIP_ACCELERATIONS), np.nan)
    work = layout.make_work(shared)
    for i, run in enumerate(runs):
        constants = shared._replace(**{name: each[i] for name, each in own.items()})
        for state, drive, out in zip(run.states, applied, result[i], strict=False):
            compute_tip_accelerations(constants, work, state[:d], state[d:], drive, out)
    return result
