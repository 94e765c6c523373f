"""Export of an arm to MJCF, the model format of MuJoCo, with links as chains of rigid bodies and springs.

A section of length L is divided into N segments of length l = L / N. The compliance of a segment is concentrated at its
middle, in three hinges with springs: G J / l about the beam axis, E I_y / l and E I_z / l about the transverse axes.
The rigid pieces of a link thus reach from the middle of one segment to the middle of the next; the pieces at the two
ends of the link are half as long.

A flexible joint is two hinges in series about one axis: the hinge of the motor, whose armature is the rotor inertia
(for the rotation relative to the inboard link only, as in Eq. (23) of the paper "Dynamic modeling and simulation of
spatial manipulator with flexible links and joints"), and the hinge of the spring. The joint angle is their sum. A rigid
joint is the hinge of the motor alone.

Modal damping is modelled by a fixed tendon for each mode of a link: a linear combination of hinge angles with a damper.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import instance, whole_number
from flexman_gym.common.errors import value_error
from flexman_gym.model.beam import build_beam
from flexman_gym.model.outboard_inertia import outboard_inertias
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.inertia import spatial_inertia
from flexman_gym.scene.joint import Joint
from flexman_gym.scene.link import Link, NonUniformLink
from flexman_gym.scene.rigid_body import LumpedMass, Payload

PIECES, MAX_PIECES = 8, 64  # number of segments of a section of a link: default and limit
STABLE_STEP = 1.5  # rad; step times largest natural frequency (rad/s); "implicitfast" and "Euler" are stable up to 2
AddLink = Callable[[Any, Any, Any], tuple[Any, dict[str, str]]]


class _Piece(NamedTuple):
    """Rigid piece of a link.

    Attributes:
        start: position along the link of the hinges at its inboard end, m; 0 for the first piece, which has no hinges.
        mass: kg.
        centre: position of the centre of mass along the link, m.
        inertia: (3,) principal moments of inertia about the centre of mass and the beam axes, kg m^2.
        stiffness: (3,) stiffness of the hinges about the beam axes, N m/rad.
    """

    start: float
    mass: float
    centre: float
    inertia: Array
    stiffness: Array


def rigid_pieces(link: Link | NonUniformLink, pieces: int) -> list[_Piece]:
    """Return the rigid pieces of a link, base to tip: the first piece, then one for each segment of each section.

    Args:
        link: the link.
        pieces: number of segments of each section; 0 for a rigid link.
    """
    halves, start = [], 0.0
    for section in link.sections:
        count = max(1, 2 * pieces)
        length = section.length or 1.0  # any length serves a rigid link of no length and mass
        halves += [(start + j * length / count, length / count, section) for j in range(count)]
        start += section.length
    ends = [0, *range(1, len(halves), 2), len(halves)] if pieces else [0, len(halves)]
    result = []
    for first, stop in pairwise(ends):
        parts = [(begin + length / 2, length, section) for begin, length, section in halves[first:stop]]
        masses = np.array([section.density * section.area * length for _, length, section in parts])
        places = np.array([place for place, _, _ in parts])
        centre, inertia = float(masses @ places / masses.sum()), np.zeros(3)
        for mass, (place, length, section) in zip(masses, parts, strict=True):
            y, z = section.second_moment_y / section.area, section.second_moment_z / section.area
            slender = length**2 / 12 + (place - centre) ** 2
            inertia += mass * np.array([y + z, y + slender, z + slender])
        begin, half, section = halves[first]
        second_moments = np.array([section.second_moment_y, section.second_moment_z])
        rigidities = section.shear_modulus * section.torsion_constant, *section.youngs_modulus * second_moments
        stiffness = np.array(rigidities) / (2.0 * half) if first else np.zeros(3)
        result.append(_Piece(begin, float(masses.sum()), centre, inertia, stiffness))
    return result


def to_mjcf(
    arm: Arm,
    pieces: int = PIECES,
    integrator: str = "implicitfast",
    step: float | None = None,
    add_link: AddLink | None = None,
) -> str:
    """Return the model of an arm at zero joint angles as the text of an MJCF file.

    The actuators are motor torques, N m. The site "tip" is the tip of the last link. Hinges are named "motor 0",
    "spring 0" and so on; the only hinge of a passive joint is named "motor 0" too, and has no actuator.

    Args:
        arm: the arm.
        pieces: number of segments of each section of a link; 0 for rigid links.
        integrator: integrator of MuJoCo; "Euler" is faster, but with modal damping it may be unstable.
        step: time step, s; None for a step at which "implicitfast" is stable, or 1 ms for rigid links.
        add_link: function that adds another model of a link. Its arguments are the root element, the element of the
            body of the joint, and the link; it returns the element of the body at the tip of the link, and the
            attributes of the tip in this body ("pos" and, optionally, "xyaxes").
    """
    instance("arm", arm, Arm, "an Arm")
    whole_number("pieces", pieces, 0, MAX_PIECES)
    for i, joint in enumerate(arm.joints):
        if joint.has_knees or joint.static_excess or joint.ripple_cycles:
            allowed = "a joint without static friction, backlash, stiffness pieces and torque ripple"
            raise value_error(f"arm.joints[{i}]", joint, allowed)
    chains = [rigid_pieces(link, pieces * link.flexible) for link in arm.links]
    outboard = outboard_inertias(arm, tuple(build_beam(link, 1, flexible=False) for link in arm.links))
    lumped_masses = [link.masses for link in arm.links]
    modes = [_modes(*each) if len(each[0]) > 1 else None for each in zip(chains, outboard, lumped_masses, strict=True)]
    highest = max((_highest_frequency(chain) for chain in chains if len(chain) > 1), default=1.5e3)
    root = ElementTree.Element("mujoco")
    option = {"integrator": integrator, "gravity": _numbers(arm.gravity)}
    options = _add(root, "option", option, timestep=repr(float(STABLE_STEP / highest if step is None else step)))
    flags = {"contact": "disable", "warmstart": "disable"}
    if not any(joint.coulomb_friction for joint in arm.joints):
        flags |= {"constraint": "disable"}
    _add(options, "flag", flags)
    _add(root, "compiler", angle="radian", autolimits="true")
    parent, actuators, tendons = (_add(root, name) for name in ("worldbody", "actuator", "tendon"))
    tip: dict[str, str] = {}
    for i, (link, joint) in enumerate(zip(arm.links, arm.joints, strict=True)):
        body = _add(parent, "body", tip, name=f"link_{i}")
        _add_joint(body, actuators, joint, i)
        if add_link:
            parent, tip = add_link(root, body, link)
            continue
        parent, tip = _add_link(body, chains[i], link, arm.stiffness_proportional_damping)
        if (shapes := modes[i]) and arm.damping_ratios[i]:
            _add_modal_dampers(tendons, f"link_{i}", shapes, arm.damping_ratios[i])
    if arm.payload is not None:
        _add_rigid_body(_add(parent, "body", tip, name="payload"), arm.payload)
    _add(parent, "site", name="tip", pos=tip["pos"])
    return ElementTree.tostring(root, encoding="unicode")


def _add_joint(body: Any, actuators: Any, joint: Joint, i: int) -> None:
    """Add the hinges of joint i to its body, and its motor to the actuators; a passive joint is a hinge alone."""
    axis = _numbers(joint.axis)
    friction = {"damping": repr(joint.rotor_damping), "frictionloss": repr(joint.coulomb_friction)}
    if joint.passive:
        spring = {} if joint.stiffness is None else {"stiffness": repr(joint.stiffness)}
        _add(body, "joint", friction | spring, name=f"motor {i}", axis=axis)
        return
    _add(body, "joint", friction, name=f"motor {i}", axis=axis, armature=repr(joint.rotor_inertia))
    limit = joint.torque_limit
    limits = {} if limit is None else {"ctrlrange": _numbers((-limit, limit))}
    _add(actuators, "motor", limits, joint=f"motor {i}", gear="1")
    if joint.stiffness is not None:
        spring = {"stiffness": repr(joint.stiffness), "damping": repr(joint.damping)}
        _add(body, "joint", spring, name=f"spring {i}", axis=axis)


def _add_link(body: Any, chain: list[_Piece], link: Any, proportional: float) -> tuple[Any, dict[str, str]]:
    """Add the pieces of a link to the body of its joint; return the last body and the attributes of the tip in it."""
    orientation, name = np.array(link.orientation), body.get("name")
    _add_inertia(body, chain[0], orientation)
    _add_lumped_masses(body, chain, link.masses, 0, orientation)
    for j, (previous, piece) in enumerate(pairwise(chain)):
        distance = piece.start - previous.start
        first = (
            {"pos": _numbers(orientation[:, 0] * distance), "xyaxes": _axes(orientation)}
            if j == 0
            else {"pos": _numbers((distance, 0, 0))}
        )
        body = _add(body, "body", first, name=f"{name}_{j}")
        for letter, axis, stiffness in zip("xyz", np.eye(3), piece.stiffness, strict=True):
            spring = {"stiffness": repr(float(stiffness)), "damping": repr(float(proportional * stiffness))}
            _add(body, "joint", spring, name=f"{name}_{j}_{letter}", axis=_numbers(axis))
        _add_inertia(body, piece, np.eye(3))
        _add_lumped_masses(body, chain, link.masses, j + 1, np.eye(3))
    if len(chain) == 1:
        return body, {"pos": _numbers(orientation[:, 0] * link.length)}
    return body, {"pos": _numbers((link.length - chain[-1].start, 0.0, 0.0)), "xyaxes": _axes(orientation.T)}


def _add_inertia(body: Any, piece: _Piece, orientation: Array) -> None:
    """Add mass and inertia of a piece to its body, with the beam axes in the columns of the orientation (3, 3)."""
    frame = {"pos": _numbers(orientation[:, 0] * (piece.centre - piece.start)), "xyaxes": _axes(orientation)}
    _add(body, "inertial", frame, mass=repr(piece.mass), diaginertia=_numbers(piece.inertia))


def _add_lumped_masses(
    body: Any, chain: list[_Piece], masses: Sequence[LumpedMass], number: int, orientation: Array
) -> None:
    """Add the lumped masses of the piece with a given number to its body; arguments as in `_add_inertia`."""
    for mass in masses:
        if _piece_number(chain, mass.position) == number:
            frame = {
                "pos": _numbers(orientation[:, 0] * (mass.position - chain[number].start)),
                "xyaxes": _axes(orientation),
            }
            _add_rigid_body(_add(body, "body", frame), mass)


def _piece_number(chain: list[_Piece], position: float) -> int:
    """Return the index of the piece at a position along a link (m)."""
    return sum(piece.start <= position for piece in chain[1:])


def _add_rigid_body(body: Any, mass: Payload | LumpedMass) -> None:
    """Add mass and inertia of a payload or lumped mass to its body."""
    inertia = np.array(mass.inertia if mass.inertia is not None else np.zeros((3, 3)))
    packed = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    attribute = {"fullinertia": _numbers(packed)} if packed.any() else {"diaginertia": "0 0 0"}
    centre = np.zeros(3) if mass.offset is None else mass.offset
    _add(body, "inertial", attribute, pos=_numbers(centre), mass=repr(mass.mass))


def _spatial(mass: LumpedMass) -> Array:
    """Return the spatial inertia (6, 6) of a lumped mass about the centre of its cross-section, linear part first."""
    return spatial_inertia(mass.mass, np.array(mass.offset or np.zeros(3)), np.array(mass.inertia or np.zeros((3, 3))))


def _modes(chain: list[_Piece], tip_inertia: Array, masses: Sequence[LumpedMass]) -> tuple[Array, Array]:
    """Return the modes of a clamped link: frequencies (k,), rad/s, and mass matrix times mode shapes (k, k)."""
    from scipy.linalg import eigh  # slow import, which most uses of the package do not need

    mass, stiffness = _matrices(chain, tip_inertia, masses)
    squares, shapes = eigh(stiffness[6:, 6:], mass[6:, 6:])
    return np.sqrt(squares), mass[6:, 6:] @ shapes


def _highest_frequency(chain: list[_Piece]) -> float:
    """Return the highest natural frequency of the free link, rad/s: an upper bound of its frequencies in the arm."""
    from scipy.linalg import eigh

    mass, stiffness = _matrices(chain, np.zeros((6, 6)))
    return float(np.sqrt(eigh(stiffness, mass, eigvals_only=True)[-1]))


def _matrices(chain: list[_Piece], tip_inertia: Array, masses: Sequence[LumpedMass] = ()) -> tuple[Array, Array]:
    """Return mass and stiffness matrix (6 + k, 6 + k) of a free link: motion of its root, then k hinge angles."""
    mass = np.zeros((6 + 3 * (len(chain) - 1),) * 2)
    end = 2.0 * chain[-1].centre - chain[-1].start  # the last piece is uniform
    bodies = [(j, piece.centre, np.diag([*[piece.mass] * 3, *piece.inertia])) for j, piece in enumerate(chain)]
    bodies += [(_piece_number(chain, each.position), each.position, _spatial(each)) for each in masses]
    for number, position, inertia in [*bodies, (len(chain) - 1, end, tip_inertia)]:
        lever_arms = [position, *(position - piece.start for piece in chain[1 : number + 1])]
        jacobian = np.zeros((6, len(mass)))
        jacobian[:3, :3] = np.eye(3)
        for j, lever_arm in enumerate(lever_arms):
            jacobian[3:, 3 * j + 3 : 3 * j + 6] = np.eye(3)
            jacobian[1, 3 * j + 5], jacobian[2, 3 * j + 4] = lever_arm, -lever_arm
        mass += jacobian.T @ inertia @ jacobian
    return mass, np.diag(np.concatenate([np.zeros(6), *(piece.stiffness for piece in chain[1:])]))


def _add_modal_dampers(tendons: Any, name: str, modes: tuple[Array, Array], ratio: float) -> None:
    """Add a tendon with a damper for each of the `_modes` of a link; its length is the modal coordinate."""
    for number, (frequency, momenta) in enumerate(zip(modes[0], modes[1].T, strict=True)):
        damping = repr(float(2.0 * ratio * frequency))
        tendon = _add(tendons, "fixed", name=f"{name}_mode_{number}", damping=damping)
        for j, coefficient in enumerate(momenta):
            if abs(coefficient) > 1e-12 * np.abs(momenta).max():
                _add(tendon, "joint", joint=f"{name}_{j // 3}_{'xyz'[j % 3]}", coef=repr(float(coefficient)))


def _add(parent: Any, tag: str, attributes: dict[str, str] | None = None, **more: str) -> Any:
    """Add a child element and return it."""
    return ElementTree.SubElement(parent, tag, (attributes or {}) | more)


def _numbers(values: Any) -> str:
    """Return numbers as text, separated by spaces."""
    return " ".join(repr(float(value)) for value in values)


def _axes(orientation: Array) -> str:
    """Return a rotation matrix (3, 3) as the text of the MJCF attribute "xyaxes": its first two columns."""
    return _numbers(orientation.T[:2].ravel())
