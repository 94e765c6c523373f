"""Resonance: modes over postures and payloads, and what shapers leave of them."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.control.modes import ringing_modes
from flexman_gym.control.resonance import (
    BOUND,
    Case,
    borne_errors,
    find_answers,
    find_cases,
    middle_case,
    recommended,
    with_payload,
)
from flexman_gym.control.shaper import SHAPERS, design, residual

ARM = fm.catalog.planar_2r(joint_stiffness=60.0, payload=fm.Payload(0.2))
MODEL = fm.build_model(ARM, 1)
POSTURES = np.array([[0.0, 0.0], [0.3, 1.5], [0.0, 0.8]])


def mode(frequency, ratio=0.0, tip=1.0):
    return np.array([[frequency, ratio, tip]])


def cases_of(*frequencies):
    """Cases of one mode each."""
    return [Case(np.zeros(1), 0.0, mode(each), mode(2.0 * each)) for each in frequencies]


def test_a_payload_changes_the_model_as_a_payload_of_the_arm_does():
    for mass in (0.0, 0.7):
        other = fm.build_model(fm.catalog.planar_2r(joint_stiffness=60.0, payload=fm.Payload(mass)), 1)
        loaded = ringing_modes(with_payload(MODEL, mass), [0.2, 0.5])
        assert loaded == pytest.approx(ringing_modes(other, [0.2, 0.5]), rel=1e-7, abs=1e-12)
    assert MODEL.constants.payload_mass[0] == 0.2, "the model itself stays as it is"


def test_cases_are_all_postures_with_all_payloads():
    cases = find_cases(MODEL, POSTURES, [0.0, 0.4])
    assert [case.payload for case in cases] == [0.0] * 3 + [0.4] * 3
    for case in cases:
        loaded = with_payload(MODEL, case.payload)
        assert case.held == pytest.approx(ringing_modes(loaded, case.posture)[:3])
        assert case.free == pytest.approx(ringing_modes(loaded, case.posture, False)[:3])
    assert cases[0].held[0, 0] > cases[3].held[0, 0], "a heavier arm is slower"


def test_the_middle_case_has_the_middle_frequency():
    assert middle_case(cases_of(3.0, 1.0, 2.0)).held[0, 0] == 2.0


def test_what_is_left_is_the_closed_form_of_each_case():
    """Of one mode a shaper for it leaves its residual, weighed by how far each mode moves the tip."""
    cases = find_cases(MODEL, POSTURES, [0.1, 0.4])
    middle, answers = middle_case(cases).held, find_answers(cases)
    assert [(each.name, each.modes) for each in answers] == [(name, count) for count in (1, 2) for name in SHAPERS]
    one = next(each for each in answers if (each.name, each.modes) == ("ei", 1))
    shaper = design("ei", *middle[0, :2])
    for row, case in enumerate(cases):
        left = np.array([residual(shaper, *each[:2]) for each in case.held])
        assert one.left[row] == pytest.approx(left[: one.left.shape[1]])
        assert one.tip[row] == pytest.approx(np.sum(left * case.held[:, 2]) / case.held[:, 2].sum())
    assert one.delay == shaper.times[-1]
    two = next(each for each in answers if (each.name, each.modes) == ("zvd", 2))
    row = next(i for i, case in enumerate(cases) if case is middle_case(cases))
    assert two.left[row, :2] == pytest.approx([0.0, 0.0], abs=1e-9) and two.delay > one.delay


@pytest.mark.parametrize(("name", "width"), [("zv", 0.06), ("zvd", 0.286), ("ei", 0.399), ("two-hump-ei", 0.726)])
def test_the_errors_that_are_borne_are_the_published_insensitivity(name, width):
    low, high = borne_errors(design(name, 3.0), mode(3.0))
    assert high - low == pytest.approx(width, abs=0.008) and low < 0.0 < high
    assert max(residual(design(name, 3.0), 3.0 * (1.0 + np.array([low, high])))) <= 5.1


def test_with_damping_the_errors_to_both_sides_differ_and_each_is_the_last_that_is_borne():
    shaper = design("zvd", 3.0, 0.1)
    low, high = borne_errors(shaper, mode(3.0, 0.1))
    assert residual(shaper, 3.0 * (1.0 + np.array([low, high])), 0.1) == pytest.approx([5.1, 5.1], abs=0.06)
    assert high > -low + 0.005


def test_the_recommendation_is_the_quickest_that_is_good_enough():
    spread = 0.045  # to either side: ZV leaves 7 %, MZV 4 %
    quick = recommended(find_answers(cases_of(1.0 - spread, 1.0, 1.0 + spread)))
    assert (quick.name, quick.modes) == ("zv", 1) and quick.tip.max() <= BOUND
    answers = find_answers(cases_of(0.88, 1.0, 1.12))
    best = recommended(answers)
    assert best.name == "zvd" and all(each.tip.max() > BOUND for each in answers if each.delay < best.delay)
    assert recommended(find_answers(cases_of(0.5, 1.0, 1.5))) is None
