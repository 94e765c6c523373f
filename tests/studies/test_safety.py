"""Tests of the study of the safety filter: bound of the rate, limits of cells, agents, and the filter it measures."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_agents.sb3 import make_model
from flexman_agents.settings import find_recipe
from studies.safety.learning import KINDS, RECIPE, ViolationCount, task
from studies.safety.measure import (
    ACCEPTED,
    FIELDS,
    HALF_SPACE,
    HEIGHT,
    RATE,
    STUDY,
    Cell,
    TorquesAlongRates,
    environment,
    filtered,
    measure,
    options,
    violation_bound,
)


@pytest.mark.parametrize("moves", [20, 2000])
def test_without_violations_the_bound_is_that_of_the_closed_form(moves):
    """(1 - rate)^moves = 5 %; about 3 / moves."""
    assert violation_bound(0, moves) == pytest.approx(1.0 - 0.05 ** (1.0 / moves))
    assert violation_bound(moves, moves) == 1.0
    found = violation_bound(1, moves)
    assert (1.0 - found) ** moves + moves * found * (1.0 - found) ** (moves - 1) == pytest.approx(0.05)


def test_cells_have_their_limits():
    strict, wide = (environment(Cell("nominal", "pd", STUDY, 1), value).limits for value in (0.5, 1.0))
    assert np.allclose(2.0 * np.array(strict.strain), wide.strain)
    assert environment(Cell("uncertain", "pd", RATE, 1), 2.0).limits.margin == {"rate": fm.Limits.rate - 2.0}
    (region,) = environment(Cell("nominal", "pd", HALF_SPACE, 1), HEIGHT).limits.workspace
    assert region == {"half_space": ((0.0, 0.0, 1.0), HEIGHT)}


def test_goals_beyond_the_half_space_violate_it_without_the_filter_only():
    cell = Cell("nominal", "lqr-tracking", HALF_SPACE, 6)
    seeds = list(range(5000, 5000 + cell.moves))
    assert options(cell, seeds)["goal_angles"].shape == (6, 3)
    found = dict(zip(FIELDS, measure(cell, HEIGHT, seeds), strict=True))
    assert (found["free_excess"] > ACCEPTED).any() and found["excess"].max() < 0.0
    assert ((found["changed"] + found["stopped"] > 0.0) >= (found["free_excess"] > 0.0)).all()
    assert (found["change"] > 0.0).any()


def test_a_stop_is_predicted_until_slow_beats_of_a_folded_arm_have_passed():
    """Intervals of 0.25 s from 1.3 s on miss a peak of the strain, 15 % beyond its limit."""
    moves, counts, _ = filtered(Cell("nominal", "along the rates", STUDY, 1), 0.6, [9010])
    assert moves.excess.max() < ACCEPTED and counts.sum() > 250


def test_the_agent_along_the_rates_feeds_energy():
    rates = np.array([[1.0, -2.0, 0.0]])
    assert (TorquesAlongRates().act({"motor_rates": rates}, rates, np.array([True])) * rates >= 0.0).all()


def test_a_violating_episode_of_a_training_is_counted_once():
    class Arms:
        over, excess = np.array([False, False]), np.array([0.1, 0.0])

    count = ViolationCount(Arms)
    count()
    Arms.over, Arms.excess = np.array([True, True]), np.zeros(2)
    for _ in range(2):
        count()
    assert (count.ended, count.violating) == (4, 1)


def test_the_recipe_is_the_training_inside_the_filter_and_its_first_update_runs_without_a_violation():
    settings = replace(find_recipe(RECIPE), steps=1024)
    safety, on_violation = KINDS["inside"]
    limits = settings.environment.limits
    assert settings.environment.replace(limits=limits) == task(on_violation).replace(safety=safety)
    assert not task("end").safety and task("end").limits.on_violation == "end"
    model = make_model(settings)
    episodes = model.get_env().get_attr("episodes")[0]
    excess = []
    episodes.callback = lambda: excess.append(episodes.excess.max())
    model.learn(settings.steps)
    assert model._n_updates == settings.hyperparameters["n_epochs"]
    assert len(excess) == 5 * settings.steps // settings.envs and max(excess) < 0.0
    assert (episodes.safety.status >= 0).all()
