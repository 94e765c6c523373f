"""Fuzz: odd calls and broken files work, or are refused in one clear line; `oracles.fuzz` and `.mutants` have more."""

import time

import numpy as np
import pytest

from oracles import fuzz
from oracles.fuzz import arguments, described, outcome, too_much
from oracles.odd import BAD, fits
from oracles.targets import TARGETS, Target

CALLS, FILES = 8, 100  # of each target, and in all


@pytest.mark.parametrize("name", TARGETS)
def test_a_call_with_odd_arguments_works_or_is_refused_in_one_line(name):
    target = TARGETS[name]
    target.call(**target.good)  # compiles what it needs
    assert outcome(target, target.good, {}) == ("works", "")
    for seed in range(CALLS):
        _, given, strange = arguments(seed, name)
        if not too_much(target, strange):
            kind, what = outcome(target, given, strange)
            assert kind != "finding", f"seed {seed}: {what}: {described(strange)}"


def test_a_broken_file_is_read_or_refused_in_one_line(tmp_path):
    pytest.importorskip("stable_baselines3")
    from oracles import mutants

    kinds = [mutants.outcome(seed, tmp_path) for seed in range(FILES)]
    assert [(seed, what) for seed, (kind, what) in enumerate(kinds) if kind == "finding"] == []
    assert {kind for kind, _ in kinds} == {"read", "refused"}


def refuse(line):
    """Refuses with a line."""
    raise ValueError(line)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda value: {}[value], "KeyError"),
        (lambda value: len(None), "TypeError"),
        (lambda value: refuse("no"), "ValueError"),
        (lambda value: refuse("value: 1 is not allowed; give\n2"), "ValueError"),
        (lambda value: refuse("value: 1 is not allowed; give " + 400 * "2"), "ValueError"),
        (lambda value: (np.zeros(2), {"a": [np.nan]}), "not finite"),
        (lambda value: np.isinf(np.float64(1e300) * np.float64(1e300)), "RuntimeWarning"),
        (lambda value: time.sleep(0.1), "took more than"),
        (lambda value: 1.0, "no number"),
    ],
)
def test_the_fuzz_finds_what_is_planted(call, said, monkeypatch):
    monkeypatch.setattr(fuzz, "LONGEST", 0.05)
    numbers = ("value",) if said == "no number" else ()
    kind, what = outcome(Target(call, {"value": 1.0}, numbers), {"value": BAD[0]}, {"value": BAD[0]})
    assert kind == "finding" and said in what


def test_a_good_line_is_known():
    assert fits("Link.length: -1.0 is not allowed; give a number from 1e-30 to 1e+30 (m)") and not fits("no")
