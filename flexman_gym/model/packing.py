"""Packing: an arm and its reduced beams as the constants that the kernels read."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.kernels import layout
from flexman_gym.kernels.layout import LANES
from flexman_gym.model.beam import Beam, ShapeIntegrals, shape_integrals
from flexman_gym.model.modes import zero_pose_rotations
from flexman_gym.scene.arm import Arm, Payload
from flexman_gym.scene.choice import ModelChoice

VANISHING = 1e-14  # a mass integral this small beside the masses of its two coordinates is a zero with rounding


def packed_constants(arm: Arm, beams: tuple[Beam, ...], modal: Array, choice: ModelChoice) -> layout.Constants:
    """Packs an arm, its reduced beams and its modal damping into the constants that the kernels read."""
    payload = arm.payload or Payload(0.0)
    sizes = np.array([len(beam.stiffness) for beam in beams], dtype=np.int64)
    widths = LANES * ((sizes + 6 + LANES - 1) // LANES)
    parts = [shape_integrals(beam) for beam in beams]

    shape = _sparse([part.shape_shape for part in parts], 9, parts)
    cross = _sparse([_axial(part.shape_shape) for part in parts], 3, parts)

    end = np.zeros(LANES)  # so that groups of lanes may reach past the last row
    both = list(zip(parts, beams, strict=True))
    stiffness = packed([*[beam.stiffness for beam in beams], end], 1)
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
        first_moment_shape=packed([part.first_moment_shape for part in parts], 3),
        position_shape=packed([part.position_shape for part in parts], 1),
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
        elastic_mass=packed([*[part.elastic - _axial_mass(beam, choice.stiffening) for part, beam in both], end], 1),
        stiffness=stiffness,
        damping=arm.stiffness_proportional_damping * stiffness + modal,
        **_stations(beams, choice.stiffening),
        tip_translation=packed([beam.tip_translation.T for beam in beams], 3),
        tip_rotation=packed([beam.tip_rotation.T for beam in beams], 3),
        payload_mass=np.array([payload.mass]),
        payload_offset=np.array([payload.offset or (0.0, 0.0, 0.0)]),
        payload_inertia=np.array(payload.inertia or np.zeros((3, 3))).ravel(),
        payload_mount=np.array(arm.links[-1].orientation).T.ravel().copy(),
    )


def packed(blocks: list[Array], width: int) -> Array:
    """Packs blocks one after the other, (rows, width), or (rows,) for a width of 1."""
    rows = np.concatenate([np.asarray(block, dtype=float).reshape(-1, width) for block in blocks])
    return np.ascontiguousarray(rows[:, 0] if width == 1 else rows)


def _joints(arm: Arm, choice: ModelChoice) -> dict[str, np.ndarray]:
    """Gives the fields of `layout.Constants` that belong to joints and their rotors."""
    springs = [joint.stiffness is not None and choice.flexible_joints for joint in arm.joints]
    motors = arm.n_joints + np.cumsum(springs) - 1
    names = ("rotor_inertia", "viscous_friction", "coulomb_friction", "coulomb_rate")
    fields = {name: np.array([getattr(joint, name) for joint in arm.joints]) for name in names}
    return fields | {
        "motor": np.where(springs, motors, -1).astype(np.int64),
        "joint_stiffness": np.array([joint.stiffness or 0.0 for joint in arm.joints]),
        "joint_damping": np.array([joint.damping for joint in arm.joints]),
        "carried_inertia": fields["rotor_inertia"] * choice.spinning_rotors,
        "rubbing": (fields["coulomb_friction"] > 0.0).astype(np.int64),
        "prescribed": np.zeros(arm.n_joints, dtype=np.int64),
    }


class _Sparse(NamedTuple):
    """The entries [b, a, ...] of square blocks, one per link, that do not vanish; see `layout.Constants`."""

    start: np.ndarray
    source: np.ndarray
    value: Array


def _sparse(blocks: list[Array], width: int, parts: list[ShapeIntegrals]) -> _Sparse:
    """Packs blocks (k, k, ...) with `width` numbers behind each pair of coordinates."""
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
    """Gives the fields of `layout.Constants` for foreshortening."""
    sizes = np.array([len(beam.stiffness) for beam in beams])
    widths = LANES * -(-sizes // LANES)
    counts = np.array([LANES * -(-len(beam.stations) // LANES) for beam in beams]) * (sizes > 0) * stiffening
    start, row, offsets = _starts(counts), _starts(widths * counts), _starts(sizes)
    points, shapes = np.zeros((4, start[-1])), np.zeros((3, row[-1]))
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
    beside = [points[2:, first:last].ravel() for first, last in pairwise(start)]
    result |= {"station_position": points[1], "station_offset": np.concatenate(beside), "station_shape": shapes}
    return result | _rows("place", places, offsets) | _rows("bend", bends, offsets)


def _rows(name: str, blocks: list[tuple[Array, Array]], offsets: np.ndarray) -> dict[str, np.ndarray]:
    """Gives the fields start, row, source and value of blocks (rows, k, s) with their sizes, one per link."""
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
    """Gives the place (n + 1,) where each of n parts starts in an array of all of them, and the end of the last."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def _axial_mass(beam: Beam, stiffening: bool) -> Array:
    """Gives the part (k, k) of the elastic mass matrix that changes with foreshortening; the kernels add it."""
    axial = beam.station_shapes[:, 0]
    return np.einsum("s,sa,sb->ab", beam.stations[:, 0], axial, axial) * stiffening


def _carrying(beams: tuple[Beam, ...], stiffening: bool) -> np.ndarray:
    """Gives the index (n,) of the first elastic coordinate of each link that moves its tip, counted over all links."""
    offset, first = 0, []
    for beam in beams:
        moves = np.abs(np.vstack([beam.tip_translation, beam.tip_rotation])).max(axis=0, initial=0.0) > 0.0
        moves |= stiffening  # by foreshortening every bending moves the tip
        first.append(offset + (int(np.argmax(moves)) if moves.any() else len(moves)))
        offset += len(moves)
    return np.array(first, dtype=np.int64)


def _axial(tensors: Array) -> Array:
    """Gives the sum (..., 3) of a x b from sums (..., 3, 3) of a b^T."""
    turned = tensors - np.swapaxes(tensors, -1, -2)
    return np.stack([turned[..., 1, 2], turned[..., 2, 0], turned[..., 0, 1]], axis=-1)
