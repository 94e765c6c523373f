"""Component modes of the links that the vibration modes of an assembled arm need."""

import numpy as np

from flexman_gym.common.checks import check_solvable
from flexman_gym.model.dynamics import mass_matrix, stiffness_matrix
from flexman_gym.model.model import build_model
from flexman_gym.scene.arm import Arm


def assembled_modes(
    arm: Arm, elements: int | tuple[int, ...] = 2, max_frequency: float = 25.0, energy_fraction: float = 0.02
) -> tuple[int | tuple[int, ...], ...]:
    """Return the component modes of each link, for `build_model`, that contribute to the vibration modes of an arm.

    A component mode is retained if it has more than `energy_fraction` of the elastic energy of a vibration mode of the
    arm (motors free, undamped). All vibration modes up to `max_frequency` are used, at least the lowest three, at zero
    joint angles and with each joint rotated by 0.8 and by 1.6 rad. Unlike `choose_model`, this function simulates
    nothing and estimates no error.

    Args:
        arm: the arm.
        elements: number of finite elements, one for all links or one per link, as in `build_model`.
        max_frequency: largest natural frequency of a vibration mode, Hz.
        energy_fraction: smallest fraction of the elastic energy of a vibration mode, 1.

    Returns:
        For each link, the number of its lowest modes or a tuple of mode numbers, from 0.

    Raises:
        ValueError: if the natural frequencies cannot be computed, for masses or stiffnesses of very different size.
    """
    from scipy.linalg import eigh

    counts = tuple(basis.shape[1] for basis in build_model(arm, elements).bases)
    model = build_model(arm, elements, counts)
    stiffness, n = stiffness_matrix(model), model.n_joints
    rotated = [angle * row for angle in (0.8, 1.6) for row in np.eye(n)]
    fractions = np.zeros(model.n_dof)
    for posture in [np.zeros(n), *rotated]:
        mass = mass_matrix(model, model.initial_state(posture))
        with check_solvable("frequencies"):
            squares, shapes = eigh(stiffness, mass)
            slow = np.sqrt(np.maximum(squares, 0.0)) < 2.0 * np.pi * max_frequency
            slow[: n + 3] = True
            slow[:n] = False  # rigid-body modes about the joints
            energies = shapes[:, slow] ** 2 * np.diag(stiffness)[:, None] / squares[slow]
        fractions = np.maximum(fractions, energies.max(axis=1, initial=0.0))
    links = [fractions[model.elastic_columns(i)] > energy_fraction for i in range(n)]
    return tuple(compact_modes(tuple(np.flatnonzero(retained).tolist())) for retained in links)


def compact_modes(numbers: tuple[int, ...]) -> int | tuple[int, ...]:
    """Return mode numbers in the form of `build_model`: a number m for the m lowest modes, else a tuple."""
    return len(numbers) if numbers == tuple(range(len(numbers))) else numbers
