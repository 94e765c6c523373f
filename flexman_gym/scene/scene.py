"""Scene: an arm, its model choice, its torque, its initial state and a duration, kept in a JSON or YAML file."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from flexman_gym.checks import (
    flag,
    one_of,
    positive,
    refusal,
    sequence,
    store,
    text,
    vector,
    whole_number,
)
from flexman_gym.scene import file as scene_file
from flexman_gym.scene.arm import Arm, Joint, Link, NonUniformLink, Payload
from flexman_gym.scene.drive import ConstantTorque, Signal, SineTorque, drive_table, signals

MOST_ELEMENTS = 64
MOST_OUTPUT_STEPS = 10_000_000

Part = TypeVar("Part")


@dataclass(frozen=True)
class ModelChoice:
    """How finely the arm of a scene is modelled; one value for all links or a tuple of one value per link.

    flexible_links   bool; a rigid link has no elastic coordinate
    elements         finite elements of a Link, or of each section of a NonUniformLink; 1 to 64, in a link as a whole
                     too. A link has 6 * elements * number of sections coordinates
    modes            modes kept of a link: how many, those of the lowest frequencies, 0 to its number of coordinates (at
                     most 384), or, in a tuple for all links, a tuple of their numbers, ascending, the lowest being 0:
                     (4, (0, 1, 3), 0) keeps four modes, modes 0, 1 and 3, and none; None keeps every coordinate
    flexible_joints  False makes every joint rigid, whatever its stiffness
    stiffening       foreshortening (geometric stiffening) of the links
    spinning_rotors  a rotor spins as a body in the frame that carries its joint; False neglects that frame's rotation,
                     as the paper does (Eq. 23). Only its inertia about the axis counts. It moves the tip of the paper's
                     arm by 103 mm (everything flexible) and 78 mm (rigid joints) within 2 s
    rotary_inertia   False is the classic Euler-Bernoulli beam: the sections of a link resist no rotation about their
                     transverse axes (Rayleigh's term), in rigid and in elastic motion, only that about the beam axis.
                     It moves the tip of the paper's arm by 7.2 mm (rigid) and 6.9 mm (everything flexible) within 2 s

    Raises ValueError for another type or a number outside its range.
    """

    flexible_links: bool | tuple[bool, ...]
    elements: int | tuple[int, ...]
    modes: int | tuple[int | tuple[int, ...], ...] | None = None
    flexible_joints: bool = True
    stiffening: bool = False
    spinning_rotors: bool = False
    rotary_inertia: bool = True

    def __post_init__(self) -> None:
        store(
            self,
            flexible_links=_one_or_each("ModelChoice.flexible_links", self.flexible_links, flag),
            elements=_one_or_each("ModelChoice.elements", self.elements, whole_number, 1, MOST_ELEMENTS),
            flexible_joints=flag("ModelChoice.flexible_joints", self.flexible_joints),
            stiffening=flag("ModelChoice.stiffening", self.stiffening),
            spinning_rotors=flag("ModelChoice.spinning_rotors", self.spinning_rotors),
            rotary_inertia=flag("ModelChoice.rotary_inertia", self.rotary_inertia),
        )
        if self.modes is not None:
            store(self, modes=_one_or_each("ModelChoice.modes", self.modes, _modes, 6 * MOST_ELEMENTS))


@dataclass(frozen=True)
class Initial:
    """The state at t = 0: the motors start at the links' angles and rates, undeformed links at rest in their frames.

    joint_angles  (n,) rad
    joint_rates   (n,) rad/s

    Raises ValueError when one is not a list of finite numbers, or when they differ in length.
    """

    joint_angles: Sequence[float]
    joint_rates: Sequence[float]

    def __post_init__(self) -> None:
        angles = vector("Initial.joint_angles", self.joint_angles, unit="rad")
        store(self, joint_angles=angles)
        store(self, joint_rates=vector("Initial.joint_rates", self.joint_rates, len(angles), "rad/s"))


@dataclass(frozen=True)
class Scene:
    """One run: everything a simulation needs except its method.

    duration, output_step  s; the duration is a whole number of output steps (to 1e-9 of itself), at most 10 million
    note                   free text for the reader
    prescribed             (n,) the acceleration of a motor (of a joint where it is rigid) whose motion is given, a
                           Signal in rad/s^2, and None for a motor that its torque drives; None where that holds for all
    tip_force              three Signals in N, the force on the tip of the last link in the base frame; None without
    base_acceleration      three Signals in m/s^2, the base moving as a whole, in the base frame; None without

    Raises ValueError when a part has the wrong type or does not fit the number of joints of the arm, and for a torque
    on a motor whose motion is prescribed.
    """

    arm: Arm
    model: ModelChoice
    torque: ConstantTorque | SineTorque
    initial: Initial
    duration: float
    output_step: float
    note: str = ""
    prescribed: Sequence[Signal | None] | None = None
    tip_force: Sequence[Signal] | None = None
    base_acceleration: Sequence[Signal] | None = None

    def __post_init__(self) -> None:
        self._check_part("arm", Arm)
        self._check_part("model", ModelChoice)
        self._check_part("torque", ConstantTorque, SineTorque)
        self._check_part("initial", Initial)
        store(
            self,
            duration=positive("Scene.duration", self.duration, "s"),
            output_step=positive("Scene.output_step", self.output_step, "s"),
            note=text("Scene.note", self.note),
            prescribed=self._checked_motion(),
            tip_force=signals("Scene.tip_force", self.tip_force, "N"),
            base_acceleration=signals("Scene.base_acceleration", self.base_acceleration, "m/s^2"),
        )
        steps = self.duration / self.output_step
        if not 0.5 < steps <= MOST_OUTPUT_STEPS or abs(steps - round(steps)) > 1e-9 * steps:
            allowed = f"1 to {MOST_OUTPUT_STEPS} whole steps in the duration {self.duration} s"
            raise refusal("Scene.output_step", self.output_step, allowed)

    def _check_part(self, part: str, *kinds: type) -> None:
        """Refuse a part of another kind, or one whose tuples do not hold one entry for each joint."""
        value = getattr(self, part)
        if not isinstance(value, kinds):
            raise refusal(f"Scene.{part}", value, " or ".join(kind.__name__ for kind in kinds))
        if isinstance(value, Arm):
            return
        for name, entry in vars(value).items():
            if isinstance(entry, tuple) and len(entry) != self.arm.n_joints:
                raise refusal(f"Scene.{part}.{name}", entry, f"{self.arm.n_joints} values, one for each joint")

    def _checked_motion(self) -> tuple[Signal | None, ...] | None:
        """The prescribed motions, refused with a torque on the same motor."""
        if self.prescribed is None:
            return None
        name, count = "Scene.prescribed", self.arm.n_joints
        motions = tuple(sequence(name, self.prescribed, "a Signal or None for each joint"))
        if len(motions) != count or not all(isinstance(motion, Signal | None) for motion in motions):
            raise refusal(name, self.prescribed, f"{count} of Signal or None, one for each joint")
        for i, (motion, torque) in enumerate(zip(motions, self.torque.signals(), strict=True)):
            if motion is not None and (torque.offset, torque.amplitude) != (0.0, 0.0):
                value = max(torque.offset, torque.amplitude, key=abs)
                raise refusal(f"Scene.torque of joint {i}", value, "0 (N m): the motion of this joint is prescribed")
        return motions if any(motions) else None

    @property
    def drive(self) -> NDArray[np.float64]:
        """The table of the drive (6, n + 6) as the kernels read it, see `kernels.layout`."""
        motions, none = self.prescribed or [None] * self.arm.n_joints, [None] * 3
        motors = [motion or torque for motion, torque in zip(motions, self.torque.signals(), strict=True)]
        return drive_table([*motors, *(self.tip_force or none), *(self.base_acceleration or none)])

    @property
    def output_times(self) -> NDArray[np.float64]:
        """Times of the output, (duration / output_step + 1,) in s, from 0 to the duration."""
        return np.linspace(0.0, self.duration, round(self.duration / self.output_step) + 1)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a scene from a .json, .yaml or .yml file.

        Raises FileNotFoundError when there is no such file, and ValueError with one line that names the file, the field
        (`arm.links[1].length`), the value and what is allowed, for whatever else is wrong with it.
        """
        try:
            return cls.from_dict(scene_file.read(Path(path)))
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None

    def save(self, path: str | Path) -> None:
        """Write the scene to a .json, .yaml or .yml file, from which `load` gives an equal one.

        Raises ValueError for another suffix.
        """
        scene_file.write(Path(path), self.to_dict())

    @classmethod
    def from_dict(cls, data: object) -> Self:
        """Return the scene that a scene file's mapping describes.

        Raises ValueError with one line that names the field (`arm.links[1].length`), the value and what is allowed.
        """
        entries = _entries(Scene, "", data)
        entries["arm"] = _arm(entries["arm"])
        entries["model"] = _part(ModelChoice, "model", entries["model"])
        entries["torque"] = _torque(entries["torque"])
        entries["initial"] = _part(Initial, "initial", entries["initial"])
        for name in ("prescribed", "tip_force", "base_acceleration"):
            if entries.get(name) is not None:
                items = enumerate(sequence(name, entries[name], "a list of mappings"))
                entries[name] = [None if item is None else _part(Signal, f"{name}[{i}]", item) for i, item in items]
        return _build(cls, "", entries)

    def to_dict(self) -> dict[str, Any]:
        """Return the scene as a scene file's mapping of dicts, lists, numbers and texts."""
        data: dict[str, Any] = _plain(self)
        if self.arm.payload is None:
            data["arm"]["payload"] = {"mass": 0.0}
        return {"note": self.note} | data


# Keys that a scene file may leave out; they are written where they differ from the default. A payload or note may be
# left out as well, and is always written.
_OPTIONAL: dict[type, tuple[str, ...]] = {
    Arm: ("modal_damping_ratio",),
    Payload: ("inertia", "offset"),
    Joint: ("viscous_friction", "coulomb_friction", "coulomb_rate"),
    ModelChoice: ("modes", "spinning_rotors", "rotary_inertia"),
    Signal: tuple(field.name for field in fields(Signal)),
    Scene: ("prescribed", "tip_force", "base_acceleration"),
}


def _one_or_each(name: str, value: object, check: Callable[..., Any], *limits: int) -> Any:
    """Check one value for all links, or a list with one for each link."""
    if not isinstance(value, list | tuple | np.ndarray):
        return check(name, value, *limits)
    entries = sequence(name, value)
    if not entries:
        raise refusal(name, value, "one value, or one for each link")
    return tuple(check(f"{name}[{i}]", entry, *limits) for i, entry in enumerate(entries))


def _modes(name: str, value: object, most: int) -> int | tuple[int, ...]:
    """Check how many modes of a link are kept, or which."""
    if not isinstance(value, list | tuple | np.ndarray):
        return whole_number(name, value, 0, most)
    numbers = tuple(whole_number(f"{name}[{i}]", entry, 0, most - 1) for i, entry in enumerate(sequence(name, value)))
    if not numbers or list(numbers) != sorted({*numbers}):
        raise refusal(name, value, "a number of modes, or mode numbers that ascend, at least one")
    return numbers


def _arm(data: object) -> Arm:
    entries = _entries(Arm, "arm", data)
    for name, part in (("links", _link), ("joints", partial(_part, Joint))):
        items = sequence(f"arm.{name}", entries[name], "mappings")
        entries[name] = [part(f"arm.{name}[{i}]", item) for i, item in enumerate(items)]
    if entries.get("payload") is not None:
        entries["payload"] = _part(Payload, "arm.payload", entries["payload"])
    return _build(Arm, "arm", entries)


def _link(path: str, data: object) -> Link | NonUniformLink:
    """A mapping with the keys of a Link, or one with `sections` that have those keys but no orientation."""
    if not isinstance(data, dict) or "sections" not in data:
        return _part(Link, path, data)
    entries = _entries(NonUniformLink, path, data)
    items = sequence(f"{path}.sections", entries["sections"], "mappings")
    for i, item in enumerate(items):
        _entries(Link, f"{path}.sections[{i}]", item, "orientation")
    entries["sections"] = [_build(Link, f"{path}.sections[{i}]", item) for i, item in enumerate(items)]
    return _build(NonUniformLink, path, entries)


def _torque(data: object) -> ConstantTorque | SineTorque:
    if not isinstance(data, dict):
        raise refusal("torque", data, "a mapping with the key kind")
    kinds: dict[str, type[ConstantTorque | SineTorque]] = {kind.kind: kind for kind in (ConstantTorque, SineTorque)}
    kind = kinds[one_of("torque.kind", data.get("kind"), kinds)]
    return _part(kind, "torque", {name: value for name, value in data.items() if name != "kind"})


def _part(kind: type[Part], path: str, data: object) -> Part:
    return _build(kind, path, _entries(kind, path, data))


def _entries(kind: Any, path: str, data: object, *left_out: str) -> dict[str, Any]:
    """Return a copy of the mapping `data` when its keys are the fields of the dataclass `kind` but those left out."""
    names = [field.name for field in fields(kind) if field.name not in left_out]
    if not isinstance(data, dict):
        raise refusal(path or "scene", data, "a mapping with the keys " + ", ".join(names))
    prefix = f"{path}." if path else ""
    for name, value in data.items():
        if name not in names:
            raise refusal(f"{prefix}{name}", value, "only the keys " + ", ".join(names))
    for name in names:
        if name not in data and name not in ("payload", "note", *_OPTIONAL.get(kind, ())):
            raise ValueError(f"{prefix}{name}: missing; give the keys " + ", ".join(names))
    return dict(data)


def _build(kind: type[Part], path: str, entries: dict[str, Any]) -> Part:
    """Create a `kind`, and name fields in its error as the file does: arm.links[1].length for Link.length."""
    try:
        return kind(**entries)
    except ValueError as error:
        raise ValueError((path + str(error).removeprefix(kind.__name__)).removeprefix(".")) from None


def _plain(value: Any) -> Any:
    """Return dataclasses as dicts and tuples as lists, all the way down."""
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    if not is_dataclass(value):
        return value
    plain: dict[str, Any] = {"kind": value.kind} if isinstance(value, ConstantTorque | SineTorque) else {}
    for field in fields(value):
        entry = getattr(value, field.name)
        if field.name not in _OPTIONAL.get(type(value), ()) or entry != field.default:
            plain[field.name] = _plain(entry)
    if isinstance(value, NonUniformLink):
        for section in plain["sections"]:
            del section["orientation"]
    return plain
