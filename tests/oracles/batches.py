"""Batches: states and drives of many arms, for tests of what moves them side by side."""

import numpy as np


def states_of(model, arms, seed=0):
    """Arms that turn, bend a little and vibrate, the rotors with them."""
    random = np.random.default_rng(seed)
    states = 1e-3 * random.normal(size=(arms, 2 * model.n_dof))
    turned = random.uniform(-1.0, 1.0, (arms, model.n_joints))
    states[:, : model.n_joints] += turned
    states[:, model.motor_columns] += turned
    return states


def drives(arms, steps, seed=1):
    """Torques, tip forces and accelerations of the base, (steps, b, n + 6)."""
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (steps, arms, 9)) * ([400.0] * 3 + [20.0] * 3 + [1.0] * 3)
