"""Elements of a URDF file: XML tree, links, joints and their numbers, which are read where they are used.

Source of the format: https://wiki.ros.org/urdf/XML. Elements and attributes without a use here are not checked.
"""

from collections.abc import Iterable
from typing import NamedTuple
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.errors import short_repr, value_error

TURNING, SLIDING, FIXED = ("revolute", "continuous"), "prismatic", "fixed"  # types of joints with a meaning here
EXPAND = "expand macros (xacro) first"  # advice for a file with macros
DEFINITIONS = {"xacro:arg", "xacro:macro", "xacro:property"}  # macros that stand for nothing by themselves
Pose = tuple[Array, Array]  # rotation matrix (3, 3) and position (3,), m


class UrdfJoint(NamedTuple):
    """Joint of the file."""

    name: str
    kind: str | None
    parent: str
    child: str
    element: ElementTree.Element

    @property
    def field(self) -> str:
        """Name for errors."""
        return f"joint {self.name!r}"

    @property
    def obstacle(self) -> str | None:
        """Type, or "mimic of" another joint, if it prevents the joint from being a joint of an arm; else None."""
        mimic = self.element.find("mimic")
        if self.kind not in TURNING:
            return f"type {short_repr(self.kind)}"
        return None if mimic is None else f"mimic of {short_repr(mimic.get('joint'))}"

    @property
    def axis(self) -> Array:
        """Unit vector (3,) of the axis in the frame of the joint."""
        axis = numbers(f"{self.field}.axis", self.element.find("axis"), "xyz", "1 0 0")
        length = float(np.linalg.norm(axis))
        if not 1e-9 < length < np.inf:
            raise value_error(f"{self.field}.axis", axis.tolist(), "an axis of length > 0")
        return axis / length

    @property
    def rest_value(self) -> float:
        """Value nearest to zero within the limits, rad or m; zero without limits."""
        limit = self.element.find("limit") if self.kind in ("revolute", SLIDING) else None
        low, high = (self.limit(name) for name in ("lower", "upper")) if limit is not None else (0.0, 0.0)
        return min(max(0.0, low), high) + 0.0 if low <= high else 0.0  # + 0.0: -0.0 is 0

    def limit(self, name: str) -> float:
        """Return a number of <limit>, 0 if it is missing; infinity is allowed."""
        return float(numbers(f"{self.field}.limit", self.element.find("limit"), name, "0", infinite=True)[0])

    def moved(self, value: float) -> Pose:
        """Return the pose of the child link in the parent link with the joint at a value, rad or m."""
        turn, place = origin(self.field, self.element)
        if value and self.kind == SLIDING:
            place = place + turn @ self.axis * value
        elif value:
            turn = turn @ turn_about(self.axis, value)
        return turn, place


class UrdfTree(NamedTuple):
    """Links and joints of the file by name, the joint to the parent of each link, and the links from the root on."""

    links: dict[str, ElementTree.Element]
    joints: dict[str, UrdfJoint]
    inboard: dict[str, UrdfJoint]
    order: list[str]

    def path(self, link: str) -> list[UrdfJoint]:
        """Return the joints from the root to a link."""
        result: list[UrdfJoint] = []
        while joint := self.inboard.get(result[-1].parent if result else link):
            result.append(joint)
        return result[::-1]

    def movers(self, moving: Iterable[str]) -> dict[str, UrdfJoint | None]:
        """Return the joint that moves each link if only the named joints move; None for links that stand still."""
        names, result = set(moving), dict[str, UrdfJoint | None]()
        for link in self.order:
            joint = self.inboard.get(link)
            result[link] = joint if joint is None or joint.name in names else result[joint.parent]
        return result


def parsed(data: bytes) -> ElementTree.Element:
    """Return the root element of an XML document without a document type, and thus without entities.

    Namespaces are not resolved, so that unknown prefixes are allowed, as in urdfdom. A declaration after comments or
    blank lines is allowed, too.
    """
    head, mark, rest = data.removeprefix(b"\xef\xbb\xbf").partition(b"<?xml")
    if mark and head and b"<robot" not in head:
        declaration, end, rest = rest.partition(b"?>")
        data = mark + declaration + end + head + rest
    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    parser.StartDoctypeDeclHandler = _refuse_document_type
    parser.Parse(data, True)
    root: ElementTree.Element = builder.close()
    return root


def _refuse_document_type(*_: object) -> None:
    raise ValueError("a document type (DTD) with its entities is not allowed; give a URDF without <!DOCTYPE>")


def macros(root: ElementTree.Element) -> list[str]:
    """Return the tags of macros that were not expanded, at places where links, joints and masses are described."""
    places = (root, *root.findall("link"), *root.findall("joint"), *root.findall("link/inertial"))
    tags = {child.tag for place in places for child in place if child.tag.startswith("xacro:")}
    return sorted(tags - DEFINITIONS)


def read_tree(root: ElementTree.Element) -> UrdfTree:
    """Return the tree of links and joints below <robot>."""
    links = _named(root, "link")
    joints = {name: _joint(name, element) for name, element in _named(root, "joint").items()}
    inboard: dict[str, UrdfJoint] = {}
    children: dict[str, list[str]] = {}
    for joint in joints.values():
        for end, name in (("parent", joint.parent), ("child", joint.child)):
            if name not in links:
                raise value_error(f"{joint.field}.{end}", name, "a link of the file")
        if joint.child in inboard:
            raise value_error(f"{joint.field}.child", joint.child, "a link without another joint to a parent")
        inboard[joint.child] = joint
        children.setdefault(joint.parent, []).append(joint.child)
    order = [name for name in links if name not in inboard]
    if len(order) > 1:
        raise value_error("the links without a parent", order, "a tree of links with one root")
    for link in order:  # which grows
        order.extend(children.get(link, ()))
    if len(order) != len(links):
        raise value_error("the links", sorted(set(links) - set(order)), "a tree of links without a loop")
    return UrdfTree(links, joints, inboard, order)


def _named(root: ElementTree.Element, tag: str) -> dict[str, ElementTree.Element]:
    """Return the elements with a tag by their names, which must differ."""
    result: dict[str, ElementTree.Element] = {}
    for element in root.findall(tag):
        name = element.get("name")
        if not name or not name.isprintable() or name in result:
            raise value_error(f"{tag}.name", name, f"a printable name that no other <{tag}> has")
        result[name] = element
    if not result:
        raise ValueError(f"{tag}: missing; give at least one <{tag}>")
    return result


def _joint(name: str, element: ElementTree.Element) -> UrdfJoint:
    """Return a joint of the file."""
    parent, child = (required(f"joint {name!r}", element, tag).get("link", "") for tag in ("parent", "child"))
    return UrdfJoint(name, element.get("type"), parent, child, element)


def origin(field: str, element: ElementTree.Element) -> Pose:
    """Return the pose in the <origin> of an element: rotations about fixed x, y and z (roll, pitch, yaw), position."""
    place = element.find("origin")
    roll, pitch, yaw = numbers(f"{field}.origin", place, "rpy", "0 0 0")
    x, y, z = np.eye(3)
    turn = turn_about(z, yaw) @ turn_about(y, pitch) @ turn_about(x, roll)
    return turn, numbers(f"{field}.origin", place, "xyz", "0 0 0")


def turn_about(axis: Array, angle: float) -> Array:
    """Return the rotation matrix (3, 3) about a unit vector (3,) by an angle, rad (Rodrigues' formula)."""
    cross = np.cross(np.eye(3), axis)
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def required(field: str, element: ElementTree.Element, tag: str) -> ElementTree.Element:
    """Return the child element with a tag."""
    child = element.find(tag)
    if child is None:
        raise ValueError(f"{field}: <{tag}> is missing; give it")
    return child


def numbers(
    field: str, element: ElementTree.Element | None, attribute: str, default: str | None = None, infinite: bool = False
) -> Array:
    """Return the numbers of an attribute.

    Args:
        field: name of the element for errors.
        element: the element.
        attribute: name of the attribute.
        default: text of a missing attribute or element; its number of entries, or 1 without it, is required.
        infinite: True if infinite numbers are allowed.
    """
    text = default if element is None else element.get(attribute, default)
    count = len(default.split()) if default else 1
    try:
        result = np.array([float(each) for each in (text or "").split()])
    except ValueError:
        result = np.zeros(0)
    if len(result) != count or np.isnan(result).any() or not (infinite or np.isfinite(result).all()):
        allowed = f"{count} finite numbers" if count > 1 else "a finite number"
        raise value_error(f"{field}.{attribute}", text, allowed + f"; {EXPAND}" * ("${" in (text or "")))
    return result
