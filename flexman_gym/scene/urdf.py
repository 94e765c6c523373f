"""Import of arms from URDF: a chain of rigid bodies, with a sidecar for sections, springs and motors.

At zero joint angles all frames of an `Arm` are parallel to its base frame. Each joint and body of the URDF is therefore
expressed in the axes of the root link, at zero angles, before the links are built. Source of the format:
https://wiki.ros.org/urdf/XML.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from flexman_gym.common import files
from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import (
    finite,
    mapping,
    non_negative,
    number_array,
    one_of,
    sequence,
    short_path,
    value_error,
)
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.serialization import find_arm

DRIVEN, SLIDING, FIXED = ("revolute", "continuous"), "prismatic", "fixed"  # supported types of joints
DAMPING = {"gravity": (0.0, 0.0, -9.81), "stiffness_proportional_damping": 0.0, "modal_damping_ratio": 0.0}  # defaults
NO_DISTANCE = 1e-12  # m; joints at a smaller distance are at the same place
AGREEMENT = 1e-6  # dimensionless; largest difference of length and direction between sidecar and URDF
Pose = tuple[Array, Array]  # rotation matrix (3, 3) and position (3,), m


class Body(NamedTuple):
    """Rigid body: mass (kg), centre of mass (3,), m, and inertia matrix (3, 3) about it, kg m^2, in common axes."""

    mass: float
    centre: Array
    inertia: Array

    @classmethod
    def joined(cls, bodies: Sequence["Body"]) -> "Body":
        """Return several bodies as one; a mass of 0 without bodies."""
        mass = sum(body.mass for body in bodies)
        centre = sum((body.mass * body.centre for body in bodies), np.zeros(3)) / (mass or 1.0)
        inertia = np.zeros((3, 3))
        for body in bodies:
            r = body.centre - centre
            inertia += body.inertia + body.mass * (r @ r * np.eye(3) - np.outer(r, r))
        return cls(mass, centre, inertia)

    def seen_from(self, rotation: Array, origin: Array) -> "Body":
        """Return the body in a frame with given axes (columns of the rotation) and origin, in the present axes."""
        inertia = rotation.T @ self.inertia @ rotation
        return Body(self.mass, rotation.T @ (self.centre - origin), (inertia + inertia.T) / 2.0)

    def plain(self, position: float = 0.0) -> dict[str, Any]:
        """Return the plain form of a Payload, or of a LumpedMass at a position along its link, m; zeros left out."""
        parts = {"inertia": self.inertia, "offset": self.centre - [position, 0.0, 0.0]}
        return {"mass": self.mass} | {name: part.tolist() for name, part in parts.items() if part.any()}


class _Joint(NamedTuple):
    """Joint of the file; `axis` and `origin` are in the frame of the parent link and of the joint, as in the file."""

    name: str
    kind: str
    parent: str
    child: str
    origin: Pose
    axis: Array
    element: ElementTree.Element


class _Builder(ElementTree.TreeBuilder):
    """Builder of an XML tree that refuses a document type, and with it all entities."""

    def doctype(self, *_: object) -> None:
        raise ValueError("a document type (DTD) with its entities is not allowed; give a URDF without <!DOCTYPE>")


def read_urdf(path: str | Path, sidecar: object, tip: str | None, held: Mapping[str, float] | None) -> Arm:
    """Return the arm of a URDF file; arguments and errors as in `Arm.from_urdf`."""
    text = files.regular_file(path).read_bytes()
    try:
        root = ElementTree.fromstring(text, ElementTree.XMLParser(target=_Builder()))
        if root.tag != "robot":
            raise value_error("the root element", root.tag, "robot; expand macros (xacro) first")
        return _arm(root, _sidecar(sidecar), tip, {} if held is None else held)
    except ElementTree.ParseError as error:
        raise ValueError(f"{short_path(path)}: {error}; give valid XML; expand macros (xacro) first") from None
    except (ValueError, LookupError) as error:  # LookupError: an unknown encoding
        raise ValueError(f"{short_path(path)}: {error}") from None


def _sidecar(given: object) -> dict[str, Any]:
    """Return the mapping of a sidecar from its file, a mapping or None; the parts are checked with the arm."""
    try:
        data = files.read_data(Path(given)) if isinstance(given, str | Path) else {} if given is None else given
    except ValueError as error:
        raise ValueError(f"sidecar {short_path(given)}: {error}") from None
    result = mapping("sidecar", data, ("links", "joints", *DAMPING))
    for name in ("links", "joints"):
        parts = result.get(name, {})
        for part, entries in mapping(f"sidecar.{name}", parts, parts if isinstance(parts, dict) else ()).items():
            if not isinstance(entries, dict):
                raise value_error(f"sidecar.{name}.{part}", entries, "a mapping")
    return result


def _arm(root: ElementTree.Element, sidecar: dict[str, Any], tip: str | None, held: Any) -> Arm:
    """Return the arm of a tree of elements, see `read_urdf`."""
    links, joints = _named(root, "link"), {name: _joint(name, each) for name, each in _named(root, "joint").items()}
    held = mapping("held", held, [name for name, joint in joints.items() if joint.kind != FIXED])
    inboard = _inboard(links, joints.values())
    poses, movers = _place(links, inboard, held)
    tip, chain = _chain(links, inboard, movers, tip)
    for name, part in (("links", [joint.child for joint in chain]), ("joints", [joint.name for joint in chain])):
        mapping(f"sidecar.{name}", sidecar.get(name, {}), part)
    ends = [*(poses[joint.child][1] for joint in chain[1:]), poses[tip][1]]
    bodies: dict[str, dict[str, Body]] = {joint.child: {} for joint in chain}
    for name, mover in movers.items():
        body = _body(name, links[name])
        if mover and body:
            turn, place = poses[name]
            bodies[mover.child][name] = body.seen_from(turn.T, -turn.T @ place)
    last, payload = bodies[chain[-1].child], None
    if tip in last and len(last) > 1 and tip != chain[-1].child:
        payload = last.pop(tip).seen_from(np.eye(3), ends[-1]).plain()
    names = [joint.child for joint in chain]
    data = {
        "links": [
            _link(name, poses[name][1], end, bodies[name], sidecar.get("links", {}).get(name))
            for name, end in zip(names, ends, strict=True)
        ],
        "joints": [
            _driven(joint, poses[joint.child][0], sidecar.get("joints", {}).get(joint.name, {})) for joint in chain
        ],
        "payload": payload,
        **{name: sidecar.get(name, default) for name, default in DAMPING.items()},
    }
    try:
        arm = find_arm(data)
    except ValueError as error:  # name the parts as the files do
        found = re.match(r"arm\.(link|joint)s\[(\d+)\](?:\.?LumpedMass)?", str(error))
        if not found:
            raise
        name = getattr(chain[int(found[2])], "child" if found[1] == "link" else "name")
        raise ValueError(f"{found[1]} {name!r}{str(error)[found.end() :]}") from None
    for name, link, end in zip(names, arm.links, ends, strict=True):
        _check_tip(name, end - poses[name][1], link.length * np.array(link.orientation)[:, 0])
    return arm


def _named(root: ElementTree.Element, tag: str) -> dict[str, ElementTree.Element]:
    """Return the elements with a tag by their names, which must differ."""
    result: dict[str, ElementTree.Element] = {}
    for element in root.findall(tag):
        name = element.get("name")
        if not name or name in result:
            raise value_error(f"{tag}.name", name, "a name of its own")
        result[name] = element
    if not result:
        raise ValueError(f"{tag}: missing; give at least one <{tag}>")
    return result


def _joint(name: str, element: ElementTree.Element) -> _Joint:
    """Return a joint of the file."""
    field = f"joint {name!r}"
    kind = one_of(f"{field}.type", element.get("type"), (*DRIVEN, SLIDING, FIXED))
    parent, child = (_required(field, element, tag).get("link", "") for tag in ("parent", "child"))
    axis = _numbers(f"{field}.axis", element.find("axis") if kind != FIXED else None, "xyz", "1 0 0")
    length = float(np.linalg.norm(axis))
    if not 1e-9 < length < np.inf:
        raise value_error(f"{field}.axis", axis.tolist(), "an axis of length > 0")
    return _Joint(name, kind, parent, child, _origin(field, element), axis / length, element)


def _inboard(links: Mapping[str, Any], joints: Any) -> dict[str, _Joint]:
    """Return child link -> joint, with the links of each joint in the file and at most one joint per child."""
    result: dict[str, _Joint] = {}
    for joint in joints:
        for end, name in (("parent", joint.parent), ("child", joint.child)):
            if name not in links:
                raise value_error(f"joint {joint.name!r}.{end}", name, "a link of the file")
        if joint.child in result:
            raise value_error(f"joint {joint.name!r}.child", joint.child, "a link without another joint to a parent")
        result[joint.child] = joint
    return result


def _place(
    links: Mapping[str, Any], inboard: Mapping[str, _Joint], held: Mapping[str, float]
) -> tuple[dict[str, Pose], dict[str, _Joint | None]]:
    """Return the pose of each link in the root link at zero angles, and the joint that moves it; None on the base."""
    roots = [name for name in links if name not in inboard]
    if len(roots) != 1:
        raise value_error("the links without a parent", roots, "a tree of links with one root")
    poses: dict[str, Pose] = {roots[0]: (np.eye(3), np.zeros(3))}
    movers: dict[str, _Joint | None] = {roots[0]: None}
    children: dict[str, list[_Joint]] = {}
    for joint in inboard.values():
        children.setdefault(joint.parent, []).append(joint)
    queue = [roots[0]]
    for parent in queue:  # which grows
        turn, place = poses[parent]
        for joint in children.get(parent, []):
            rotation, position = turn @ joint.origin[0], place + turn @ joint.origin[1]
            value = finite(f"held[{joint.name!r}]", held.get(joint.name, 0.0), "rad or m")
            if joint.kind == SLIDING:
                position = position + rotation @ joint.axis * value
            elif joint.kind != FIXED:
                rotation = rotation @ _turn_about(joint.axis, value)
            merged = joint.kind == FIXED or joint.name in held
            poses[joint.child], movers[joint.child] = (rotation, position), movers[parent] if merged else joint
            queue.append(joint.child)
    if len(queue) != len(links):
        raise value_error("the links", sorted(set(links) - set(queue)), "a tree of links without a loop")
    return poses, movers


def _chain(
    links: Mapping[str, Any], inboard: Mapping[str, _Joint], movers: Mapping[str, _Joint | None], tip: str | None
) -> tuple[str, list[_Joint]]:
    """Return the tip and the joints from base to tip that move; other moving joints are refused."""
    parents = {joint.parent for joint in inboard.values()}
    leaves = [name for name in links if name not in parents and movers[name]]
    if tip is None and len(leaves) > 1:
        raise value_error("tip", tip, f"one of the ends of the branches: {', '.join(leaves)}")
    if not any(movers.values()):
        raise ValueError("joint: no joint moves; give at least one revolute or continuous joint that is not held")
    tip = one_of("tip", tip or (leaves or [""])[0], [name for name in links if movers[name]])
    chain: list[_Joint] = []
    while mover := movers[chain[0].parent if chain else tip]:
        chain.insert(0, mover)
    for joint in {each.name: each for each in movers.values() if each}.values():
        field, hold = f"joint {joint.name!r}", f"held={{{joint.name!r}: position}}"
        if joint.kind == SLIDING:
            raise value_error(f"{field}.type", joint.kind, f"revolute, continuous or fixed, or {hold}")
        if joint.element.find("mimic") is not None:
            raise value_error(f"{field}.mimic", joint.element.find("mimic").get("joint"), f"none, or {hold}")  # type: ignore[union-attr]
        if joint not in chain:
            raise value_error(field, "a branch", f"only joints between the base and {tip!r}, or {hold}")
    return tip, chain


def _link(name: str, start: Array, end: Array, bodies: dict[str, Body], section: dict[str, Any] | None) -> Any:
    """Return the plain form of a link from its joint at `start` to `end` (3,), m, in the axes of the root.

    Args:
        name: link of the URDF that the joint moves.
        start: position of its joint.
        end: position of the next joint, or of the tip.
        bodies: link of the URDF -> body that moves with the joint.
        section: entry of the sidecar with a section, which replaces the body of this link; None for a rigid link.
    """
    length = float(np.linalg.norm(end - start))
    direction = (end - start) / length if length > NO_DISTANCE else np.array([1.0, 0.0, 0.0])
    side = np.cross([0.0, 0.0, 1.0], direction)
    y = side / np.linalg.norm(side) if np.linalg.norm(side) > AGREEMENT else np.array([0.0, 1.0, 0.0])
    y -= y @ direction * direction
    rotation = np.stack([direction, y / np.linalg.norm(y), np.cross(direction, y / np.linalg.norm(y))], axis=1)
    plain = {"length": length if length > NO_DISTANCE else 0.0, "orientation": rotation.tolist()}
    merged = [body for other, body in bodies.items() if section is None or other != name]
    body = Body.joined(merged)
    if section is None:
        if not body.mass:
            raise ValueError(f"link {name!r}.inertial: missing; give <inertial> with mass and inertia to a moving link")
        body = body.seen_from(rotation, start)
        inertia = {"mass": body.mass, "centre": body.centre.tolist(), "inertia": body.inertia.tolist()}
        return {"shape": "rigid", **plain, **inertia}
    if "sections" in section:
        del plain["length"]
    plain |= section
    if body.mass:
        allowed = "3 rows of 3 numbers"
        body = body.seen_from(number_array(f"link {name!r}.orientation", plain["orientation"], (3, 3), allowed), start)
        position, given = float(np.clip(body.centre[0], 0.0, length)), plain.get("masses", ())
        masses = sequence(f"link {name!r}.masses", given, "LumpedMass")
        plain["masses"] = [*masses, {"position": position, **body.plain(position)}]
    return plain


def _check_tip(name: str, expected: Array, given: Array) -> None:
    """Check that a link of the sidecar reaches to the next joint of the URDF; vectors (3,), m."""
    if not np.linalg.norm(given - expected) <= AGREEMENT * max(float(np.linalg.norm(expected)), NO_DISTANCE * 1e6):
        allowed = f"a length and an orientation that lead to the next joint at {expected.round(9).tolist()} (m)"
        raise value_error(f"link {name!r}", given.round(9).tolist(), allowed)


def _driven(joint: _Joint, turn: Array, extra: dict[str, Any]) -> dict[str, Any]:
    """Return the plain form of a joint, with its axis in the axes of the root; entries of the sidecar take precedence.

    The motor of the sidecar determines the torque limit if it has a limit itself; its speed limit, if absent, is that
    of the joint.
    """
    field, values = f"joint {joint.name!r}", {}
    for tag, name in (("dynamics", "damping"), ("dynamics", "friction"), ("limit", "effort"), ("limit", "velocity")):
        number = _numbers(f"{field}.{tag}.{name}", joint.element.find(tag), name, "0")
        values[name] = non_negative(f"{field}.{tag}.{name}", float(number[0]))
    axis = turn @ joint.axis
    plain = {"axis": (axis / np.linalg.norm(axis)).tolist(), "rotor_inertia": 0.0, "stiffness": None, "damping": 0.0,
             "viscous_friction": values["damping"], "coulomb_friction": values["friction"],
             "torque_limit": values["effort"] or None}  # fmt: skip
    motor = extra["motor"] if isinstance(extra.get("motor"), dict) else {}
    if motor:
        del plain["rotor_inertia"]
        if values["velocity"] and isinstance(motor.get("gear_ratio"), int | float):
            extra = extra | {"motor": {"speed_limit": values["velocity"] * motor["gear_ratio"], **motor}}
    if extra.get("passive") is True or {"current_limit", "voltage_limit"} & motor.keys():
        del plain["torque_limit"]
    return plain | extra


def _body(name: str, element: ElementTree.Element) -> Body | None:
    """Return the body of a link in its frame; None without mass."""
    inertial, field = element.find("inertial"), f"link {name!r}.inertial"
    if inertial is None:
        return None
    number = _numbers(f"{field}.mass", _required(field, inertial, "mass"), "value")[0]
    mass = non_negative(f"{field}.mass", float(number), "kg")
    entries, tensor = _required(field, inertial, "inertia"), np.zeros((3, 3))
    for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        entry = f"i{'xyz'[i]}{'xyz'[j]}"
        tensor[i, j] = tensor[j, i] = _numbers(f"{field}.{entry}", entries, entry)[0]
    if mass == 0.0 and tensor.any():
        raise value_error(f"{field}.mass", mass, "a number > 0 (kg) where an inertia is given")
    turn, place = _origin(field, inertial)
    return Body(mass, place, turn @ tensor @ turn.T) if mass else None


def _origin(field: str, element: ElementTree.Element) -> Pose:
    """Return the pose in the <origin> of an element: rotations about fixed x, y and z (roll, pitch, yaw), position."""
    origin = element.find("origin")
    roll, pitch, yaw = _numbers(f"{field}.origin", origin, "rpy", "0 0 0")
    x, y, z = np.eye(3)
    turn = _turn_about(z, yaw) @ _turn_about(y, pitch) @ _turn_about(x, roll)
    return turn, _numbers(f"{field}.origin", origin, "xyz", "0 0 0")


def _turn_about(axis: Array, angle: float) -> Array:
    """Return the rotation matrix (3, 3) about a unit vector (3,) by an angle, rad (Rodrigues' formula)."""
    cross = np.cross(np.eye(3), axis)
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def _required(field: str, element: ElementTree.Element, tag: str) -> ElementTree.Element:
    """Return the child element with a tag."""
    child = element.find(tag)
    if child is None:
        raise ValueError(f"{field}: <{tag}> is missing; give it")
    return child


def _numbers(field: str, element: ElementTree.Element | None, attribute: str, default: str | None = None) -> Array:
    """Return the numbers of an attribute; the default, also for a missing element, sets how many (1 without it)."""
    text = default if element is None else element.get(attribute, default)
    count = len(default.split()) if default else 1
    try:
        result = np.array([float(each) for each in (text or "").split()])
    except ValueError:
        result = np.zeros(0)
    if len(result) != count or not np.isfinite(result).all():
        raise value_error(f"{field}.{attribute}", text, f"{count} finite numbers" if count > 1 else "a finite number")
    return result
