"""Table: a row for each entrant, every figure below its name, whatever the length of names."""

import re

import numpy as np
import pytest

from flexman_gym.envs.description import Description
from flexman_gym.evaluation import table

from oracles.records import record

ONE = Description("FlexOne-v0", {"horizon": 1.5})
BAND = 0.02 * 0.8 / 8.5  # m, of FlexOne-v0


def rows(names, count=3, settled=2.5):
    """A table of entrants that do the same."""
    return table({name: [record(settled=settled, error=1e-3, band=BAND)] * count for name in names}, ONE).splitlines()


@pytest.mark.parametrize("name", ["pd", "a name of more than twelve letters", "runs/" + 40 * "x", 300 * "long "])
def test_names_of_any_length_do_not_shift_the_table(name):
    title, head, *lines, caption = rows([name, "zero"])
    assert len(lines) == 2 and max(map(len, [title, head, *lines, caption])) <= 220
    for word in ("reward", "settling, s", "p-p, mm", "failed"):
        end = head.index(word) + len(word)
        assert all(line[end - 1] != " " and line[end : end + 1] in ("", " ") for line in lines), word
    assert lines[0].count("x") == name.count("x")


def test_the_head_says_on_which_environment_all_rows_were_run():
    title, head, *_ = rows(["pd"])
    assert title == "3 episodes of FlexOne-v0 (horizon), the same for all"
    assert f"in {1e3 * BAND:.3g} mm" in head, "the band is a part of the reach"
    assert "(as it is)" in table({"pd": [record()]}, Description())


def test_what_has_not_settled_is_a_dash():
    assert "- (- to -)" in rows(["pd"], settled=np.inf)[2]


def test_a_task_that_does_not_settle_is_judged_by_its_rms_error():
    text = table({"pd": [record()]}, Description("FlexRRR-Track-v0"))
    assert "RMS error, mm" in text and "settling, s" not in text


def test_every_figure_stands_below_its_name():
    """Three episodes, of which one fails: an interval goes from its low to its high end around the median."""
    numbers = (2.5, 0.001, 0.0004, ""), (3.5, 0.002, 0.0005, ""), (np.inf, 0.003, 0.0006, "rate")
    made = [record(100.0, time, vibration, error, 0.25, failure, band=BAND)
            for time, vibration, error, failure in numbers]  # fmt: skip
    head, line, caption = table({"pd": made}, ONE).splitlines()[1:4]
    result = dict(zip(re.split(r" {2,}", head), re.split(r" {2,}", line), strict=True))
    assert result == {
        "entrant": "pd", "reward": "100.0", f"in {1e3 * BAND:.3g} mm": "67%", "settling, s": "3.5 (2.5 to -)",
        "p-p, mm": "2 (1 to -)", "error, mm": "0.5 (0.4 to 0.6)", "roughness": "0.000", "effort": "0.250",
        "failed": "33%",
    }  # fmt: skip
    assert "reward, roughness and effort are means" in caption
