"""Ranks: the order in which modes are left out."""

import numpy as np

from flexman_gym.arrays import Array, Vector
from flexman_gym.fidelity.candidates import Candidate
from flexman_gym.model.instant import mass_matrix, stiffness_matrix, tip_jacobian
from flexman_gym.model.model import Model


def tip_parts(model: Model, full: Candidate, states: Array) -> dict[tuple[int, int], float]:
    """Gives how far (m) each mode (link, number) moves the tip in the motion of the reference, ascending.

    A mode that bends turns the free joints the other way, as momentum is kept. The motion of the tip includes this
    turn.

    Args:
        model: of the full candidate.
        full: the candidate that keeps everything.
        states: (T, 2 d) of the reference.
    """
    turns = np.eye(model.n_dof)[:, : model.n_joints]
    turns[model.motor_columns] = np.eye(model.n_joints)
    moves = np.zeros(model.n_dof)
    for state in states[:: max(1, len(states) // 8)]:
        momentum = turns.T @ mass_matrix(model, state)
        moved = np.eye(model.n_dof) - turns @ np.linalg.solve(momentum @ turns, momentum)
        tip = tip_jacobian(model, state[: model.n_dof]) @ moved
        moves = np.maximum(moves, np.linalg.norm(tip, axis=0))
    moves *= np.abs(states[:, : model.n_dof]).max(axis=0)
    parts = {}
    for link, kept in enumerate(full.modes):
        for number, part in zip(kept, moves[model.elastic_columns(link)], strict=True):
            parts[link, number] = float(part)
    return dict(sorted(parts.items(), key=lambda item: item[1]))


def stiffest(model: Model, full: Candidate, angles: Vector) -> list[tuple[int, int]]:
    """Gives the modes (link, number) in an order that lowers the highest frequency of the arm fast.

    Each is the mode with the largest part in the highest vibration of the arm without the modes before it.

    Args:
        model: of the full candidate.
        full: the candidate that keeps everything.
        angles: (n,) rad, of the joints.
    """
    from scipy.linalg import eigh

    mass = mass_matrix(model, model.initial_state(angles))
    stiffness, size = stiffness_matrix(model), np.sqrt(np.diag(mass))
    modes = [(link, number) for link, kept in enumerate(full.modes) for number in kept]
    first, order = model.n_dof - len(modes), []
    left = list(range(model.n_dof))
    while len(left) > first:
        block = np.ix_(left, left)
        shape = eigh(stiffness[block], mass[block])[1][:, -1]
        place = first + int(np.argmax(np.abs(shape * size[left])[first:]))
        order.append(modes[left.pop(place) - first])
    return order
