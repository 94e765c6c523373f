"""Simulation of the first stage with MuJoCo's rigid pieces, driven by the measured hub angle."""

from typing import Any

import mujoco  # type: ignore[import-not-found, import-untyped, unused-ignore]
import numpy as np

import flexman_gym as fm
from flexman_gym.scene.signals import SampledAngles
from flexman_gym.toolbox.interchange.mjcf import to_mjcf
from studies.machine.measure import LOGGED

PIECES = 4
HEAVY = 1e6  # kg m^2; hub inertia so large that the hub follows the prescribed motion


def deflection(arm: fm.Arm, record: fm.Measurement) -> Any:
    """Return the filtered deflection (T,) at the end of the block behind the strip, m.

    The block is four orders of magnitude stiffer than the strip and is therefore a part of the payload: as rigid pieces
    it would need steps below a microsecond.
    """
    strip, block = arm.links[0].sections
    one = fm.Arm([strip], [fm.Joint((0.0, 0.0, 1.0))], _carried(arm, block), modal_damping_ratio=arm.damping_ratios[0])
    model = mujoco.MjModel.from_xml_string(to_mjcf(one, PIECES))
    data, hub = mujoco.MjData(model), model.joint("motor 0")
    model.dof_armature[hub.dofadr[0]] = HEAVY
    steps = int(np.ceil(record.period / model.opt.timestep))
    model.opt.timestep = record.period / steps
    motion = SampledAngles(record.times, record.inputs["motor_angle_1"], record.deviations["motor_angle_1"])
    data.qpos[hub.qposadr[0]], data.qvel[hub.dofadr[0]] = motion.start()
    push, times = motion.acceleration, np.asarray(record.times)
    result = []
    for start in times.tolist():
        result.append(_off_the_line(model, data, block.length))
        moments = start + model.opt.timestep * (np.arange(steps) + 0.5)
        values, slopes = push.lines(moments)
        for rate in (values + slopes * moments).tolist():
            data.qfrc_applied[hub.dofadr[0]] = HEAVY * rate
            mujoco.mj_step(model, data)
    return LOGGED.applied(np.array(result), record.period)


def _off_the_line(model: Any, data: Any, beyond: float) -> float:
    """Return the lateral distance (m) of a point beyond the strip's end from the axis of the hub frame."""
    mujoco.mj_kinematics(model, data)
    place = data.site("tip").xpos + beyond * data.xmat[model.site("tip").bodyid[0]].reshape(3, 3)[:, 0]
    frame = data.body("link_0").xmat.reshape(3, 3)
    return float((frame.T @ place)[1])


def _carried(arm: fm.Arm, block: Any) -> fm.Payload:
    """Return the block and the load behind it as one rigid body at the end of the strip."""
    load: Any = arm.payload
    masses = np.array([block.mass, load.mass])
    places = np.array([block.length / 2.0, block.length + load.offset[0]])
    centre = float(masses @ places / masses.sum())
    about = block.mass * block.length**2 / 12.0 + load.inertia[2][2] + float(masses @ (places - centre) ** 2)
    inertia = (about * np.eye(3)).tolist()
    return fm.Payload(float(masses.sum()), inertia, (centre, 0.0, 0.0))
