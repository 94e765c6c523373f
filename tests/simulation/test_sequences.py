"""Sequences of an extrapolated step: in the lanes they give the bits of one after the other."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import flexman_gym as fm
from flexman_gym.simulation import run

NAMES = [name for name in fm.METHODS if name.startswith("extrapolated")]
FIELDS = ("states", "tip", "energy", "work", "dissipation", "evaluations", "status")


def driven(flexible=True, stiffening=False):
    """The paper's arm under gravity, torques that swing and a force on the tip that comes and goes within steps."""
    arm = fm.catalog.paper_rrr(gravity=(0.0, 0.0, -9.81), payload=fm.Payload(2.0))
    choice = fm.ModelChoice(flexible, 1, stiffening=stiffening)
    torque = fm.SineTorque((100.0, 50.0, 20.0), (1.0, 2.0, 3.0), (0.0, 0.5, 1.0))
    push = [fm.Signal(), fm.Signal(5.0, start=0.033, stop=0.071), fm.Signal(amplitude=2.0, frequency_hz=4.0)]
    start = fm.Initial((0.1, 0.2, 0.3), (0.5, 0.0, -0.5))
    return fm.Scene(arm, choice, torque, start, 0.2, 0.02, tip_force=push)


def both(monkeypatch, scene, **options):
    """The run with sequences in the lanes, and that of one after the other."""
    result = []
    for least in (1, 99):
        monkeypatch.setattr(run, "LEAST_SEQUENCES", least)
        monkeypatch.setattr(run, "LEAST_RIGID", least)
        result.append(fm.simulate(scene, **options))
    return result


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("flexible", "stiffening"), [(False, False), (True, False), (True, True)])
@pytest.mark.parametrize("step", [0.01, 0.04, None])
def test_lanes_hold_the_bits_of_one_sequence_after_the_other(monkeypatch, name, flexible, stiffening, step):
    together, alone = both(monkeypatch, driven(flexible, stiffening), method=name, step=step, rtol=1e-4, atol=1e-7)
    assert together.status == "ok"
    for field in FIELDS:
        assert np.array_equal(getattr(together, field), getattr(alone, field)), field


def test_a_run_that_diverges_does_so_in_lanes_too(monkeypatch):
    wild = replace(driven(), initial=fm.Initial((0.0, 0.0, 0.0), (9e5, 0.0, 0.0)))
    together, alone = both(monkeypatch, wild, method="extrapolated_euler_5", step=0.02)
    assert together.status == alone.status == "diverged" and len(together.time) == len(alone.time)


def test_constants_that_are_changed_between_two_calls_count(monkeypatch):
    """The lanes know constants by their addresses."""
    model, ends = fm.build_model(fm.catalog.paper_rrr(), 1), []
    for change in (True, False):
        other = fm.build_model(fm.catalog.paper_rrr(payload=fm.Payload(5.0)), 1)
        first = run.Run(model if change else other, fm.METHODS["extrapolated_euler_5"], None, [])
        state = np.append(model.initial_state([0.0] * 3, [1.0, 0.5, -0.5]), [0.0, 0.0])
        rows, outputs = np.zeros((1, len(state))), np.zeros((1, 16))
        first.start(state, rows[0], outputs[0])
        if change:
            first.constants = other.constants._replace(prescribed=first.constants.prescribed)
        first(driven().pieces.table(), (0.0, 0.01, 3), state, rows, outputs)
        ends.append(state)
    assert np.array_equal(*ends)


@given(st.sets(st.integers(1, 20), min_size=1, max_size=8), st.integers(1, 8))
def test_every_part_has_its_turn_and_no_lane_waits_long(numbers, lanes):
    sequence = sorted(numbers)
    rounds = run.sequence_rounds(sequence, lanes)
    done = {number: [] for number in range(len(sequence))}
    for turn in rounds:
        for number, part in turn:
            if part < sequence[number]:
                done[number].append(part)
    assert all(parts == list(range(sequence[number])) for number, parts in done.items())
    least = max(sequence[-1], -(-sum(sequence) // lanes))
    assert least <= len(rounds) < least + sequence[-1]
    for lane in rounds.transpose(1, 0, 2):  # a sequence stays in its lane, part after part
        for before, after in pairwise(lane):
            assert tuple(after) == (before[0], before[1] + 1) or after[1] == 0
