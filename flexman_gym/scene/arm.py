"""Arm: a serial chain of links and revolute joints with a payload, in SI units."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexman_gym.common.arrays import Vector
from flexman_gym.common.checks import MAX_SIZE, check_magnitudes, instances, non_negative, set_fields, vector
from flexman_gym.common.errors import value_error, warn_caller
from flexman_gym.common.registry import load_entry
from flexman_gym.scene.input_checks import check_keywords, warn_unusual_units
from flexman_gym.scene.joint import Joint
from flexman_gym.scene.link import Link, NonUniformLink
from flexman_gym.scene.rigid_body import LumpedMass, Payload

# Limits beyond which a value is probably in a wrong unit.
MAX_GRAVITY = 300.0  # m/s^2
MAX_MASS_RATIO = 100.0  # dimensionless; mass of a lumped mass or payload / mass of the links
MAX_REACH_RATIO = 20.0  # offset or radius of gyration of a lumped mass or payload / total length of the links
MAX_ROWS = 10  # rows of a table of `print`


@check_keywords
@dataclass(frozen=True)
class Arm:
    """Serial arm of links and revolute joints on a fixed base.

    Joint i drives link i, and joint i + 1 is mounted at the tip of link i.

    Attributes:
        links: n instances of Link or NonUniformLink, from base to tip; stored as a tuple.
        joints: n instances of Joint; stored as a tuple.
        payload: Payload at the tip of the last link, or None. A payload of zero mass is stored as None, because both
            describe the same arm.
        gravity: acceleration of gravity (3,) in the base frame, m/s^2.
        stiffness_proportional_damping: coefficient beta of the damping C = beta K of every link, s; not negative.
        modal_damping_ratio: damping ratio of every component mode of a link, at least 0 and less than 1; one number for
            all links, or (n,).

    Raises:
        ValueError: for an arm without links, for different numbers of links and joints, and for a value outside its
            range.

    Examples:
        >>> joint = fm.Joint((0, 0, 1), rotor_inertia=0.01, stiffness=30.0)
        >>> arm = fm.Arm([fm.Link.tube(0.5, diameter=0.02, wall=0.001)], [joint], fm.Payload(0.1), (0, 0, -9.81))
        >>> arm.n_joints
        1
    """

    links: Sequence[Link | NonUniformLink]
    joints: Sequence[Joint]
    payload: Payload | None = None
    gravity: Vector = (0.0, 0.0, 0.0)
    stiffness_proportional_damping: float = 0.0
    modal_damping_ratio: float | Vector = 0.0

    @classmethod
    def from_urdf(
        cls,
        path: str | Path,
        sidecar: str | Path | Mapping[str, Any] | None = None,
        tip: str | None = None,
        held: Mapping[str, float] | str | None = None,
        inertias: str = "project",
    ) -> "Arm":
        """Read an arm of rigid links from a URDF file.

        The base frame has the axes of the root link and its origin at the first joint. Links behind fixed and held
        joints are merged with the link that carries them; the body of a separate link at the tip is the payload. Data
        that the arm does not use are not checked, such as the inertia of the base. Limits of torque and speed are
        read, where a number <= 0 means none, and the ranges of revolute joints, see `Joint.angle_range`.

        An inertia matrix is impossible if a principal moment exceeds the sum of the other two (or is negative). With
        inertias="project" it is replaced, with a warning, by that of the nearest distribution of mass: negative second
        moments of mass are set to zero, which keeps the largest principal moment and increases the others. This is
        done where the excess is at most 1 % of the largest moment, as after rounding to three digits; for a link with
        less than 5 % of the moving mass, because masses of arms are seldom known more accurately; for a change that is
        smaller than the inertia of the same mass with a radius of gyration of 1 mm; and for rigid links that joints
        with parallel axes move, if the moment about them is unchanged. Other impossible inertias are refused. A link of
        zero mass has no inertia: one in the file is left out, with a warning.

        Args:
            path: the file.
            sidecar: .yaml or .json file, or a mapping, with what a URDF lacks: `links`, link of the URDF -> section as
                in the file of an arm, without length and orientation (y is horizontal), in place of the <inertial>;
                `joints`, joint -> fields of Joint; `gravity` in the axes of the root link (default: 9.81 m/s^2 against
                z), `stiffness_proportional_damping` and `modal_damping_ratio`.
            tip: link at the end of the chain, whose origin is the tip; may be omitted without branches.
            held: joint -> constant angle (rad) or position (m), for joints that are not part of the chain; "rest" for
                all joints except the revolute ones between base and tip, each at zero or at the nearest value within
                its limits, with a warning for joints between base and tip and for values other than zero.
            inertias: "project" or "strict", which refuses every impossible inertia.

        Raises:
            FileNotFoundError: if a file does not exist.
            ValueError: for invalid XML, for entities, and for joints and bodies that an arm cannot have; one message
                lists all joints to be held, or all links without mass, with the argument to paste.

        Examples:
            >>> arm = fm.Arm.from_urdf("docs/examples/two_links.urdf")
            >>> arm.n_joints
            2
        """
        arm: Arm = load_entry("flexman_gym.toolbox.interchange.urdf:read_urdf")(path, sidecar, tip, held, inertias)
        return arm

    def __post_init__(self) -> None:
        set_fields(
            self,
            links=instances("Arm.links", self.links, Link, NonUniformLink),
            joints=instances("Arm.joints", self.joints, Joint),
            gravity=vector("Arm.gravity", self.gravity, 3, "m/s^2"),
            stiffness_proportional_damping=non_negative(
                "Arm.stiffness_proportional_damping", self.stiffness_proportional_damping, "s"
            ),
            modal_damping_ratio=self._checked_ratio(),
        )
        check_magnitudes("Arm.gravity", self.gravity, MAX_SIZE, "m/s^2")
        if len(self.joints) != len(self.links):
            raise ValueError(
                f"Arm.joints: {len(self.joints)} joints are not allowed; give {len(self.links)}, one for each link"
            )
        if not isinstance(self.payload, Payload | None):
            raise value_error("Arm.payload", self.payload, "a Payload or None")
        if self.payload == Payload(0.0):
            set_fields(self, payload=None)
        self._warn_of_wrong_units()

    def _warn_of_wrong_units(self) -> None:
        warn_unusual_units("Arm", vars(self))
        if (gravity := math.hypot(*self.gravity)) > MAX_GRAVITY:
            warn_caller(
                f"Arm.gravity: {gravity:g} (m/s^2) is unusual; wrong unit? is it in mm/s^2? 9810 mm/s^2 are 9.81"
            )
        length = sum(link.length for link in self.links)
        beam_mass = sum(link.mass - link.flexible * sum(body.mass for body in link.masses) for link in self.links)
        bodies: list[tuple[str, LumpedMass | Payload]] = [
            (f"Arm.links[{i}].masses[{j}]", body)
            for i, link in enumerate(self.links)
            for j, body in enumerate(link.masses if link.flexible else ())
        ]
        if self.payload:
            bodies.append(("Arm.payload", self.payload))
        for name, body in bodies:
            _warn_of_body(name, body, beam_mass, length)

    def _checked_ratio(self) -> float | Vector:
        """Return the modal damping ratio as one number, or as a tuple with one number for each link."""
        value, field = self.modal_damping_ratio, "Arm.modal_damping_ratio"
        per_link = isinstance(value, list | tuple) or getattr(value, "ndim", 0) > 0
        ratios = vector(field, value, len(self.links)) if per_link else (non_negative(field, value),)
        if not all(0.0 <= ratio < 1.0 for ratio in ratios):
            raise value_error(field, value, "numbers >= 0 and < 1" if per_link else "a number >= 0 and < 1")
        return ratios if per_link else ratios[0]

    def __str__(self) -> str:
        """Return a table of the links and a table of the joints."""
        links, joints = [], []
        for number, (link, joint) in enumerate(zip(self.links, self.joints, strict=True), 1):
            bending = [
                (part.youngs_modulus * part.second_moment_y, part.youngs_modulus * part.second_moment_z)
                for part in link.sections
            ]
            axes = (
                f"{min(axis):.4g}" + f" to {max(axis):.4g}" * (max(axis) > min(axis))
                for axis in zip(*bending, strict=True)
            )
            links.append((number, float(link.length), float(link.mass), *(axes if link.flexible else ("rigid",) * 2)))
            limit = "none" if joint.torque_limit is None else f"{joint.torque_limit:.4g}"
            spring = "rigid" if joint.stiffness is None else f"{joint.stiffness:.4g}"
            axis = "({:.3g}, {:.3g}, {:.3g})".format(*joint.axis)
            joints.append((number, axis, spring, float(joint.damping), float(joint.rotor_inertia), limit))
        gravity = "({:g}, {:g}, {:g}) m/s^2".format(*self.gravity)
        return "\n".join([
            f"Arm with {self.n_joints} joints, reach {sum(link.length for link in self.links):.4g} m, payload "
            f"{self.payload.mass if self.payload else 0.0:.4g} kg, gravity {gravity}",
            *_text_table(("link", "length (m)", "mass (kg)", "E I_y (N m^2)", "E I_z (N m^2)"), links),
            *_text_table(("joint", "axis", "stiffness (N m/rad)", "damping (N m s/rad)", "rotor (kg m^2)",
                         "limit (N m)"), joints),
        ])  # fmt: skip

    @property
    def damping_ratios(self) -> tuple[float, ...]:
        """Modal damping ratio of each link, (n,)."""
        ratio = self.modal_damping_ratio
        return ratio if isinstance(ratio, tuple) else (float(ratio),) * self.n_joints  # type: ignore[arg-type]

    @property
    def angle_ranges(self) -> tuple[tuple[float, float] | None, ...]:
        """Range of the angle of each joint, rad; None for a joint that turns without stops."""
        return tuple(joint.angle_range for joint in self.joints)

    @property
    def home(self) -> tuple[float, ...]:
        """Posture (n,) in the middle of the angle ranges, 0 for a joint without a range, rad."""
        return tuple(0.0 if each is None else 0.5 * (each[0] + each[1]) for each in self.angle_ranges)

    @property
    def n_joints(self) -> int:
        """Number n of joints, which equals the number of links."""
        return len(self.joints)

    def _repr_png_(self) -> bytes:
        """Return a picture for a notebook."""
        picture: bytes = load_entry("flexman_gym.toolbox.view.notebook:arm_picture")(self)
        return picture


def _text_table(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> list[str]:
    """Return the lines of a table with right-aligned columns; of many rows only the first ones and the last one."""
    cells = [[f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row] for row in rows]
    if len(cells) > MAX_ROWS:
        cells = [*cells[: MAX_ROWS - 2], ["..."] * len(heads), cells[-1]]
    widths = [max(map(len, column)) for column in zip(heads, *cells, strict=True)]
    return ["  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)) for line in (heads, *cells)]


def _warn_of_body(name: str, body: LumpedMass | Payload, link_mass: float, length: float) -> None:
    """Warn (UserWarning) of a body whose mass or size is out of proportion to its arm.

    Args:
        name: field of the body, for the message.
        body: the lumped mass or payload.
        link_mass: total mass of the links, kg.
        length: total length of the links, m.
    """
    mass, inertia, offset = body.mass, body.inertia, body.offset
    gyration = math.sqrt(max(inertia[i][i] for i in range(3)) / mass) if inertia is not None and mass > 0.0 else 0.0
    distance = max(map(abs, offset)) if offset is not None else 0.0
    if mass > MAX_MASS_RATIO * link_mass:
        ratio = mass / link_mass
        message = f"{name}.mass: {mass:g} (kg) is {ratio:.3g} times the mass of the links; wrong unit? is it in g?"
    elif distance > MAX_REACH_RATIO * length:
        message = f"{name}.offset: {distance:g} (m) is far beyond an arm of {length:g} m; wrong unit? is it in mm?"
    elif gyration > MAX_REACH_RATIO * length:
        message = f"{name}.inertia: its radius of gyration is {gyration:.3g} m; wrong unit? is it in g cm^2 or kg mm^2?"
    else:
        return
    warn_caller(message)
