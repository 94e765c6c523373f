"""Simulation of scenes: one scene, or several scenes of one model together.

The torques and prescribed motions of a scene are smooth in intervals, such as those between samples; no step crosses
the boundary of two intervals.
"""

import math
import time as clock
from collections.abc import Iterator, Mapping, Sequence
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
from flexman_gym.kernels.outputs import tip_accelerations as compute_tip_accelerations
from flexman_gym.kernels.runge_kutta import state_derivative
from flexman_gym.model.model import Model, check_model, scene_model
from flexman_gym.scene.scene import Scene
from flexman_gym.scene.signals import PiecewiseSignals
from flexman_gym.simulation.batch import MAX_ARMS, MAX_THREADS
from flexman_gym.simulation.batch_integrators import LaneIntegrator
from flexman_gym.simulation.diagnostics import explain_energy, explain_failure
from flexman_gym.simulation.integrator import MAX_STEPS, Integrator, find_method, find_tolerance, prescribed_flags
from flexman_gym.simulation.methods import DEFAULT_METHOD, IteratedGauss, LinearlyImplicit, Method
from flexman_gym.simulation.parameters import varied_constants
from flexman_gym.simulation.trajectory import Kinetics, Trajectory, build_trajectory

TIP_ACCELERATIONS = {  # name of a component -> column of `tip_accelerations`
    f"{name}_{axis}": part.start + i
    for name, part in (("tip_acceleration", layout.TIP_ACCELERATION), ("specific_force", layout.SPECIFIC_FORCE))
    for i, axis in enumerate("xyz")
}


class _Interval(NamedTuple):
    """Part of a simulation within one piece of the drive.

    Attributes:
        piece: number of the piece.
        row: number of outputs before it.
        rows: number of whole output intervals it covers; 0 where it is shorter than one.
        moment: start (s), step (s), and steps in an output interval, or in the whole part where it is shorter.
        complete: flag of an output at its end.
    """

    piece: int
    row: int
    rows: int
    moment: tuple[float, float, int]
    complete: bool


def integration_intervals(pieces: PiecewiseSignals, interval: float, substeps: int, rows: range) -> Iterator[_Interval]:
    """Divide a simulation through output rows at the boundaries of the pieces of its drive.

    Steps between an output and the end of a piece, or between two ends of pieces, are equal and no longer than the
    others.

    Args:
        pieces: the drive.
        interval: time between outputs, s.
        substeps: steps in an interval.
        rows: numbers of the outputs.

    Yields:
        The parts in order.
    """
    ends = pieces.moments / interval  # in intervals; whole numbers at outputs
    whole = np.round(ends)
    ends = np.where(np.abs(ends - whole) <= RATIO_TOLERANCE * np.maximum(whole, 1.0), whole, ends)
    for piece, (start, end) in enumerate(pairwise(np.minimum(ends, rows.stop).tolist())):
        now = max(start, float(rows.start))
        while now < end:
            row = math.floor(now)
            count = math.floor(end) - row if now == row else 0
            then = row + count if count else min(end, row + 1.0)
            if count:
                moment = row * interval, interval / substeps, substeps
            else:
                steps = max(1, math.ceil(substeps * (then - now) * (1.0 - RATIO_TOLERANCE)))
                moment = now * interval, (then - now) * interval / steps, steps
            yield _Interval(piece, row, count, moment, then == math.floor(then))
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
    """Integrate a state and its ledger (2 d + 2,) piece by piece, and fill rows (r, 2 d + 2) and outputs (r, OUTPUTS).

    Args:
        run: the integrator.
        pieces: pieces of the drive.
        plan: time between rows (s), and steps in it.
        state: overwritten, as by an `Integrator`.
        rows: overwritten, as by an `Integrator`.
        outputs: overwritten, as by an `Integrator`.
        first: number of the first row since the start of the drive.

    Returns:
        Status, number of valid rows, number of evaluations, and the start of the last call: table, moment and state.
    """
    row, result = np.zeros((1, len(state))), np.zeros((1, layout.OUTPUTS))
    status, valid, evaluations, began = layout.OK, 0, 0, (pieces.table(), (0.0, *plan), state.copy())
    for call in integration_intervals(pieces, *plan, range(first, first + len(rows))):
        began, at = (pieces.table(call.piece), call.moment, state.copy()), call.row - first
        some = slice(at, at + call.rows)
        here, there = (rows[some], outputs[some]) if call.rows else (row, result)
        status, valid_rows, calls = run(began[0], call.moment, state, here, there)
        evaluations += calls
        valid = at + valid_rows if call.rows or call.complete else valid
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
    """Simulate a scene.

    Args:
        scene: arm, torque, initial state, duration.
        model: a model of the scene's arm; None builds the one specified by the scene.
        method: a Method or a name from `METHODS`. "auto" takes "midpoint_3" with a step and the reference method
            "dop853" without one.
        step: s. It divides the output step of the scene, into at most 100000 steps, or is a multiple of it; a multiple
            gives an output after every step. Steps are shorter where a sample of the drive ends within one. None lets a
            method with an error estimate choose its steps. A reference method always chooses its steps; a given step is
            its first guess.
        rtol: relative local error of adaptive steps.
        atol: absolute local error of adaptive steps.

    Returns:
        The trajectory at the output times. A failure is a status of the trajectory, not an exception.

    Examples:
        >>> trajectory = fm.simulate(fm.catalog.paper_scene("ff"), method="midpoint_3", step=0.005)
        >>> trajectory.status, trajectory.tip.shape, trajectory.tip[-1].round(1)
        ('ok', (201, 3), array([ 1.1,  2.1, -0.6]))
    """
    plan = _plan_scene(scene, model, method, step, rtol, atol)
    return _simulate_plan(scene, plan)


class _ScenePlan(NamedTuple):
    """Model, method and steps of the simulation of a scene.

    Attributes:
        model, method: the model and the Method.
        tolerance: (rtol, atol), or None for fixed steps.
        interval: time between outputs, s.
        substeps: number of steps in it.
        rows: number of outputs after the first.
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
    """Check the arguments of `simulate` and return the plan."""
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
    """Return the initial state and ledger (2 d + 2,) of a scene."""
    return np.append(_initial_state(scene, model), [0.0, 0.0])


def _prescribed_joints(scene: Scene) -> list[int]:
    """Return the numbers of the joints with prescribed motion in a scene."""
    return [i for i, motion in enumerate(scene.prescribed or ()) if motion is not None]


def _simulate_plan(scene: Scene, plan: _ScenePlan, constants: dict[str, Any] | None = None) -> Trajectory:
    """Simulate a scene by a plan, with some constants of the model replaced."""
    model, interval, rows = plan.model, plan.interval, plan.rows
    run, state = _make_integrator(scene, plan, constants), _initial_row(scene, model)
    states, outputs = np.zeros((rows + 1, len(state))), np.zeros((rows + 1, layout.OUTPUTS))
    run.start(state, states[0], outputs[0])
    started = clock.perf_counter()
    times = interval, plan.substeps
    status, valid, evaluations, _ = _run_pieces(run, scene.pieces, times, state, states[1:], outputs[1:])
    elapsed = clock.perf_counter() - started
    outcome = (STATUS[status], evaluations, elapsed)
    sources = partial(_explanation, scene, plan, constants), partial(_kinetics, scene, plan, constants)
    return build_trajectory(model, interval, states[: valid + 1], outputs[: valid + 1], outcome, *sources)


def _make_integrator(scene: Scene, plan: _ScenePlan, constants: dict[str, Any] | None = None) -> Integrator:
    """Return the integrator of a plan, with some constants of the model replaced."""
    run = Integrator(plan.model, plan.method, plan.tolerance, _prescribed_joints(scene))
    run.constants = run.constants._replace(**(constants or {}))
    return run


def _explanation(scene: Scene, plan: _ScenePlan, constants: dict[str, Any] | None, result: Trajectory) -> str:
    """Return the explanation of a failure or an energy alarm of a trajectory; "" without either."""
    run, step = _make_integrator(scene, plan, constants), plan.interval / plan.substeps
    if result.status != STATUS[layout.OK]:
        last = np.append(result.states[-1], [result.work[-1], result.dissipation[-1]])
        row, rows, outputs = len(result.time) - 1, np.zeros((1, len(last))), np.zeros((1, layout.OUTPUTS))
        again = _run_pieces(run, scene.pieces, (plan.interval, plan.substeps), last, rows, outputs, row)
        return explain_failure(_make_integrator(scene, plan, constants), plan.model, *again[3], result.status)
    alarm = result.energy_alarm()
    before = result.states[result.time <= (alarm or 0.0)]
    return "" if alarm is None else explain_energy(plan.model, run, step, alarm, before)


def _kinetics(scene: Scene, plan: _ScenePlan, constants: dict[str, Any] | None, result: Trajectory) -> Kinetics:
    """Return accelerations and drive of a trajectory of a scene; where samples jump, those after the jump."""
    run, size, pieces = _make_integrator(scene, plan, constants), result.states.shape[1], scene.pieces
    rates, accelerations, drives = np.zeros(size + 2), [], []
    for time, state in zip(result.time, result.states, strict=True):
        piece = min(int(np.searchsorted(pieces.moments, time, side="right")), len(pieces.moments) - 1) - 1
        state_derivative(run.constants, run.work, pieces.table(piece), time, np.append(state, [0.0, 0.0]), rates)
        accelerations.append(rates[size // 2 : size].copy())
        drives.append(run.work.drive.copy())
    return Kinetics(replace(plan.model, constants=run.constants), np.array(accelerations), np.array(drives))


def _initial_state(scene: Scene, model: Model) -> Array:
    """Return the initial state (2 d,) of a scene."""
    given = scene.initial.state
    if given is None:
        return model.initial_state(scene.initial.joint_angles, scene.initial.joint_rates)
    check_magnitudes("Initial.state", vector("Initial.state", given, 2 * model.n_dof), layout.LARGEST_STATE)
    return np.array(given)


def _output_interval(method: Method, step: float | None, output_step: float) -> tuple[float, int]:
    """Return the time between outputs and the number of steps in it."""
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

    Linearly implicit methods with fixed steps integrate eight scenes at once, in about twice the time of one. The other
    methods run one scene after the other; so do scenes whose samples have different times. Each trajectory equals that
    of `simulate`, bit for bit.

    Args:
        scenes: b scenes of the same duration, output step and prescribed joints.
        model: the model of all scenes; None builds the one specified by the scenes, which then need equal arms.
        method: see `simulate`.
        step: see `simulate`.
        rtol: see `simulate`.
        atol: see `simulate`.
        threads: largest number of threads, 1 to 256.
        **parameters: values (b, ...) of physical parameters in place of the model's, by name, see `Batch.vary`.

    Returns:
        b trajectories.

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
    """Check that a scene can be simulated together with the first one; `built` if its model is built from the scene."""
    if not isinstance(scene, Scene):
        raise value_error(name, scene, "a Scene")
    for part in ("duration", "output_step"):
        if getattr(scene, part) != getattr(first, part):
            raise value_error(f"{name}.{part}", getattr(scene, part), f"that of scenes[0], {getattr(first, part)}")
    for part in ("arm", "model") if built else ():
        if getattr(scene, part) != getattr(first, part):
            raise value_error(f"{name}.{part}", "different", "that of scenes[0], or a model for all scenes")
    joints = _prescribed_joints(first)
    if scene.arm.n_joints != first.arm.n_joints or _prescribed_joints(scene) != joints:
        raise value_error(name, "a scene of different joints", f"{first.arm.n_joints} joints, with {joints} prescribed")


def _simulate_in_lanes(
    scenes: list[Scene], plan: _ScenePlan, varied: dict[str, Array], drives: list[PiecewiseSignals], threads: int
) -> list[Trajectory]:
    """Simulate scenes, whose drives have their pieces in common, by fixed steps of a linearly implicit method."""
    model, method, count = plan.model, plan.method, len(scenes)
    assert isinstance(method, LinearlyImplicit | IteratedGauss)
    flags = prescribed_flags(model.n_joints, _prescribed_joints(scenes[0]))
    shared = model.constants._replace(prescribed=flags)
    integrator = LaneIntegrator(shared, method, (plan.interval, plan.substeps), count, threads)
    integrator.vary(np.arange(count), varied)
    starts = np.array([_initial_row(scene, model) for scene in scenes])
    rows, outputs = np.zeros((count, plan.rows + 1, starts.shape[1])), np.zeros((count, plan.rows + 1, layout.OUTPUTS))
    rows[:, 0] = starts
    started = clock.perf_counter()
    counts = _run_in_lanes(integrator, drives, plan, rows, outputs)
    seconds = (clock.perf_counter() - started) / count
    stages = method.evaluations
    result = []
    for i, (states, read, (valid, steps)) in enumerate(zip(rows, outputs, counts.tolist(), strict=True)):
        status = STATUS[layout.OK if valid == plan.rows else layout.DIVERGED]
        outcome = status, steps * stages, seconds
        own = scenes[i], plan, _constants_of(varied, i)
        sources = partial(_explanation, *own), partial(_kinetics, *own)
        result.append(build_trajectory(model, plan.interval, states[: valid + 1], read[: valid + 1], outcome, *sources))
    return result


def _run_in_lanes(
    integrator: LaneIntegrator, drives: list[PiecewiseSignals], plan: _ScenePlan, rows: Array, outputs: Array
) -> IntArray:
    """Fill rows and outputs after the first, piece by piece; return valid rows and steps taken, (b, 2)."""
    counts, ok, last = np.zeros((len(rows), 2), dtype=np.int64), np.ones(len(rows), dtype=bool), rows[:, 0]
    for call in integration_intervals(drives[0], plan.interval, plan.substeps, range(plan.rows)):
        part, read, now = (
            rows[:, call.row :][:, : call.rows + 1],
            outputs[:, call.row :][:, : call.rows + 1],
            0 * counts,
        )
        if not call.rows:
            part, read = (np.zeros((len(rows), 2, each.shape[2])) for each in (rows, outputs))
            part[:, 0] = last
        integrator.run(np.array([each.table(call.piece) for each in drives]), part, read, now, call.moment)
        if call.moment[0] == 0.0:
            outputs[:, 0] = read[:, 0]
        if call.complete and not call.rows:
            rows[:, call.row + 1], outputs[:, call.row + 1] = part[:, 1], read[:, 1]
        counts[ok] += now[ok] if call.complete or call.rows else now[ok] * (0, 1)
        last, ok = part[:, -1], ok & (now[:, 0] == part.shape[1] - 1)
    return counts


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
    flags = prescribed_flags(model.n_joints, _prescribed_joints(scene))
    pieces, d = scene.pieces, model.n_dof
    times = scene.output_step * np.arange(size)
    drives = np.array([pieces.table(p) for p in range(len(pieces.moments) - 1)])
    before = np.clip(np.searchsorted(pieces.moments, times - 1e-9 * times[-1]) - 1, 0, len(drives) - 1)
    applied = drives[before, layout.OFFSET] + drives[before, layout.SLOPE] * times[:, None]
    result = np.full((len(runs), size, layout.TIP_ACCELERATIONS), np.nan)
    work = layout.make_work(model.constants)
    for i, run in enumerate(runs):
        constants = model.constants._replace(prescribed=flags, **{name: each[i] for name, each in own.items()})
        for state, drive, out in zip(run.states, applied, result[i], strict=False):
            compute_tip_accelerations(constants, work, state[:d], state[d:], drive, out)
    return result
