"""Figures: numbers of an episode are those of the metrics, and of many episodes means, medians and shares."""

from dataclasses import replace

import numpy as np
import pytest

from flexman_gym.evaluation import FIGURES, Record, evaluate, rollout

from oracles.records import record


def of(*records):
    """Every figure of some episodes together."""
    return {name: figure.sum_up(records) for name, figure in FIGURES.items()}


def test_figures_are_those_of_the_metrics():
    time = 0.02 * np.arange(501)
    tips = np.zeros((501, 3))
    tips[:, 1] = 0.03 * np.cos(2 * np.pi * time)  # whole periods in 3 s
    errors = np.where(time < 3.99, 1.0, 0.01)
    actions = 0.5 * np.where(np.arange(500) % 2, -1.0, 1.0)[:, None] * np.ones(3)
    result = of(Record(tips, errors, actions, np.full(500, 0.5), "", 0.02, 0.02))
    assert (result["reward"], result["error"], result["effort"], result["failed"]) == (250.0, 0.01, 0.25, 0.0)
    assert result["settling_time"] == pytest.approx(4.0) and result["vibration"] == pytest.approx(0.06, rel=1e-9)
    assert result["roughness"] == pytest.approx(1.0), "from 0.5 to -0.5 and back in every period"


def test_the_error_at_the_end_is_the_median_of_its_last_second():
    """Neither the last sample nor what was before."""
    errors = np.concatenate([np.full(450, 1.0), np.full(50, 0.01), [0.5]])
    made = Record(np.zeros((501, 3)), errors, np.zeros((500, 1)), np.zeros(500), "", 0.02, 0.02)
    assert FIGURES["error"].of(made) == 0.01


def test_rms_error_is_over_the_whole_episode():
    made = Record(np.zeros((3, 3)), np.array([0.3, 0.4, 0.0]), np.zeros((2, 3)), np.zeros(2), "", 0.02, 0.01)
    assert FIGURES["rms_error"].of(made) == pytest.approx(np.sqrt(0.25 / 3.0))


def test_shares_are_parts_of_all_and_a_failure_never_settles():
    made = [record(settled=time, failure="" if time < 2 else "rate") for time in (1.0, np.inf, 3.0, np.inf)]
    result = of(*made)
    assert (result["settled"], result["failed"]) == (0.25, 0.75)
    assert result["settling_time"] == result["vibration"] == np.inf


def test_reward_effort_and_roughness_are_means():
    """Of episodes whose medians are others."""
    result = of(*(record(reward=reward, effort=effort) for reward, effort in ((0, 0.1), (1, 0.2), (11, 0.9))))
    assert (result["reward"], result["effort"]) == pytest.approx((4.0, 0.4))


def test_evaluate_is_every_figure_of_a_rollout():
    result, records = evaluate("pd", "FlexOne-v0", [1, 2, 3]), rollout("pd", "FlexOne-v0", [1, 2, 3]).records
    assert result == of(*records) and set(result) >= {"settled", "settling_time", "vibration", "error", "roughness"}


def test_of_many_episodes_a_median_is_that_of_the_upper_middle_and_a_mean_the_mean():
    records = [
        replace(record(), rewards=np.array([value]), errors=np.full(501, value)) for value in (1.0, 2.0, 4.0, 9.0)
    ]
    assert FIGURES["reward"].sum_up(records) == 4.0 and FIGURES["error"].sum_up(records) == pytest.approx(4.0)
    assert FIGURES["error"].sum_up(records[:3]) == pytest.approx(2.0)


@pytest.mark.parametrize("name", FIGURES)
def test_every_figure_says_what_is_better(name):
    """A calm episode that settles is better in every figure than a rough one that fails."""
    good, bad = record(), record(0.0, np.inf, 1.0, 0.5, 0.9, "rate")
    bad = replace(bad, actions=bad.actions * np.where(np.arange(500) % 2, -1.0, 1.0)[:, None])
    one, other = FIGURES[name].of(good), FIGURES[name].of(bad)
    assert one > other if FIGURES[name].better == "high" else one < other
