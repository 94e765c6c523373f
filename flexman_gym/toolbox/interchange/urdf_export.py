"""Export of an arm to URDF, with a sidecar for its sections, springs and motors; `Arm.from_urdf` reads both."""

from typing import Any
from xml.etree import ElementTree

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.inertia import Body
from flexman_gym.scene.link import Link, NonUniformLink
from flexman_gym.scene.rigid_body import LumpedMass, Payload
from flexman_gym.scene.serialization import to_plain
from flexman_gym.toolbox.interchange.mjcf import rigid_pieces
from flexman_gym.toolbox.interchange.urdf import DAMPING


def to_urdf(arm: Arm) -> tuple[str, dict[str, Any]]:
    """Return the text of the URDF of an arm with rigid links, and the mapping of its sidecar.

    Links are named base, link_1 to link_n and tip, which has the body of the payload; joints joint_1 to joint_n.
    """
    root, place, plain = ElementTree.Element("robot", name="arm"), np.zeros(3), to_plain(arm)
    _add(root, "link", name="base")
    names = ["base", *(f"link_{i}" for i in range(1, arm.n_joints + 1)), "tip"]
    for i, (link, joint) in enumerate(zip(arm.links, arm.joints, strict=True)):
        kind = "revolute" if joint.angle_range else "continuous"
        element = _add_joint(root, f"joint_{i + 1}", kind, names[i : i + 2], place)
        _add(element, "axis", xyz=_numbers(joint.axis))
        ends = dict(zip(("lower", "upper"), map(repr, joint.angle_range or ()), strict=False))
        _add(element, "limit", effort=repr(joint.torque_limit or 0.0), velocity=repr(joint.speed_limit or 0.0), **ends)
        _add(element, "dynamics", damping=repr(joint.viscous_friction), friction=repr(joint.coulomb_friction))
        turn = np.array(link.orientation)
        _add_body(_add(root, "link", name=names[i + 1]), _body(link).seen_from(turn.T, np.zeros(3)))
        place = turn[:, 0] * link.length
        del plain["joints"][i]["axis"]
    _add_joint(root, "mount", "fixed", names[-2:], place)
    tip = _add(root, "link", name="tip")
    if arm.payload is not None:
        _add_body(tip, _lump(arm.payload, 0.0))
    sidecar = {
        "links": {f"link_{i}": plain["links"][i - 1] for i, link in enumerate(arm.links, 1) if link.flexible},
        "joints": {f"joint_{i}": each for i, each in enumerate(plain["joints"], 1)},
        **{name: plain[name] for name in DAMPING if name in plain},
    }
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n", sidecar


def _body(link: Link | NonUniformLink) -> Body:
    """Return a link with its lumped masses as one rigid body, in the axes of the beam with the origin at its joint."""
    lumps = [_lump(mass, mass.position) for mass in link.masses]
    if not link.flexible:
        return Body.joined(lumps)
    (beam,) = rigid_pieces(link, 0)
    return Body.joined([Body(beam.mass, np.array([beam.centre, 0.0, 0.0]), np.diag(beam.inertia)), *lumps])


def _lump(body: LumpedMass | Payload, position: float) -> Body:
    """Return a lumped mass or payload as a body, in axes with an origin at the distance `position` (m) along -x."""
    centre = np.array([position, 0.0, 0.0]) + (body.offset or np.zeros(3))
    return Body(body.mass, centre, np.array(body.inertia or np.zeros((3, 3))))


def _add_joint(root: Any, name: str, kind: str, ends: list[str], place: Array) -> Any:
    """Add a joint at a place (3,), m, in the parent link, and return its element."""
    element = _add(root, "joint", name=name, type=kind)
    for tag, link in zip(("parent", "child"), ends, strict=True):
        _add(element, tag, link=link)
    _add(element, "origin", xyz=_numbers(place))
    return element


def _add_body(link: Any, body: Body) -> None:
    """Add mass, centre of mass and inertia to the element of a link."""
    element = _add(link, "inertial")
    _add(element, "origin", xyz=_numbers(body.centre))
    _add(element, "mass", value=repr(float(body.mass)))
    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    _add(element, "inertia", **{f"i{'xyz'[i]}{'xyz'[j]}": repr(float(body.inertia[i, j])) for i, j in pairs})


def _add(parent: Any, tag: str, **attributes: str) -> Any:
    """Add a child element and return it."""
    return ElementTree.SubElement(parent, tag, attributes)


def _numbers(values: Any) -> str:
    """Return numbers as text, separated by spaces."""
    return " ".join(repr(float(value)) for value in values)
