"""Export of an arm to MJCF, the model format of MuJoCo, as rigid pieces connected by springs.

A section of length L is divided into `pieces` segments of length l = L / pieces. The compliance of a segment is
concentrated at its middle, in three hinges with springs: G J / l about the beam axis, E I / l about the two transverse
axes. Rigid pieces thus connect the middles of neighbouring segments, with half a segment at either end of a link.

A flexible joint is two hinges in series about one axis: the hinge of the motor, whose armature is the inertia of the
rotor (which resists relative rotation only, as in Eq. 23 of the paper), and the hinge of the spring. The joint angle is
their sum. A rigid joint is the hinge of the motor alone.

Each mode of a link has the damping ratio of the arm: a fixed tendon over the hinges damps the speed of this mode only.
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

PIECES, MAX_PIECES = 8, 64  # per section of a link; default and limit
STABLE_STEP = 1.5  # step times the largest natural frequency (rad/s); "implicitfast" and "Euler" are stable up to 2
AddLink = Callable[[Any, Any, Any], tuple[Any, dict[str, str]]]


class _Piece(NamedTuple):
    """Rigid piece of a link.

    Attributes:
        start: position of its hinges along the link, m; 0 for the first piece, which is fixed to the joint.
        mass: kg.
        centre: position of its centre of mass along the link, m.
        inertia: (3,) about the centre of mass, along the axes of the beam, kg m^2.
        stiffness: (3,) of its hinges about these axes, N m/rad.
    """

    start: float
    mass: float
    centre: float
    inertia: Array
    stiffness: Array


def rigid_pieces(link: Link | NonUniformLink, pieces: int) -> list[_Piece]:
    """Return the 1 + k rigid pieces of a link, base to tip: the first piece, and one for each segment of each section.

    Args:
        link: the link.
        pieces: number of segments of each section; 0 for a rigid link.
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
        springs = own.shear_modulus * own.torsion_constant, *own.youngs_modulus * _second_moments(own)
        stiffness = np.array(springs) / (2.0 * half) if first else np.zeros(3)
        result.append(_Piece(place, float(masses.sum()), centre, inertia, stiffness))
    return result


def _second_moments(link: Link) -> Array:
    """Return the second moments of area (2,) of a section about y and z, m^4."""
    return np.array([link.second_moment_y, link.second_moment_z])


def to_mjcf(
    arm: Arm,
    pieces: int = PIECES,
    integrator: str = "implicitfast",
    step: float | None = None,
    add_link: AddLink | None = None,
) -> str:
    """Return the model of an arm at zero angles in the format of MuJoCo.

    The actuators are the motors, in N m. The site "tip" is the tip. Hinges are named "motor 0", "spring 0" and so on.

    Args:
        arm: the arm.
        pieces: number of segments of each section of a link; 0 for rigid links.
        integrator: integrator of MuJoCo; "Euler" is faster, but modal damping may make it unstable.
        step: time step, s; None for a step at which "implicitfast" is stable, or 1 ms for rigid links.
        add_link: function that adds a link of another kind to the body of its joint. Its arguments are the root
            element, the body and the link; it returns the body at the tip of the link and the position of the tip in
            that body.
    """
    instance("arm", arm, Arm, "an Arm")
    whole_number("pieces", pieces, 0, MAX_PIECES)
    cut = [rigid_pieces(link, pieces) for link in arm.links]
    lumped_masses = [link.masses for link in arm.links]
    modes = [_modes(*each) for each in zip(cut, _tips(arm), lumped_masses, strict=True)] if pieces else []
    highest = max(map(_highest_frequency, cut)) if pieces else 1.5e3
    root = ElementTree.Element("mujoco")
    option = {"integrator": integrator, "gravity": _numbers(arm.gravity)}
    options = _add(root, "option", option, timestep=repr(float(STABLE_STEP / highest if step is None else step)))
    flags = {"contact": "disable", "warmstart": "disable"}
    _add(options, "flag", flags if _has_dry_friction(arm) else flags | {"constraint": "disable"})
    _add(root, "compiler", angle="radian", autolimits="true")
    parent, actuators, tendons = (_add(root, name) for name in ("worldbody", "actuator", "tendon"))
    place: dict[str, str] = {}
    for i, (link, joint) in enumerate(zip(arm.links, arm.joints, strict=True)):
        body = _add(parent, "body", place, name=f"link_{i}")
        _joint(body, actuators, joint, i)
        if add_link:
            parent, place = add_link(root, body, link)
            continue
        parent, place = _link(body, cut[i], link, arm.stiffness_proportional_damping)
        if modes and arm.damping_ratios[i]:
            _damp(tendons, f"link_{i}", modes[i], arm.damping_ratios[i])
    if arm.payload is not None:
        _rigid(_add(parent, "body", place, name="payload"), arm.payload)
    _add(parent, "site", name="tip", pos=place["pos"])
    return ElementTree.tostring(root, encoding="unicode")


def _has_dry_friction(arm: Arm) -> bool:
    """Return whether a joint has dry friction, which is a constraint in MuJoCo."""
    return any(joint.coulomb_friction for joint in arm.joints)


def _joint(body: Any, actuators: Any, joint: Joint, i: int) -> None:
    """Add the hinges and the motor of a joint."""
    axis = _numbers(joint.axis)
    friction = {"damping": repr(joint.viscous_friction), "frictionloss": repr(joint.coulomb_friction)}
    _add(body, "joint", friction, name=f"motor {i}", axis=axis, armature=repr(joint.rotor_inertia))
    limit = joint.torque_limit
    given = {} if limit is None else {"ctrlrange": _numbers((-limit, limit))}
    _add(actuators, "motor", given, joint=f"motor {i}", gear="1")
    if joint.stiffness is not None:
        spring = {"stiffness": repr(joint.stiffness), "damping": repr(joint.damping)}
        _add(body, "joint", spring, name=f"spring {i}", axis=axis)


def _link(body: Any, cut: list[_Piece], link: Any, proportional: float) -> tuple[Any, dict[str, str]]:
    """Add the pieces of a link to the body of its joint; return the last body and the next joint's position there."""
    orientation, name = np.array(link.orientation), body.get("name")
    _inertial(body, cut[0], orientation)
    _masses(body, cut, link.masses, 0, orientation)
    for j, (before, piece) in enumerate(pairwise(cut)):
        along = piece.start - before.start
        first = (
            {"pos": _numbers(orientation[:, 0] * along), "xyaxes": _axes(orientation)}
            if j == 0
            else {"pos": _numbers((along, 0, 0))}
        )
        body = _add(body, "body", first, name=f"{name}_{j}")
        for letter, axis, stiffness in zip("xyz", np.eye(3), piece.stiffness, strict=True):
            spring = {"stiffness": repr(float(stiffness)), "damping": repr(float(proportional * stiffness))}
            _add(body, "joint", spring, name=f"{name}_{j}_{letter}", axis=_numbers(axis))
        _inertial(body, piece, np.eye(3))
        _masses(body, cut, link.masses, j + 1, np.eye(3))
    if len(cut) == 1:
        return body, {"pos": _numbers(orientation[:, 0] * link.length)}
    return body, {"pos": _numbers((link.length - cut[-1].start, 0.0, 0.0)), "xyaxes": _axes(orientation.T)}


def _inertial(body: Any, piece: _Piece, orientation: Array) -> None:
    """Add the mass and inertia of a piece to a body at its start.

    The beam lies along the x axis of the orientation (3, 3).
    """
    where = {"pos": _numbers(orientation[:, 0] * (piece.centre - piece.start)), "xyaxes": _axes(orientation)}
    _add(body, "inertial", where, mass=repr(piece.mass), diaginertia=_numbers(piece.inertia))


def _masses(body: Any, cut: list[_Piece], masses: Sequence[LumpedMass], number: int, orientation: Array) -> None:
    """Add the lumped masses of a piece to its body, with the beam along the x axis of the orientation (3, 3)."""
    for mass in masses:
        if _piece_number(cut, mass.position) == number:
            where = {
                "pos": _numbers(orientation[:, 0] * (mass.position - cut[number].start)),
                "xyaxes": _axes(orientation),
            }
            _rigid(_add(body, "body", where), mass)


def _piece_number(cut: list[_Piece], position: float) -> int:
    """Return the index of the piece at a position along a link (m)."""
    return sum(piece.start <= position for piece in cut[1:])


def _rigid(body: Any, mass: Payload | LumpedMass) -> None:
    """Add the mass and inertia of a rigid body."""
    inertia = np.array(mass.inertia if mass.inertia is not None else np.zeros((3, 3)))
    packed = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    about = {"fullinertia": _numbers(packed)} if packed.any() else {"diaginertia": "0 0 0"}
    centre = np.zeros(3) if mass.offset is None else mass.offset
    _add(body, "inertial", about, pos=_numbers(centre), mass=repr(mass.mass))


def _spatial(mass: LumpedMass) -> Array:
    """Return the spatial inertia (6, 6) of a lumped mass about the beam axis at its section, linear part first."""
    return spatial_inertia(mass.mass, np.array(mass.offset or np.zeros(3)), np.array(mass.inertia or np.zeros((3, 3))))


def _tips(arm: Arm) -> Array:
    """Return the spatial inertia (n, 6, 6) of everything outboard at the tip of each link."""
    return outboard_inertias(arm, tuple(build_beam(link, 1, flexible=False) for link in arm.links))


def _modes(cut: list[_Piece], carried: Array, masses: Sequence[LumpedMass]) -> tuple[Array, Array]:
    """Return frequencies (k,) in rad/s and modal momenta (k, k) of a clamped link with an inertia at its tip."""
    from scipy.linalg import eigh  # slow import, which most uses of the package do not need

    mass, stiffness = _matrices(cut, carried, masses)
    squares, shapes = eigh(stiffness[6:, 6:], mass[6:, 6:])
    return np.sqrt(squares), mass[6:, 6:] @ shapes


def _highest_frequency(cut: list[_Piece]) -> float:
    """Return the highest natural frequency of a free link, rad/s; joints and loads do not raise it."""
    from scipy.linalg import eigh

    mass, stiffness = _matrices(cut, np.zeros((6, 6)))
    return float(np.sqrt(eigh(stiffness, mass, eigvals_only=True)[-1]))


def _matrices(cut: list[_Piece], carried: Array, masses: Sequence[LumpedMass] = ()) -> tuple[Array, Array]:
    """Return mass and stiffness (6 + k, 6 + k) of a free straight link over root motion and hinge angles."""
    mass = np.zeros((6 + 3 * (len(cut) - 1),) * 2)
    end = 2.0 * cut[-1].centre - cut[-1].start  # the last piece is uniform
    bodies = [(j, piece.centre, np.diag([*[piece.mass] * 3, *piece.inertia])) for j, piece in enumerate(cut)]
    bodies += [(_piece_number(cut, each.position), each.position, _spatial(each)) for each in masses]
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
    """Add a damper for each mode of a link: the modal coordinate is the momentum of the mode times the hinge angles."""
    for number, (frequency, momenta) in enumerate(zip(modes[0], modes[1].T, strict=True)):
        damping = repr(float(2.0 * ratio * frequency))
        tendon = _add(tendons, "fixed", name=f"{name}_mode_{number}", damping=damping)
        for j, coefficient in enumerate(momenta):
            if abs(coefficient) > 1e-12 * np.abs(momenta).max():
                _add(tendon, "joint", joint=f"{name}_{j // 3}_{'xyz'[j % 3]}", coef=repr(float(coefficient)))


def _add(parent: Any, tag: str, attributes: dict[str, str] | None = None, **more: str) -> Any:
    """Return a new child element of an element."""
    return ElementTree.SubElement(parent, tag, (attributes or {}) | more)


def _numbers(values: Any) -> str:
    """Return numbers as text in the format of MJCF."""
    return " ".join(repr(float(value)) for value in values)


def _axes(orientation: Array) -> str:
    """Return a rotation matrix as the text of the MJCF attribute "xyaxes"."""
    return _numbers(orientation.T[:2].ravel())
