"""Gain tables: gains of the sampled LQR on a grid of postures and payloads, or along the path of each arm."""

import hashlib
import os
import tempfile
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray, IntArray, pad_rows, row_dots
from flexman_gym.common.files import READ_ERRORS, open_arrays
from flexman_gym.kernels.cache import find_cache_folder
from flexman_gym.model.friction import frictionless
from flexman_gym.model.linearization import SLIDING
from flexman_gym.model.model import Model
from flexman_gym.model.statics import first_angle_is_free
from flexman_gym.simulation.physical_parameters import varied_model
from flexman_gym.toolbox.controllers.cost_weights import CostWeights, posture_gain

POSTURE_SPACING = 0.17  # rad; distance of postures in the table; with 0.43 rad a folded arm oscillates
SAVE_INTERVAL = 50  # number of new designs (15 ms each) between two writes of the file
GRID_JOINTS = 4  # largest number of joints of a grid, with 2^(1 + joints) gains at the corners of a cell
MAX_STORED = 1000  # number of gains along paths in the memory
MIN_SQUARED_LENGTH = 1e-12  # rad^2; avoids division by zero for a path that stands still
# Payloads for which gains are designed, fractions of the range. Light payloads change the inertia of a light arm by the
# largest factor: with 0, 1/2 and 1, gains interpolated for a twentieth of the range make such an arm oscillate.
PAYLOAD_NODES = (0.0, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0)


def spread(payloads: Sequence[float]) -> tuple[float, ...]:
    """Return the payloads for which gains are designed, over the range of given payloads, kg; one for a single one."""
    low, high = payloads[0], payloads[-1]
    return tuple(low + part * (high - low) for part in PAYLOAD_NODES) if high > low else (low,)


class GainDesigns:
    """Gains K (n, 2 d) of the sampled LQR without friction, for p payloads.

    Args:
        model: model of the arm.
        limits: torque limits (n,), N m.
        period: control period, s.
        weights: cost weights.
        payloads: (p,) payloads, kg, ascending.
    """

    def __init__(
        self, model: Model, limits: Array, period: float, weights: CostWeights, payloads: Sequence[float]
    ) -> None:
        model = frictionless(model)
        self.model, self.payloads = model, np.array(payloads, dtype=float)
        self.models = [varied_model(model, payload_mass=mass) for mass in payloads]
        self._limits, self._period, self._weights = limits, period, weights

    def gain(self, node: int, posture: Array) -> Array:
        """Return the gain (n, 2 d) for the payload with an index, at motor angles (n,) rad."""
        return posture_gain(self.models[node], posture, self._weights, self._limits, self._period)

    def places(self, payloads: Array) -> tuple[IntArray, Array]:
        """Return the index (r,) of the node below payloads (r,) kg, and the part (r,) of the way to the next node."""
        count = len(self.payloads)
        place = np.interp(payloads, self.payloads, np.arange(count)) if count > 1 else np.zeros(len(payloads))
        low = np.minimum(np.floor(place).astype(np.int64), max(count - 2, 0))
        return low, place - low

    def seal(self) -> str:
        """Return a digest of everything that determines the gains."""
        seal = hashlib.sha256(SLIDING.encode())  # separates files of versions that linearised about sticking motors
        design = self._limits, np.array(self._period), np.hstack(self._weights), np.array(type(self._weights).__name__)
        for values in (*self.model.constants, *design, self.payloads):
            seal.update(np.ascontiguousarray(values).tobytes())
        return seal.hexdigest()[:16]


class GainTable:
    """Gains K (n, 2 d) of the sampled LQR without friction, interpolated on a grid of postures and payloads.

    Interpolation is multilinear, with postures `POSTURE_SPACING` apart. The angle of a first joint whose axis is
    parallel to gravity does not affect the gains and is no coordinate of the grid.

    Args:
        designs: gains for each payload; other payloads are clipped to their range.
    """

    def __init__(self, designs: GainDesigns) -> None:
        self._designs, model = designs, designs.model
        self._joints = np.arange(1 if first_angle_is_free(model) else 0, model.n_joints)
        self._rows: dict[tuple[int, ...], int] = {}  # grid point -> row of its gain
        self._corner_rows: dict[bytes, list[int]] = {}  # cell -> rows of the gains at its corners
        self._gains = np.zeros((0, model.n_joints, 2 * model.n_dof))
        self._cells = np.zeros((0, 1 + len(self._joints)), dtype=np.int64)  # present cell of each arm
        self._corners = np.zeros((0, 2 ** (1 + len(self._joints))), dtype=np.int64)
        self._steps = np.array(list(product((0, 1), repeat=1 + len(self._joints))))
        self._path, self._unsaved = self._file(), 0
        self._load()

    def __call__(self, arms: IntArray, postures: Array, payloads: Array) -> Array:
        """Return the gains (r, n, 2 d) of the arms (r,) at motor angles (r, n) rad and payloads (r,) kg."""
        low, part = self._designs.places(payloads)
        positions = postures[:, self._joints] / POSTURE_SPACING
        cells = np.column_stack([low, np.floor(positions).astype(np.int64)])
        self._find(arms, cells)
        parts = np.column_stack([part, positions - cells[:, 1:]])
        weights = np.ones((len(parts), len(self._steps)))
        for axis in range(parts.shape[1]):
            part = parts[:, axis, None]
            weights *= np.where(self._steps[:, axis], part, 1.0 - part)
        result = np.zeros((len(parts), *self._gains.shape[1:]))
        for corner in range(len(self._steps)):
            result += weights[:, corner, None, None] * self._gains[self._corners[arms, corner]]
        return result

    def _find(self, arms: IntArray, cells: IntArray) -> None:
        """Update the corner gains of the arms (r,) whose grid cell changed to the cell given in `cells` (r, axes)."""
        count = int(arms.max(initial=-1)) + 1
        if count > len(self._cells):
            outside = np.full((count - len(self._cells), cells.shape[1]), np.iinfo(np.int64).min)
            self._cells, self._corners = np.concatenate([self._cells, outside]), pad_rows(self._corners, count)
        moved: BoolArray = (cells != self._cells[arms]).any(axis=1)
        for arm, cell in zip(arms[moved], cells[moved], strict=True):
            key = cell.tobytes()
            if key not in self._corner_rows:
                self._corner_rows[key] = [self._row(tuple(corner)) for corner in (cell + self._steps).tolist()]
            self._corners[arm] = self._corner_rows[key]
        self._cells[arms] = cells

    def _row(self, key: tuple[int, ...]) -> int:
        """Return the row of the gain at a grid point; a missing gain is computed."""
        key = (min(key[0], len(self._designs.payloads) - 1), *key[1:])
        if key not in self._rows:
            posture = np.zeros(self._gains.shape[1])
            posture[self._joints] = POSTURE_SPACING * np.array(key[1:])
            gain = self._designs.gain(key[0], posture)
            self._rows[key] = len(self._gains)
            self._gains = np.concatenate([self._gains, gain[None]])
            self._unsaved += 1
            if self._unsaved >= SAVE_INTERVAL:
                self.save()
        return self._rows[key]

    def at(self, posture: Array, payload: Array) -> Array:
        """Return the gain (n, 2 d) at motor angles (n,) rad and a payload (1,) kg."""
        result: Array = self(np.zeros(1, dtype=np.int64), posture[None], payload)[0]
        return result

    def _file(self) -> Path | None:
        """Return the path of the file with the gains of this arm, in the cache folder of the kernels, or None."""
        folder = find_cache_folder()
        return None if folder is None else Path(folder) / f"gains-{self._designs.seal()}-{POSTURE_SPACING}.npz"

    def _load(self) -> None:
        """Read the gains from the file; an unreadable file is replaced by the next `save`."""
        try:
            with open_arrays(self._path) as data:  # type: ignore[arg-type]
                keys, gains = data["keys"], data["gains"]
        except READ_ERRORS:
            return
        if gains.shape[1:] == self._gains.shape[1:] and keys.shape == (len(gains), 1 + len(self._joints)):
            self._rows = {tuple(key): row for row, key in enumerate(keys.tolist())}
            self._gains = gains

    def save(self) -> None:
        """Write new gains to the file; a file that cannot be written is omitted."""
        if self._path is None or not self._unsaved:
            return
        handle, name = tempfile.mkstemp(dir=self._path.parent, suffix=".npz")
        try:
            with os.fdopen(handle, "wb") as file:
                np.savez(file, keys=np.array(list(self._rows)), gains=self._gains)
            os.replace(name, self._path)
        except OSError:
            Path(name).unlink(missing_ok=True)
        self._unsaved = 0


class PathGains:
    """Gains K (n, 2 d) of the sampled LQR without friction, interpolated along the path of each arm and by payload.

    A grid of postures has 2^n corners a cell; the postures of a path are few for any number of joints. An arm beside
    its path has the gain of the nearest point of the path.

    Args:
        designs: gains for each payload; other payloads are clipped to their range.
        route: function of the index of an arm that returns postures (g, n) along its path, rad.
    """

    def __init__(self, designs: GainDesigns, route: Callable[[int], Array]) -> None:
        self._designs, self._route = designs, route
        self._gains: dict[tuple[int, bytes], Array] = {}

    def __call__(self, arms: IntArray, postures: Array, payloads: Array) -> Array:
        """Return the gains (r, n, 2 d) of the arms (r,) at motor angles (r, n) rad and payloads (r,) kg."""
        nodes, parts = self._designs.places(payloads)
        each = zip(arms.tolist(), postures, nodes.tolist(), parts, strict=True)
        return np.array([self._along(self._route(arm), posture, node, part) for arm, posture, node, part in each])

    def at(self, posture: Array, payload: Array) -> Array:
        """Return the gain (n, 2 d) at motor angles (n,) rad and a payload (1,) kg."""
        (node,), (part,) = self._designs.places(payload)
        return self._along(posture[None], posture, int(node), part)

    def _along(self, route: Array, posture: Array, node: int, part: float) -> Array:
        """Return the gain at the point of a route (g, n) nearest to a posture (n,), between two payload nodes."""
        place = _nearest(route, posture)
        low = min(int(place), max(len(route) - 2, 0))
        result = self._between(route[low], node, part)
        if place > low:
            result = result + (place - low) * (self._between(route[low + 1], node, part) - result)
        return result

    def _between(self, posture: Array, node: int, part: float) -> Array:
        """Return the gain at a posture (n,) of a route, between a payload node and the next."""
        result = self._stored(node, posture)
        return result + part * (self._stored(node + 1, posture) - result) if part > 0.0 else result

    def _stored(self, node: int, posture: Array) -> Array:
        """Return the gain of a payload node at a posture (n,); a missing gain is computed."""
        key = node, posture.tobytes()
        if key not in self._gains:
            if len(self._gains) >= MAX_STORED:
                self._gains.clear()
            self._gains[key] = self._designs.gain(node, posture)
        return self._gains[key]

    def save(self) -> None:
        """Write nothing: the paths of another session are other ones."""


def _nearest(route: Array, posture: Array) -> float:
    """Return the position, from 0 to g - 1, of the point nearest to a posture (n,) on a polygon of postures (g, n)."""
    if len(route) < 2:
        return 0.0
    sides, offsets = np.diff(route, axis=0), posture - route[:-1]
    parts = np.clip(row_dots(sides, offsets) / np.maximum(row_dots(sides, sides), MIN_SQUARED_LENGTH), 0.0, 1.0)
    gaps = offsets - parts[:, None] * sides
    side = int(row_dots(gaps, gaps).argmin())
    return side + float(parts[side])


def make_gains(designs: GainDesigns, route: Callable[[int], Array]) -> GainTable | PathGains:
    """Return the gains on a grid of postures, or along paths for an arm with more than GRID_JOINTS joints."""
    return GainTable(designs) if designs.model.n_joints <= GRID_JOINTS else PathGains(designs, route)
