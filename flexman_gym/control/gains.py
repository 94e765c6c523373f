"""Gains: a table of LQR gains over posture and payload, designed where they are asked for and kept on disk."""

import hashlib
import os
import tempfile
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import numpy as np

from flexman_gym.arrays import Array, Flags, IntArray, grown
from flexman_gym.checks import BROKEN, open_arrays
from flexman_gym.control.discrete import Weights, optimal_gain
from flexman_gym.kernels.cache import find_folder
from flexman_gym.model.linear import SLIDING, linearize
from flexman_gym.model.model import Model
from flexman_gym.model.statics import holding_torques, rest_state
from flexman_gym.simulation.parameters import varied_model

SPACING = 0.17  # rad between postures; with 0.43 the gains between two of them let a folded arm shake
UNSAVED = 50  # designs, of 15 ms each, that a killed process may lose


class GainTable:
    """Gains K (n, 2 d) of the sampled LQR, linear between designs at postures SPACING apart and at some payloads.

    A first joint that turns the arm about the direction of gravity changes nothing and has no axis in the table.

    Args:
        model: of the arm.
        limits: (n,) N m, torque limits.
        period: of control, s.
        weights: of the cost.
        payloads: kg, ascending; one, or several between which the payload is interpolated and beyond which it is not.
    """

    def __init__(self, model: Model, limits: Array, period: float, weights: Weights, payloads: Sequence[float]) -> None:
        self._design = limits, period, weights
        self._payloads = np.array(payloads, dtype=float)
        self._models = [varied_model(model, payload_mass=mass) for mass in payloads]
        somewhere, turn = np.full(model.n_joints, 0.3), np.eye(model.n_joints)[0]
        alike = np.allclose(holding_torques(model, somewhere), holding_torques(model, somewhere + turn))
        self._joints = np.arange(1 if alike else 0, model.n_joints)
        self._rows: dict[tuple[int, ...], int] = {}
        self._rows_of: dict[bytes, list[int]] = {}  # those of the corners of a cell
        self._gains = np.zeros((0, model.n_joints, 2 * model.n_dof))
        self._cells = np.zeros((0, 1 + len(self._joints)), dtype=np.int64)  # of each arm, and the rows of its corners
        self._corners = np.zeros((0, 2 ** (1 + len(self._joints))), dtype=np.int64)
        self._steps = np.array(list(product((0, 1), repeat=1 + len(self._joints))))
        self._path, self._unsaved = self._file(model), 0
        self._load()

    def __call__(self, arms: IntArray, postures: Array, payloads: Array) -> Array:
        """Gives the gains (r, n, 2 d) of the arms (r,) at motor angles (r, n) rad and payloads (r,) kg."""
        places = np.column_stack([self._between(payloads), postures[:, self._joints] / SPACING])
        cells = np.floor(places).astype(np.int64)
        cells[:, 0] = np.minimum(cells[:, 0], max(len(self._payloads) - 2, 0))
        self._find(arms, cells)
        parts = places - cells
        weights = np.ones((len(places), len(self._steps)))
        for axis in range(places.shape[1]):
            part = parts[:, axis, None]
            weights *= np.where(self._steps[:, axis], part, 1.0 - part)
        result = np.zeros((len(places), *self._gains.shape[1:]))
        for corner in range(len(self._steps)):
            result += weights[:, corner, None, None] * self._gains[self._corners[arms, corner]]
        return result

    def _between(self, payloads: Array) -> Array:
        """Where payloads (b,) are among those of the table, from 0 on."""
        if len(self._payloads) == 1:
            return np.zeros(len(payloads))
        return np.interp(payloads, self._payloads, np.arange(len(self._payloads)))

    def _find(self, arms: IntArray, cells: IntArray) -> None:
        """Looks up the corners of the cells (r, axes) of the arms (r,) that have come into another one."""
        count = int(arms.max(initial=-1)) + 1
        if count > len(self._cells):
            far = np.full((count - len(self._cells), cells.shape[1]), np.iinfo(np.int64).min)
            self._cells, self._corners = np.concatenate([self._cells, far]), grown(self._corners, count)
        moved: Flags = (cells != self._cells[arms]).any(axis=1)
        for arm, cell in zip(arms[moved], cells[moved], strict=True):
            key = cell.tobytes()
            if key not in self._rows_of:
                self._rows_of[key] = [self._row(tuple(corner)) for corner in (cell + self._steps).tolist()]
            self._corners[arm] = self._rows_of[key]
        self._cells[arms] = cells

    def _row(self, key: tuple[int, ...]) -> int:
        """The row of a design, which is made where it is missing."""
        key = (min(key[0], len(self._payloads) - 1), *key[1:])
        if key not in self._rows:
            model, posture = self._models[key[0]], np.zeros(self._gains.shape[1])
            posture[self._joints] = SPACING * np.array(key[1:])
            limits, period, weights = self._design
            linear = linearize(model, state=rest_state(model, posture), torque=holding_torques(model, posture))
            gain = optimal_gain(linear, model.motor_columns, limits, weights, period)
            self._rows[key] = len(self._gains)
            self._gains = np.concatenate([self._gains, gain[None]])
            self._unsaved += 1
            if self._unsaved >= UNSAVED:
                self.save()
        return self._rows[key]

    def _file(self, model: Model) -> Path | None:
        """Where designs for this arm are kept, beside the kernels that they were calculated with."""
        folder = find_folder()
        if folder is None:
            return None
        seal = hashlib.sha256(SLIDING.encode())  # designs of motors that stick were kept before
        for values in (*model.constants, *map(np.array, self._design), self._payloads, np.array(SPACING)):
            seal.update(np.ascontiguousarray(values).tobytes())
        return Path(folder) / f"gains-{seal.hexdigest()[:16]}.npz"

    def _load(self) -> None:
        """Takes the designs of the file; one that cannot be read is written anew."""
        try:
            with open_arrays(self._path) as data:  # type: ignore[arg-type]
                keys, gains = data["keys"], data["gains"]
        except BROKEN:
            return
        if gains.shape[1:] == self._gains.shape[1:] and keys.shape == (len(gains), 1 + len(self._joints)):
            self._rows = {tuple(key): row for row, key in enumerate(keys.tolist())}
            self._gains = gains

    def save(self) -> None:
        """Writes the designs to the file, where one can be written."""
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
