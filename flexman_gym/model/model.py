"""The model: an arm turned into the constants that the kernels read."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import refusal, vector
from flexman_gym.kernels import layout
from flexman_gym.kernels.layout import LANES
from flexman_gym.model.beam import Beam, Element, ShapeIntegrals, beam_elements, build_beam, shape_integrals
from flexman_gym.model.modes import loaded_modes, modal_damping, outboard_inertias, zero_pose_rotations
from flexman_gym.scene.arm import Arm, Payload
from flexman_gym.scene.scene import MOST_ELEMENTS, ModelChoice, Scene

VANISHING = 1e-14  # a mass integral this small beside the masses of its two coordinates is a zero with rounding


@dataclass(frozen=True, eq=False)
class Model:
    """A discretised arm; what `build_model` returns.

    Attributes:
        arm: the arm it was built from.
        choice: elements, modes and flexibilities, as they were asked for.
        constants: arrays that the kernels read; shapes and units in `kernels.layout.Constants`.
        bases: (6 * elements * sections, k_i) of each link, the node coordinates per unit of its elastic coordinates; of
            a rigid link (0, 0).
        modal_damping: the part of `constants.damping` that comes from the modal damping ratio, packed like it.
    """

    arm: Arm
    choice: ModelChoice
    constants: layout.Constants
    bases: tuple[Array, ...]
    modal_damping: Array

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
        """(n,) index in x of each motor angle; that of the joint angle where the joint is rigid."""
        return np.where(self.constants.motor >= 0, self.constants.motor, np.arange(self.n_joints))

    def elastic_columns(self, link: int) -> slice:
        """Columns of x that hold the elastic coordinates of a link (counted from 0)."""
        first = self.n_joints + self.n_motors
        start, stop = self.constants.elastic_start[link : link + 2]
        return slice(first + int(start), first + int(stop))

    def elements(self, link: int) -> list[Element]:
        """Finite elements of a link (counted from 0), base to tip."""
        return beam_elements(self.arm.links[link], _each("elements", self.choice.elements, self.n_joints)[link])

    def initial_state(
        self, joint_angles: Sequence[float] | Array, joint_rates: Sequence[float] | Array | None = None
    ) -> Array:
        """State (2 d,) of the undeformed arm at joint angles (n,) rad and rates (n,) rad/s; motors follow."""
        state = np.zeros(2 * self.n_dof)
        starts = ((0, "joint_angles", joint_angles, "rad"), (self.n_dof, "joint_rates", joint_rates, "rad/s"))
        for column, name, values, unit in starts:
            if values is not None:
                checked = vector(name, values, self.n_joints, unit)
                state[column : column + self.n_joints] = checked
                state[column + self.motor_columns] = checked
        return state


def build_model(
    arm: Arm,
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
        arm: the arm.
        elements: finite elements of a Link, or of each section of a NonUniformLink; one value or one per link, and no
            more than 64 elements of a link in all. A link has 6 * elements * number of sections coordinates.
        modes: loaded component modes kept of a flexible link, at most its number of coordinates; None keeps them all.
            One value or one per link: how many, of the lowest frequencies, or a tuple of their numbers, counted from 0.
        flexible_links: False makes a link rigid.
        flexible_joints: False locks the springs of all joints; their rotor inertia stays.
        stiffening: foreshortening of bent links (geometric stiffening), needed where links spin about as fast as they
            bend, or bend far.
        spinning_rotors, rotary_inertia: see `ModelChoice`.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """
    switches = {"spinning_rotors": spinning_rotors, "rotary_inertia": rotary_inertia}
    choice = ModelChoice(flexible_links, elements, modes, flexible_joints, stiffening, **switches)
    n = arm.n_joints
    flexible = _each("flexible_links", choice.flexible_links, n)
    counts = _each("elements", choice.elements, n)
    kept = _each("modes", choice.modes, n)
    for i, (link, count) in enumerate(zip(arm.links, counts, strict=True)):
        most = MOST_ELEMENTS // len(link.sections)
        if count > most:
            raise refusal(f"elements[{i}]", count, f"at most {most} for each of the {len(link.sections)} sections")
    beams = tuple(map(build_beam, arm.links, counts, flexible, [choice.rotary_inertia] * n))
    outboard = outboard_inertias(arm, beams)
    bases, dampings, reduced = [], [], []
    for i, beam in enumerate(beams):
        basis = _basis(beam, outboard[i], kept[i] if flexible[i] else None, f"modes[{i}]")
        bases.append(basis)
        dampings.append(basis.T @ modal_damping(beam, outboard[i], arm.modal_damping_ratio) @ basis)
        reduced.append(beam.reduced(basis))
    damping = _packed([*dampings, np.zeros(LANES)], 1)
    return Model(arm, choice, _constants(arm, tuple(reduced), damping, choice), tuple(bases), damping)


def scene_model(scene: Scene) -> Model:
    """The model that a scene asks for."""
    return build_model(scene.arm, **vars(scene.model))


def _each(name: str, value: object, n: int) -> tuple:
    """One value per link from one for all or one for each."""
    if not isinstance(value, tuple):
        return (value,) * n
    if len(value) != n:
        raise refusal(name, value, f"one value, or {n}, one per link")
    return value


def _basis(beam: Beam, outboard: Array, modes: int | tuple[int, ...] | None, field: str) -> Array:
    size = len(beam.stiffness)
    if modes is None:
        return np.eye(size)
    if isinstance(modes, int) and modes > size:
        raise refusal(field, modes, f"at most {size}, the elastic coordinates of this link's elements")
    if isinstance(modes, tuple) and modes[-1] >= size:
        raise refusal(field, modes, f"mode numbers below {size}, the elastic coordinates of this link's elements")
    return loaded_modes(beam, outboard)[1][:, range(modes) if isinstance(modes, int) else modes]


def _constants(arm: Arm, beams: tuple[Beam, ...], modal: Array, choice: ModelChoice) -> layout.Constants:
    payload = arm.payload or Payload(0.0)
    sizes = np.array([len(beam.stiffness) for beam in beams], dtype=np.int64)
    widths = LANES * ((sizes + 6 + LANES - 1) // LANES)
    parts = [shape_integrals(beam) for beam in beams]

    shape = _sparse([part.shape_shape for part in parts], 9, parts)
    cross = _sparse([_axial(part.shape_shape) for part in parts], 3, parts)

    end = np.zeros(LANES)  # for whole groups at the end
    both = list(zip(parts, beams, strict=True))
    stiffness = _packed([*[beam.stiffness for beam in beams], end], 1)
    return layout.Constants(
        elastic_start=np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        square_start=np.concatenate([[0], np.cumsum(sizes**2)]).astype(np.int64),
        gravity=np.array(arm.gravity, dtype=float),
        mount=zero_pose_rotations(arm).ravel(),
        axis=np.array([np.array(li.orientation).T @ jo.axis for li, jo in zip(arm.links, arm.joints, strict=True)]),
        **_joints(arm, choice),
        length=np.array([link.length for link in arm.links]),
        mass=np.array([part.mass for part in parts]),
        first_moment=np.array([part.first_moment for part in parts]),
        second_moment=np.array([part.second_moment for part in parts]).ravel(),
        first_moment_shape=_packed([part.first_moment_shape for part in parts], 3),
        position_shape=_packed([part.position_shape for part in parts], 1),
        shape_start=shape.start,
        shape_source=shape.source,
        shape_value=shape.value,
        cross_start=cross.start,
        cross_source=cross.source,
        cross_value=cross.value,
        factor_start=np.concatenate([[0], np.cumsum(sizes * widths)])[:-1].astype(np.int64),
        factor_width=widths,
        carrying=_carrying(beams, choice.stiffening),
        turning=_carrying(beams, False),
        elastic_mass=_packed([*[part.elastic - _axial_mass(beam, choice.stiffening) for part, beam in both], end], 1),
        stiffness=stiffness,
        damping=arm.stiffness_proportional_damping * stiffness + modal,
        **_stations(beams, choice.stiffening),
        tip_translation=_packed([beam.tip_translation.T for beam in beams], 3),
        tip_rotation=_packed([beam.tip_rotation.T for beam in beams], 3),
        payload_mass=np.array([payload.mass]),
        payload_offset=np.array([payload.offset or (0.0, 0.0, 0.0)]),
        payload_inertia=np.array(payload.inertia or np.zeros((3, 3))).ravel(),
        payload_mount=np.array(arm.links[-1].orientation).T.ravel().copy(),
    )


def _packed(blocks: list[Array], width: int) -> Array:
    """Blocks one after the other, (rows, width), or (rows,) for a width of 1."""
    rows = np.concatenate([np.asarray(block, dtype=float).reshape(-1, width) for block in blocks])
    return np.ascontiguousarray(rows[:, 0] if width == 1 else rows)


def _joints(arm: Arm, choice: ModelChoice) -> dict[str, np.ndarray]:
    """The fields of `layout.Constants` that belong to joints and their rotors."""
    springs = [joint.stiffness is not None and choice.flexible_joints for joint in arm.joints]
    motors = arm.n_joints + np.cumsum(springs) - 1
    names = ("rotor_inertia", "viscous_friction", "coulomb_friction", "coulomb_rate")
    fields = {name: np.array([getattr(joint, name) for joint in arm.joints]) for name in names}
    return fields | {
        "motor": np.where(springs, motors, -1).astype(np.int64),
        "joint_stiffness": np.array([joint.stiffness or 0.0 for joint in arm.joints]),
        "joint_damping": np.array([joint.damping for joint in arm.joints]),
        "carried_inertia": fields["rotor_inertia"] * choice.spinning_rotors,
        "prescribed": np.zeros(arm.n_joints, dtype=np.int64),
    }


class _Sparse(NamedTuple):
    """The entries [b, a, ...] of square blocks, one per link, that do not vanish; see `layout.Constants`."""

    start: np.ndarray
    source: np.ndarray
    value: Array


def _sparse(blocks: list[Array], width: int, parts: list[ShapeIntegrals]) -> _Sparse:
    """Blocks (k, k, ...) with `width` numbers behind each pair of coordinates."""
    offset, counts, sources, values = 0, [np.zeros(1, dtype=np.int64)], [], []
    for block, part in zip(blocks, parts, strict=True):
        k = len(part.elastic)
        entries = block.reshape(k, width * k).T
        size = np.sqrt(np.diag(part.elastic))
        kept = np.abs(entries) > VANISHING * np.outer(np.repeat(size, width), size)
        counts.append(kept.sum(axis=1))
        values.append(entries[kept])
        sources.append(np.nonzero(kept)[1] + offset)
        offset += k
    return _Sparse(
        np.cumsum(np.concatenate(counts), dtype=np.int64),
        np.concatenate(sources).astype(np.int64),
        np.concatenate(values),
    )


def _stations(beams: tuple[Beam, ...], stiffening: bool) -> dict[str, np.ndarray]:
    """The fields of `layout.Constants` for foreshortening."""
    sizes = np.array([len(beam.stiffness) for beam in beams])
    widths = LANES * -(-sizes // LANES)
    counts = np.array([LANES * -(-len(beam.stations) // LANES) for beam in beams]) * (sizes > 0) * stiffening
    start, row, offsets = _starts(counts), _starts(widths * counts), _starts(sizes)
    points, shapes = np.zeros((2, start[-1])), np.zeros((3, row[-1]))
    places, bends = [], []
    for i, beam in enumerate(beams):
        known = min(counts[i], len(beam.stations))
        points[:, start[i] : start[i] + known] = beam.stations[:known].T
        shape = np.zeros((3, counts[i], widths[i]))
        shape[:, :known, : sizes[i]] = np.swapaxes(beam.station_shapes[:known], 0, 1)
        shapes[:, row[i] : row[i + 1]] = shape.reshape(3, -1)
        shape = np.swapaxes(shape, 1, 2)[:, : sizes[i]]
        places.append((shape, np.abs(shape).max(axis=(0, 2), initial=0.0)))
        drawn = np.zeros((sizes[i], sizes[i], counts[i]))
        drawn[:, :, :known] = np.moveaxis(beam.shortening[:known], 0, 2)
        size = np.sqrt(np.diag(beam.shortening[0]))
        bends.append((drawn, np.outer(size, size)))
    result = {"station_start": start, "station_width": widths, "station_row": row[:-1], "station_mass": points[0]}
    result |= {"station_position": points[1], "station_shape": shapes}
    return result | _rows("place", places, offsets) | _rows("bend", bends, offsets)


def _rows(name: str, blocks: list[tuple[Array, Array]], offsets: np.ndarray) -> dict[str, np.ndarray]:
    """Fields start, row, source and value of blocks (rows, k, s), one per link, with their sizes to compare with."""
    counts, starts = [], []
    sources, values = [np.zeros(0, dtype=np.int64)], [np.zeros(0)]
    for (block, size), offset in zip(blocks, offsets, strict=False):
        row, source = np.nonzero(np.abs(block).max(axis=2, initial=0.0) > VANISHING * size)
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
    """(n + 1,) where each of n parts starts in an array of all of them, and its end."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def _axial_mass(beam: Beam, stiffening: bool) -> Array:
    """Part of the elastic mass matrix (k, k) that the kernels add themselves, as it changes with foreshortening."""
    axial = beam.station_shapes[:, 0]
    return np.einsum("s,sa,sb->ab", beam.stations[:, 0], axial, axial) * stiffening


def _carrying(beams: tuple[Beam, ...], stiffening: bool) -> np.ndarray:
    """(n,) index of the first elastic coordinate of each link that moves its tip, counted over all links."""
    offset, first = 0, []
    for beam in beams:
        moves = np.abs(np.vstack([beam.tip_translation, beam.tip_rotation])).max(axis=0, initial=0.0) > 0.0
        moves |= stiffening  # by foreshortening every bending moves the tip
        first.append(offset + (int(np.argmax(moves)) if moves.any() else len(moves)))
        offset += len(moves)
    return np.array(first, dtype=np.int64)


def _axial(tensors: Array) -> Array:
    """(..., 3) sum of a x b from (..., 3, 3) sums of a b^T."""
    turned = tensors - np.swapaxes(tensors, -1, -2)
    return np.stack([turned[..., 1, 2], turned[..., 2, 0], turned[..., 0, 1]], axis=-1)
