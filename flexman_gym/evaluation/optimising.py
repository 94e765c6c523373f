"""Optimising: the quickest slews of an environment's episodes, searched for and replayed in it."""

import time
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import refusal
from flexman_gym.control.lqr import LQR
from flexman_gym.control.optimised import Optimised
from flexman_gym.control.shooting import Shooting
from flexman_gym.control.slew_table import SlewTable, numbers_of
from flexman_gym.envs.description import Description
from flexman_gym.envs.setup import build
from flexman_gym.evaluation.figures import FIGURES
from flexman_gym.evaluation.rollout import rollout
from flexman_gym.simulation.batch import Batch

SETTLING = FIGURES["settling_time"]


class Found(NamedTuple):
    """Settling times (s) of the slew of an episode and of the tracking LQR, and CPU seconds of the search."""

    seed: int
    time: float
    tracking: float
    seconds: float


def empty_table(environment: Description) -> SlewTable:
    """Gives a table without slews, which says what it is for."""
    setup = environment.setup()
    model, method, step, _ = build(setup)
    about = {
        "environment": environment.whole(),
        "model": f"{model.n_dof} coordinates, method {getattr(method, 'name', method)}, step {step:.9g} s",
    }
    return SlewTable(about, numbers_of(model, np.array(setup.torque_limit), setup.control_period))


def optimise(environment: Description, seeds: Sequence[int], table: SlewTable) -> Iterator[Found]:
    """Puts the slews of the episodes that a table does not have yet into it, and tells of each.

    A slew counts with the settling time of its replay in the environment.

    Args:
        environment: whose slews are optimised; its arms must be the model.
        seeds: of the episodes.
        table: of this arm.

    Raises:
        ValueError: one line, for an environment that disturbs its arms or moves its goals, and for a table of another.
    """
    setup, left = environment.setup(), [seed for seed in seeds if seed not in table.found]
    if setup.task.moves or setup.disturbed is not None:
        raise refusal("environment", environment.id, "one whose goals stay, with no randomisation and no disturbance")
    if table.about.get("environment") != environment.whole():
        raise refusal("table", table.about.get("environment"), "a table of this environment, or a new file")
    model, method, step, _ = build(setup)
    regulator = LQR(model, setup.torque_limit, setup.control_period)
    player = Optimised(table, model, setup.torque_limit, setup.control_period)

    def arms(count: int) -> Batch:
        return Batch(model, method, step, setup.control_period, arms=count)

    draws: list[Array] = []
    tracked = rollout("lqr-tracking", environment, left, lambda episodes: _keep(draws, episodes.view.plan))
    for seed, ends, record in zip(left, draws, tracked.records, strict=True):
        begun = time.process_time()
        slew = Shooting(regulator, arms, record.band, setup.limits.rate, *ends).search()
        seconds, reached = time.process_time() - begun, np.inf
        if slew is not None:
            table.found[seed] = ends, slew, reached
            reached = SETTLING.sum_up(rollout(player, environment, [seed]).records)
            table.found[seed] = ends, slew, reached
        yield Found(seed, reached, SETTLING.sum_up([record]), seconds)


def _keep(draws: list[Array], plan: Mapping[str, Array]) -> None:
    """Keeps starts and goals (2, n) rad of the first episodes."""
    if not draws:
        draws += list(np.stack([plan["start"], plan["goal_angles"]], axis=1))
