"""MJCF: an arm as rigid pieces between springs, in the format of MuJoCo.

A section of length L is cut into `pieces` segments of length l = L / pieces. The compliance of a segment sits in its
middle, as three hinges with springs: G J / l about the beam, E I / l about the two axes across it. So rigid pieces lie
between the middles of neighbouring segments, and half a segment at either end of a link.

A flexible joint is two hinges about one axis, one after the other: the motor's, whose armature is the rotor's inertia
(which resists relative rotation only, as in the paper's Eq. 23), and the spring's; the joint angle is their sum.
A rigid joint is the motor's hinge alone.

Each mode of a link has the damping ratio of the arm: a fixed tendon over the hinges damps the speed of that mode alone.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import instance, whole_number
from flexman_gym.model.beam import build_beam
from flexman_gym.model.component_modes import outboard_inertias, spatial_inertia
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.joint import Joint
from flexman_gym.scene.link import Link, NonUniformLink
from flexman_gym.scene.rigid_body import LumpedMass, Payload

PIECES, MAX_PIECES = 8, 64  # of a section
STEP = 1.5  # over the largest natural frequency (rad/s); "implicitfast" and "Euler" are stable up to 2
Grow = Callable[[Any, Any, Any], tuple[Any, dict[str, str]]]


class _Piece(NamedTuple):
    """A rigid piece of a link.

    Attributes:
        start: place of its hinges along the link, m; 0 of the first piece, which is fixed to the joint.
        mass: kg.
        centre: place of its centre of mass along the link, m.
        inertia: (3,) about that, along the axes of the beam, kg m^2.
        stiffness: (3,) of its hinges about these axes, N m/rad.
    """

    start: float
    mass: float
    centre: float
    inertia: Array
    stiffness: Array


def rigid_pieces(link: Link | NonUniformLink, pieces: int) -> list[_Piece]:
    """Gives the rigid pieces of a link, base to tip: one for each segment of each section and the first, 1 + k.

    Args:
        link: the link.
        pieces: segments of each section; 0 for a rigid link.
    """
    halves, start = [], 0.0
    for section in link.sections:
        count = max(1, 2 * pieces)
        halves += [(start + j * section.length / count, section.length / count, section) for j in range(count)]
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
        place, half, own = halves[first]
        springs = own.shear_modulus * own.torsion_constant, *own.youngs_modulus * _second(own)
        stiffness = np.array(springs) / (2.0 * half) if first else np.zeros(3)
        result.append(_Piece(place, float(masses.sum()), centre, inertia, stiffness))
    return result


def _second(link: Link) -> Array:
    return np.array([link.second_moment_y, link.second_moment_z])


def mjcf(
    arm: Arm,
    pieces: int = PIECES,
    integrator: str = "implicitfast",
    step: float | None = None,
    grow: Grow | None = None,
) -> str:
    """Gives the model of an arm in MuJoCo's format, at zero angles.

    Motors are the actuators, in N m. The site "tip" is the tip. Hinges are named "motor 0", "spring 0" and so on.

    Args:
        arm: the arm.
        pieces: segments of each section of a link; 0 for rigid links.
        integrator: of MuJoCo; "Euler" takes less time, but modal damping may make it unstable.
        step: s; None takes one at which "implicitfast" is stable, 1 ms for rigid links.
        grow: lets links of another kind grow from the bodies of their joints: takes the root element, the body and the
            link, and returns the body at its tip and where in it that is.

    Raises:
        ValueError: for anything but an arm, and for another number of pieces.
    """
    instance("arm", arm, Arm, "an Arm")
    whole_number("pieces", pieces, 0, MAX_PIECES)
    cut = [rigid_pieces(link, pieces) for link in arm.links]
    sitting = [link.masses for link in arm.links]
    modes = [_modes(*each) for each in zip(cut, _tips(arm), sitting, strict=True)] if pieces else []
    fastest = max(map(_fastest, cut)) if pieces else 1.5e3
    root = ElementTree.Element("mujoco")
    option = {"integrator": integrator, "gravity": format_numbers(arm.gravity)}
    options = add_element(root, "option", option, timestep=repr(float(STEP / fastest if step is None else step)))
    flags = {"contact": "disable", "warmstart": "disable"}
    add_element(options, "flag", flags if _rubs(arm) else flags | {"constraint": "disable"})
    add_element(root, "compiler", angle="radian", autolimits="true")
    parent, actuators, tendons = (add_element(root, name) for name in ("worldbody", "actuator", "tendon"))
    place: dict[str, str] = {}
    for i, (link, joint) in enumerate(zip(arm.links, arm.joints, strict=True)):
        body = add_element(parent, "body", place, name=f"link_{i}")
        _joint(body, actuators, joint, i)
        if grow:
            parent, place = grow(root, body, link)
            continue
        parent, place = _link(body, cut[i], link, arm.stiffness_proportional_damping)
        if modes and arm.damping_ratios[i]:
            _damp(tendons, f"link_{i}", modes[i], arm.damping_ratios[i])
    if arm.payload is not None:
        _rigid(add_element(parent, "body", place, name="payload"), arm.payload)
    add_element(parent, "site", name="tip", pos=place["pos"])
    return ElementTree.tostring(root, encoding="unicode")


def _rubs(arm: Arm) -> bool:
    """Whether a joint has dry friction, which is a constraint in MuJoCo."""
    return any(joint.coulomb_friction for joint in arm.joints)


def _joint(body: Any, actuators: Any, joint: Joint, i: int) -> None:
    """Adds the hinges and the motor of a joint."""
    axis = format_numbers(joint.axis)
    friction = {"damping": repr(joint.viscous_friction), "frictionloss": repr(joint.coulomb_friction)}
    add_element(body, "joint", friction, name=f"motor {i}", axis=axis, armature=repr(joint.rotor_inertia))
    limit = joint.torque_limit
    given = {} if limit is None else {"ctrlrange": format_numbers((-limit, limit))}
    add_element(actuators, "motor", given, joint=f"motor {i}", gear="1")
    if joint.stiffness is not None:
        spring = {"stiffness": repr(joint.stiffness), "damping": repr(joint.damping)}
        add_element(body, "joint", spring, name=f"spring {i}", axis=axis)


def _link(body: Any, cut: list[_Piece], link: Any, proportional: float) -> tuple[Any, dict[str, str]]:
    """Adds the pieces of a link to the body of its joint; returns the last and where in it the next joint sits."""
    turn, name = np.array(link.orientation), body.get("name")
    _inertial(body, cut[0], turn)
    _masses(body, cut, link.masses, 0, turn)
    for j, (before, piece) in enumerate(pairwise(cut)):
        along = piece.start - before.start
        first = (
            {"pos": format_numbers(turn[:, 0] * along), "xyaxes": format_axes(turn)}
            if j == 0
            else {"pos": format_numbers((along, 0, 0))}
        )
        body = add_element(body, "body", first, name=f"{name}_{j}")
        for letter, axis, stiffness in zip("xyz", np.eye(3), piece.stiffness, strict=True):
            spring = {"stiffness": repr(float(stiffness)), "damping": repr(float(proportional * stiffness))}
            add_element(body, "joint", spring, name=f"{name}_{j}_{letter}", axis=format_numbers(axis))
        _inertial(body, piece, np.eye(3))
        _masses(body, cut, link.masses, j + 1, np.eye(3))
    if len(cut) == 1:
        return body, {"pos": format_numbers(turn[:, 0] * link.length)}
    return body, {"pos": format_numbers((link.length - cut[-1].start, 0.0, 0.0)), "xyaxes": format_axes(turn.T)}


def _inertial(body: Any, piece: _Piece, turn: Array) -> None:
    """Adds mass and inertia of a piece to a body at its start, in which the beam lies along the turned x axis."""
    where = {"pos": format_numbers(turn[:, 0] * (piece.centre - piece.start)), "xyaxes": format_axes(turn)}
    add_element(body, "inertial", where, mass=repr(piece.mass), diaginertia=format_numbers(piece.inertia))


def _masses(body: Any, cut: list[_Piece], masses: Sequence[LumpedMass], number: int, turn: Array) -> None:
    """Adds the lumped masses that sit on a piece to its body, in which the beam lies along the turned x axis."""
    for mass in masses:
        if _piece_below(cut, mass.position) == number:
            where = {
                "pos": format_numbers(turn[:, 0] * (mass.position - cut[number].start)),
                "xyaxes": format_axes(turn),
            }
            _rigid(add_element(body, "body", where), mass)


def _piece_below(cut: list[_Piece], position: float) -> int:
    """Number of the piece on which a place along a link (m) is."""
    return sum(piece.start <= position for piece in cut[1:])


def _rigid(body: Any, mass: Payload | LumpedMass) -> None:
    """Adds mass and inertia of a rigid body."""
    inertia = np.array(mass.inertia if mass.inertia is not None else np.zeros((3, 3)))
    packed = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    about = {"fullinertia": format_numbers(packed)} if packed.any() else {"diaginertia": "0 0 0"}
    centre = np.zeros(3) if mass.offset is None else mass.offset
    add_element(body, "inertial", about, pos=format_numbers(centre), mass=repr(mass.mass))


def _spatial(mass: LumpedMass) -> Array:
    """The inertia (6, 6) of a lumped mass about the axis at its section, linear part first."""
    return spatial_inertia(mass.mass, np.array(mass.offset or np.zeros(3)), np.array(mass.inertia or np.zeros((3, 3))))


def _tips(arm: Arm) -> Array:
    """Inertia (n, 6, 6) at the tip of each link, of all that it carries, at its place along the link."""
    return outboard_inertias(arm, tuple(build_beam(link, 1, flexible=False) for link in arm.links))


def _modes(cut: list[_Piece], carried: Array, masses: Sequence[LumpedMass]) -> tuple[Array, Array]:
    """Frequencies (k,) in rad/s of a clamped link that carries an inertia, and momenta of its modes, columns (k, k)."""
    from scipy.linalg import eigh  # its import takes long, and not every use of the package needs it

    mass, stiffness = _matrices(cut, carried, masses)
    squares, shapes = eigh(stiffness[6:, 6:], mass[6:, 6:])
    return np.sqrt(squares), mass[6:, 6:] @ shapes


def _fastest(cut: list[_Piece]) -> float:
    """The largest frequency of a free link, rad/s; no joint and no load makes it larger."""
    from scipy.linalg import eigh

    mass, stiffness = _matrices(cut, np.zeros((6, 6)))
    return float(np.sqrt(eigh(stiffness, mass, eigvals_only=True)[-1]))


def _matrices(cut: list[_Piece], carried: Array, masses: Sequence[LumpedMass] = ()) -> tuple[Array, Array]:
    """Mass and stiffness (6 + k, 6 + k) of a free straight link in the motion of its root and the angles of hinges."""
    mass = np.zeros((6 + 3 * (len(cut) - 1),) * 2)
    end = 2.0 * cut[-1].centre - cut[-1].start  # the last piece is uniform
    bodies = [(j, piece.centre, np.diag([*[piece.mass] * 3, *piece.inertia])) for j, piece in enumerate(cut)]
    bodies += [(_piece_below(cut, each.position), each.position, _spatial(each)) for each in masses]
    for number, place, inertia in [*bodies, (len(cut) - 1, end, carried)]:
        arms = [place, *(place - piece.start for piece in cut[1 : number + 1])]
        moved = np.zeros((6, len(mass)))
        moved[:3, :3] = np.eye(3)
        for j, arm in enumerate(arms):
            moved[3:, 3 * j + 3 : 3 * j + 6] = np.eye(3)
            moved[1, 3 * j + 5], moved[2, 3 * j + 4] = arm, -arm
        mass += moved.T @ inertia @ moved
    return mass, np.diag(np.concatenate([np.zeros(6), *(piece.stiffness for piece in cut[1:])]))


def _damp(tendons: Any, name: str, modes: tuple[Array, Array], ratio: float) -> None:
    """Adds a damper for each mode of a link: the coordinate of a mode is its momentum times the hinges' angles."""
    for number, (frequency, momenta) in enumerate(zip(modes[0], modes[1].T, strict=True)):
        damping = repr(float(2.0 * ratio * frequency))
        tendon = add_element(tendons, "fixed", name=f"{name}_mode_{number}", damping=damping)
        for j, coefficient in enumerate(momenta):
            if abs(coefficient) > 1e-12 * np.abs(momenta).max():
                add_element(tendon, "joint", joint=f"{name}_{j // 3}_{'xyz'[j % 3]}", coef=repr(float(coefficient)))


def add_element(parent: Any, tag: str, attributes: dict[str, str] | None = None, **more: str) -> Any:
    """Gives an element that is added to another one."""
    return ElementTree.SubElement(parent, tag, (attributes or {}) | more)


def format_numbers(values: Any) -> str:
    """Gives values as MJCF has them."""
    return " ".join(repr(float(value)) for value in values)


def format_axes(turn: Array) -> str:
    """Gives a rotation matrix as MJCF's "xyaxes" has it."""
    return format_numbers(turn.T[:2].ravel())
