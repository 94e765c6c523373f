"""Machine: a fit to runs of a real arm predicts others, and fits to made-up arms know how far they are off."""

import numpy as np
import pytest

import flexman_gym as fm
from studies.machine.measure import (
    COUPLED,
    DATA,
    FIT,
    MUJOCO,
    ONE,
    SCORE,
    SHEET,
    STAGE_1,
    FitRow,
    both_stages,
    draws,
    driven,
    moving,
)
from studies.machine.page import page


def test_half_of_the_runs_of_a_real_arm_predicts_the_others():
    """The goals: R2 of 0.90 in the median and 0.95 at 20 and 30 degrees, 1.80 to 1.97 Hz, damping 0.09 to 0.16."""
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


def test_the_page_tells_its_rows():
    rows = [FitRow(FIT, half, name, 0.9) for half in "AB" for name in ("natural frequency, Hz", "EI factor",
            "amplitude factor, measured", "amplitude factor of the model")]  # fmt: skip
    rows += [
        FitRow(SCORE, "lqg_20deg", "A", 0.951),
        FitRow(SHEET, "lqg_20deg", "A", 0.8),
        FitRow(MUJOCO, "lqg_20deg", "R2", 0.952),
    ]
    rows += [FitRow(COUPLED, f"link_deflection_{i}_y", "R2", 0.9) for i in (1, 2)]
    text = page(rows, "nothing")
    assert "| lqg_20deg | A | 0.951 | 0.800 | 0.952 |" in text
    assert "| R2 of link_deflection_2_y, second half | 0.900 |  |" in text
