"""Model: an arm turned into the constants that the kernels read."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from flexman_gym.arrays import Array, Vector
from flexman_gym.checks import bounded, instance, refusal, vector
from flexman_gym.kernels import layout
from flexman_gym.kernels.layout import LANES
from flexman_gym.model.beam import Beam, build_beam
from flexman_gym.model.element import Element, beam_elements
from flexman_gym.model.modes import kept_modes, loaded_modes, modal_damping, outboard_inertias
from flexman_gym.model.packing import packed, packed_constants
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.choice import MOST_ELEMENTS, ModelChoice
from flexman_gym.scene.naming import ArmLike, find_arm
from flexman_gym.scene.scene import Scene
from flexman_gym.scene.slips import warn_of_modes

REMEMBERED = 24  # finite elements of an arm, up to which its links are remembered whole, some megabytes of them


@dataclass(frozen=True, eq=False, repr=False)
class Model:
    """A discretised arm, as `build_model` returns it.

    Attributes:
        arm: the arm from which it was built.
        choice: elements, modes and flexibilities, as they were asked for.
        constants: arrays that the kernels read; shapes and units in `kernels.layout.Constants`.
        bases: (6 * elements * sections, k_i) of each link, the node coordinates per unit of its elastic coordinates;
            (0, 0) of a rigid link.
        modal_damping: the part of `constants.damping` that comes from the modal damping ratio, packed like
            `constants.damping`.

    Examples:
        >>> model = fm.build_model(fm.catalog.paper_rrr(), elements=2)
        >>> model.n_joints, model.n_motors, model.n_elastic, model.n_dof
        (3, 3, 36, 42)
    """

    arm: Arm
    choice: ModelChoice
    constants: layout.Constants
    bases: tuple[Array, ...]
    modal_damping: Array

    def __repr__(self) -> str:
        bends = [self.bases[i].shape[1] for i in range(self.n_joints)]
        springs = "".join("s" if motor >= 0 else "r" for motor in self.constants.motor)
        length, mass = float(self.constants.length.sum()), float(self.constants.mass.sum())
        switches = [name for name in ("stiffening", "spinning_rotors", "rotary_inertia") if getattr(self.choice, name)]
        return (
            f"<Model: {self.n_dof} coordinates, of {self.n_joints} joints, {self.n_motors} motors on springs and "
            f"{self.n_elastic} of bending links\n"
            f"  links: {length:.4g} m, {mass:.4g} kg, elastic coordinates {bends}; joints, spring or rigid: {springs}\n"
            f"  payload {self.constants.payload_mass[0]:.4g} kg, gravity {self.constants.gravity.tolist()} m/s^2\n"
            f"  {', '.join(switches) or 'no further switches'}>"
        )

    @property
    def n_joints(self) -> int:
        """Number n of joints and of links."""
        return len(self.constants.mass)

    @property
    def n_motors(self) -> int:
        """Number m of flexible joints, each with a motor coordinate."""
        return int((self.constants.motor >= 0).sum())

    @property
    def n_elastic(self) -> int:
        """Number k of elastic coordinates of all links."""
        return len(self.constants.first_moment_shape)

    @property
    def n_dof(self) -> int:
        """Number d = n + m + k of coordinates; a state has 2 d numbers."""
        return self.n_joints + self.n_motors + self.n_elastic

    @property
    def motor_columns(self) -> np.ndarray:
        """Index (n,) in x of each motor angle; where the joint is rigid, of the joint angle."""
        return np.where(self.constants.motor >= 0, self.constants.motor, np.arange(self.n_joints))

    def elastic_columns(self, link: int) -> slice:
        """Gives the columns of x that hold the elastic coordinates of a link (counted from 0)."""
        first = self.n_joints + self.n_motors
        start, stop = self.constants.elastic_start[link : link + 2]
        return slice(first + int(start), first + int(stop))

    def elements(self, link: int) -> list[Element]:
        """Gives the finite elements of a link (counted from 0), base to tip."""
        return beam_elements(self.arm.links[link], _each("elements", self.choice.elements, self.n_joints)[link])

    def initial_state(self, joint_angles: Vector, joint_rates: Vector | None = None) -> Array:
        """Gives the state (2 d,) of the undeformed arm, with the motors at the angles and rates of the joints.

        Args:
            joint_angles: (n,) rad.
            joint_rates: (n,) rad/s, zero by default.

        Raises:
            ValueError: for wrong shapes, and values that are not finite or beyond 1e6.
        """
        state = np.zeros(2 * self.n_dof)
        starts = ((0, "joint_angles", joint_angles, "rad"), (self.n_dof, "joint_rates", joint_rates, "rad/s"))
        for column, name, values, unit in starts:
            if values is not None:
                checked = vector(name, values, self.n_joints, unit)
                bounded(name, checked, layout.LARGEST_STATE, unit)
                state[column : column + self.n_joints] = checked
                state[column + self.motor_columns] = checked
        return state

    def at_rest(self, angles: Array) -> Array:
        """Gives states (r, 2 d) of the undeformed arm at rest, with motors and joints at angles (r, n) rad."""
        states = np.zeros((len(angles), 2 * self.n_dof))
        states[:, : self.n_joints] = states[:, self.motor_columns] = angles
        return states


def build_model(
    arm: ArmLike,
    elements: int | tuple[int, ...] = 2,
    modes: int | tuple[int | tuple[int, ...], ...] | None = None,
    flexible_links: bool | tuple[bool, ...] = True,
    flexible_joints: bool = True,
    stiffening: bool = False,
    *,
    spinning_rotors: bool = False,
    rotary_inertia: bool = True,
) -> Model:
    """Discretises an arm.

    Args:
        arm: the arm, or what `scene.naming.find_arm` takes for one.
        elements: finite elements of a Link, or of each section of a NonUniformLink; one value or one per link. A link
            has at most 64 elements in all, and 6 * elements * number of sections coordinates.
        modes: loaded component modes kept of a flexible link, at most its number of coordinates; one value or one per
            link. A number keeps so many of the lowest frequencies, a tuple keeps modes by their numbers, counted from
            0. None keeps them all.
        flexible_links: False makes a link rigid.
        flexible_joints: False locks the springs of all joints; their rotor inertia stays.
        stiffening: foreshortening of bent links (geometric stiffening), which links need that bend far or spin fast.
        spinning_rotors: see `ModelChoice`.
        rotary_inertia: see `ModelChoice`.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """
    arm = find_arm(arm)
    choice = ModelChoice(flexible_links, elements, modes, flexible_joints, stiffening, spinning_rotors, rotary_inertia)
    n = arm.n_joints
    flexible = _each("flexible_links", choice.flexible_links, n)
    counts = _each("elements", choice.elements, n)
    kept = _each("modes", choice.modes, n)
    for i, (link, count) in enumerate(zip(arm.links, counts, strict=True)):
        most = MOST_ELEMENTS // len(link.sections)
        if count > most:
            raise refusal(f"elements[{i}]", count, f"at most {most} for each of the {len(link.sections)} sections")
    whole = _remembered if sum(len(link.sections) for link in arm.links) * max(counts) <= REMEMBERED else _whole_links
    bases, dampings, reduced = [], [], []
    beams = whole(arm, counts, flexible, choice.rotary_inertia)
    warn_of_modes([modes_[0][0] for _, modes_ in beams if len(modes_[0])])
    for i, (beam, modes_) in enumerate(beams):
        basis = kept_modes(modes_[1], kept[i] if flexible[i] else None, f"modes[{i}]")
        bases.append(basis)
        dampings.append(basis.T @ modal_damping(beam.stiffness, modes_, arm.damping_ratios[i]) @ basis)
        reduced.append(beam.reduced(basis))
    damping = packed([*dampings, np.zeros(LANES)], 1)
    return Model(arm, choice, packed_constants(arm, tuple(reduced), damping, choice), tuple(bases), damping)


def _whole_links(
    arm: Arm, elements: tuple[int, ...], flexible: tuple[bool, ...], rotary_inertia: bool
) -> list[tuple[Beam, tuple[Array, Array]]]:
    """Gives each link with all its coordinates, and frequencies and shapes of its loaded modes."""
    beams = tuple(map(build_beam, arm.links, elements, flexible, [rotary_inertia] * arm.n_joints))
    return [
        (beam, loaded_modes(beam, inertia)) for beam, inertia in zip(beams, outboard_inertias(arm, beams), strict=True)
    ]


# one arm is often built with many a choice of modes; nothing changes these arrays
_remembered = lru_cache(maxsize=8)(_whole_links)


def scene_model(scene: Scene) -> Model:
    """Builds the model that a scene asks for.

    Raises:
        ValueError: for anything but a scene, and what `build_model` refuses.
    """
    instance("scene", scene, Scene, "a Scene")
    return build_model(scene.arm, **vars(scene.model))


def checked_model(model: object) -> Model:
    """Gives a Model.

    Raises:
        ValueError: for anything else.
    """
    return instance("model", model, Model, "a Model, from build_model")


def _each(name: str, value: object, n: int) -> tuple:
    """Gives one value per link from one value for all or one for each."""
    if name == "elements" and value is None:
        raise refusal(name, None, "whole numbers from 1 on, or the scene to choose_model, which chooses them")
    if not isinstance(value, tuple):
        return (value,) * n
    if len(value) != n:
        raise refusal(name, value, f"one value, or {n}, one per link")
    return value
