"""Import of arms from URDF: a chain of rigid bodies, with a sidecar for sections, springs and motors.

At zero joint angles all frames of an `Arm` are parallel to its base frame. Each joint and body of the URDF is therefore
expressed in the axes of the root link, at zero angles, before the links are built.
"""

import json
import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.parsers.expat import ExpatError

import numpy as np

from flexman_gym.common import files
from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import finite, mapping, non_negative, number_array, one_of, sequence
from flexman_gym.common.errors import short_path, short_repr, value_error, warn_caller
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.inertia import Body
from flexman_gym.scene.joint import LARGEST_RANGE
from flexman_gym.scene.serialization import find_arm
from flexman_gym.toolbox.interchange.urdf_file import (
    EXPAND,
    FIXED,
    SLIDING,
    TURNING,
    Pose,
    UrdfJoint,
    UrdfTree,
    macros,
    numbers,
    parsed,
    read_tree,
)
from flexman_gym.toolbox.interchange.urdf_inertia import INERTIAS, check_change, nearest_bodies, read_inertials

DAMPING = {"gravity": (0.0, 0.0, -9.81), "stiffness_proportional_damping": 0.0, "modal_damping_ratio": 0.0}  # defaults
NAMED = 3  # number of joints whose reason is in an error
NO_DISTANCE = 1e-12  # m; joints at a smaller distance are at the same place
AGREEMENT = 1e-6  # dimensionless; largest difference of length and direction between sidecar and URDF


class _Chain(NamedTuple):
    """Joints of the arm from base to tip, the constant values of the other joints, and the joint that moves a link."""

    tree: UrdfTree
    tip: str
    joints: list[UrdfJoint]
    held: dict[str, float]
    movers: dict[str, UrdfJoint | None]

    def poses(self, wanted: Collection[str]) -> dict[str, Pose]:
        """Return the poses of links, and of those between them and the root, in the root link at zero angles."""
        needed = {self.tree.order[0]}
        for name in wanted:
            while name not in needed:
                needed.add(name)
                name = self.tree.inboard[name].parent
        result = {self.tree.order[0]: (np.eye(3), np.zeros(3))}
        for name in self.tree.order[1:]:
            if name in needed:
                joint = self.tree.inboard[name]
                turn, place = result[joint.parent]
                rotation, position = joint.moved(self.held.get(joint.name, 0.0))
                result[name] = turn @ rotation, place + turn @ position
        return result


def read_urdf(
    path: str | Path, sidecar: object, tip: str | None, held: Mapping[str, float] | str | None, inertias: str
) -> Arm:
    """Return the arm of a URDF file; arguments and errors as in `Arm.from_urdf`."""
    data, name = files.regular_file(path).read_bytes(), short_path(path)
    one_of("inertias", inertias, INERTIAS)
    unexpanded: list[str] = []
    notes: list[str] = []
    try:
        root = parsed(data)
        if root.tag != "robot":
            raise value_error("the root element", root.tag, f"robot; {EXPAND}")
        unexpanded = macros(root)
        chain = _chain(read_tree(root), tip, held, notes)
        arm = _arm(chain, _sidecar(sidecar), inertias, notes)
    except ExpatError as error:
        advice = f"; {EXPAND}" * (b"<xacro:" in data)
        raise ValueError(f"{name}: {error}; give valid XML{advice}") from None
    except (ValueError, LookupError) as error:  # LookupError: an unknown encoding
        advice = f"; {EXPAND}: {', '.join(unexpanded)}" if unexpanded else ""
        raise ValueError(f"{name}: {error}{advice}") from None
    if unexpanded:
        notes.append(f"macros that are not expanded are left out: {', '.join(unexpanded)}; {EXPAND}")
    for note in notes:
        warn_caller(f"{name}: {note}")
    return arm


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


def _chain(tree: UrdfTree, tip: str | None, held: Any, notes: list[str]) -> _Chain:
    """Return the joints from base to tip and the values of the others, which must be held; notes are added."""
    free = [joint for joint in tree.joints.values() if joint.kind != FIXED]
    rest = isinstance(held, str) and held == "rest"
    given = {} if held is None or rest else _held(held, {joint.name: joint for joint in free})
    moving = {joint.name for joint in free if joint.name not in given and not (rest and joint.obstacle)}
    movers = tree.movers(moving)
    tip = _tip(tree, movers, tip)
    path = [joint.name for joint in tree.path(tip)]
    joints = [tree.joints[name] for name in path if name in moving and not tree.joints[name].obstacle]
    if not joints:
        raise ValueError(f"joint: no joint turns {tip!r}; give a tip behind a revolute or continuous joint, not held")
    chain = {joint.name for joint in joints}
    others = [joint for joint in free if joint.name not in chain and joint.name not in given]
    values = given | {joint.name: joint.rest_value for joint in others}
    if others and not rest:
        reasons = [f"{joint.name!r} ({joint.obstacle or 'off the chain'})" for joint in others]
        more = f" and {len(others) - NAMED} more" * (len(others) > NAMED)
        named = f"joint{'s' * (len(others) > 1)} {', '.join(reasons[:NAMED])}{more}"
        raise ValueError(
            f"{named}: a motion besides the revolute joints from the base to {tip!r} is not allowed; give "
            f'held="rest", or held={values!r}'
        )
    for text, parts in (
        ("between base and tip", [joint for joint in others if joint.name in path]),
        ("off zero", [joint for joint in others if joint.name not in path and joint.rest_value]),
    ):
        if parts:
            listed = ", ".join(
                f"{joint.name!r} ({joint.obstacle or joint.kind}) at {joint.rest_value:g}" for joint in parts
            )
            notes.append(f'held="rest" holds joints {text} (rad or m): {listed}')
    return _Chain(tree, tip, joints, values, tree.movers(chain))


def _held(held: object, joints: Mapping[str, UrdfJoint]) -> dict[str, float]:
    """Return the checked values of held joints, rad or m."""
    if not isinstance(held, dict):
        raise value_error("held", held, f'"rest", or a mapping with some of {", ".join(joints)}')
    values = {}
    for name, value in mapping("held", held, joints).items():
        values[name] = finite(f"held[{name!r}]", value, "rad or m")
        kind = joints[name].kind
        if values[name] and kind not in (*TURNING, SLIDING):
            raise value_error(
                f"held[{name!r}]", value, f"0.0: a joint of type {short_repr(kind)} is held at its origin"
            )
    return values


def _tip(tree: UrdfTree, movers: Mapping[str, UrdfJoint | None], tip: str | None) -> str:
    """Return the link at the tip; without a name, the file must have one end that moves."""
    moved = [name for name in tree.order if movers[name]]
    if not moved:
        raise ValueError("joint: no joint moves; give at least one revolute or continuous joint that is not held")
    if tip is not None:
        return one_of("tip", tip, moved)
    parents = {joint.parent for joint in tree.joints.values()}
    ends = [name for name in moved if name not in parents]
    if len(ends) > 1:
        counts = [sum(movers[joint.child] is joint for joint in tree.path(name)) for name in ends]
        listed = ", ".join(
            f"{name} ({count} joint{'s' * (count > 1)})" for name, count in zip(ends, counts, strict=True)
        )
        form = "{urdf: FILE, tip: NAME} in a file or as the setting arm"
        raise value_error("tip", tip, f"a link that moves ({form}), such as an end of a branch: {listed}")
    return ends[0]


def _arm(chain: _Chain, sidecar: dict[str, Any], inertias: str, notes: list[str]) -> Arm:
    """Return the arm of a chain of joints; notes about changed inertias are added."""
    joints, tip, movers = chain.joints, chain.tip, chain.movers
    names = [joint.child for joint in joints]
    for part, known in (("links", names), ("joints", [joint.name for joint in joints])):
        mapping(f"sidecar.{part}", sidecar.get(part, {}), known)
    sections = sidecar.get("links", {})
    moved = [name for name in chain.tree.order if movers[name] and name not in sections]
    inertials = read_inertials({name: chain.tree.links[name] for name in moved})
    poses = chain.poses([*names, tip, *inertials])
    found, changed = nearest_bodies(inertials, poses)
    bodies: dict[str, dict[str, Body]] = {name: {} for name in names}
    for name, body in found.items():
        bodies[movers[name].child][name] = body  # type: ignore[union-attr]
    _check_masses([name for name in names if name not in sections and not bodies[name]], chain.tree)
    ends = [*(poses[name][1] for name in names[1:]), poses[tip][1]]
    last, payload = bodies[names[-1]], None
    if tip in last and tip != names[-1] and (len(last) > 1 or names[-1] in sections):
        payload = last.pop(tip).seen_from(np.eye(3), ends[-1]).plain()
    arm = _built(chain, {
        "links": [
            _link(name, poses[name][1], end, bodies[name], sections.get(name))
            for name, end in zip(names, ends, strict=True)
        ],
        "joints": [
            _driven(joint, poses[joint.child][0], sidecar.get("joints", {}).get(joint.name, {})) for joint in joints
        ],
        "payload": payload,
        **{name: sidecar.get(name, default) for name, default in DAMPING.items()},
    })  # fmt: skip
    for name, link, end in zip(names, arm.links, ends, strict=True):
        _check_tip(name, end - poses[name][1], link.length * np.array(link.orientation)[:, 0])
    total = sum(link.mass for link in arm.links) + (arm.payload.mass if arm.payload else 0.0)
    turned = [] if sections else [poses[name][0] @ joint.axis for name, joint in zip(names, joints, strict=True)]
    for name in changed:
        axes = [poses[name][0].T @ axis for axis in turned[: joints.index(movers[name]) + 1]]  # type: ignore[arg-type]
        notes.append(check_change(name, inertials[name], total, axes, inertias))
    return arm


def _built(chain: _Chain, data: dict[str, Any]) -> Arm:
    """Return the arm of its plain form; errors name links and joints as the files do."""
    try:
        return find_arm(data)
    except ValueError as error:
        found = re.match(r"arm\.(?:(link|joint)s\[(\d+)\](?:\.?LumpedMass)?|payload)", str(error))
        if not found:
            raise
        kind, number = found[1] or "link", int(found[2] or 0)
        name = getattr(chain.joints[number], "child" if kind == "link" else "name") if found[1] else chain.tip
        raise ValueError(f"{kind} {name!r}{str(error)[found.end() :]}") from None


def _check_masses(names: list[str], tree: UrdfTree) -> None:
    """Raise a ValueError with the sidecar that supplies the bodies of links, if there are links without mass."""
    if not names:
        return
    rows = [[0.0] * 3] * 3
    entry = {"shape": "rigid", "mass": 0.0, "centre": rows[0], "inertia": rows}
    entries = json.dumps({"links": dict.fromkeys(names, entry)}, ensure_ascii=False)
    missing = all(tree.links[name].find("inertial") is None for name in names)
    raise ValueError(
        f"link{'s' * (len(names) > 1)} {', '.join(map(repr, names))}.inertial: "
        f"{'missing' if missing else 'no mass is not allowed'}; give <inertial> with mass and inertia to a link that a "
        "joint moves, or hold the joint, or replace the zeros (kg; m; kg m^2; in axes with x to the next joint and y "
        f"horizontal) in sidecar={entries}"
    )


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
        body = body.seen_from(rotation, start)
        inertia = {"mass": body.mass, "centre": body.centre.tolist(), "inertia": body.inertia.tolist()}
        return {"shape": "rigid", **plain, **inertia}
    if "sections" in section:
        del plain["length"]
    elif not plain["length"] and not {"length", "orientation"} & section.keys() and section.get("shape") != "rigid":
        allowed = "{'shape': 'rigid', ...}, or another tip: its joint and the next one, or the tip, are at one place"
        raise value_error(f"sidecar.links.{name}.shape", section.get("shape"), allowed)
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


def _driven(joint: UrdfJoint, turn: Array, extra: dict[str, Any]) -> dict[str, Any]:
    """Return the plain form of a joint, with its axis in the axes of the root; entries of the sidecar take precedence.

    The motor of the sidecar determines the limits of torque and speed that it has itself.
    """
    motor = extra["motor"] if isinstance(extra.get("motor"), dict) else {}
    axis, dynamics = turn @ joint.axis, joint.element.find("dynamics")
    plain = {"axis": (axis / np.linalg.norm(axis)).tolist(), "stiffness": None, "damping": 0.0}
    for name, attribute in (("viscous_friction", "damping"), ("coulomb_friction", "friction")):
        if name not in extra:
            (value,) = numbers(f"{joint.field}.dynamics", dynamics, attribute, "0")
            plain[name] = non_negative(f"{joint.field}.dynamics.{attribute}", float(value))
    if not motor:
        plain["rotor_inertia"] = 0.0
    if not (
        extra.get("passive") is True or "torque_limit" in extra or {"current_limit", "voltage_limit"} & motor.keys()
    ):
        plain["torque_limit"] = _bound(joint, "effort")
    if extra.get("passive") is not True:
        if "speed_limit" not in motor | extra:
            plain["speed_limit"] = _bound(joint, "velocity")
        if "angle_range" not in extra:
            plain["angle_range"] = _angle_range(joint)
    return plain | extra


def _angle_range(joint: UrdfJoint) -> list[float] | None:
    """Return the range of a revolute joint, rad; None for a continuous joint, and for a range of some turns."""
    low, high = joint.limit("lower"), joint.limit("upper")
    return [low, high] if joint.kind == "revolute" and 0.0 < high - low <= LARGEST_RANGE else None


def _bound(joint: UrdfJoint, name: str) -> float | None:
    """Return a bound of <limit>; None for a number <= 0 or infinity, which files have for no bound."""
    value = joint.limit(name)
    return value if 0.0 < value < np.inf else None
