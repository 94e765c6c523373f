"""Slopes: derivatives by the coordinates of an arm, as differences over steps of a size that fits each of them."""

from collections.abc import Callable

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.model.element import NODE_COORDINATES
from flexman_gym.model.instant import RICHARDSON
from flexman_gym.model.model import Model

FIRST_STEP = 0.005  # rad, for a first derivative: its truncation is just below rounding


def coordinate_slopes(model: Model, function: Callable[[Array], Array], x: Array) -> Array:
    """Gives slopes (m, d) by the coordinates of a function (m,) of them, by differences extrapolated to order six.

    No step moves a section by more than 0.5 % of its link's length or 0.005 rad.

    Args:
        model: the model.
        function: of coordinates (d,).
        x: (d,) where the slopes are taken.
    """
    size = coordinate_sizes(model)

    def slope(unit: Array) -> Array:
        h = FIRST_STEP
        parts = [
            weight / (2 * k * h) * (function(x + k * h * unit) - function(x - k * h * unit)) for k, weight in RICHARDSON
        ]
        return np.sum(parts, axis=0)

    return np.transpose([slope(unit) for unit in np.diag(size)]) / size


def coordinate_sizes(model: Model) -> Array:
    """Gives the size (d,) of each coordinate that turns a section by 1 rad or moves it by the length of its link."""
    sizes = np.ones(model.n_dof)
    for i, (link, basis) in enumerate(zip(model.arm.links, model.bases, strict=True)):
        moved = np.abs(basis).reshape(len(basis) // NODE_COORDINATES, 2, 3, basis.shape[1])
        largest = np.maximum(moved[:, 0] / link.length, moved[:, 1]).max(axis=(0, 1), initial=0.0)
        sizes[model.elastic_columns(i)] = 1.0 / largest
    return sizes
