"""MuJoCo's version of an arm: every link as a chain of rigid pieces between springs, run at a fixed step.

A link of length L is cut into `pieces` segments of length l = L / pieces. The compliance of a segment sits in its
middle, as three hinges with springs: G J / l about the beam, E I / l about the two axes across it. So a link has
`pieces` sets of springs, whole pieces between them and a half piece at either end. A rigid link is one of no pieces.

A flexible joint is two hinges about one axis, one after the other: the motor's, whose armature is the rotor's inertia
(which resists relative rotation only, as in the paper's Eq. 23), and the spring's; the joint angle is their sum.
A rigid joint is the motor's hinge alone.
"""

import math
import time
from typing import Any
from xml.etree import ElementTree

import mujoco  # type: ignore[import-not-found, import-untyped, unused-ignore]
import numpy as np

import flexman_gym as fm
from flexman_gym.arrays import Array
from studies.peers.runs import PeerRun, Timer, output_count, row, with_rigid_joints
from studies.precision.measure import OK, Row, Study

SANE = 0.5  # m, of an error that still is a simulation of a flexible arm
RIGID_STEP, RIGID_LINKS_STEP = 1e-3, 5e-3  # of RK4, whose errors are then far below those of a rigid arm
DISCRETE = (2, 10, 20, 50, 100)  # steps of `discrete` in 10 ms: it is stable at all of them
INTEGRATORS = ("Euler", "RK4", "implicitfast", "discrete")


def integrators() -> list[str]:
    """The integrators that the installed version has."""
    known = [name.removeprefix("mjINT_").lower() for name in dir(mujoco.mjtIntegrator) if name.startswith("mjINT_")]
    return [name for name in INTEGRATORS if name.lower() in known]


def description(arm: fm.Arm, pieces: int, integrator: str, step: float) -> str:
    """The MJCF of an arm of uniform links in `pieces` pieces each (0 for rigid ones), at zero angles; step in s."""
    root = ElementTree.Element("mujoco")
    option = {"timestep": repr(float(step)), "integrator": integrator, "gravity": _text(arm.gravity)}
    flags = _add(_add(root, "option", option), "flag")
    flags.attrib.update(contact="disable", constraint="disable", warmstart="disable")
    _add(root, "compiler", angle="radian", autolimits="true")
    parent = _add(root, "worldbody")
    actuators = _add(root, "actuator")
    place: dict[str, str] = {}
    for i, (link, joint) in enumerate(zip(arm.links, arm.joints, strict=True)):
        body = _add(parent, "body", place, name=f"link {i}")
        armature = {"armature": repr(joint.rotor_inertia)}
        _add(body, "joint", armature, name=f"motor {i}", axis=_text(joint.axis))
        _add(actuators, "motor", joint=f"motor {i}", gear="1")
        if joint.stiffness is not None:
            spring = {"stiffness": repr(joint.stiffness), "damping": repr(joint.damping)}
            _add(body, "joint", spring, name=f"spring {i}", axis=_text(joint.axis))
        parent, place = _link(body, link, pieces)
    if arm.payload is not None:
        raise ValueError("arm.payload: this description has none")
    _add(parent, "site", name="tip", pos=place["pos"])
    return ElementTree.tostring(root, encoding="unicode")


def _link(body: ElementTree.Element, link: Any, pieces: int) -> tuple[ElementTree.Element, dict[str, str]]:
    """Adds the pieces of a link to the body of its joint; returns the last and where in it the next joint sits."""
    (section,) = link.sections
    turn = np.array(link.orientation)
    if not pieces:
        _inertia(body, section, link.length, turn)
        return body, {"pos": _text(turn[:, 0] * link.length)}
    whole = link.length / pieces
    _inertia(body, section, whole / 2, turn)
    place = {"pos": _text(turn[:, 0] * whole / 2), "quat": _quaternion(turn)}
    stiffnesses = (
        section.shear_modulus * section.torsion_constant / whole,
        section.youngs_modulus * section.second_moment_y / whole,
        section.youngs_modulus * section.second_moment_z / whole,
    )
    for j in range(pieces):
        body = _add(body, "body", place)
        for axis, stiffness in zip(np.eye(3), stiffnesses, strict=True):
            _add(body, "joint", axis=_text(axis), stiffness=repr(float(stiffness)))
        length = whole if j < pieces - 1 else whole / 2
        _inertia(body, section, length, np.eye(3))
        place = {"pos": _text((length, 0.0, 0.0))}
    return body, {"pos": _text((whole / 2, 0.0, 0.0)), "quat": _quaternion(turn.T)}


def _inertia(body: ElementTree.Element, section: Any, length: float, turn: Array) -> None:
    """Mass and inertia of a rigid piece of beam that starts at the origin of the body, along the turned x axis."""
    mass, line = section.density * section.area * length, section.density * length
    y, z, slender = section.second_moment_y, section.second_moment_z, section.area * length**2 / 12
    inertia = line * np.array([y + z, y + slender, z + slender])
    where = {"pos": _text(turn[:, 0] * length / 2), "quat": _quaternion(turn)}
    _add(body, "inertial", where, mass=repr(float(mass)), diaginertia=_text(inertia))


def run(scene: fm.Scene, pieces: int, integrator: str, step: float) -> PeerRun:
    """Runs a scene of constant torques from rest at zero angles; the step (s) divides its output step."""
    model = mujoco.MjModel.from_xml_string(description(scene.arm, pieces, integrator, step))
    data = mujoco.MjData(model)
    data.ctrl[:] = np.array(scene.torque.value)  # type: ignore[union-attr]
    rows, substeps = output_count(scene, step)
    mujoco.set_mju_user_warning(lambda message: None)  # else it writes a file about every divergence
    mujoco.mj_forward(model, data)
    tip = np.full((rows + 1, 3), np.nan)
    tip[0] = data.site("tip").xpos
    started = time.process_time(), time.perf_counter()
    for i in range(1, rows + 1):
        mujoco.mj_step(model, data, substeps)
        mujoco.mj_kinematics(model, data)  # a step leaves the places of its start
        tip[i] = data.site_xpos[0]
        if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number or not np.isfinite(data.qpos).all():
            tip[i:] = np.nan  # it resets itself and goes on from the start
            break
    reached = i * scene.output_step
    costs = (time.process_time() - started[0]) / reached, (time.perf_counter() - started[1]) / reached
    evaluations = (4 if integrator == "RK4" else 1) / step
    return PeerRun(_name(scene.arm, pieces), integrator, step, tip, *costs, evaluations)


def _name(arm: fm.Arm, pieces: int) -> str:
    if pieces:
        return f"MuJoCo, {pieces} pieces"
    return "MuJoCo, rigid" if arm.joints[0].stiffness is None else "MuJoCo, rigid links"


def runs(study: Study) -> list[Timer]:
    """Runs with rigid links, rigid joints too, and with 4 and 8 pieces."""
    rigid = with_rigid_joints(study.scene)
    return [
        lambda: row(study, run(rigid, 0, "RK4", RIGID_STEP)),
        lambda: row(study, run(study.scene, 0, "RK4", RIGID_LINKS_STEP)),
        *stable_runs(study),
    ]


def stable_runs(study: Study) -> list[Timer]:
    """Runs with 4 and 8 pieces: at the longest stable step of each integrator, found by trying."""

    def timed(pieces: int, integrator: str, parts: int) -> Row:
        return row(study, run(study.scene, pieces, integrator, 0.01 / parts), sane=SANE)

    result: list[Timer] = []
    for pieces in (4, 8):
        for name in integrators():
            parts = DISCRETE[0]
            while name != "discrete" and timed(pieces, name, parts).status != OK:
                parts = math.ceil(1.1 * parts)
            chosen = {"discrete": DISCRETE, "Euler": (parts, 2 * parts)}.get(name, (parts,))
            result += [lambda a=(pieces, name, each): timed(*a) for each in chosen]  # type: ignore[misc]
    return result


def _add(parent: ElementTree.Element, tag: str, attributes: dict[str, str] | None = None, **more: str) -> Any:
    return ElementTree.SubElement(parent, tag, (attributes or {}) | more)


def _text(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)


def _quaternion(turn: Array) -> str:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, turn.ravel())
    return _text(quaternion)
