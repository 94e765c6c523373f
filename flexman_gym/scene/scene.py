"""Scene: an arm, its model choice, its torque, its initial state and a duration, kept in a JSON or YAML file."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from flexman_gym.arrays import Vector
from flexman_gym.checks import (
    positive,
    refusal,
    sequence,
    store,
    text,
    vector,
)
from flexman_gym.scene import file as scene_file
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.choice import ModelChoice
from flexman_gym.scene.drive import ConstantTorque, Signal, SineTorque, drive_table, signals
from flexman_gym.scene.plain import arm_of, built, entries_of, part_of, plain, torque_of

MOST_OUTPUT_STEPS = 10_000_000


@dataclass(frozen=True)
class Initial:
    """The state at t = 0: motors at the angles and rates of the joints, links undeformed and at rest in their frames.

    Attributes:
        joint_angles: (n,) rad.
        joint_rates: (n,) rad/s.
        state: (2 d,) a whole state of the scene's model that takes the place of both, with bent links and wound
            springs; None without one. Its order is that of `kernels.layout`.

    Raises:
        ValueError: for an attribute that is not a list of finite numbers, and for lists of different length.
    """

    joint_angles: Vector
    joint_rates: Vector
    state: Vector | None = None

    def __post_init__(self) -> None:
        angles = vector("Initial.joint_angles", self.joint_angles, unit="rad")
        store(self, joint_angles=angles)
        store(self, joint_rates=vector("Initial.joint_rates", self.joint_rates, len(angles), "rad/s"))
        if self.state is not None:
            store(self, state=vector("Initial.state", self.state))


@dataclass(frozen=True)
class Scene:
    """One run: everything that a simulation needs except its method.

    Attributes:
        arm: the arm.
        model: how finely the arm is modelled.
        torque: of the motors.
        initial: the state at t = 0.
        duration: s.
        output_step: time between outputs, s. The duration is a whole number of output steps (to 1e-9 of itself), at
            most 10 million.
        note: free text for the reader.
        prescribed: (n,) a Signal in rad/s^2 for a motor whose motion is given (a joint where it is rigid), the
            acceleration; None for a motor that its torque drives. None in place of the list where torques drive all
            motors.
        tip_force: three Signals in N, the force on the tip of the last link in the base frame; None without one.
        base_acceleration: three Signals in m/s^2, the acceleration of the base as a whole in the base frame; None
            without one.

    Raises:
        ValueError: for a part that has the wrong type or does not fit the number of joints of the arm, and for a torque
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
        """Refuses a part of another kind, or one whose tuples do not hold one entry for each joint."""
        value = getattr(self, part)
        if not isinstance(value, kinds):
            raise refusal(f"Scene.{part}", value, " or ".join(kind.__name__ for kind in kinds))
        if isinstance(value, Arm):
            return
        for name, entry in vars(value).items():
            if name != "state" and isinstance(entry, tuple) and len(entry) != self.arm.n_joints:
                raise refusal(f"Scene.{part}.{name}", entry, f"{self.arm.n_joints} values, one for each joint")

    def _checked_motion(self) -> tuple[Signal | None, ...] | None:
        """Checks the prescribed motions; it refuses a motion and a torque on the same motor."""
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
        """Table of the drive (6, n + 6) as the kernels read it, see `kernels.layout`."""
        motions, none = self.prescribed or [None] * self.arm.n_joints, [None] * 3
        motors = [motion or torque for motion, torque in zip(motions, self.torque.signals(), strict=True)]
        return drive_table([*motors, *(self.tip_force or none), *(self.base_acceleration or none)])

    @property
    def output_times(self) -> NDArray[np.float64]:
        """Times of the output (duration / output_step + 1,), from 0 to the duration, s."""
        return np.linspace(0.0, self.duration, round(self.duration / self.output_step) + 1)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Reads a scene from a .json, .yaml or .yml file.

        Raises:
            FileNotFoundError: when there is no such file.
            ValueError: for anything else that is wrong with it; one line names the file, the field
                (`arm.links[1].length`), the value and what is allowed.
        """
        try:
            return cls.from_dict(scene_file.read(Path(path)))
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None

    def save(self, path: str | Path) -> None:
        """Writes the scene to a .json, .yaml or .yml file, from which `load` gives an equal one.

        Raises:
            ValueError: for another suffix.
        """
        scene_file.write(Path(path), self.to_dict())

    @classmethod
    def from_dict(cls, data: object) -> Self:
        """Builds the scene that the mapping of a scene file describes.

        Raises:
            ValueError: one line that names the field (`arm.links[1].length`), the value and what is allowed.
        """
        entries = entries_of(Scene, "", data)
        entries["arm"] = arm_of(entries["arm"])
        entries["model"] = part_of(ModelChoice, "model", entries["model"])
        entries["torque"] = torque_of(entries["torque"])
        entries["initial"] = part_of(Initial, "initial", entries["initial"])
        for name in ("prescribed", "tip_force", "base_acceleration"):
            if entries.get(name) is not None:
                items = enumerate(sequence(name, entries[name], "a list of mappings"))
                entries[name] = [None if item is None else part_of(Signal, f"{name}[{i}]", item) for i, item in items]
        return built(cls, "", entries)

    def to_dict(self) -> dict[str, Any]:
        """Gives the scene as the mapping of a scene file, of dicts, lists, numbers and texts."""
        data: dict[str, Any] = plain(self)
        if self.arm.payload is None:
            data["arm"]["payload"] = {"mass": 0.0}
        return {"note": self.note} | data
