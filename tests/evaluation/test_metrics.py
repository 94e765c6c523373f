"""Figures: numbers of an episode are those of the metrics, and of many episodes means, medians and shares."""

import re
from dataclasses import replace

import numpy as np
import pytest

from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.metrics import METRICS, evaluate
from flexman_gym.evaluation.rollouts import EpisodeRecord, rollout
from flexman_gym.evaluation.tables import metrics_table

from oracles.records import record


def of(*records):
    """Every figure of some episodes together."""
    return {name: metric.evaluate(records) for name, metric in METRICS.items()}


def test_figures_are_those_of_the_metrics():
    time = 0.02 * np.arange(501)
    tips = np.zeros((501, 3))
    tips[:, 1] = 0.03 * np.cos(2 * np.pi * time)  # whole periods in 3 s
    errors = np.where(time < 3.99, 1.0, 0.01)
    actions = 0.5 * np.where(np.arange(500) % 2, -1.0, 1.0)[:, None] * np.ones(3)
    result = of(EpisodeRecord(tips, errors, actions, np.full(500, 0.5), "", 0.02, 0.02))
    assert (result["reward"], result["error"], result["effort"], result["failed"]) == (250.0, 0.01, 0.25, 0.0)
    assert result["settling_time"] == pytest.approx(4.0) and result["vibration"] == pytest.approx(0.06, rel=1e-9)
    assert result["roughness"] == pytest.approx(1.0), "from 0.5 to -0.5 and back in every period"


def test_the_error_at_the_end_is_the_median_of_its_last_second():
    """Neither the last sample nor what was before."""
    errors = np.concatenate([np.full(450, 1.0), np.full(50, 0.01), [0.5]])
    made = EpisodeRecord(np.zeros((501, 3)), errors, np.zeros((500, 1)), np.zeros(500), "", 0.02, 0.02)
    assert METRICS["error"].function(made) == 0.01


def test_rms_error_is_over_the_whole_episode():
    made = EpisodeRecord(np.zeros((3, 3)), np.array([0.3, 0.4, 0.0]), np.zeros((2, 3)), np.zeros(2), "", 0.02, 0.01)
    assert METRICS["rms_error"].function(made) == pytest.approx(np.sqrt(0.25 / 3.0))


def test_shares_are_parts_of_all_and_a_failure_never_settles():
    made = [record(settled=time, failure="" if time < 2 else "rate") for time in (1.0, np.inf, 3.0, np.inf)]
    result = of(*made)
    assert (result["settled"], result["failed"]) == (0.25, 0.75)
    assert result["settling_time"] == result["vibration"] == np.inf


def test_reward_effort_and_roughness_are_means():
    """Of episodes whose medians are others."""
    result = of(*(record(reward=reward, effort=effort) for reward, effort in ((0, 0.1), (1, 0.2), (11, 0.9))))
    assert (result["reward"], result["effort"]) == pytest.approx((4.0, 0.4))


@pytest.mark.slow
def test_evaluate_is_every_figure_of_a_rollout():
    result, records = evaluate("pd", "FlexOne-v0", [1, 2, 3]), rollout("pd", "FlexOne-v0", [1, 2, 3]).records
    assert result == of(*records) and set(result) >= {"settled", "settling_time", "vibration", "error", "roughness"}


def test_of_many_episodes_a_median_is_that_of_the_upper_middle_and_a_mean_the_mean():
    records = [
        replace(record(), rewards=np.array([value]), errors=np.full(501, value)) for value in (1.0, 2.0, 4.0, 9.0)
    ]
    assert METRICS["reward"].evaluate(records) == 4.0 and METRICS["error"].evaluate(records) == pytest.approx(4.0)
    assert METRICS["error"].evaluate(records[:3]) == pytest.approx(2.0)


@pytest.mark.parametrize("name", METRICS)
def test_every_figure_says_what_is_better(name):
    """A calm episode that settles is better in every figure than a rough one that fails."""
    good, bad = record(), record(0.0, np.inf, 1.0, 0.5, 0.9, "rate")
    bad = replace(bad, actions=bad.actions * np.where(np.arange(500) % 2, -1.0, 1.0)[:, None])
    one, other = METRICS[name].function(good), METRICS[name].function(bad)
    assert one > other if METRICS[name].better == "high" else one < other


ONE = Configuration("FlexOne-v0", {"horizon": 1.5})
BAND = 0.02 * 0.8 / 8.5  # m, of FlexOne-v0


def rows(names, count=3, settled=2.5):
    """A table of agents that do the same."""
    return metrics_table(
        {name: [record(settled=settled, error=1e-3, band=BAND)] * count for name in names}, ONE
    ).splitlines()


@pytest.mark.parametrize("name", ["pd", "a name of more than twelve letters", "runs/" + 40 * "x", 300 * "long "])
def test_names_of_any_length_do_not_shift_the_table(name):
    title, head, *lines, caption = rows([name, "zero"])
    assert len(lines) == 2 and max(map(len, [title, head, *lines, caption])) <= 100
    for word in ("reward", "settling, s", "p-p, mm", "failed"):
        end = head.index(word) + len(word)
        assert all(line[end - 1] != " " and line[end : end + 1] in ("", " ") for line in lines), word
    shown = lines[0][: head.index("reward") - 2].rstrip()
    assert shown == name if len(name) <= 22 else shown == f"...{name[-19:]}".rstrip(), "the end of a path differs"


def test_the_row_of_all_seeds_has_the_metrics_over_all_runs():
    """Of two runs that settle in every episode, after 1 and after 2 s: the median is one of both, the interval both."""
    runs = {f"seed-{i}": [record(1.0 + i, settled=1.0 + i, error=1e-3, band=BAND)] * 3 for i in range(2)}
    title, head, *lines, caption, second = metrics_table(runs, ONE, all_seeds=True).splitlines()
    cells = [dict(zip(re.split(r" {2,}", head), re.split(r" {2,}", line), strict=True)) for line in lines]
    assert [cell["agent"] for cell in cells] == ["seed-0", "seed-1", "all seeds"]
    assert [cell["settling, s"] for cell in cells] == ["1", "2", "2 (1-2)"]
    assert [cell["reward"] for cell in cells] == ["1.000", "2.000", "1.500"]
    assert second == "all seeds: intervals of a hierarchical bootstrap over 2 training runs and episodes"
    others = [line.split() for line in (title, head, *lines[:2], caption)]
    assert others == [line.split() for line in metrics_table(runs, ONE).splitlines()]


def test_the_head_says_on_which_environment_all_rows_were_run():
    title, head, *_ = rows(["pd"])
    assert title == "3 episodes of FlexOne-v0 (horizon), the same for all, reward distance"
    assert f"in {1e3 * BAND:.3g} mm" in head, "the band is a part of the reach"
    assert "(default settings)" in metrics_table({"pd": [record()]}, Configuration())


def test_lengths_have_the_digits_that_count_and_an_interval_only_where_it_differs():
    """Errors in mm: an interval from 0.0004 to 2, and one below 0.01 as a whole."""
    wide = metrics_table({"pd": [record(error=error) for error in (4e-7, 4e-7, 2e-3)]}, ONE)
    assert "below 0.01 (below 0.01-2)" in wide
    assert "1.2 " in (equal := metrics_table({"pd": [record(error=1.234e-3)] * 3}, ONE)) and "1.2 (" not in equal
    assert "below 0.01 " in (small := metrics_table({"pd": [record(error=4e-7)] * 3}, ONE)) and "(below" not in small


def test_what_has_not_settled_is_a_dash():
    head, line = rows(["pd"], settled=np.inf)[1:3]
    assert line[head.index("settling, s") :].split()[0] == "-"


def test_a_task_that_does_not_settle_is_evaluated_by_its_rms_error():
    text = metrics_table({"pd": [record()]}, Configuration("FlexRRR-Track-v0"))
    assert "RMS error, mm" in text and "settling, s" not in text


def test_every_figure_stands_below_its_name():
    """Three episodes, of which one fails: an interval goes from its low to its high end around the median."""
    numbers = (2.5, 0.001, 0.0004, ""), (3.5, 0.002, 0.0005, ""), (np.inf, 0.003, 0.0006, "rate")
    made = [record(100.0, time, vibration, error, 0.25, failure, band=BAND)
            for time, vibration, error, failure in numbers]  # fmt: skip
    head, line, caption = metrics_table({"pd": made}, ONE).splitlines()[1:4]
    result = dict(zip(re.split(r" {2,}", head), re.split(r" {2,}", line), strict=True))
    assert result == {
        "agent": "pd", "reward": "100.0", f"in {1e3 * BAND:.3g} mm": "67% (21-94)", "settling, s": "3.5 (2.5-inf)",
        "p-p, mm": "2 (1-inf)", "error, mm": "0.5 (0.4-0.6)", "failed": "33% (6-79)",
    }  # fmt: skip
    assert "the reward is a mean" in caption
