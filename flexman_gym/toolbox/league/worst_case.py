"""Worst case of an agent: physical parameters, start and goal with the largest final error, by gradient ascent."""

from collections.abc import Callable
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.postures import PostureRanges
from flexman_gym.envs.tasks import Slew
from flexman_gym.evaluation.rollouts import rollout
from flexman_gym.model.model import build_model
from flexman_gym.simulation.physical_parameters import UNCERTAIN
from flexman_gym.toolbox.controllers.observers.perturbed_models import UncertainParameters

STARTS, ASCENTS = 64, 4  # numbers of random points, and of the best of them from which ascents start
STEP = 0.01  # fraction of half a range; step of forward differences, larger than the rounding of actions
LENGTHS = (2.0, 1.0, 0.5, 0.24, 0.12, 0.06, 0.02, 0.006)  # in half ranges; steps tried along a gradient
MIN_INCREASE = 0.005  # dimensionless; relative increase of the objective below which an ascent ends
FINAL_TIME = 1.0  # s; time at the end of an episode over which the error is averaged


def worst_case(agent: str, environment: Configuration, seed: int, starts: int = STARTS) -> dict[str, Any]:
    """Search the parameters, start and goal for which an agent has the largest mean error in the last second.

    They vary within the ranges of the environment. Noise, delays and disturbances are those of one seed.

    Args:
        agent: name of an agent, see `find_agent`.
        environment: the environment.
        seed: seed of the episodes.
        starts: number of random points.

    Returns:
        Final error "error" (m), seed and options of a reset, as JSON-compatible data. A failed episode has an infinite
        error.
    """
    box = Box(environment)
    periods = max(1, round(FINAL_TIME / environment.control_period))

    def final_errors(points: Array) -> Array:
        result = rollout(agent, environment, [seed] * len(points), options=box.options(points))
        failed = np.array([bool(each) for each in result.failures])
        return np.where(failed, np.inf, result.errors[:, -periods:].mean(axis=1))

    points = np.random.default_rng(seed).uniform(-1.0, 1.0, (starts, box.size))
    point, error = ascend(final_errors, points)
    options = {name: values[0].tolist() for name, values in box.options(point[None]).items() if name != "parameters"}
    options["parameters"] = {name: each[0].tolist() for name, each in box.parameters(point[None]).items()}
    return {"error": error if np.isfinite(error) else None, "seed": seed, "options": options}


class Box:
    """Box of the parameters, starts and goals of an environment, with the coordinates -1 to 1.

    Args:
        environment: the environment.

    Attributes:
        size: number k of coordinates.
    """

    def __init__(self, environment: Configuration) -> None:
        ranges = {name: span for name, span in environment.randomised_ranges.items() if name in UNCERTAIN}
        self._model = build_model(environment.arm, 1, flexible_links=False)
        self._uncertain = UncertainParameters(self._model, ranges)
        self._task = environment.task if isinstance(environment.task, Slew) else None
        self.size = len(self._uncertain.names) + (0 if self._task is None else 2 * self._model.n_joints)

    def parameters(self, points: Array) -> dict[str, Array]:
        """Return the physical parameters (b, ...) of points (b, k) by name."""
        uncertain = self._uncertain
        scaled = points[:, : len(uncertain.names)] * np.sqrt(3.0) * uncertain.deviation  # half the width of a range
        return uncertain.values(self._model, uncertain.mean + scaled)

    def options(self, points: Array) -> dict[str, Any]:
        """Return the options of a reset for points (b, k)."""
        options: dict[str, Any] = {"parameters": self.parameters(points)}
        if self._task is not None:
            start, slew = np.split(points[:, len(self._uncertain.names) :], 2, axis=1)
            ranges = PostureRanges.of(self._model.arm)
            options["start"] = ranges.home + ranges.start_span(self._task.start) * start
            low, high = ranges.change_bounds(options["start"], self._task.slew)
            options["goal_angles"] = options["start"] + np.where(slew < 0.0, -low, high) * slew
        return options


def ascend(objective: Callable[[Array], Array], points: Array) -> tuple[Array, float]:
    """Maximise a function > 0 in the box from -1 to 1 by projected gradient ascent from the best of some points.

    Gradients are forward differences. All points of the gradients and of the line searches are evaluated together.

    Args:
        objective: function of points (b, k), with values (b,).
        points: (b, k) points.

    Returns:
        Point (k,) with the largest value found, and its value.
    """
    values = objective(points)
    best = np.argsort(-values)[:ASCENTS]
    points, values = points[best], values[best]
    rising = np.flatnonzero(np.isfinite(values))
    while len(rising):
        now = points[rising]
        inward = np.where(now > 0.0, -STEP, STEP)
        near = _evaluate(objective, now[:, None] + inward[:, :, None] * np.eye(now.shape[1]))
        gradient = np.nan_to_num((near - values[rising, None]) / inward)
        gradient[(np.abs(now) >= 1.0) & (gradient * now > 0.0)] = 0.0
        gradient /= np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-300)
        tried = np.clip(now[:, None] + np.array(LENGTHS)[:, None] * gradient[:, None], -1.0, 1.0)
        found = _evaluate(objective, tried)
        each, chosen = np.arange(len(now)), found.argmax(axis=1)
        better = found[each, chosen] > (1.0 + MIN_INCREASE) * values[rising]
        points[rising[better]] = tried[each, chosen][better]
        values[rising[better]] = found[each, chosen][better]
        rising = rising[better & np.isfinite(found[each, chosen])]
    return points[values.argmax()], float(values.max())


def _evaluate(objective: Callable[[Array], Array], points: Array) -> Array:
    """Return the values (r, b) of points (r, b, k)."""
    return objective(points.reshape(-1, points.shape[2])).reshape(points.shape[:2])
