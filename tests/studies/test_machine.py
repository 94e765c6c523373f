"""Tests of fits to a real arm, which predict held-out runs, and to simulated arms, whose parameters are recovered."""

import numpy as np
import pytest

import flexman_gym as fm
from studies.machine.measure import (
    DATA,
    ONE,
    STAGE_1,
    both_stages,
    draws,
    driven,
    moving,
)


def test_half_of_the_runs_of_a_real_arm_predicts_the_others():
    """Goals: R2 of 0.90 in the median and 0.95 at 20 and 30 degrees, 1.80 to 1.97 Hz, damping ratio 0.09 to 0.16."""
    runs = moving(DATA)
    names = sorted(runs)
    assert len(names) == 11
    half = [runs[name] for name in names[::2]]
    found = fm.fit(
        fm.catalog.quanser_2dsfl(1), ["link_stiffness_factor", "link_damping"], records=half, starts=0, **ONE
    )
    modes = fm.modes(fm.build_model(found.arm, **ONE))
    assert 1.80 < modes.frequencies[0] < 1.97 and 0.09 < modes.damping_ratios[0] < 0.16
    scores = {name: found.score(runs[name])[STAGE_1] for name in names[1::2]}
    assert np.median(list(scores.values())) > 0.90
    assert min(scores["lqg_20deg"], scores["hinf_neg_20deg"]) > 0.95
    assert found.undetermined == () and found.warnings == ()


def test_records_of_both_stages_say_what_went_in_and_came_out():
    record = both_stages(DATA / "two_stages.csv")
    assert record.period == pytest.approx(0.002) and len(record.times) == 5000
    assert set(record.outputs) == set(record.filters) == set(record.gains)
    currents = driven(DATA / "two_stages.csv")
    assert set(currents.inputs) == {"current_1", "current_2"} and currents.period == pytest.approx(0.01)
    assert np.abs(currents.inputs["current_1"]).max() < 0.94  # A, the limit of the drives


def test_the_truth_of_a_made_up_arm_is_where_the_fit_says():
    found = [each for each in draws(3, 1) if each[2]]
    assert len(found) >= 4
    assert max(abs(error) for _, error, _ in found) < 4.0
