"""Component modes of a clamped link with the inertia of the outboard arm at its tip.

Component modes are retained in the order of their frequencies. The torsion modes of the bare link have high
frequencies, although its torsion moves the whole outboard arm. Loaded modes therefore include the inertia of the rigid
outboard arm, at zero joint angles, at the tip of the link.
"""

from typing import NamedTuple, Self

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.errors import value_error
from flexman_gym.model.beam import Beam

NEGLIGIBLE = 1e-12  # off-diagonal entry / geometric mean of its diagonal entries, below which it is a rounded zero


class LoadedModes(NamedTuple):
    """Modes of a clamped link with a rigid inertia at its tip.

    Attributes:
        frequencies: (k,) angular frequencies, rad/s, ascending.
        shapes: (k, k) shapes as columns, normalised to unit modal mass, including the inertia at the tip.
    """

    frequencies: Array
    shapes: Array

    @classmethod
    def of(cls, beam: Beam, outboard: Array) -> Self:
        """Return the modes of a link.

        The eigenvalue problem is solved for each uncoupled group of coordinates, because two bending modes of equal
        frequency could otherwise lie in any two planes. Modes along y and z have more mass integrals equal to zero.

        Args:
            beam: the link, with k elastic coordinates.
            outboard: (6, 6) spatial inertia at its tip, linear part first; units as in `outboard_inertias`.
        """
        from scipy.linalg import eigh  # slow import, which most uses of the package do not need

        tip = np.vstack([beam.tip_translation, beam.tip_rotation])
        mass, stiffness = beam.mass_matrix + tip.T @ outboard @ tip, beam.stiffness
        frequencies, shapes, count = np.zeros(len(mass)), np.zeros_like(mass), 0
        for group in _uncoupled_groups(mass, stiffness):
            block, columns = np.ix_(group, group), slice(count, count + len(group))
            try:
                squares, shapes[group, columns] = eigh(stiffness[block], mass[block])
                if not (squares > 0.0).all():  # negative only by rounding, as the link is clamped
                    raise np.linalg.LinAlgError
            except (np.linalg.LinAlgError, ValueError):
                allowed = "links and loads whose masses are within fifteen digits of each other"
                raise value_error("arm", "this one", allowed) from None
            frequencies[columns] = np.sqrt(squares)
            count += len(group)
        # rounding must not determine the order of two equal frequencies
        order = np.argsort([float(f"{frequency:.9g}") for frequency in frequencies], kind="stable")
        return cls(frequencies[order], shapes[:, order])

    def basis(self, modes: int | tuple[int, ...] | None, field: str) -> Array:
        """Return the node coordinates (size, k) of the link per unit of each retained coordinate.

        Args:
            modes: number of retained modes, or a tuple of their indices; None retains all coordinates.
            field: name of the argument, for errors.
        """
        size = len(self.shapes)
        if modes is None:
            return np.eye(size)
        count = f"{size}, the elastic coordinates of this link's elements"
        if isinstance(modes, int) and modes > size:
            raise value_error(field, modes, f"at most {count}")
        if isinstance(modes, tuple) and modes[-1] >= size:
            raise value_error(field, modes, f"mode numbers below {count}")
        return self.shapes[:, range(modes) if isinstance(modes, int) else modes]

    def damping(self, stiffness: Array, ratio: float) -> Array:
        """Return the damping matrix (k, k) of a link by one damping ratio of all modes, from its stiffness matrix."""
        # K shapes / frequencies^2 = M shapes with the loaded mass matrix M; its transpose is the inverse of the shapes
        inverse = stiffness @ self.shapes / self.frequencies**2
        return 2.0 * ratio * inverse * self.frequencies @ inverse.T


def _uncoupled_groups(*matrices: Array) -> list[np.ndarray]:
    """Return groups of coordinates without coupling between different groups: the connected components.

    The matrices (k, k) are symmetric and positive definite.
    """
    coupled = np.zeros(matrices[0].shape, dtype=bool)
    for matrix in matrices:
        size = np.sqrt(np.diag(matrix))
        coupled |= np.abs(matrix) > NEGLIGIBLE * np.outer(size, size)
    group, previous = np.arange(len(coupled)), np.full(len(coupled), -1)
    while not np.array_equal(group, previous):  # the lowest index of a group spreads over the group
        previous, group = group, np.where(coupled, group, len(group)).min(axis=1, initial=len(group))
    return [np.flatnonzero(group == number) for number in np.unique(group)]
