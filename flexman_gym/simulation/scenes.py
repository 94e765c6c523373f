"""Scenes: a whole scene moved through time."""

import time as clock
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import WHOLE, bounded, instance, parts, positive, refusal, vector
from flexman_gym.kernels import layout
from flexman_gym.kernels.layout import STATUS
from flexman_gym.kernels.stages import derivative
from flexman_gym.model.model import Model, checked_model, scene_model
from flexman_gym.scene.scene import Scene
from flexman_gym.simulation.explanation import Failure, explain, explain_energy
from flexman_gym.simulation.families import Method
from flexman_gym.simulation.methods import DEFAULT
from flexman_gym.simulation.piecewise import run_pieces
from flexman_gym.simulation.run import MOST_STEPS, Run, find_method, find_tolerance
from flexman_gym.simulation.trajectory import Moved, Trajectory, trajectory


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
    plan = find_plan(scene, model, method, step, rtol, atol)
    return follow(scene, plan)


class Plan(NamedTuple):
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


def find_plan(
    scene: Scene, model: Model | None, method: str | Method, step: float | None, rtol: float, atol: float
) -> Plan:
    """Checks the arguments of `simulate` and gives what follows from them.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """
    instance("scene", scene, Scene, "a Scene")
    model = scene_model(scene) if model is None else checked_model(model)
    if model.n_joints != scene.arm.n_joints:
        raise refusal("model", f"{model.n_joints} joints", f"a model of the scene's arm, {scene.arm.n_joints} joints")
    automatic = "dop853" if step is None else DEFAULT
    chosen = find_method(automatic if isinstance(method, str) and method == "auto" else method)
    interval, substeps = _output_interval(chosen, step, scene.output_step)
    rows = parts("step", interval, scene.duration, "a number of seconds that divides the duration")
    return Plan(model, chosen, find_tolerance(chosen, step, rtol, atol), interval, substeps, rows)


def first_state(scene: Scene, model: Model) -> Array:
    """Gives the state and ledger (2 d + 2,) with which a scene starts."""
    return np.append(_start(scene, model), [0.0, 0.0])


def prescribed_joints(scene: Scene) -> list[int]:
    """Gives the joints whose motion a scene prescribes."""
    return [i for i, motion in enumerate(scene.prescribed or ()) if motion is not None]


def follow(scene: Scene, plan: Plan, constants: dict[str, Any] | None = None) -> Trajectory:
    """Simulates a scene by a plan, with constants in place of some of the model's."""
    model, interval, rows = plan.model, plan.interval, plan.rows
    run, state = bound_run(scene, plan, constants), first_state(scene, model)
    states, outputs = np.zeros((rows + 1, len(state))), np.zeros((rows + 1, layout.OUTPUTS))
    run.start(state, states[0], outputs[0])
    started = clock.perf_counter()
    times = interval, plan.substeps
    status, valid, evaluations, _ = run_pieces(run, scene.pieces, times, state, states[1:], outputs[1:])
    elapsed = clock.perf_counter() - started
    outcome = (STATUS[status], evaluations, elapsed)
    told = partial(explanation, scene, plan, constants), partial(motion, scene, plan, constants)
    return trajectory(model, interval, states[: valid + 1], outputs[: valid + 1], outcome, *told)


def bound_run(scene: Scene, plan: Plan, constants: dict[str, Any] | None = None) -> Run:
    """Gives the run of a plan, with constants in place of some of the model's."""
    run = Run(plan.model, plan.method, plan.tolerance, prescribed_joints(scene))
    run.constants = run.constants._replace(**(constants or {}))
    return run


def explanation(scene: Scene, plan: Plan, constants: dict[str, Any] | None, result: Trajectory) -> str:
    """Says what went first in a failure or an energy alarm of a trajectory; "" while all is well."""
    run, step = bound_run(scene, plan, constants), plan.interval / plan.substeps
    if result.status != STATUS[layout.OK]:
        last = np.append(result.states[-1], [result.work[-1], result.dissipation[-1]])
        row, rows, outputs = len(result.time) - 1, np.zeros((1, len(last))), np.zeros((1, layout.OUTPUTS))
        again = run_pieces(run, scene.pieces, (plan.interval, plan.substeps), last, rows, outputs, row)
        return explain(Failure(bound_run(scene, plan, constants), plan.model, *again[3], result.status))
    late = result.energy_alarm()
    early = result.states[result.time <= (late or 0.0)]
    return "" if late is None else explain_energy(plan.model, run, step, late, early)


def motion(scene: Scene, plan: Plan, constants: dict[str, Any] | None, result: Trajectory) -> Moved:
    """Gives the accelerations of a trajectory of a scene, and what drove it; where samples jump, behind the jump."""
    run, size, pieces = bound_run(scene, plan, constants), result.states.shape[1], scene.pieces
    slope, slopes, drives = np.zeros(size + 2), [], []
    for time, state in zip(result.time, result.states, strict=True):
        piece = min(int(np.searchsorted(pieces.moments, time, side="right")), len(pieces.moments) - 1) - 1
        derivative(run.constants, run.work, pieces.table(piece), time, np.append(state, [0.0, 0.0]), slope)
        slopes.append(slope[size // 2 : size].copy())
        drives.append(run.work.drive.copy())
    return Moved(replace(plan.model, constants=run.constants), np.array(slopes), np.array(drives))


def _start(scene: Scene, model: Model) -> Array:
    """Gives the state (2 d,) from which a scene starts."""
    given = scene.initial.state
    if given is None:
        return model.initial_state(scene.initial.joint_angles, scene.initial.joint_rates)
    bounded("Initial.state", vector("Initial.state", given, 2 * model.n_dof), layout.LARGEST_STATE)
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
        return output_step, parts("step", step, output_step, allowed, MOST_STEPS)
    multiple = step / output_step
    if not multiple < 1e15 or abs(multiple - round(multiple)) > WHOLE * multiple:
        raise refusal("step", step, f"{allowed}, {output_step} s")
    return step, 1
