"""Ring-down of MuJoCo's arm of rigid pieces: integrators and steps, compared with its own finest run."""

import time
from collections.abc import Iterator
from dataclasses import replace

import mujoco  # type: ignore[import-not-found, import-untyped, unused-ignore]
import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.toolbox.interchange.mjcf import to_mjcf
from flexman_gym.toolbox.precision.peers.mujoco import integrators
from studies.ringdown.measure import (
    DURATION,
    LARGEST_DEFLECTION,
    SPREAD,
    UNDAMPED,
    RingDownRow,
    default_model,
    median_kept,
    percentiles,
)

PIECES, FINEST = 4, 20e-6  # pieces per link; step of the RK4 reference, s
STEPS = {"Euler": (5e-3, 1e-3, 1e-4, 5e-5), "RK4": (1e-3, 1e-4, 5e-5), "implicitfast": (5e-3, 1e-3, 1e-4, 5e-5)}
STEPS["discrete"] = (5e-3, 1e-3, 5e-4, 1e-4)


def release(integrator: str, step: float, seed: int) -> tuple[Array, float, float, float]:
    """Release an arm with free motors; return tip (3,) m and both energies (J) after 3 s, and the CPU time (s).

    All pieces of a link turn by the same angle, so that its tip is deflected as far as in our cases.
    """
    arm = replace(default_model().arm, modal_damping_ratio=0.0)
    text = to_mjcf(arm, PIECES, integrator, step).replace("<flag ", '<flag energy="enable" ')
    model = mujoco.MjModel.from_xml_string(text)
    data, random = mujoco.MjData(model), np.random.default_rng(seed)
    mujoco.set_mju_user_warning(lambda message: None)  # else it writes a file about every divergence
    for i, link in enumerate(arm.links):
        motor = model.joint(f"motor {i}").qposadr[0]
        data.qpos[motor] = random.uniform(-1.0, 1.0) * SPREAD[i]
        size, angle = random.uniform(0.0, LARGEST_DEFLECTION), random.uniform(0.0, 2.0 * np.pi)
        turn = 2.0 * size / (PIECES * link.length) * np.array([-np.sin(angle), np.cos(angle)])
        first = motor + 1 + (arm.joints[i].stiffness is not None)
        for piece in range(PIECES):  # three hinges a piece: along the beam, and about the two axes across it
            data.qpos[first + 3 * piece + 1 : first + 3 * piece + 3] = turn
    mujoco.mj_forward(model, data)
    began, started = float(data.energy.sum()), time.process_time()
    mujoco.mj_step(model, data, round(DURATION[UNDAMPED] / step))
    seconds = time.process_time() - started
    mujoco.mj_forward(model, data)
    broken = data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number or not np.isfinite(data.qpos).all()
    ended = np.nan if broken else float(data.energy.sum())
    return data.site("tip").xpos.copy(), began, ended, seconds


def rows(count: int) -> Iterator[RingDownRow]:
    """Measure every integrator and step on a number of arms."""
    references = [release("RK4", FINEST, seed)[0] for seed in range(count)]
    for integrator in (name for name in integrators() if name in STEPS):
        for step in STEPS[integrator]:
            runs = [release(integrator, step, seed) for seed in range(count)]
            kept = np.array([ended / began for _, began, ended, _ in runs])
            failed = ~np.isfinite(kept) | (kept > 10.0)
            tip = np.array(
                [np.linalg.norm(run[0] - reference) for run, reference in zip(runs, references, strict=True)]
            )
            energy, tip = np.where(failed, np.inf, np.abs(kept - 1.0)), np.where(failed, np.inf, tip)
            cpu = sum(run[3] for run in runs) / (count * DURATION[UNDAMPED])
            name = f"MuJoCo, {PIECES} pieces"
            shares = percentiles(energy, tip)
            shares |= {"kept": median_kept(kept, failed), "failed": float(failed.mean())}
            yield RingDownRow(UNDAMPED, name, integrator, step, count, cpu, **shares)
