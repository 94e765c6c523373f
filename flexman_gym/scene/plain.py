"""Plain: arms, drives and choices as dicts, lists, numbers and texts, and back."""

import warnings
from dataclasses import fields, is_dataclass
from functools import partial
from typing import Any, TypeVar

from flexman_gym.checks import one_of, refusal, sequence
from flexman_gym.scene.arm import Arm, Joint, Link, NonUniformLink, Payload
from flexman_gym.scene.drive import ConstantTorque, Signal, SineTorque

Part = TypeVar("Part")

# Sections of arms in the catalog that no section can have; each says why there, and a file of it need not warn again.
SECTION = ("area", "second_moment_y", "second_moment_z")
KNOWN_SECTIONS = ((0.028, 8.33e-7, 8.33e-7), (4e-4, 1.3e-8, 4e-9))

# Keys that a scene file may leave out; they are written where they differ from the default. A payload or a note may
# be left out as well, but is always written.
OPTIONAL: dict[str, tuple[str, ...]] = {
    "Arm": ("modal_damping_ratio",),
    "Payload": ("inertia", "offset"),
    "Joint": ("viscous_friction", "coulomb_friction", "coulomb_rate", "torque_limit"),
    "ModelChoice": ("modes", "spinning_rotors", "rotary_inertia"),
    "Initial": ("state",),
    "Signal": tuple(field.name for field in fields(Signal)),
    "Scene": ("prescribed", "tip_force", "base_acceleration"),
}


def arm_of(data: object) -> Arm:
    """Builds the arm that a mapping describes.

    Raises:
        ValueError: for entries that are not allowed; it names the field (`arm.links[1].length`).
    """
    entries = entries_of(Arm, "arm", data)
    for name, part in (("links", _link), ("joints", partial(part_of, Joint))):
        items = sequence(f"arm.{name}", entries[name], "mappings")
        entries[name] = [part(f"arm.{name}[{i}]", item) for i, item in enumerate(items)]
    if entries.get("payload") is not None:
        entries["payload"] = part_of(Payload, "arm.payload", entries["payload"])
    return built(Arm, "arm", entries)


def _link(path: str, data: object) -> Link | NonUniformLink:
    """Builds a Link from a mapping, or a NonUniformLink from one with `sections`, which have no orientation."""
    if not isinstance(data, dict) or "sections" not in data:
        return part_of(Link, path, data)
    entries = entries_of(NonUniformLink, path, data)
    items = sequence(f"{path}.sections", entries["sections"], "mappings")
    for i, item in enumerate(items):
        entries_of(Link, f"{path}.sections[{i}]", item, "orientation")
    entries["sections"] = [built(Link, f"{path}.sections[{i}]", item) for i, item in enumerate(items)]
    return built(NonUniformLink, path, entries)


def torque_of(data: object) -> ConstantTorque | SineTorque:
    """Builds the torque that a mapping with a `kind` describes.

    Raises:
        ValueError: for entries that are not allowed; it names the field (`torque.value`).
    """
    if not isinstance(data, dict):
        raise refusal("torque", data, "a mapping with the key kind")
    kinds: dict[str, type[ConstantTorque | SineTorque]] = {kind.kind: kind for kind in (ConstantTorque, SineTorque)}
    kind = kinds[one_of("torque.kind", data.get("kind"), kinds)]
    return part_of(kind, "torque", {name: value for name, value in data.items() if name != "kind"})


def part_of(kind: type[Part], path: str, data: object) -> Part:
    """Builds a `kind` from the mapping of its fields.

    Args:
        kind: a dataclass.
        path: the name of the field of the file that holds the mapping.
        data: the mapping.

    Raises:
        ValueError: for entries that are not allowed; it names the field.
    """
    return built(kind, path, entries_of(kind, path, data))


def entries_of(kind: Any, path: str, data: object, *left_out: str) -> dict[str, Any]:
    """Gives a copy of a mapping after a check of its keys.

    Args:
        kind: the dataclass whose fields the keys must be.
        path: the name of the field of the file that holds the mapping.
        data: the mapping.
        left_out: names of fields that must not be keys.

    Raises:
        ValueError: for something else than a mapping, for other keys and for missing ones; it names the field.
    """
    names = [field.name for field in fields(kind) if field.name not in left_out]
    if not isinstance(data, dict):
        raise refusal(path or "scene", data, "a mapping with the keys " + ", ".join(names))
    prefix = f"{path}." if path else ""
    for name, value in data.items():
        if name not in names:
            raise refusal(f"{prefix}{name}", value, "only the keys " + ", ".join(names))
    for name in names:
        if name not in data and name not in ("payload", "note", *OPTIONAL.get(kind.__name__, ())):
            raise ValueError(f"{prefix}{name}: missing; give the keys " + ", ".join(names))
    return dict(data)


def built(kind: type[Part], path: str, entries: dict[str, Any]) -> Part:
    """Builds a `kind` from its entries; an error names the field as the file does.

    Raises:
        ValueError: for entries that `kind` refuses; it names arm.links[1].length, for example, in place of Link.length.
    """
    try:
        with warnings.catch_warnings():
            if tuple(entries.get(name) for name in SECTION) in KNOWN_SECTIONS:
                warnings.simplefilter("ignore", UserWarning)
            return kind(**entries)
    except ValueError as error:
        raise ValueError((path + str(error).removeprefix(kind.__name__)).removeprefix(".")) from None


def plain(value: Any) -> Any:
    """Gives dataclasses as dicts and tuples as lists, all the way down."""
    if isinstance(value, tuple):
        return [plain(entry) for entry in value]
    if not is_dataclass(value):
        return value
    entries: dict[str, Any] = {"kind": value.kind} if isinstance(value, ConstantTorque | SineTorque) else {}
    for field in fields(value):
        entry = getattr(value, field.name)
        if field.name not in OPTIONAL.get(type(value).__name__, ()) or entry != field.default:
            entries[field.name] = plain(entry)
    if isinstance(value, NonUniformLink):
        for section in entries["sections"]:
            del section["orientation"]
    return entries
