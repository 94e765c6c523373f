"""Several scenes of one model, simulated side by side."""

import time as clock
from collections.abc import Sequence
from functools import partial

import numpy as np

from flexman_gym.arrays import Array, IntArray
from flexman_gym.checks import refusal, sequence, whole_number
from flexman_gym.kernels import layout
from flexman_gym.kernels.layout import STATUS
from flexman_gym.model.model import Model
from flexman_gym.scene.drive import Pieces
from flexman_gym.scene.scene import Scene
from flexman_gym.simulation.batch import MOST_ARMS, MOST_THREADS
from flexman_gym.simulation.families import LinearlyImplicit, Method, Sweeps
from flexman_gym.simulation.movers import Abreast
from flexman_gym.simulation.parameters import varied_constants
from flexman_gym.simulation.piecewise import calls
from flexman_gym.simulation.run import prescribed_flags
from flexman_gym.simulation.scenes import (
    Plan,
    explanation,
    find_plan,
    first_state,
    follow,
    motion,
    prescribed_joints,
)
from flexman_gym.simulation.trajectory import Trajectory, trajectory


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
    if not 0 < len(scenes) <= MOST_ARMS:
        raise refusal("scenes", f"{len(scenes)} scenes", f"1 to {MOST_ARMS}")
    whole_number("threads", threads, 1, MOST_THREADS)
    plan = find_plan(scenes[0], model, method, step, rtol, atol)
    for i, scene in enumerate(scenes):
        _check_alike(f"scenes[{i}]", scene, scenes[0], model is None)
    varied = varied_constants(plan.model, len(scenes), parameters)
    lanes = isinstance(plan.method, LinearlyImplicit | Sweeps) and plan.tolerance is None and len(scenes) > 1
    drives = [scene.pieces for scene in scenes] if lanes else []
    if not lanes or not all(np.array_equal(each.moments, drives[0].moments) for each in drives):
        return [follow(scene, plan, _own(varied, i)) for i, scene in enumerate(scenes)]
    return _abreast(scenes, plan, varied, drives, threads)


def _check_alike(name: str, scene: object, first: Scene, built: bool) -> None:
    """Refuses a scene that cannot be simulated beside the first one; `built` if its model is built from the scene."""
    if not isinstance(scene, Scene):
        raise refusal(name, scene, "a Scene")
    for part in ("duration", "output_step"):
        if getattr(scene, part) != getattr(first, part):
            raise refusal(f"{name}.{part}", getattr(scene, part), f"that of scenes[0], {getattr(first, part)}")
    for part in ("arm", "model") if built else ():
        if getattr(scene, part) != getattr(first, part):
            raise refusal(f"{name}.{part}", "another one", "that of scenes[0], or a model for all scenes")
    joints = prescribed_joints(first)
    if scene.arm.n_joints != first.arm.n_joints or prescribed_joints(scene) != joints:
        raise refusal(name, "a scene of other joints", f"{first.arm.n_joints} joints, with {joints} prescribed")


def _abreast(
    scenes: list[Scene], plan: Plan, varied: dict[str, Array], drives: list[Pieces], threads: int
) -> list[Trajectory]:
    """Simulates scenes, whose drives have their pieces in common, by fixed steps of a linearly implicit method."""
    model, method, count = plan.model, plan.method, len(scenes)
    assert isinstance(method, LinearlyImplicit | Sweeps)
    flags = prescribed_flags(model.n_joints, prescribed_joints(scenes[0]))
    shared = model.constants._replace(prescribed=flags)
    mover = Abreast(shared, method, (plan.interval, plan.substeps), count, threads)
    mover.vary(np.arange(count), varied)
    starts = np.array([first_state(scene, model) for scene in scenes])
    rows, outputs = np.zeros((count, plan.rows + 1, starts.shape[1])), np.zeros((count, plan.rows + 1, layout.OUTPUTS))
    rows[:, 0] = starts
    started = clock.perf_counter()
    counts = _moved(mover, drives, plan, rows, outputs)
    seconds = (clock.perf_counter() - started) / count
    stages = method.evaluations
    result = []
    for i, (states, read, (valid, steps)) in enumerate(zip(rows, outputs, counts.tolist(), strict=True)):
        status = STATUS[layout.OK if valid == plan.rows else layout.DIVERGED]
        outcome = status, steps * stages, seconds
        own = scenes[i], plan, _own(varied, i)
        told = partial(explanation, *own), partial(motion, *own)
        result.append(trajectory(model, plan.interval, states[: valid + 1], read[: valid + 1], outcome, *told))
    return result


def _moved(mover: Abreast, drives: list[Pieces], plan: Plan, rows: Array, outputs: Array) -> IntArray:
    """Fills rows and outputs behind the first, piece by piece; how many are valid and the steps taken, (b, 2)."""
    counts, well, last = np.zeros((len(rows), 2), dtype=np.int64), np.ones(len(rows), dtype=bool), rows[:, 0]
    for call in calls(drives[0], plan.interval, plan.substeps, range(plan.rows)):
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


def _own(varied: dict[str, Array], scene: int) -> dict[str, Array]:
    """The constants that a scene has of its own."""
    return {name: values[scene] for name, values in varied.items()}
