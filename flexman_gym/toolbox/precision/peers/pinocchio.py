"""Model of an arm in Pinocchio: rigid links and joints, with `aba` called from a Runge-Kutta loop in Python."""

import importlib
import time
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.errors import value_error
from flexman_gym.model.dynamics import mass_matrix
from flexman_gym.model.model import build_model
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.scene import Scene
from flexman_gym.toolbox.precision.peers.peer_run import PeerRun, check_modelled, output_count, peer_row
from flexman_gym.toolbox.precision.runs import PrecisionScene, Timer

pin: Any = importlib.import_module("pinocchio")  # no type stubs
STEPS = 10  # Runge-Kutta steps of an output step; their error is far below that of a rigid arm


def rigid_model(arm: Arm) -> Any:
    """Return the `pinocchio.Model` of an arm with rotors and rigid joints.

    Raises:
        ValueError: for an arm with bodies beside its beams and a payload at the tip, which the model would lack.
    """
    model, place, parent = pin.Model(), pin.SE3.Identity(), 0
    for link, joint in zip(arm.links, arm.joints, strict=True):
        parent = model.addJoint(parent, pin.JointModelRevoluteUnaligned(*joint.axis), place, f"joint {parent + 1}")
        turn, reached = np.array(link.orientation), 0.0
        for section in link.sections:
            y, z, slender = section.second_moment_y, section.second_moment_z, section.area * section.length**2 / 12
            inertia = section.density * section.length * np.diag([y + z, y + slender, z + slender])
            body = pin.Inertia(section.mass, np.array([reached + section.length / 2, 0.0, 0.0]), inertia)
            model.appendBodyToJoint(parent, body, pin.SE3(turn, np.zeros(3)))
            reached += section.length
        place = pin.SE3(np.eye(3), turn[:, 0] * reached)
    if arm.payload is not None:
        inertia = np.zeros((3, 3)) if arm.payload.inertia is None else np.array(arm.payload.inertia)
        offset = np.zeros(3) if arm.payload.offset is None else np.array(arm.payload.offset)
        model.appendBodyToJoint(parent, pin.Inertia(arm.payload.mass, offset, inertia), place)
    model.addFrame(pin.Frame("tip", parent, 0, place, pin.FrameType.OP_FRAME))
    model.armature, model.gravity.linear = np.array([j.rotor_inertia for j in arm.joints]), np.array(arm.gravity)
    _check_mass(arm, model)
    return model


def _check_mass(arm: Arm, model: Any) -> None:
    """Raise a ValueError if the mass matrix differs from that of our rigid arm."""
    ours = build_model(arm, flexible_links=False, flexible_joints=False)
    posture = np.linspace(0.3, 0.9, arm.n_joints)
    theirs, expected = pin.crba(model, model.createData(), posture), mass_matrix(ours, ours.initial_state(posture))
    if not np.allclose(np.triu(theirs), np.triu(expected), rtol=0.0, atol=1e-9 * expected.max()):
        raise value_error("arm", "an arm with further bodies", "one of beams, rotors and a payload for Pinocchio")


def run(scene: Scene, step: float) -> PeerRun:
    """Run a scene with rigid links and joints; the step (s) must divide the output step."""
    check_modelled(scene)
    model = rigid_model(scene.arm)
    data = model.createData()
    angles, rates = np.array(scene.initial.joint_angles), np.array(scene.initial.joint_rates)
    rows, substeps = output_count(scene, step)
    tip = np.zeros((rows + 1, 3))
    started = time.process_time(), time.perf_counter()
    for i in range(rows + 1):
        pin.framesForwardKinematics(model, data, angles)
        tip[i] = data.oMf[-1].translation
        for k in range(substeps if i < rows else 0):
            torque = scene.torque.at(i * scene.output_step + (k + 0.5) * step)
            angles, rates = _runge_kutta(model, data, (angles, rates), torque, step)
    costs = (time.process_time() - started[0]) / scene.duration, (time.perf_counter() - started[1]) / scene.duration
    return PeerRun("Pinocchio, rigid", "RK4", step, tip, *costs, 4 / step)


def _runge_kutta(model: Any, data: Any, state: tuple[Array, Array], torque: Array, step: float) -> tuple[Array, Array]:
    """Return angles and rates after a classical Runge-Kutta step (s)."""
    q, v = state
    a = pin.aba(model, data, q, v, torque)
    v2 = v + step / 2 * a
    b = pin.aba(model, data, q + step / 2 * v, v2, torque)
    v3 = v + step / 2 * b
    c = pin.aba(model, data, q + step / 2 * v2, v3, torque)
    v4 = v + step * c
    d = pin.aba(model, data, q + step * v3, v4, torque)
    return q + step / 6 * (v + 2 * v2 + 2 * v3 + v4), v + step / 6 * (a + 2 * b + 2 * c + d)


def runs(scene: PrecisionScene) -> list[Timer]:
    """Return the timer of the rigid arm."""
    rigid_model(scene.scene.arm)  # raises a ValueError for an arm that it lacks
    return [lambda: peer_row(scene, run(scene.scene, scene.scene.output_step / STEPS))]
