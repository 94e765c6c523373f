"""Model of an arm in MuJoCo: every link is a chain of rigid pieces with springs, simulated at a fixed step."""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import mujoco  # type: ignore[import-not-found, import-untyped, unused-ignore]
import numpy as np
from mujoco import batch

from flexman_gym.common.arrays import Array
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.scene import Scene
from flexman_gym.scene.signals import ConstantTorque
from flexman_gym.toolbox.interchange.mjcf import to_mjcf
from flexman_gym.toolbox.precision.peers.peer_run import (
    PeerRun,
    check_modelled,
    output_count,
    peer_row,
    with_rigid_joints,
)
from flexman_gym.toolbox.precision.runs import OK, PrecisionRow, PrecisionScene, Timer

SANE = 0.06  # largest error of the tip of a run that counts as stable / length of the stretched arm
RIGID_STEPS, RIGID_LINKS_STEPS = 10, 2  # RK4 steps of an output step; their error is far below that of a rigid arm
DISCRETE = (2, 10, 20, 50, 100)  # steps of `discrete` of an output step of 10 ms; stable at all of them
QUICKEST = ("Euler", "discrete")
INTEGRATORS = ("Euler", "RK4", "implicit", "implicitfast", "discrete")


def integrators() -> list[str]:
    """Return the integrators of the installed version."""
    known = [name.removeprefix("mjINT_").lower() for name in dir(mujoco.mjtIntegrator) if name.startswith("mjINT_")]
    return [name for name in INTEGRATORS if name.lower() in known]


def run(scene: Scene, pieces: int, integrator: str, step: float) -> PeerRun:
    """Run a scene; the step (s) must divide the output step.

    Args:
        scene: arm, torques, initial joint angles and rates, duration.
        pieces: number of rigid pieces of a link; 0 for rigid links.
        integrator: integrator of MuJoCo.
        step: s.
    """
    return advance(scene, _name(scene.arm, pieces), integrator, step, to_mjcf(scene.arm, pieces, integrator, step))


def advance(scene: Scene, name: str, integrator: str, step: float, text: str) -> PeerRun:
    """Run a scene with the arm given as MJCF text."""
    check_modelled(scene)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    for i, (angle, rate) in enumerate(zip(scene.initial.joint_angles, scene.initial.joint_rates, strict=True)):
        motor = model.joint(f"motor {i}")
        data.qpos[motor.qposadr], data.qvel[motor.dofadr] = angle, rate
    driven = [not joint.passive for joint in scene.arm.joints]  # a passive joint has no actuator
    constant = isinstance(scene.torque, ConstantTorque)
    rows, substeps = output_count(scene, step)
    mujoco.set_mju_user_warning(lambda message: None)  # else it writes a file about every divergence
    mujoco.mj_forward(model, data)
    tip = np.full((rows + 1, 3), np.nan)
    tip[0] = data.site("tip").xpos
    started = time.process_time(), time.perf_counter()
    for i in range(1, rows + 1):
        for k in range(1 if constant else substeps):
            data.ctrl[:] = scene.torque.at((i - 1) * scene.output_step + (k + 0.5) * step)[driven]
            mujoco.mj_step(model, data, substeps if constant else 1)
        mujoco.mj_kinematics(model, data)  # positions after a step are those of its start
        tip[i] = data.site_xpos[0]
        if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number or not np.isfinite(data.qpos).all():
            tip[i:] = np.nan  # MuJoCo resets a diverged state
            break
    reached = i * scene.output_step
    costs = (time.process_time() - started[0]) / reached, (time.perf_counter() - started[1]) / reached
    evaluations = (4 if integrator == "RK4" else 1) / step
    return PeerRun(name, integrator, step, tip, *costs, evaluations)


def step_factors(arm: Arm, pieces: int, integrator: str, step: float, small: float = 1e-5) -> Any:
    """Return the complex amplification factors of a step (s) about rest, from central differences."""
    model = mujoco.MjModel.from_xml_string(to_mjcf(arm, pieces, integrator, step))
    data, after = mujoco.MjData(model), []
    for state in small * np.vstack([np.eye(2 * model.nv), -np.eye(2 * model.nv)]):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = np.split(state, 2)
        mujoco.mj_step(model, data)
        after.append(np.concatenate([data.qpos, data.qvel]))
    ahead, back = np.split(np.array(after), 2)
    return np.linalg.eigvals((ahead - back) / (2.0 * small))


def batched_arms(scene: Scene, pieces: int, step: float, arms: int, threads: int) -> Iterator[Array]:
    """Simulate arms from rest with `mujoco.batch`; yield the tip (3,) m of the first arm at the output times."""
    model = mujoco.MjModel.from_xml_string(to_mjcf(scene.arm, pieces, "Euler", step))
    many, count = batch.Batch(model, arms, threads), output_count(scene, step)[1]
    many.ctrl, tips = np.array(scene.torque.value), many.bind("site_xpos")  # type: ignore[union-attr]
    while True:
        many.step(nstep=count, stage=mujoco.mjtStage.mjSTAGE_POS)
        yield tips[0, 0].copy()


def _name(arm: Arm, pieces: int) -> str:
    if pieces:
        return f"MuJoCo, {pieces} pieces"
    return "MuJoCo, rigid" if arm.joints[0].stiffness is None else "MuJoCo, rigid links"


def runs(scene: PrecisionScene, names: Sequence[str] = QUICKEST) -> list[Timer]:
    """Return timers of the rigid arm, the arm of rigid links, and the arms of 4 and 8 pieces per link.

    Args:
        scene: scene with its reference.
        names: integrators of the arms of pieces.
    """
    rigid, interval = with_rigid_joints(scene.scene), scene.scene.output_step
    return [
        lambda: peer_row(scene, run(rigid, 0, "RK4", interval / RIGID_STEPS)),
        lambda: peer_row(scene, run(scene.scene, 0, "RK4", interval / RIGID_LINKS_STEPS)),
        *stable_runs(scene, names),
    ]


def stable_runs(scene: PrecisionScene, names: Sequence[str]) -> list[Timer]:
    """Return timers of the arms of 4 and 8 pieces per link at the longest stable step of each integrator."""
    result: list[Timer] = []
    for pieces in (4, 8):
        for name in names:
            timed = partial(_timed, scene, pieces, name)
            parts = fewest_parts(timed) if name != "discrete" else 0
            chosen = {"discrete": DISCRETE, "Euler": (parts, 2 * parts)}.get(name, (parts,))
            result += [partial(timed, each) for each in chosen]
    return result


def sane_error(arm: Arm) -> float:
    """Return the largest error of the tip, m, of a run that counts as stable."""
    return SANE * sum(link.length for link in arm.links)


def fewest_parts(timed: Callable[[int], PrecisionRow]) -> int:
    """Return the smallest number of steps per output step with which a run is stable, by trial."""
    parts = DISCRETE[0]
    while timed(parts).status != OK:
        parts = math.ceil(1.1 * parts)
    return parts


def longest_step(scene: PrecisionScene, pieces: int, integrator: str) -> float:
    """Return the longest stable step (s)."""
    return scene.scene.output_step / fewest_parts(partial(_timed, scene, pieces, integrator))


def _timed(scene: PrecisionScene, pieces: int, integrator: str, parts: int) -> PrecisionRow:
    done = run(scene.scene, pieces, integrator, scene.scene.output_step / parts)
    return peer_row(scene, done, sane=sane_error(scene.scene.arm))
