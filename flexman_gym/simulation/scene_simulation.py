"""Simulation of scenes: one scene, or several scenes of one model together."""

import math
import time as clock
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
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
    value_error,
    vector,
    whole_number,
    whole_ratio,
)
from flexman_gym.kernels import layout
from flexman_gym.kernels.layout import STATUS
from flexman_gym.kernels.runge_kutta import state_derivative
from flexman_gym.model.model import Model, check_model, scene_model
from flexman_gym.scene.scene import Scene
from flexman_gym.scene.signals import PiecewiseSignals
from flexman_gym.simulation.batch import MAX_ARMS, MAX_THREADS
from flexman_gym.simulation.batch_integrators import LaneIntegrator
from flexman_gym.simulation.diagnostics import Failure, explain_energy, explain_failure
from flexman_gym.simulation.integrator import MAX_STEPS, Integrator, find_method, find_tolerance, prescribed_flags
from flexman_gym.simulation.methods import DEFAULT_METHOD, IteratedGauss, LinearlyImplicit, Method
from flexman_gym.simulation.parameters import varied_constants
from flexman_gym.simulation.trajectory import Kinetics, Trajectory, build_trajectory


class _Interval(NamedTuple):
    """A part of a run that lies in one piece of the drive.

    Attributes:
        piece: its number.
        row: outputs that have passed before it.
        rows: whole intervals between outputs that it lasts; 0 where it is shorter than one.
        moment: start (s), step (s) and steps in an interval, or in all of it where it is shorter.
        complete: whether an output follows it.
    """

    piece: int
    row: int
    rows: int
    moment: tuple[float, float, int]
    complete: bool


def integration_intervals(pieces: PiecewiseSignals, interval: float, substeps: int, rows: range) -> Iterator[_Interval]:
    """Divides a run through rows, an interval (s) of so many steps apart, by the pieces of its drive.

    Steps between an output and the end of a piece, or two ends of pieces, are equal, and no longer than the others.
    """
    ends = pieces.moments / interval  # in intervals; those at an output are whole numbers
    whole = np.round(ends)
    ends = np.where(np.abs(ends - whole) <= RATIO_TOLERANCE * np.maximum(whole, 1.0), whole, ends)
    for piece, (start, end) in enumerate(pairwise(np.minimum(ends, rows.stop).tolist())):
        now = max(start, float(rows.start))
        while now < end:
            row = math.floor(now)
            many = math.floor(end) - row if now == row else 0
            then = row + many if many else min(end, row + 1.0)
            if many:
                moment = row * interval, interval / substeps, substeps
            else:
                steps = max(1, math.ceil(substeps * (then - now) * (1.0 - RATIO_TOLERANCE)))
                moment = now * interval, (then - now) * interval / steps, steps
            yield _Interval(piece, row, many, moment, then == math.floor(then))
            now = then


def _run_pieces(
    run: Integrator,
    pieces: PiecewiseSignals,
    plan: tuple[float, int],
    state: Array,
    rows: Array,
    outputs: Array,
    first: int = 0,
) -> tuple[int, int, int, tuple[Array, tuple[float, float, int], Array]]:
    """Moves a state and its ledger (2 d + 2,), and fills rows (r, 2 d + 2) and outputs (r, OUTPUTS).

    Args:
        run: what moves it.
        pieces: of the drive.
        plan: time between rows (s), and steps in it.
        state: overwritten as by a `Integrator`.
        rows: overwritten as by a `Integrator`.
        outputs: overwritten as by a `Integrator`.
        first: number of the first of the rows, since the drive began.

    Returns:
        The status, the number of valid rows, that of evaluations, and how the last call began: table, moment and state.
    """
    row, result = np.zeros((1, len(state))), np.zeros((1, layout.OUTPUTS))
    status, valid, evaluations, began = layout.OK, 0, 0, (pieces.table(), (0.0, *plan), state.copy())
    for call in integration_intervals(pieces, *plan, range(first, first + len(rows))):
        began, at = (pieces.table(call.piece), call.moment, state.copy()), call.row - first
        some = slice(at, at + call.rows)
        here, there = (rows[some], outputs[some]) if call.rows else (row, result)
        status, good, more = run(began[0], call.moment, state, here, there)
        evaluations += more
        valid = at + good if call.rows or call.complete else valid
        if call.complete and not call.rows and status == layout.OK:
            rows[at], outputs[at] = row[0], result[0]
        if status != layout.OK:
            break
    return status, valid, evaluations, began


def simulate(
    scene: Scene,
    model: Model | None = None,
    method: str | Method = "auto",
    step: float | None = None,
    rtol: float = 1e-6,
    atol: float = 1e-9,
) -> Trajectory:
    """Simulates a scene.

    Args:
        scene: arm, torque, initial state, duration.
        model: None takes the model that the scene asks for.
        method: a Method or a name from `METHODS`. "auto" takes "midpoint_3_sweeps" with a step and the
            reference "dop853" without one.
        step: s. It divides the output step of the scene, into at most 100000 steps, or is a multiple of it; a multiple
            gives an output after every step. Steps are shorter where a sample of the drive ends one. None lets a
            method that estimates its error choose its steps. A reference
            always chooses its steps; the given step is its first guess.
        rtol: relative local error, of a method that chooses its steps.
        atol: absolute local error, of such a method.

    Raises:
        ValueError: one line with field, value and what is allowed.

    Examples:
        >>> trajectory = fm.simulate(fm.catalog.paper_scene("ff"), method="midpoint_3_sweeps", step=0.005)
        >>> trajectory.status, trajectory.tip.shape, trajectory.tip[-1].round(1)
        ('ok', (201, 3), array([ 1.1,  2.1, -0.6]))
    """
    plan = _plan_scene(scene, model, method, step, rtol, atol)
    return _simulate_plan(scene, plan)


class _ScenePlan(NamedTuple):
    """How a scene is simulated.

    Attributes:
        model, method: the model and the Method.
        tolerance: (rtol, atol), or None for fixed steps.
        interval: time between outputs, s.
        substeps: number of steps in it.
        rows: number of outputs behind the first.
    """

    model: Model
    method: Method
    tolerance: tuple[float, float] | None
    interval: float
    substeps: int
    rows: int


def _plan_scene(
    scene: Scene, model: Model | None, method: str | Method, step: float | None, rtol: float, atol: float
) -> _ScenePlan:
    """Checks the arguments of `simulate` and gives what follows from them.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """
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
    return _ScenePlan(model, chosen, find_tolerance(chosen, step, rtol, atol), interval, substeps, rows)


def _initial_row(scene: Scene, model: Model) -> Array:
    """Gives the state and ledger (2 d + 2,) with which a scene starts."""
    return np.append(_initial_state(scene, model), [0.0, 0.0])


def prescribed_joints(scene: Scene) -> list[int]:
    """Gives the joints whose motion a scene prescribes."""
    return [i for i, motion in enumerate(scene.prescribed or ()) if motion is not None]


def _simulate_plan(scene: Scene, plan: _ScenePlan, constants: dict[str, Any] | None = None) -> Trajectory:
    """Simulates a scene by a plan, with constants in place of some of the model's."""
    model, interval, rows = plan.model, plan.interval, plan.rows
    run, state = _make_integrator(scene, plan, constants), _initial_row(scene, model)
    states, outputs = np.zeros((rows + 1, len(state))), np.zeros((rows + 1, layout.OUTPUTS))
    run.start(state, states[0], outputs[0])
    started = clock.perf_counter()
    times = interval, plan.substeps
    status, valid, evaluations, _ = _run_pieces(run, scene.pieces, times, state, states[1:], outputs[1:])
    elapsed = clock.perf_counter() - started
    outcome = (STATUS[status], evaluations, elapsed)
    told = partial(_explanation, scene, plan, constants), partial(_kinetics, scene, plan, constants)
    return build_trajectory(model, interval, states[: valid + 1], outputs[: valid + 1], outcome, *told)


def _make_integrator(scene: Scene, plan: _ScenePlan, constants: dict[str, Any] | None = None) -> Integrator:
    """Gives the run of a plan, with constants in place of some of the model's."""
    run = Integrator(plan.model, plan.method, plan.tolerance, prescribed_joints(scene))
    run.constants = run.constants._replace(**(constants or {}))
    return run


def _explanation(scene: Scene, plan: _ScenePlan, constants: dict[str, Any] | None, result: Trajectory) -> str:
    """Says what went first in a failure or an energy alarm of a trajectory; "" while all is well."""
    run, step = _make_integrator(scene, plan, constants), plan.interval / plan.substeps
    if result.status != STATUS[layout.OK]:
        last = np.append(result.states[-1], [result.work[-1], result.dissipation[-1]])
        row, rows, outputs = len(result.time) - 1, np.zeros((1, len(last))), np.zeros((1, layout.OUTPUTS))
        again = _run_pieces(run, scene.pieces, (plan.interval, plan.substeps), last, rows, outputs, row)
        return explain_failure(Failure(_make_integrator(scene, plan, constants), plan.model, *again[3], result.status))
    late = result.energy_alarm()
    early = result.states[result.time <= (late or 0.0)]
    return "" if late is None else explain_energy(plan.model, run, step, late, early)


def _kinetics(scene: Scene, plan: _ScenePlan, constants: dict[str, Any] | None, result: Trajectory) -> Kinetics:
    """Gives the accelerations of a trajectory of a scene, and what drove it; where samples jump, behind the jump."""
    run, size, pieces = _make_integrator(scene, plan, constants), result.states.shape[1], scene.pieces
    slope, slopes, drives = np.zeros(size + 2), [], []
    for time, state in zip(result.time, result.states, strict=True):
        piece = min(int(np.searchsorted(pieces.moments, time, side="right")), len(pieces.moments) - 1) - 1
        state_derivative(run.constants, run.work, pieces.table(piece), time, np.append(state, [0.0, 0.0]), slope)
        slopes.append(slope[size // 2 : size].copy())
        drives.append(run.work.drive.copy())
    return Kinetics(replace(plan.model, constants=run.constants), np.array(slopes), np.array(drives))


def _initial_state(scene: Scene, model: Model) -> Array:
    """Gives the state (2 d,) from which a scene starts."""
    given = scene.initial.state
    if given is None:
        return model.initial_state(scene.initial.joint_angles, scene.initial.joint_rates)
    check_magnitudes("Initial.state", vector("Initial.state", given, 2 * model.n_dof), layout.LARGEST_STATE)
    return np.array(given)


def _output_interval(method: Method, step: float | None, output_step: float) -> tuple[float, int]:
    """Gives the time between outputs and the number of steps in it."""
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
    """Simulates b scenes of one model, which may differ in torques, disturbances and initial state.

    Linearly implicit methods with fixed steps move eight of them at once, in about twice the time of one. The others
    run one after the other, and so do scenes whose samples are of different moments. Each trajectory is, bit for bit,
    that of `simulate`.

    Args:
        scenes: b scenes, of the same duration and output step, and with the same joints prescribed.
        model: None takes the model that the scenes ask for; then they are of equal arms.
        method: see `simulate`.
        step: see `simulate`.
        rtol: see `simulate`.
        atol: see `simulate`.
        threads: most threads that move scenes, 1 to 256.
        parameters: values (b, ...) of physical parameters in place of the model's, by name, see `Batch.vary`.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """
    scenes = list(sequence("scenes", scenes))
    if not 0 < len(scenes) <= MAX_ARMS:
        raise value_error("scenes", f"{len(scenes)} scenes", f"1 to {MAX_ARMS}")
    whole_number("threads", threads, 1, MAX_THREADS)
    plan = _plan_scene(scenes[0], model, method, step, rtol, atol)
    for i, scene in enumerate(scenes):
        _check_compatible(f"scenes[{i}]", scene, scenes[0], model is None)
    varied = varied_constants(plan.model, len(scenes), parameters)
    lanes = isinstance(plan.method, LinearlyImplicit | IteratedGauss) and plan.tolerance is None and len(scenes) > 1
    drives = [scene.pieces for scene in scenes] if lanes else []
    if not lanes or not all(np.array_equal(each.moments, drives[0].moments) for each in drives):
        return [_simulate_plan(scene, plan, _constants_of(varied, i)) for i, scene in enumerate(scenes)]
    return _simulate_in_lanes(scenes, plan, varied, drives, threads)


def _check_compatible(name: str, scene: object, first: Scene, built: bool) -> None:
    """Refuses a scene that cannot be simulated beside the first one; `built` if its model is built from the scene."""
    if not isinstance(scene, Scene):
        raise value_error(name, scene, "a Scene")
    for part in ("duration", "output_step"):
        if getattr(scene, part) != getattr(first, part):
            raise value_error(f"{name}.{part}", getattr(scene, part), f"that of scenes[0], {getattr(first, part)}")
    for part in ("arm", "model") if built else ():
        if getattr(scene, part) != getattr(first, part):
            raise value_error(f"{name}.{part}", "another one", "that of scenes[0], or a model for all scenes")
    joints = prescribed_joints(first)
    if scene.arm.n_joints != first.arm.n_joints or prescribed_joints(scene) != joints:
        raise value_error(name, "a scene of other joints", f"{first.arm.n_joints} joints, with {joints} prescribed")


def _simulate_in_lanes(
    scenes: list[Scene], plan: _ScenePlan, varied: dict[str, Array], drives: list[PiecewiseSignals], threads: int
) -> list[Trajectory]:
    """Simulates scenes, whose drives have their pieces in common, by fixed steps of a linearly implicit method."""
    model, method, count = plan.model, plan.method, len(scenes)
    assert isinstance(method, LinearlyImplicit | IteratedGauss)
    flags = prescribed_flags(model.n_joints, prescribed_joints(scenes[0]))
    shared = model.constants._replace(prescribed=flags)
    mover = LaneIntegrator(shared, method, (plan.interval, plan.substeps), count, threads)
    mover.vary(np.arange(count), varied)
    starts = np.array([_initial_row(scene, model) for scene in scenes])
    rows, outputs = np.zeros((count, plan.rows + 1, starts.shape[1])), np.zeros((count, plan.rows + 1, layout.OUTPUTS))
    rows[:, 0] = starts
    started = clock.perf_counter()
    counts = _run_in_lanes(mover, drives, plan, rows, outputs)
    seconds = (clock.perf_counter() - started) / count
    stages = method.evaluations
    result = []
    for i, (states, read, (valid, steps)) in enumerate(zip(rows, outputs, counts.tolist(), strict=True)):
        status = STATUS[layout.OK if valid == plan.rows else layout.DIVERGED]
        outcome = status, steps * stages, seconds
        own = scenes[i], plan, _constants_of(varied, i)
        told = partial(_explanation, *own), partial(_kinetics, *own)
        result.append(build_trajectory(model, plan.interval, states[: valid + 1], read[: valid + 1], outcome, *told))
    return result


def _run_in_lanes(
    mover: LaneIntegrator, drives: list[PiecewiseSignals], plan: _ScenePlan, rows: Array, outputs: Array
) -> IntArray:
    """Fills rows and outputs behind the first, piece by piece; how many are valid and the steps taken, (b, 2)."""
    counts, well, last = np.zeros((len(rows), 2), dtype=np.int64), np.ones(len(rows), dtype=bool), rows[:, 0]
    for call in integration_intervals(drives[0], plan.interval, plan.substeps, range(plan.rows)):
        part, read, now = (
            rows[:, call.row :][:, : call.rows + 1],
            outputs[:, call.row :][:, : call.rows + 1],
            0 * counts,
        )
        if not call.rows:
            part, read = (np.zeros((len(rows), 2, each.shape[2])) for each in (rows, outputs))
            part[:, 0] = last
        mover.run(np.array([each.table(call.piece) for each in drives]), part, read, now, call.moment)
        if call.moment[0] == 0.0:
            outputs[:, 0] = read[:, 0]
        if call.complete and not call.rows:
            rows[:, call.row + 1], outputs[:, call.row + 1] = part[:, 1], read[:, 1]
        counts[well] += now[well] if call.complete or call.rows else now[well] * (0, 1)
        last, well = part[:, -1], well & (now[:, 0] == part.shape[1] - 1)
    return counts


def _constants_of(varied: dict[str, Array], scene: int) -> dict[str, Array]:
    """The constants that a scene has of its own."""
    return {name: values[scene] for name, values in varied.items()}
