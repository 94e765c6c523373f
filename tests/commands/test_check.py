"""Tests of `flexman check`: the speed that it prints."""

from itertools import accumulate, repeat

import pytest

from flexman_gym.__main__ import main
from flexman_gym.commands import check

SECONDS = (0.05, 0.05, 0.1, 40.0, 0.025)  # CPU time of each round


@pytest.mark.slow
def test_the_speed_is_that_of_cpu_time_and_a_slow_round_does_not_count(monkeypatch):
    monkeypatch.setattr(check, "TIMED_STEPS", 10)
    steps = [second for each in SECONDS for second in (0.0, each)]
    monkeypatch.setattr(check.time, "process_time", accumulate(steps).__next__)
    elapsed = accumulate(repeat(1e6))  # loading kernels asks for it, too
    monkeypatch.setattr(check.time, "perf_counter", elapsed.__next__)
    assert len(SECONDS) == check.ROUNDS and abs(check._steps_per_second() - 10 / 0.05) < 1e-6


def test_the_line_of_the_speed_says_how_it_is_measured(monkeypatch, capsys):
    monkeypatch.setattr(check, "_steps_per_second", lambda: 12345.6)
    assert main(["check"]) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("steps of FlexRRR-v0: 12,346 per CPU second (one arm, random actions; median of 5 rounds")
