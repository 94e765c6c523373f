"""Scene: arm, model choice, torques, initial state and duration of a simulation, stored in a JSON or YAML file."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Vector
from flexman_gym.common.checks import (
    RATIO_TOLERANCE,
    flag,
    positive,
    sequence,
    set_fields,
    text,
    vector,
    whole_number,
)
from flexman_gym.common.errors import short_path, value_error
from flexman_gym.common.files import read_data, write_csv, write_data
from flexman_gym.common.formatting import text_fields
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.input_checks import check_keywords
from flexman_gym.scene.scene_files import COLUMN_UNITS, signal_from_plain, split_samples, torque_from_plain
from flexman_gym.scene.serialization import find_arm, from_plain, to_plain
from flexman_gym.scene.signals import (
    ConstantTorque,
    PiecewiseSignals,
    SampledAngles,
    SampledSignal,
    SampledTorque,
    Signal,
    SineTorque,
)

MAX_ELEMENTS = 64  # largest number of finite elements of a link


@dataclass(frozen=True)
class ModelChoice:
    """Modelling assumptions: flexible or rigid parts, discretisation, and inertial and geometric effects.

    `flexible_links`, `elements` and `modes` are one value for all links, or a tuple with one value per link.

    In the simulation of `catalog.paper_scene`, spinning rotors change the tip position at some time within 2 s by up to
    103 mm (links and joints flexible) or 78 mm (joints rigid), and rotary inertia by up to 7.2 mm (links and joints
    rigid) or 6.9 mm (both flexible).

    Attributes:
        flexible_links: False makes a link rigid, without elastic coordinates.
        elements: number of finite elements, 1 to 64, of a Link or of each section of a NonUniformLink; a link has at
            most 64 in total, and 6 * elements * (number of sections) elastic coordinates. None leaves the number to
            `choose_model`.
        modes: component modes of a link; None uses all elastic coordinates. A number m uses the m modes of lowest
            frequency, from 0 to the number of coordinates (at most 384). In a tuple for all links, a tuple lists mode
            numbers in ascending order, from 0 for the lowest: (4, (0, 1, 3), 0) uses four modes of the first link,
            modes 0, 1 and 3 of the second and none of the third.
        flexible_joints: False makes every joint rigid, also where it has a stiffness.
        stiffening: True includes the foreshortening of the links (geometric stiffening).
        spinning_rotors: True includes the gyroscopic coupling of the spinning rotors: the angular velocity of the
            inboard link in the kinetic energy of a rotor, which has a moment of inertia about the joint axis only.
            False neglects this coupling, as Eq. (23) of the paper "Dynamic modeling and simulation of spatial
            manipulator with flexible links and joints".
        rotary_inertia: True includes the rotary inertia of the cross-sections about their transverse axes (Rayleigh
            beam). False is the classical Euler-Bernoulli beam: cross-sections have rotary inertia about the beam axis
            only, in rigid and in elastic motion.

    Examples:
        >>> choice = fm.ModelChoice(flexible_links=True, elements=2, modes=(4, (0, 1, 3), 0))
        >>> choice.modes
        (4, (0, 1, 3), 0)
    """

    flexible_links: bool | tuple[bool, ...]
    elements: int | tuple[int, ...] | None
    modes: int | tuple[int | tuple[int, ...], ...] | None = None
    flexible_joints: bool = True
    stiffening: bool = False
    spinning_rotors: bool = False
    rotary_inertia: bool = True

    def __post_init__(self) -> None:
        set_fields(
            self,
            flexible_links=_one_or_each("ModelChoice.flexible_links", self.flexible_links, flag),
            flexible_joints=flag("ModelChoice.flexible_joints", self.flexible_joints),
            stiffening=flag("ModelChoice.stiffening", self.stiffening),
            spinning_rotors=flag("ModelChoice.spinning_rotors", self.spinning_rotors),
            rotary_inertia=flag("ModelChoice.rotary_inertia", self.rotary_inertia),
        )
        if self.elements is not None:
            elements = _one_or_each("ModelChoice.elements", self.elements, whole_number, 1, MAX_ELEMENTS)
            set_fields(self, elements=elements)
        if self.modes is not None:
            set_fields(self, modes=_one_or_each("ModelChoice.modes", self.modes, _modes, 6 * MAX_ELEMENTS))


def _one_or_each(name: str, value: object, check: Callable[..., Any], *limits: int) -> Any:
    """Return one checked value for all links, or a tuple with one checked value for each link."""
    if not isinstance(value, list | tuple | np.ndarray):
        return check(name, value, *limits)
    entries = sequence(name, value)
    if not entries:
        raise value_error(name, value, "one value, or one for each link")
    return tuple(check(f"{name}[{i}]", entry, *limits) for i, entry in enumerate(entries))


def _modes(name: str, value: object, most: int) -> int | tuple[int, ...]:
    """Return a checked number of modes (at most `most`), or a tuple of checked mode numbers (below `most`)."""
    if not isinstance(value, list | tuple | np.ndarray):
        return whole_number(name, value, 0, most)
    numbers = tuple(whole_number(f"{name}[{i}]", entry, 0, most - 1) for i, entry in enumerate(sequence(name, value)))
    if not numbers or list(numbers) != sorted({*numbers}):
        raise value_error(name, value, "a number of modes, or at least one mode number in ascending order")
    return numbers


MAX_OUTPUT_STEPS = 10_000_000
ATTITUDE_TOLERANCE = 1e-6  # largest difference between 1 and the norm of a quaternion


@dataclass(frozen=True)
class Initial:
    """State at t = 0: joints and motors at given angles and rates, joint springs and links undeformed.

    Attributes:
        joint_angles: angles (n,) of the joints and their motors, rad.
        joint_rates: rates (n,) of the joints and their motors, rad/s.
        state: complete state (2 d,) of the scene's model in the order of `kernels.layout`, for an arm that starts with
            deformed links or springs; it replaces joint angles and rates. None if the arm starts undeformed.

    Examples:
        >>> start = fm.Initial(joint_angles=(0.5, -0.2), joint_rates=(0.0, 0.0))
        >>> start.joint_angles
        (0.5, -0.2)
    """

    joint_angles: Vector
    joint_rates: Vector
    state: Vector | None = None

    def __post_init__(self) -> None:
        angles = vector("Initial.joint_angles", self.joint_angles, unit="rad")
        set_fields(self, joint_angles=angles)
        set_fields(self, joint_rates=vector("Initial.joint_rates", self.joint_rates, len(angles), "rad/s"))
        if self.state is not None:
            set_fields(self, state=vector("Initial.state", self.state))


@check_keywords
@dataclass(frozen=True)
class Scene:
    """Complete definition of a simulation except its integration method.

    Attributes:
        arm: Arm, or any argument of `scene.serialization.find_arm`, such as the name of an arm in the catalog.
        model: modelling assumptions.
        torque: motor torques.
        initial: state at t = 0.
        duration: duration of the simulation, s.
        output_step: time between outputs, s. The duration is a whole number of output steps within a relative 1e-9, at
            most 10 million.
        note: free text.
        prescribed: motions of motors with prescribed motion (of the joints themselves where rigid), n entries: Signal
            or SampledSignal of the acceleration, rad/s^2; SampledAngles, which also replace the angle and rate in
            `initial`; or None for a motor driven by its torque. None if torques drive all motors.
        tip_force: external force on the tip of the last link, three Signals or SampledSignals along x, y and z of the
            base frame, N; None for no force.
        base_acceleration: acceleration of the base, three Signals or SampledSignals along x, y and z of the base frame,
            m/s^2; None for a base that does not accelerate.
        base_angular_acceleration: angular acceleration of the base, three Signals or SampledSignals along x, y and z of
            the base frame, rad/s^2; None for zero. The base frame turns with the base, and the gravity of the arm is
            that in the world frame.
        base_attitude: unit quaternion (w, x, y, z) at t = 0, the rotation from the base frame to the world frame; None
            for a base frame along the world frame.
        base_angular_velocity: angular velocity (3,) of the base at t = 0, base frame, rad/s; None for zero.

    Raises:
        ValueError: for a field of the wrong type, for a number of joints that differs from the arm, for a torque on a
            motor with prescribed motion, and for samples that end before the duration.

    Examples:
        >>> choice = fm.ModelChoice(flexible_links=(True,), elements=(2,))
        >>> start = fm.Initial(joint_angles=(0.0,), joint_rates=(0.0,))
        >>> scene = fm.Scene(fm.catalog.one_joint(), choice, fm.ConstantTorque((0.1,)), start, 1.0, output_step=0.01)
        >>> fm.simulate(scene).tip.shape
        (101, 3)
    """

    arm: Arm
    model: ModelChoice
    torque: ConstantTorque | SineTorque | SampledTorque
    initial: Initial
    duration: float
    output_step: float
    note: str = ""
    prescribed: Sequence[Signal | SampledSignal | SampledAngles | None] | None = None
    tip_force: Sequence[Signal | SampledSignal] | None = None
    base_acceleration: Sequence[Signal | SampledSignal] | None = None
    base_angular_acceleration: Sequence[Signal | SampledSignal] | None = None
    base_attitude: Vector | None = None
    base_angular_velocity: Vector | None = None

    def __post_init__(self) -> None:
        set_fields(self, arm=find_arm(self.arm))
        self._check_part("model", ModelChoice)
        self._check_part("torque", ConstantTorque, SineTorque, SampledTorque)
        self._check_part("initial", Initial)
        set_fields(
            self,
            duration=positive("Scene.duration", self.duration, "s"),
            output_step=positive("Scene.output_step", self.output_step, "s"),
            note=text("Scene.note", self.note),
            prescribed=self._checked_motion(),
            tip_force=_check_signals("Scene.tip_force", self.tip_force, "N"),
            base_acceleration=_check_signals("Scene.base_acceleration", self.base_acceleration, "m/s^2"),
            base_angular_acceleration=_check_signals(
                "Scene.base_angular_acceleration", self.base_angular_acceleration, "rad/s^2"
            ),
        )
        if self.base_attitude is not None:
            set_fields(self, base_attitude=_check_attitude("Scene.base_attitude", self.base_attitude))
        if self.base_angular_velocity is not None:
            rate = vector("Scene.base_angular_velocity", self.base_angular_velocity, 3, "rad/s")
            set_fields(self, base_angular_velocity=rate)
        steps = self.duration / self.output_step
        if not 0.5 < steps <= MAX_OUTPUT_STEPS or abs(steps - round(steps)) > 1e-9 * steps:
            allowed = f"1 to {MAX_OUTPUT_STEPS} whole steps in the duration {self.duration} s"
            raise value_error("Scene.output_step", self.output_step, allowed)
        self._check_passive_joints()
        self._check_samples()
        if any(isinstance(motion, SampledAngles) for motion in self.prescribed or ()):
            set_fields(self, initial=self._initial_state())

    def __str__(self) -> str:
        """Return the tables of the arm, and each further field."""
        rest = ((each.name, getattr(self, each.name)) for each in fields(self)[1:])
        return "\n".join([str(self.arm), *text_fields(entry for entry in rest if entry[1] not in (None, ""))])

    def _check_part(self, part: str, *kinds: type) -> None:
        """Check the type of a field, and its number of joints."""
        value = getattr(self, part)
        if not isinstance(value, kinds):
            raise value_error(f"Scene.{part}", value, " or ".join(kind.__name__ for kind in kinds))
        if isinstance(value, Arm):
            return
        entries = {"values": value.values[0]} if isinstance(value, SampledTorque) else vars(value)
        for name, entry in entries.items():
            if name != "state" and isinstance(entry, tuple) and len(entry) != self.arm.n_joints:
                raise value_error(f"Scene.{part}.{name}", entry, f"{self.arm.n_joints} values, one for each joint")

    def _checked_motion(self) -> tuple[Signal | SampledSignal | SampledAngles | None, ...] | None:
        """Return the prescribed motions as a tuple after checking that the torques of these motors are zero."""
        if self.prescribed is None:
            return None
        name, count = "Scene.prescribed", self.arm.n_joints
        motions = tuple(sequence(name, self.prescribed, "a Signal or None for each joint"))
        kinds = Signal | SampledSignal | SampledAngles | None
        if len(motions) != count or not all(isinstance(motion, kinds) for motion in motions):
            allowed = f"{count} of Signal, SampledSignal, SampledAngles or None, one for each joint"
            raise value_error(name, self.prescribed, allowed)
        for i, (motion, torque) in enumerate(zip(motions, self.torque.signals(), strict=True)):
            if motion is not None and torque.largest != 0.0:
                allowed = "0 (N m): the motion of this joint is prescribed"
                raise value_error(f"Scene.torque of joint {i}", torque.largest, allowed)
        return motions if any(motions) else None

    def _check_passive_joints(self) -> None:
        """Check that passive joints have neither a torque nor a prescribed motion."""
        motions = self.prescribed or (None,) * self.arm.n_joints
        for i, joint in enumerate(self.arm.joints):
            torque = self.torque.signals()[i].largest
            if joint.passive and torque != 0.0:
                raise value_error(f"Scene.torque of joint {i}", torque, "0 (N m): the joint is passive")
            if joint.passive and motions[i] is not None:
                raise value_error(f"Scene.prescribed[{i}]", motions[i], "None: the joint is passive")

    def _check_samples(self) -> None:
        """Check that all samples cover the time from 0 to the duration."""
        for name in ("torque", *COLUMN_UNITS):
            part = getattr(self, name)
            for i, item in enumerate(part.signals() if name == "torque" else part or ()):
                if not isinstance(item, SampledSignal | SampledAngles):
                    continue
                end = item.times[-1] if isinstance(item, SampledAngles) else item.end
                if item.times[0] > 0.0 or end < self.duration * (1.0 - RATIO_TOLERANCE):
                    span = f"samples from {item.times[0]:g} to {end:g} s"
                    raise value_error(f"Scene.{name}[{i}]", span, f"samples from 0 to {self.duration:g} s or longer")

    def _initial_state(self) -> Initial:
        """Return the initial state with the angles and rates of motions prescribed by SampledAngles."""
        angles, rates = list(self.initial.joint_angles), list(self.initial.joint_rates)
        for i, motion in enumerate(self.prescribed or ()):
            if isinstance(motion, SampledAngles):
                angles[i], rates[i] = motion.start()
        return replace(self.initial, joint_angles=tuple(angles), joint_rates=tuple(rates))

    @property
    def prescribed_joints(self) -> list[int]:
        """Indices, from 0, of the joints with prescribed motion."""
        return [i for i, motion in enumerate(self.prescribed or ()) if motion is not None]

    @property
    def rotates(self) -> bool:
        """True if the base rotates or is tilted."""
        return any((self.base_angular_acceleration, self.base_attitude, self.base_angular_velocity))

    @property
    def signals(self) -> list[Signal | SampledSignal | None]:
        """Signals (n + 6) of n motors, 3 components of the tip force and 3 of the base acceleration; None for zero."""
        motions, none = self.prescribed or [None] * self.arm.n_joints, [None] * 3
        accelerations = [motion.acceleration if isinstance(motion, SampledAngles) else motion for motion in motions]
        motors = [motion or torque for motion, torque in zip(accelerations, self.torque.signals(), strict=True)]
        return [*motors, *(self.tip_force or none), *(self.base_acceleration or none)]

    @cached_property
    def pieces(self) -> PiecewiseSignals:
        """The signals for the kernels, without the rotation of the base."""
        return PiecewiseSignals(self.signals, self.duration)

    @property
    def output_times(self) -> NDArray[np.float64]:
        """Times of the outputs from 0 to the duration, (duration / output_step + 1,), s."""
        return np.linspace(0.0, self.duration, round(self.duration / self.output_step) + 1)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a scene from a .json, .yaml or .yml file.

        Args:
            path: path of the file.

        Raises:
            FileNotFoundError: if the file does not exist.
            ValueError: for any other error in the file, with a one-line message: the file, the field (such as
                `arm.links[1].length`), the value and the allowed values.
        """
        try:
            return cls.from_dict(read_data(Path(path)), Path(path).parent)
        except ValueError as error:
            raise ValueError(f"{short_path(path)}: {error}") from None

    def save(self, path: str | Path) -> None:
        """Write the scene to a .json, .yaml or .yml file, from which `load` returns an equal scene.

        Signals of more than a hundred samples are written to CSV files in the same folder, such as scene_torque.csv for
        scene.json.
        """
        data, tables = split_samples(Path(path), self.to_dict())
        write_data(Path(path), data)
        for file, columns in tables.items():
            write_csv(file, columns)

    @classmethod
    def from_dict(cls, data: object, folder: Path = Path()) -> Self:
        """Build the scene described by the mapping of a scene file.

        A CSV file outside the folder is read with a FutureWarning; the next release will require explicit permission.

        Args:
            data: mapping as in a scene file.
            folder: folder to which the paths of CSV files are relative.

        Raises:
            FileNotFoundError: if a CSV file does not exist.
            ValueError: for an invalid entry, with a one-line message: the field (such as `arm.links[1].length`), the
                value and the allowed values.
        """

        def signals(name: str) -> Callable[[Any], Any]:
            return lambda value: (
                None
                if value is None
                else [
                    signal_from_plain(f"{name}[{i}]", item, COLUMN_UNITS[name], folder)
                    for i, item in enumerate(sequence(name, value, "a list of mappings"))
                ]
            )

        return from_plain(
            cls,
            "",
            data,
            arm=find_arm,
            model=partial(from_plain, ModelChoice, "model"),
            torque=partial(torque_from_plain, folder=folder),
            initial=partial(from_plain, Initial, "initial"),
            **{name: signals(name) for name in COLUMN_UNITS},  # type: ignore[arg-type]
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the scene as nested dicts and lists of numbers and strings, as in a scene file."""
        data: dict[str, Any] = to_plain(self)
        if self.arm.payload is None:
            data["arm"]["payload"] = {"mass": 0.0}
        return {"note": self.note} | data


def _check_attitude(name: str, value: object) -> tuple[float, ...]:
    """Return a unit quaternion (scalar first) with its rounding errors removed.

    Raises:
        ValueError: for other than four numbers, or a norm that is not 1.
    """
    numbers = vector(name, value, 4)
    norm = math.hypot(*numbers)
    if abs(norm - 1.0) > ATTITUDE_TOLERANCE:
        raise value_error(name, tuple(numbers), "a unit quaternion (w, x, y, z), scalar first, norm 1")
    return tuple(each / norm for each in numbers)


def _check_signals(name: str, value: object, units: str) -> tuple[Signal | SampledSignal, ...] | None:
    """Return the checked signals of the three components of a vector in the base frame as a tuple, or None.

    Args:
        name: field, for errors.
        value: three Signals or SampledSignals along x, y and z, or None.
        units: unit of the vector, for errors.
    """
    if value is None:
        return None
    allowed = f"None or three of Signal or SampledSignal, along x, y and z ({units})"
    items = tuple(sequence(name, value, allowed))
    if len(items) != 3 or not all(isinstance(item, Signal | SampledSignal) for item in items):
        raise value_error(name, value, allowed)
    return items
