"""Accuracy: how far the tip of an environment's default is from that of a finer step and of a finer model."""

import time
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.kernels import layout
from flexman_gym.model.model import Model, build_model
from flexman_gym.simulation.batch import Batch

MOTIONS, DURATION, HELD, SPREAD, PART = 8, 1.0, 0.2, 0.5, 0.5  # s, s, rad, of the torque limits
FINER = 8  # times as many steps


class Accuracy(NamedTuple):
    """Largest distances (m) of the tip in each motion (MOTIONS,) from finer steps and from a finer model, and its cost.

    The finer model has all coordinates of the elements and foreshortening, and the finer steps. Its cost is that of the
    default's step on it, in times that on the default's model.
    """

    steps: Array
    model: Array
    cost: float


def accuracy(name: str, **arguments: Any) -> Accuracy:
    """Moves the arm of a named environment, made with these arguments, by random torques from rest."""
    env = gym.make(name, **arguments).unwrapped
    setup, model, period = env.setup, env.simulator.model, env.simulator.control_period  # type: ignore[attr-defined]
    method, substeps = env.simulator.method, env.simulator.substeps  # type: ignore[attr-defined]
    finest = build_model(setup.arm, **(vars(model.choice) | {"modes": None, "stiffening": True}))
    random, periods = np.random.default_rng(0), round(DURATION / period)
    postures = random.uniform(-SPREAD, SPREAD, (MOTIONS, model.n_joints))
    levels = random.uniform(-PART, PART, (round(DURATION / HELD), MOTIONS, model.n_joints)) * setup.torque_limit
    drives = np.zeros((MOTIONS, periods, model.n_joints + 6))
    drives[:, :, : model.n_joints] = np.repeat(levels, round(HELD / period), axis=0)[:periods].swapaxes(0, 1)

    def tips(of: Model, parts: int) -> tuple[Array, float]:
        batch = Batch(of, method, period / parts, period, arms=MOTIONS)
        batch.reset(np.arange(MOTIONS), of.at_rest(postures))
        batch.roll(drives[:, :1])  # loads what is compiled
        batch.reset(np.arange(MOTIONS), of.at_rest(postures))
        started = time.process_time()
        outputs = batch.roll(drives)[1]
        return outputs[:, :, layout.TIP], time.process_time() - started

    ours, (finer, quick), (finest_tips, slow) = (
        tips(model, substeps)[0], tips(model, FINER * substeps), tips(finest, FINER * substeps),
    )  # fmt: skip
    by_steps, by_model = (np.linalg.norm(each - ours, axis=-1).max(axis=1) for each in (finer, finest_tips))
    return Accuracy(by_steps, by_model, slow / quick)
