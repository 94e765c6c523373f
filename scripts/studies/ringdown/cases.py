"""Ring-down, cases: arms that are let go bent, arms that are hit at the tip, and arms that slew."""

from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.envs.effects.initial_vibration import bent_shape
from flexman_gym.envs.setup import Setup, build
from flexman_gym.model.model import Model, build_model

RELEASE, IMPULSE, SLEW, UNDAMPED, BENT = "release", "impulse", "slew", "release, undamped", "both planes"
DURATION = {RELEASE: 3.0, IMPULSE: 3.0, SLEW: 2.4, UNDAMPED: 3.0, BENT: 3.0}  # s
PERIOD = 0.02  # s, a control period
LARGEST_DEFLECTION, LARGEST_IMPULSE, LARGEST_TORQUE, HOLD = 0.05, 50.0, 300.0, 20  # m, N s, N m, periods
SPREAD, NARROW = np.array([np.pi, 1.5, 2.0]), 0.9  # rad, the range of postures; the latter of BENT


class Cases(NamedTuple):
    """b arms: states (b, 2 d) that they start from, and drives (periods, b, n + 6) as `Batch.step` takes them."""

    states: Array
    drives: Array


@cache
def default_model(undamped: bool = False) -> Model:
    """Builds the model of FlexRRR-v0, without any damping where that is wanted."""
    model = build(Setup()).model
    if not undamped:
        return model
    choice = vars(model.choice)
    return build_model(replace(model.arm, modal_damping_ratio=0.0), **choice)


def cases(kind: str, count: int, seed: int = 0) -> Cases:
    """Draws arms of a kind.

    In a release the tips of all links are let go from 0 to 5 cm in random directions across their beams, bent as a
    force on the tip bends them; in "both planes" up to 5 cm in each, from postures within 0.9 rad. An impulse of 0 to
    50 N s is a force on the tip during the first control period. A slew has random torques up to 300 N m that change
    every 0.4 s. The motors are free in all of them.
    """
    model = default_model(kind == UNDAMPED)
    random, n = np.random.default_rng([seed, list(DURATION).index(kind)]), model.n_joints
    states = model.at_rest(random.uniform(-1.0, 1.0, (count, n)) * (NARROW if kind == BENT else SPREAD))
    drives = np.zeros((round(DURATION[kind] / PERIOD), count, n + 6))
    if kind in (RELEASE, UNDAMPED):
        for link in range(n):
            size, angle = random.uniform(0.0, LARGEST_DEFLECTION, count), random.uniform(0.0, 2.0 * np.pi, count)
            tips = size * np.array([np.cos(angle), np.sin(angle)])
            states[:, model.elastic_columns(link)] = (bent_shape(model, link) @ tips).T
    elif kind == BENT:
        for link in range(n):
            tips = random.uniform(-LARGEST_DEFLECTION, LARGEST_DEFLECTION, (2, count))
            states[:, model.elastic_columns(link)] = (bent_shape(model, link) @ tips).T
    elif kind == IMPULSE:
        way = random.normal(size=(count, 3))
        way *= random.uniform(0.0, LARGEST_IMPULSE, (count, 1)) / np.linalg.norm(way, axis=1, keepdims=True)
        drives[0, :, n : n + 3] = way / PERIOD
    else:
        for first in range(0, len(drives), HOLD):
            drives[first : first + HOLD, :, :n] = LARGEST_TORQUE * random.uniform(-1.0, 1.0, (count, n))
    return Cases(states, drives)
