"""Conversion of scenes to and from nested dicts and lists, as in their files, and arms given by name or file."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from functools import cache, partial
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Any, TypeVar

from flexman_gym.common import files
from flexman_gym.common.checks import mapping, one_of, sequence, text, whole_number
from flexman_gym.common.errors import KeywordError, short_path, suggestion, value_error
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.input_checks import FOREIGN_KEYWORDS
from flexman_gym.scene.joint import Joint, Motor
from flexman_gym.scene.link import IDENTITY, SHAPES, Link, NonUniformLink, Outline
from flexman_gym.scene.rigid_body import LumpedMass, Payload

Part = TypeVar("Part")

# Values of cross-sections in the catalog that no real section has (see the description of the arm): no warning.
SECTION_FIELDS = ("area", "second_moment_y", "second_moment_z")
IMPOSSIBLE_SECTIONS = ((0.028, 8.33e-7, 8.33e-7), (4e-4, 1.3e-8, 4e-9))

# Class -> fields with a default that its mapping in a file must have all the same; other fields with a default may be
# missing, and are written only if they differ from it, except the payload and the note.
REQUIRED_KEYS: dict[str, tuple[str, ...]] = {
    "Arm": ("gravity", "stiffness_proportional_damping"),
    "Link": ("orientation",),
    "NonUniformLink": ("orientation",),
    "Joint": ("rotor_inertia", "stiffness", "damping"),
    "ModelChoice": ("flexible_joints", "stiffening"),
}


def _optional_keys(kind: Any) -> list[str]:
    """Return the fields of a dataclass that its mapping in a file may lack."""
    required = REQUIRED_KEYS.get(kind.__name__, ())
    return [each.name for each in fields(kind) if each.default is not MISSING and each.name not in required]


def _arm_from_plain(data: object) -> Arm:
    """Return the arm described by a mapping; errors name the field, such as `arm.links[1].length`."""
    links, joints = partial(_items, "arm.links", _link), partial(_items, "arm.joints", _joint)
    return from_plain(Arm, "arm", data, links=links, joints=joints, payload=_optional(Payload, "arm.payload"))


def _items(path: str, build: Callable[[str, object], Any], data: object) -> list[Any]:
    """Return the parts of an arm (links, joints, sections or masses) built from the mappings of a list."""
    return [build(f"{path}[{i}]", item) for i, item in enumerate(sequence(path, data, "mappings"))]


def _optional(kind: type[Part], path: str) -> Callable[[object], Part | None]:
    """Return a function that builds a `kind` from a mapping and returns None for None."""
    return lambda data: None if data is None else from_plain(kind, path, data)


def _link(path: str, data: object) -> Link | NonUniformLink:
    """Return a Link from a mapping, or a NonUniformLink from a mapping with `sections`.

    A mapping with a `shape` holds the arguments of `Link.strip`, `Link.tube`, `Link.rod` or `Link.rigid`.
    """
    entries = _with_masses(path, data)
    if "shape" in entries:
        build = getattr(Link, one_of(f"{path}.shape", entries.pop("shape"), (*SHAPES, "rigid")))
        mapping(path, entries, list(signature(build).parameters))
        try:
            link: Link = build(**entries)
            return link
        except TypeError as error:
            raise value_error(
                path, entries, f"the arguments of {build.__qualname__}: {str(error).split('() ')[-1]}"
            ) from None
        except ValueError as error:
            raise ValueError(path + str(error).removeprefix("Link")) from None
    if "sections" not in entries:
        return _uniform_link(path, entries)
    return from_plain(NonUniformLink, path, entries, sections=partial(_items, f"{path}.sections", _section))


def _with_masses(path: str, data: object) -> dict[str, Any]:
    """Return a copy of the mapping of a link with its lumped masses built."""
    entries = dict(data) if isinstance(data, dict) else _check_entries(Link, path, data)
    if "masses" in entries:
        entries["masses"] = _items(f"{path}.masses", partial(from_plain, LumpedMass), entries["masses"])
    return entries


def _section(path: str, data: object) -> Link:
    """Return a section of a link from a mapping; orientation and masses must be missing or have default values."""
    defaults = {"orientation": [list(row) for row in IDENTITY], "masses": []}
    if isinstance(data, dict):
        data = {name: value for name, value in data.items() if name not in defaults or value != defaults[name]}
    return _uniform_link(path, data, *defaults)


def _uniform_link(path: str, data: object, *excluded: str) -> Link:
    """Return a Link from a mapping with the fields of the class, except the excluded ones."""
    return from_plain(Link, path, data, excluded, outline=_optional(Outline, f"{path}.outline"))


def _joint(path: str, data: object) -> Joint:
    """Return a Joint from a mapping; its rotor inertia may be missing if it has a motor or is passive."""
    if isinstance(data, dict) and data.get("passive") is True:
        data = {"rotor_inertia": 0.0} | data
    if not isinstance(data, dict) or data.get("motor") is None:
        return from_plain(Joint, path, data)
    motor = partial(from_plain, Motor, f"{path}.motor")
    return from_plain(Joint, path, {"rotor_inertia": 0.0} | data, motor=motor)


def from_plain(
    kind: type[Part], path: str, data: object, excluded: Sequence[str] = (), **parts: Callable[[Any], Any]
) -> Part:
    """Build a dataclass from the mapping of its fields.

    Args:
        kind: the dataclass.
        path: field of the mapping in the file, such as "arm.payload", for errors.
        data: the mapping.
        excluded: names of fields that the mapping must not contain.
        **parts: field name -> function that converts the entry of the mapping to the value of the field.

    Raises:
        ValueError: for unknown or missing keys and for forbidden values, with a one-line message that names the field.
    """
    entries = _check_entries(kind, path, data, *excluded)
    for name, build in parts.items():
        if name in entries:
            entries[name] = build(entries[name])
    return _build_part(kind, path, entries)


def _check_entries(kind: Any, path: str, data: object, *excluded: str) -> dict[str, Any]:
    """Return a copy of a mapping after checking that its keys are fields of a dataclass, and not excluded ones."""
    names = [field.name for field in fields(kind) if field.name not in excluded]
    if not isinstance(data, dict):
        raise value_error(path or "scene", data, "a mapping with the keys " + ", ".join(names))
    prefix = f"{path}." if path else ""
    for name, value in data.items():
        if name not in names:
            allowed = FOREIGN_KEYWORDS.get(kind.__name__, {}).get(name)
            allowed = allowed or f"only the keys {', '.join(names)}{suggestion(name, names)}"
            raise value_error(f"{prefix}{name}", value, allowed)
    if missing := [name for name in names if name not in data and name not in _optional_keys(kind)]:
        raise ValueError(f"{prefix}{', '.join(missing)}: missing; give the keys " + ", ".join(names))
    return dict(data)


def _build_part(kind: type[Part], path: str, entries: dict[str, Any]) -> Part:
    """Return a `kind` with the given fields; errors name the path in the file, such as arm.links[1].length."""
    try:
        with warnings.catch_warnings():
            if tuple(entries.get(name) for name in SECTION_FIELDS) in IMPOSSIBLE_SECTIONS:
                warnings.simplefilter("ignore", UserWarning)
            return kind(**entries)
    except ValueError as error:
        raise ValueError((path + str(error).removeprefix(kind.__name__)).removeprefix(".")) from None


def to_plain(value: Any) -> Any:
    """Return a value with all dataclasses in it as dicts and all tuples as lists, for `from_plain` and for files."""
    if isinstance(value, tuple):
        return [to_plain(entry) for entry in value]
    if not is_dataclass(value):
        return value
    entries: dict[str, Any] = {"kind": value.kind} if hasattr(value, "kind") else {}
    optional = {*_optional_keys(type(value))} - {"payload", "note"}
    for field in fields(value):
        entry = getattr(value, field.name)
        if field.name not in optional or entry != field.default:
            entries[field.name] = to_plain(entry)
    if isinstance(value, Joint) and value.motor:
        del entries["rotor_inertia"]
        if value.motor.joint_torque_limit is not None:
            del entries["torque_limit"]
        if value.motor.joint_speed_limit is not None:
            del entries["speed_limit"]
    if isinstance(value, NonUniformLink):
        for section in entries["sections"]:
            del section["orientation"]
    return entries


ARM_FOLDER = Path(__file__).parent / "arms"
ARMS = tuple(sorted(path.stem for path in ARM_FOLDER.glob("*.yaml")))  # names of the arms in the catalog
SUFFIXES, URDF = (".json", ".yaml", ".yml"), ".urdf"
ArmLike = Arm | Mapping[str, Any] | str


def find_arm(value: object, folder: Path = Path()) -> Arm:
    """Return an arm that is given as an Arm, by name, by file or as a mapping.

    Args:
        value: an Arm; the name of an arm in the catalog; a mapping with this name under the key "catalog" and with
            options of the arm; the path of a file with an arm or a scene, or of a URDF whose joints off the chain are
            held at rest; a mapping with the path of a URDF at "urdf" and arguments of `Arm.from_urdf`, or a file with
            such a mapping; or a mapping as in an arm file.
        folder: folder to which the path is relative.

    Raises:
        FileNotFoundError: if the file does not exist.
        ValueError: for any other value, with a one-line message: the field, the value and the allowed values.
    """
    if isinstance(value, Arm):
        return value
    if not isinstance(value, str | dict):
        raise value_error("arm", value, f"an Arm, a mapping, a file, or a name in the catalog: {', '.join(ARMS)}")
    if isinstance(value, str) and value.endswith(SUFFIXES):
        try:
            data = files.read_data(folder / value)
        except ValueError as error:
            raise ValueError(f"{short_path(value)}: {error}") from None
        whole = data if {"links", "urdf"} & data.keys() else data.get("arm", data)
        place = (folder / value).parent
        return _arm_from_urdf(whole, place) if isinstance(whole, dict) and "urdf" in whole else _arm_from_plain(whole)
    if isinstance(value, str) and value.endswith(URDF):
        return Arm.from_urdf(folder / value, held="rest")
    if isinstance(value, dict) and "urdf" in value:
        return _arm_from_urdf(value, folder)
    if isinstance(value, dict) and "catalog" not in value:
        return _arm_from_plain(value)
    entries = {"catalog": value} if isinstance(value, str) else value
    arguments = {text("a key of arm", name): each for name, each in entries.items() if name != "catalog"}
    name = one_of("arm", entries["catalog"], ARMS)
    if isinstance(arguments.get("payload"), dict):
        arguments["payload"] = from_plain(Payload, "arm.payload", arguments["payload"])
    try:
        return named_arm(name)(**arguments)
    except TypeError as error:
        raise value_error("arm", arguments, f"the arguments of {name}: {str(error).split('() ')[-1]}") from None


def _arm_from_urdf(value: dict[str, Any], folder: Path) -> Arm:
    """Return the arm of a mapping with the path of a URDF and the arguments of `Arm.from_urdf`."""
    entries = mapping("arm", value, ("urdf", "sidecar", "tip", "held", "inertias"))
    given = {"held": "rest"} | {name: each for name, each in entries.items() if name != "urdf"}
    if isinstance(given.get("sidecar"), str):
        given["sidecar"] = folder / given["sidecar"]
    return Arm.from_urdf(folder / text("arm.urdf", entries["urdf"]), **given)


@cache
def named_arm(name: str) -> Callable[..., Arm]:
    """Return the function that builds an arm of the catalog, with the options of its file as arguments.

    The file has the keys `description` (docstring of the function), `source`, `arm` (mapping as in an arm file),
    `options` (name of an option -> field of the arm, such as "payload", "links[0].area" or "joints.stiffness" for all
    joints; "file" selects another arm), and `values` (name of an option -> allowed values by name, or a list from which
    the option selects by number, from 1).

    Args:
        name: name of a file in ARM_FOLDER, without suffix.

    Returns:
        The function; it raises a ValueError for values that Joint or Arm does not accept.
    """
    data = files.read_data(ARM_FOLDER / f"{name}.yaml", of_package=True)
    arm, options, values = _arm_from_plain(data["arm"]), data.get("options", {}), data.get("values", {})
    defaults = {option: _default(arm, name, field, values.get(option)) for option, field in options.items()}
    kind = Parameter.POSITIONAL_OR_KEYWORD
    call = Signature([Parameter(option, kind, default=value) for option, value in defaults.items()])

    def build(*positional: Any, **named: Any) -> Arm:
        try:
            arguments = call.bind(*positional, **named).arguments
        except TypeError as error:
            raise KeywordError(f"{name}() {error}; give {', '.join(options) or 'no arguments'}") from None
        changes: dict[str, dict[str, Any]] = {}
        for option, value in arguments.items():
            part, _, field = options[option].rpartition(".")
            changes.setdefault(part, {})[field] = _option_value(option, value, values.get(option))
        return _change_fields(arm, name, changes)

    build.__name__ = build.__qualname__ = name
    build.__module__, build.__doc__ = "flexman_gym.scene.catalog", f"{data['description']}\nSource: {data['source']}.\n"
    build.__signature__ = call  # type: ignore[attr-defined]
    return build


def _default(arm: Arm, name: str, field: str, values: Any) -> Any:
    """Return the default of an option: its value in the file of the arm; for all joints, that of the first joint."""
    if field == "file":
        return values.index(name) + 1
    part, _, attribute = field.rpartition(".")
    parts, indices = _select_parts(arm, part) if part else ("", [])
    value = getattr(getattr(arm, parts)[indices[0]] if part else arm, attribute)
    return next(name for name, number in values.items() if number == value) if values else value


def _option_value(option: str, value: Any, values: Any) -> Any:
    """Return the value of a field for an option; `values` are the allowed values in the file of the arm, if any."""
    if isinstance(values, list):
        return values[whole_number(option, value, 1, len(values)) - 1]
    return values[one_of(option, value, values)] if values else value


def _select_parts(arm: Arm, part: str) -> tuple[str, list[int]]:
    """Return "links" or "joints" and the selected indices, for "links[0]" or, for all joints, "joints"."""
    name, _, index = part.rstrip("]").partition("[")
    return name, [int(index)] if index else list(range(arm.n_joints))


def _change_fields(arm: Arm, name: str, changes: dict[str, dict[str, Any]]) -> Arm:
    """Return an arm of the catalog with new values (field -> value) in its parts ("" for the arm itself)."""
    arm_fields = changes.pop("", {})
    if (file := arm_fields.pop("file", name)) != name:
        return named_arm(file)()
    for part, entries in changes.items():
        name, indices = _select_parts(arm, part)
        parts = arm_fields[name] = list(getattr(arm, name))
        for i in indices:
            parts[i] = _build_part(type(parts[i]), type(parts[i]).__name__, vars(parts[i]) | entries)
    return _build_part(Arm, "Arm", vars(arm) | arm_fields)
