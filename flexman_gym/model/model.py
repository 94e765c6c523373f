"""Model of an arm: finite elements, component modes, and the constants that the kernels read."""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import check_magnitudes, instance, vector
from flexman_gym.common.errors import value_error, warn_caller
from flexman_gym.kernels import layout
from flexman_gym.kernels.layout import LANES
from flexman_gym.model.beam import Beam, build_beam
from flexman_gym.model.component_modes import LoadedModes
from flexman_gym.model.element import NODE_COORDINATES, Element
from flexman_gym.model.joint_constants import joint_constants
from flexman_gym.model.outboard_inertia import outboard_inertias, zero_pose_rotations
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.rigid_body import Payload
from flexman_gym.scene.scene import MAX_ELEMENTS, ModelChoice, Scene
from flexman_gym.scene.serialization import ArmLike, find_arm

UNCOUPLED = 1e-8  # entry of K or C / geometric mean of its diagonal entries, below which it is a rounded zero
NEGLIGIBLE = 1e-14  # mass integral / geometric mean for its two coordinates, below which it is a rounded zero
MIN_FREQUENCY, MAX_FREQUENCY = 0.01, 1e4  # Hz; usual range of the first natural frequency of a link


class _ShapeIntegrals(NamedTuple):
    """Mass integrals of a beam with k elastic coordinates (Eqs. (13) and (14), see `model.beam`), summed over points.

    r0 is the undeformed position of a mass m, S_a the shape function of coordinate a. Polar moments of inertia enter as
    fictitious second moments of mass.
    """

    mass: float  # kg; sum m
    first_moment: Array  # (3,) sum m r0
    first_moment_shape: Array  # (k, 3) sum m S_a
    second_moment: Array  # (3, 3) sum m r0 r0^T
    position_shape: Array  # (k, 3, 3) sum m r0 S_a^T
    shape_shape: Array  # (k, k, 3, 3) sum m S_b S_a^T; the first index is b
    elastic: Array  # (k, k) sum m S_a . S_b


def _integrate(beam: Beam) -> _ShapeIntegrals:
    """Return the mass integrals of a beam, which determine its inertial forces in any state."""
    m, r0, s = beam.masses, beam.positions, beam.shapes
    position_shape = np.einsum("p,pi,pja->aij", m, r0, s)
    half = beam.polar @ beam.twist / 2
    position_shape[:, 1, 2] += half
    position_shape[:, 2, 1] -= half
    return _ShapeIntegrals(
        mass=float(m.sum()),
        first_moment=m @ r0,
        first_moment_shape=np.einsum("p,pia->ai", m, s),
        second_moment=np.einsum("p,pi,pj->ij", m, r0, r0) + beam.polar.sum() / 2 * np.diag([-1.0, 1.0, 1.0]),
        position_shape=position_shape,
        shape_shape=np.einsum("p,pib,pja->baij", m, s, s),
        elastic=beam.mass_matrix,
    )


def _pack_constants(
    arm: Arm, beams: tuple[Beam, ...], modal: Array, choice: ModelChoice, rounded: float
) -> layout.Constants:
    """Return the constants of the kernels for an arm.

    Args:
        arm: the arm.
        beams: its links in reduced coordinates, base to tip.
        modal: packed damping matrices of the links by modal damping ratios; rounded zeros are set to zero in place.
        choice: modelling assumptions.
        rounded: see `_remove_rounded_couplings`.
    """
    payload = arm.payload or Payload(0.0)
    sizes = np.array([len(beam.stiffness) for beam in beams], dtype=np.int64)
    widths = LANES * ((sizes + 6 + LANES - 1) // LANES)
    parts = [_integrate(beam) for beam in beams]

    end = np.zeros(LANES)  # the kernels read groups of LANES numbers, the last one beyond the last row
    pairs = list(zip(parts, beams, strict=True))
    stiffness = _pack([*[beam.stiffness for beam in beams], end], 1)
    coupled = _remove_rounded_couplings(rounded, sizes, stiffness, modal)
    return layout.Constants(
        elastic_start=_starts(sizes),
        square_start=_starts(sizes**2),
        gravity=np.array(arm.gravity, dtype=float),
        mount=zero_pose_rotations(arm).ravel(),
        axis=np.array([np.array(li.orientation).T @ jo.axis for li, jo in zip(arm.links, arm.joints, strict=True)]),
        **joint_constants(arm, choice),
        length=np.array([link.length for link in arm.links]),
        mass=np.array([part.mass for part in parts]),
        first_moment=np.array([part.first_moment for part in parts]),
        second_moment=np.array([part.second_moment for part in parts]).ravel(),
        first_moment_shape=_pack([part.first_moment_shape for part in parts], 3),
        position_shape=_pack([part.position_shape for part in parts], 1),
        **_sparse("shape", [part.shape_shape for part in parts], 9, parts),
        **_sparse("cross", [_axial(part.shape_shape) for part in parts], 3, parts),
        factor_start=_starts(sizes * widths)[:-1],
        factor_width=widths,
        tip_start=_first_moving(beams, choice.stiffening),
        tip_linear_start=_first_moving(beams, False),
        elastic_mass=_pack([*[part.elastic - _axial_mass(beam, choice.stiffening) for part, beam in pairs], end], 1),
        stiffness=stiffness,
        damping=arm.stiffness_proportional_damping * stiffness + modal,
        coupled=coupled,
        **_station_constants(beams, choice.stiffening),
        tip_translation=_pack([beam.tip_translation.T for beam in beams], 3),
        tip_rotation=_pack([beam.tip_rotation.T for beam in beams], 3),
        payload_mass=np.array([payload.mass]),
        payload_offset=np.array([payload.offset or (0.0, 0.0, 0.0)]),
        payload_inertia=np.array(payload.inertia or np.zeros((3, 3))).ravel(),
        payload_mount=np.array(arm.links[-1].orientation).T.ravel().copy(),
    )


def _remove_rounded_couplings(rounded: float, sizes: np.ndarray, *matrices: Array) -> np.ndarray:
    """Set off-diagonal entries that are rounded zeros to zero, in packed blocks of the given sizes (n,).

    Loaded modes have diagonal stiffness and modal damping matrices but for rounding. An entry up to `rounded` times the
    geometric mean of its two diagonal entries is a rounded zero.

    Returns:
        For each link (n,) 1 if one of its blocks still has entries off the diagonal, else 0.
    """
    coupled, start = np.zeros(len(sizes), dtype=np.int64), 0
    for i, k in enumerate(sizes):
        for matrix in matrices:
            block = matrix[start : start + k * k].reshape(k, k)
            size = np.sqrt(np.abs(np.diag(block)))
            block[(np.abs(block) <= rounded * np.outer(size, size)) & ~np.eye(k, dtype=bool)] = 0.0
            coupled[i] |= np.count_nonzero(block) > np.count_nonzero(np.diag(block))
        start += k * k
    return coupled


def _pack(blocks: list[Array], width: int) -> Array:
    """Return blocks concatenated row by row, (rows, width), or (rows,) for a width of 1."""
    rows = np.concatenate([np.asarray(block, dtype=float).reshape(-1, width) for block in blocks])
    return np.ascontiguousarray(rows[:, 0] if width == 1 else rows)


def _sparse(name: str, blocks: list[Array], width: int, parts: list[_ShapeIntegrals]) -> dict[str, np.ndarray]:
    """Return the fields start, source and value of `layout.Constants` with the non-zero entries [b, a, ...] of blocks.

    The names of the fields begin with `name`; the block (k, k, ...) of a link has `width` numbers for each pair.
    """
    offset, counts, sources, values = 0, [], [], []
    for block, part in zip(blocks, parts, strict=True):
        k = len(part.elastic)
        entries = block.reshape(k, width * k).T
        size = np.sqrt(np.diag(part.elastic))
        retained = np.abs(entries) > NEGLIGIBLE * np.outer(np.repeat(size, width), size)
        counts.append(retained.sum(axis=1))
        values.append(entries[retained])
        sources.append(np.nonzero(retained)[1] + offset)
        offset += k
    return {
        f"{name}_start": _starts(np.concatenate(counts)),
        f"{name}_source": np.concatenate(sources).astype(np.int64),
        f"{name}_value": np.concatenate(values),
    }


def _station_constants(beams: tuple[Beam, ...], stiffening: bool) -> dict[str, np.ndarray]:
    """Return the fields of `layout.Constants` for foreshortening, by name."""
    sizes = np.array([len(beam.stiffness) for beam in beams])
    widths = LANES * -(-sizes // LANES)
    counts = np.array([LANES * -(-len(beam.stations) // LANES) for beam in beams]) * (sizes > 0) * stiffening
    start, row, offsets = _starts(counts), _starts(widths * counts), _starts(sizes)
    points, shapes = np.zeros((4, start[-1])), np.zeros((3, row[-1]))
    displacements, shortenings = [], []
    for i, beam in enumerate(beams):
        used = min(counts[i], len(beam.stations))
        points[:, start[i] : start[i] + used] = beam.stations[:used].T
        shape = np.zeros((3, counts[i], widths[i]))
        shape[:, :used, : sizes[i]] = np.swapaxes(beam.station_shapes[:used], 0, 1)
        shapes[:, row[i] : row[i + 1]] = shape.reshape(3, -1)
        shape = np.swapaxes(shape, 1, 2)[:, : sizes[i]]
        displacements.append((shape, np.abs(shape).max(axis=(0, 2), initial=0.0)))
        shortening = np.zeros((sizes[i], sizes[i], counts[i]))
        shortening[:, :, :used] = np.moveaxis(beam.shortening[:used], 0, 2)
        size = np.sqrt(np.diag(beam.shortening[0]))
        shortenings.append((shortening, np.outer(size, size)))
    result = {"station_start": start, "station_width": widths, "station_row": row[:-1], "station_mass": points[0]}
    off_axis = [points[2:, first:last].ravel() for first, last in pairwise(start)]
    result |= {"station_position": points[1], "station_offset": np.concatenate(off_axis), "station_shape": shapes}
    return result | _rows("displacement", displacements, offsets) | _rows("bend", shortenings, offsets)


def _rows(name: str, blocks: list[tuple[Array, Array]], offsets: np.ndarray) -> dict[str, np.ndarray]:
    """Return the fields start, row, source and value of `layout.Constants` with the non-zero rows of blocks.

    Args:
        name: prefix of the field names.
        blocks: array (rows, k, s) of each link, and magnitudes (rows, k) with which its entries are compared.
        offsets: (n,) number of elastic coordinates of all inboard links.
    """
    counts, starts = [], []
    sources, values = [np.zeros(0, dtype=np.int64)], [np.zeros(0)]
    for (block, size), offset in zip(blocks, offsets, strict=False):
        row, source = np.nonzero(np.abs(block).max(axis=2, initial=0.0) > NEGLIGIBLE * size)
        starts.append(sum(each.size for each in values) - sum(each.size for each in sources) * block.shape[2])
        counts.append(np.bincount(row, minlength=len(block)))
        sources.append(offset + source.astype(np.int64))
        values.append(block[row, source].ravel())
    return {
        f"{name}_start": _starts(np.concatenate(counts)),
        f"{name}_row": np.array(starts, dtype=np.int64),
        f"{name}_source": np.concatenate(sources),
        f"{name}_value": np.concatenate(values),
    }


def _starts(counts: np.ndarray) -> np.ndarray:
    """Return the start indices of n packed arrays with given sizes (n,), followed by the total size, (n + 1,)."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def _axial_mass(beam: Beam, stiffening: bool) -> Array:
    """Return the contribution (k, k) of axial station motion to the elastic mass matrix; the kernels add it."""
    axial = beam.station_shapes[:, 0]
    return np.einsum("s,sa,sb->ab", beam.stations[:, 0], axial, axial) * stiffening


def _first_moving(beams: tuple[Beam, ...], stiffening: bool) -> np.ndarray:
    """Return for each link (n,) the index, among all elastic coordinates, of the first one that moves its tip.

    With foreshortening (stiffening) every coordinate moves the tip.
    """
    offset, first = 0, []
    for beam in beams:
        moving = np.abs(np.vstack([beam.tip_translation, beam.tip_rotation])).max(axis=0, initial=0.0) > 0.0
        moving |= stiffening
        first.append(offset + (int(np.argmax(moving)) if moving.any() else len(moving)))
        offset += len(moving)
    return np.array(first, dtype=np.int64)


def _axial(tensors: Array) -> Array:
    """Return the sum (..., 3) of cross products a x b for a sum (..., 3, 3) of dyads a b^T."""
    difference = tensors - np.swapaxes(tensors, -1, -2)
    return np.stack([difference[..., 1, 2], difference[..., 2, 0], difference[..., 0, 1]], axis=-1)


_Links = list[tuple[Beam, LoadedModes]]  # see `_build_links`
MAX_CACHED_ELEMENTS = 24  # largest number of finite elements of an arm whose unreduced links are cached


@dataclass(frozen=True, eq=False, repr=False)
class Model:
    """Discretised arm, as returned by `build_model`.

    Attributes:
        arm: the arm.
        choice: modelling assumptions and discretisation.
        constants: arrays for the kernels; shapes and units in `kernels.layout.Constants`.
        bases: for each link, the matrix (6 * elements * sections, k_i) of node coordinates per unit of its k_i elastic
            coordinates; (0, 0) for a rigid link.
        modal_damping: part of `constants.damping` by modal damping ratios, in the packed form of `constants.damping`.

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
        counts = [self.bases[i].shape[1] for i in range(self.n_joints)]
        springs = "".join("s" if motor >= 0 else "r" for motor in self.constants.motor)
        length, mass = float(self.constants.length.sum()), float(self.constants.mass.sum())
        switches = [name for name in ("stiffening", "spinning_rotors", "rotary_inertia") if getattr(self.choice, name)]
        return (
            f"<Model: {self.n_dof} coordinates: {self.n_joints} joints, {self.n_motors} motors of flexible joints, "
            f"{self.n_elastic} elastic\n"
            f"  links: {length:.4g} m, {mass:.4g} kg, elastic coordinates {counts}; spring or rigid joints: {springs}\n"
            f"  payload {self.constants.payload_mass[0]:.4g} kg, gravity {self.constants.gravity.tolist()} m/s^2\n"
            f"  {', '.join(switches) or 'no further switches'}>"
        )

    @property
    def n_joints(self) -> int:
        """Number n of joints, and of links."""
        return len(self.constants.mass)

    @property
    def n_motors(self) -> int:
        """Number m of motor angles among the coordinates: one for each flexible joint, none for a rigid joint."""
        return int((self.constants.motor >= 0).sum())

    @property
    def n_elastic(self) -> int:
        """Number k of elastic coordinates of all links."""
        return len(self.constants.first_moment_shape)

    @property
    def n_dof(self) -> int:
        """Number d = n + m + k of coordinates; a state has 2 d entries."""
        return self.n_joints + self.n_motors + self.n_elastic

    @property
    def motor_columns(self) -> np.ndarray:
        """Indices (n,) of the motor angles among the coordinates x; for a rigid joint the index of the joint angle."""
        return np.where(self.constants.motor >= 0, self.constants.motor, np.arange(self.n_joints))

    @property
    def driven_columns(self) -> np.ndarray:
        """Indices of the motor angles of all joints but the passive ones, as in `motor_columns`."""
        return self.motor_columns[self.constants.passive == 0]

    def elastic_columns(self, link: int) -> slice:
        """Return the slice of the coordinates x with the elastic coordinates of a link (index from 0)."""
        first = self.n_joints + self.n_motors
        start, stop = self.constants.elastic_start[link : link + 2]
        return slice(first + int(start), first + int(stop))

    def elements(self, link: int) -> list[Element]:
        """Return the finite elements of a link (index from 0), base to tip."""
        return Element.divide(self.arm.links[link], _each("elements", self.choice.elements, self.n_joints)[link])

    def node_basis(self, link: int) -> Array:
        """Return all node coordinates (size, k) of a link, clamped ones too, per unit of each elastic coordinate."""
        basis, count = self.bases[link], len(self.elements(link))
        return np.vstack([np.zeros((NODE_COORDINATES * (count + 1) - len(basis), basis.shape[1])), basis])

    def initial_state(self, joint_angles: Vector, joint_rates: Vector | None = None) -> Array:
        """Return the state (2 d,) of the undeformed arm with the motors at the angles and rates of the joints.

        Args:
            joint_angles: (n,) rad, magnitude at most 1e6.
            joint_rates: (n,) rad/s, zero by default, magnitude at most 1e6.
        """
        state = np.zeros(2 * self.n_dof)
        starts = ((0, "joint_angles", joint_angles, "rad"), (self.n_dof, "joint_rates", joint_rates, "rad/s"))
        for column, name, values, unit in starts:
            if values is not None:
                checked = vector(name, values, self.n_joints, unit)
                check_magnitudes(name, checked, layout.LARGEST_STATE, unit)
                state[column : column + self.n_joints] = checked
                state[column + self.motor_columns] = checked
        return state

    def at_rest(self, angles: Array) -> Array:
        """Return states (r, 2 d) of the undeformed arm at rest, with motors and joints at angles (r, n) rad."""
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
    """Discretise an arm by finite elements and, optionally, component modes.

    Args:
        arm: an `Arm`, the name of an arm in the catalog, a file, or a mapping; see `scene.serialization.find_arm`.
        elements: number of finite elements of a Link, or of each section of a NonUniformLink; one value or one per
            link. A link has at most 64 elements in total, and 6 * elements * number of sections elastic coordinates.
        modes: retained component modes (`model.component_modes.LoadedModes`) of a flexible link; one value or one per
            link. A number m retains the m lowest, a tuple retains modes by index from 0, None all elastic coordinates.
        flexible_links: False makes a link rigid; one value or one per link.
        flexible_joints: False makes all joints rigid; their rotor inertia remains.
        stiffening: True includes the foreshortening of the links (geometric stiffening), needed for large deflections
            and for fast rotation.
        spinning_rotors: gyroscopic coupling of the spinning rotors, see `ModelChoice`.
        rotary_inertia: see `ModelChoice`.

    Warns:
        UserWarning: if the first natural frequency of the links suggests wrong units.

    Examples:
        >>> model = fm.build_model(fm.catalog.one_joint(), elements=4, modes=3)
        >>> model.n_elastic, fm.frequencies(model, lock_joints=True)[:2].round(2)
        (3, array([ 1.41, 11.19]))
    """
    arm = find_arm(arm)
    choice = ModelChoice(flexible_links, elements, modes, flexible_joints, stiffening, spinning_rotors, rotary_inertia)
    n = arm.n_joints
    flexible = _flexible(arm, choice)
    counts = _each("elements", choice.elements, n)
    retained = _each("modes", choice.modes, n)
    for i, (link, count) in enumerate(zip(arm.links, counts, strict=True)):
        most = MAX_ELEMENTS // len(link.sections)
        if count > most:
            raise value_error(f"elements[{i}]", count, f"at most {most} for each of the {len(link.sections)} sections")
    size = sum(len(link.sections) for link in arm.links) * max(counts)
    build_links = _build_links_cached if size <= MAX_CACHED_ELEMENTS else _build_links
    beams = build_links(arm, counts, flexible, choice.rotary_inertia)
    _warn_unusual_frequency([loaded.frequencies[0] for _, loaded in beams if len(loaded.frequencies)])
    bases = tuple(
        loaded.basis(retained[i] if flexible[i] else None, f"modes[{i}]") for i, (_, loaded) in enumerate(beams)
    )
    return _assemble(arm, choice, beams, bases, UNCOUPLED)


def changed_model(model: Model, arm: Arm) -> Model:
    """Return the model of a changed arm in the elastic coordinates of a given model.

    The node coordinates of a link per unit of each elastic coordinate, `Model.bases`, are those of the given model; in
    these coordinates stiffness and damping matrices of the changed arm are not diagonal.

    Args:
        model: model of an arm.
        arm: arm with changed dimensions or materials, with as many links and sections.
    """
    choice, n = model.choice, model.n_joints
    counts, flexible = _each("elements", choice.elements, n), _flexible(arm, choice)
    return _assemble(arm, choice, _build_links(arm, counts, flexible, choice.rotary_inertia), model.bases, 0.0)


def _flexible(arm: Arm, choice: ModelChoice) -> tuple[bool, ...]:
    """Return for each link True if it is modelled as flexible."""
    given = _each("flexible_links", choice.flexible_links, arm.n_joints)
    return tuple(one and link.flexible for one, link in zip(given, arm.links, strict=True))


def _assemble(arm: Arm, choice: ModelChoice, beams: _Links, bases: tuple[Array, ...], rounded: float) -> Model:
    """Return the model of an arm from its links and bases; see `_remove_rounded_couplings` for `rounded`."""
    reduced = tuple(beam.reduced(basis) for (beam, _), basis in zip(beams, bases, strict=True))
    dampings = [
        basis.T @ loaded.damping(beam.stiffness, ratio) @ basis
        for (beam, loaded), basis, ratio in zip(beams, bases, arm.damping_ratios, strict=True)
    ]
    damping = _pack([*dampings, np.zeros(LANES)], 1)
    return Model(arm, choice, _pack_constants(arm, reduced, damping, choice, rounded), bases, damping)


def _build_links(arm: Arm, elements: tuple[int, ...], flexible: tuple[bool, ...], rotary_inertia: bool) -> _Links:
    """Return each link with all its elastic coordinates, and frequencies (rad/s) and shapes of its loaded modes."""
    beams = tuple(map(build_beam, arm.links, elements, flexible, [rotary_inertia] * arm.n_joints))
    return [
        (beam, LoadedModes.of(beam, inertia))
        for beam, inertia in zip(beams, outboard_inertias(arm, beams), strict=True)
    ]


# An arm is often rebuilt with other modes; no code modifies the cached arrays.
_build_links_cached = lru_cache(maxsize=8)(_build_links)


def scene_model(scene: Scene) -> Model:
    """Return the model of a scene, built from its fields `arm` and `model`."""
    instance("scene", scene, Scene, "a Scene")
    return build_model(scene.arm, **vars(scene.model))


def check_model(model: object) -> Model:
    """Return the argument after checking that it is a Model."""
    return instance("model", model, Model, "a Model, from build_model")


def _each(name: str, value: object, n: int) -> tuple:
    """Return a tuple (n,) with a value for each link, for one value for all links or a tuple (n,)."""
    if name == "elements" and value is None:
        raise value_error(name, None, "whole numbers >= 1; or pass the scene to choose_model, which chooses them")
    if not isinstance(value, tuple):
        return (value,) * n
    if len(value) != n:
        raise value_error(name, value, f"one value, or {n}, one per link")
    return value


def _warn_unusual_frequency(angular_frequencies: list[float]) -> None:
    """Warn if the lowest natural frequency of the flexible links (rad/s) is outside the usual range: wrong units?"""
    frequency = min(angular_frequencies, default=2.0 * np.pi) / (2.0 * np.pi)
    if not MIN_FREQUENCY <= frequency <= MAX_FREQUENCY:
        usual = f"usual is {MIN_FREQUENCY:g} to {MAX_FREQUENCY:g} Hz; check the units of moduli, sizes and masses"
        warn_caller(f"arm: the first bending frequency of its links, {frequency:.3g} Hz, suggests wrong units; {usual}")
