"""Worst case: ascent in a box, and an episode that is worse than random ones."""

import numpy as np
import pytest

from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.rollouts import rollout
from flexman_gym.toolbox.league import worst_case


def test_ascent_ends_in_the_corner_of_a_monotonic_function_and_at_an_interior_maximum():
    slope, centre = np.array([3.0, -1.0, 0.5]), np.array([0.3, -0.6, 0.1])
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (8, 3))
    point, value = worst_case.ascend(lambda x: np.exp(x @ slope), points)
    assert point.tolist() == [1.0, -1.0, 1.0] and value == pytest.approx(np.exp(4.5))
    point, value = worst_case.ascend(lambda x: np.exp(-5.0 * ((x - centre) ** 2).sum(axis=1)), points)
    assert np.abs(point - centre).max() < 0.1 and 0.97 < value <= 1.0


def test_the_worst_case_is_an_episode_within_the_ranges_and_worse_than_random_ones():
    environment = Configuration("FlexOne-v0", {"horizon": 2.0, "randomisation": {"payload_mass": [0.0, 0.2]}})
    found, periods = worst_case.worst_case("pd", environment, 7, starts=16), round(1.0 / environment.control_period)
    options, task = found["options"], environment.task
    start, goal = np.array(options["start"]), np.array(options["goal_angles"])
    assert np.abs(start).max() <= task.start and np.abs(goal - start).max() <= task.slew * (1.0 + 1e-12)
    assert 0.0 <= options["parameters"]["payload_mass"] <= 0.2
    again = rollout("pd", environment, [7], options=options).errors[0, -periods:].mean()
    assert again == pytest.approx(found["error"], rel=1e-6)
    random = rollout("pd", environment, range(32)).errors[:, -periods:].mean(axis=1)
    assert found["error"] > 1.001 * random.max()
