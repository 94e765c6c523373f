"""Input shapers: impulse sequences, residual vibration over postures and payloads."""

import numpy as np
import pytest
from scipy.linalg import expm

import flexman_gym as fm
from flexman_gym.simulation.physical_parameters import varied_model
from flexman_gym.toolbox.controllers.excited_modes import excited_modes
from flexman_gym.toolbox.controllers.input_shaping.shapers import (
    SHAPERS,
    TIP_VIBRATION_LIMIT,
    OperatingPoint,
    Shaper,
    ShaperEvaluation,
    convolve_samples,
    design_shaper,
    shaper_residual,
)
from flexman_gym.toolbox.controllers.references.trajectories import TIMINGS

from oracles.assertions import refusal

ERRORS = np.array([0.7, 0.9, 1.0, 1.05, 1.3])
RATIOS = (0.0, 0.03, 0.1)
PERIODS = {"zv": 0.5, "mzv": 0.75, "zvd": 1.0, "ei": 1.0, "two-hump-ei": 1.5}
# widths of the frequencies with at most 5 % residual, parts of the design: Singhose, Porter, Tuttle and Singer (1997)
INSENSITIVITY = {"zv": 0.06, "zvd": 0.286, "ei": 0.399, "two-hump-ei": 0.726}


def rings(shaper, frequency, ratio):
    """What an oscillator has of its energy's root after the last impulse, in percent of that after one, by expm."""
    rate = 2.0 * np.pi * frequency
    system = np.array([[0.0, 1.0], [-(rate**2), -2.0 * ratio * rate]])
    state, before = np.zeros(2), 0.0
    for time, amplitude in zip(*shaper, strict=True):
        state = expm(system * (time - before)) @ state + [0.0, amplitude]
        before = time
    # amplitude of free decay: x and the velocity in the frame that turns with it
    turning = (state[1] + ratio * rate * state[0]) / (rate * np.sqrt(1.0 - ratio**2))
    return 100.0 * np.hypot(state[0], turning) * rate * np.sqrt(1.0 - ratio**2)


@pytest.mark.parametrize("name", SHAPERS)
@pytest.mark.parametrize("ratio", RATIOS)
def test_amplitudes_add_up_to_one_in_the_time_that_is_known(name, ratio):
    shaper = design_shaper(name, 2.0, ratio)
    assert shaper.amplitudes.sum() == pytest.approx(1.0, abs=1e-14) and (shaper.amplitudes > 0.0).all()
    assert shaper.times[-1] == pytest.approx(PERIODS[name] / (2.0 * np.sqrt(1.0 - ratio**2)), rel=1e-12)


@pytest.mark.parametrize("name", SHAPERS)
@pytest.mark.parametrize("ratio", RATIOS)
def test_the_residual_is_that_of_an_oscillator(name, ratio):
    shaper = design_shaper(name, 0.8, ratio)
    simulated = [rings(shaper, 0.8 * error, ratio) for error in ERRORS]
    assert shaper_residual(shaper, 0.8 * ERRORS, ratio) == pytest.approx(simulated, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("ratio", RATIOS)
def test_at_its_mode_a_shaper_leaves_nothing_or_what_is_tolerated(ratio):
    for name in SHAPERS:
        left = 7.0 if name == "ei" else 0.0
        assert shaper_residual(design_shaper(name, 1.3, ratio, 0.07), 1.3, ratio) == pytest.approx(left, abs=1e-10), (
            name
        )
    near = 1.0 + 1e-5 * np.array([-1.0, 1.0])
    zvd, zv = (shaper_residual(design_shaper(name, 1.0, ratio), near, ratio) / 1e-5 for name in ("zvd", "zv"))
    assert zvd.max() < 0.01 and zv.min() > 100.0, "percent per part of the frequency: ZVD has no slope there"


def test_two_hump_amplitudes_are_those_of_the_polynomial():
    """Without damping its amplitudes are symmetric; the two humps beside the mode are as high as is tolerated."""
    shaper, near = design_shaper("two-hump-ei", 1.0), np.linspace(0.7, 1.3, 6001)
    left = shaper_residual(shaper, near)
    tops = left[1:-1][(left[1:-1] > left[2:]) & (left[1:-1] > left[:-2])]
    assert shaper.amplitudes == pytest.approx(shaper.amplitudes[::-1]) and tops == pytest.approx([5.0, 5.0], abs=1e-3)


def test_ei_is_zero_on_both_sides_of_its_mode():
    near = np.linspace(0.8, 1.2, 40001)
    left = shaper_residual(design_shaper("ei", 1.0), near)
    zeros = near[1:-1][(left[1:-1] < left[2:]) & (left[1:-1] < left[:-2])]
    assert (
        len(zeros) == 2 and zeros[0] < 1.0 < zeros[1] and shaper_residual(design_shaper("ei", 1.0), zeros).max() < 0.01
    )


@pytest.mark.parametrize("name", INSENSITIVITY)
def test_the_insensitivity_is_that_which_was_published(name):
    near = np.linspace(0.5, 1.5, 100001)
    borne = shaper_residual(design_shaper(name, 1.0), near) <= 5.0 + 1e-9
    assert np.diff(near[borne][[0, -1]]).item() == pytest.approx(INSENSITIVITY[name], abs=0.004)
    assert borne[np.abs(near - 1.0) < 0.49 * INSENSITIVITY[name]].all(), "in one piece"


def test_two_shapers_kill_both_modes():
    first, second = design_shaper("zv", 0.5, 0.02), design_shaper("ei", 1.7, 0.01, 0.03)
    shaper = first.convolve(second)
    assert shaper.amplitudes.sum() == pytest.approx(1.0) and (np.diff(shaper.times) >= 0.0).all()
    assert shaper.times[-1] == pytest.approx(first.times[-1] + second.times[-1])
    assert shaper_residual(shaper, 0.5, 0.02) == pytest.approx(0.0, abs=1e-10)
    product = shaper_residual(first, 1.1, 0.01) * shaper_residual(second, 1.1, 0.01) / 100.0
    assert shaper_residual(shaper, 1.1, 0.01) == pytest.approx(product), "residuals multiply"


@pytest.mark.parametrize("name", SHAPERS)
def test_samples_cost_what_is_said(name):
    """At 0.3 Hz and 20 ms less than 0.02 %; each sample sums to one, and lies in the mean where the impulses do."""
    frequency, period = 0.31, 0.02
    shaper = design_shaper(name, frequency)
    parts = shaper.sample(period)
    times = period * np.arange(len(parts))
    assert parts.sum() == pytest.approx(1.0) and parts @ times == pytest.approx(shaper.amplitudes @ shaper.times)
    price = abs(shaper_residual(Shaper(times, parts), frequency) - shaper_residual(shaper, frequency))
    assert price < 100.0 * (2.0 * np.pi * frequency * period) ** 2 / 8.0 < 0.02


def test_a_sampled_shaper_is_convolved_as_by_the_definition():
    """Each column alone, for the times of the values; values after their end are not made."""
    values, fractions = np.random.default_rng(0).normal(size=(40, 3)), design_shaper("ei", 1.3, 0.05).sample(0.02)
    for few in (values, values[:5]):
        expected = [np.convolve(fractions, column)[: len(few)] for column in few.T]
        assert convolve_samples(fractions, few) == pytest.approx(np.transpose(expected), abs=1e-14)


def test_an_arm_rings_after_a_shaped_command_as_the_closed_form_says():
    """The motor is led exactly; what rings afterwards is measured in the mode's own coordinate, over 1.2 periods."""
    model = fm.build_model(fm.catalog.one_joint(), 2, 2)
    frequency, ratio, _ = excited_modes(model, [0.0])[0]
    period, way = 0.002, 0.02
    count = round(0.6 / frequency / period)
    base = way * TIMINGS["quintic"].at(np.arange(count + 1) / count)[0]

    def swing(parts):
        command = np.convolve(np.concatenate([base, np.full(len(parts) - 1, way)]), parts)[: len(base) + len(parts) - 1]
        command = np.concatenate([command, np.full(round(1.2 / frequency / period), way)])
        simulator = fm.Simulator(model, step=0.001, control_period=period, prescribed=[0])
        simulator.reset()
        speed, place, seen = 0.0, 0.0, []
        for now in command:  # accelerations that lead the motor there at the middle of each period, in the mean
            wanted = (now - place) / period
            simulator.step([0.0], acceleration=[(wanted - speed) / period])
            place, speed = place + 0.5 * (speed + wanted) * period, wanted
            seen.append(simulator.deflection[1] + 0.8 * (simulator.state[0] - simulator.state[1]))
        free = np.array(seen[-round(1.1 / frequency / period) :])
        return np.ptp(free)

    plain = swing(np.ones(1))
    for name in ("zv", "zvd", "ei"):
        for error in (0.8, 1.15):
            shaper = design_shaper(name, frequency * error, ratio)
            left = 100.0 * swing(shaper.sample(period)) / plain
            assert left == pytest.approx(float(shaper_residual(shaper, frequency, ratio)), rel=0.05, abs=0.4), (
                name,
                error,
            )


def test_a_design_that_cannot_be_is_refused_in_one_line():
    assert refusal(design_shaper, "zvdd", 1.0).startswith(
        "shaper: 'zvdd' is not allowed; give one of zv, mzv, zvd, ei, two-"
    )
    assert refusal(design_shaper, "zv", 0.0).startswith("frequency: 0.0 ")
    assert refusal(design_shaper, "zv", 1.0, 1.0).startswith("ratio: 1.0 ")
    assert refusal(design_shaper, "ei", 1.0, 0.8).startswith(
        "ratio: 0.8 is not allowed; give a mode with less damping, or no"
    )
    assert refusal(design_shaper, "ei", 1.0, 0.0, 1.0).startswith("tolerance: 1.0 ")
    assert refusal(design_shaper("zv", 1.0).sample, 0.0).startswith("period: 0.0 ")
    assert shaper_residual(design_shaper("zv", 1.0, 0.8), 1.0, 0.8) == pytest.approx(0.0, abs=1e-10), (
        "others bear any damping"
    )


ARM = fm.catalog.planar_2r(joint_stiffness=60.0, payload=fm.Payload(0.2))
MODEL = fm.build_model(ARM, 1)
POSTURES = np.array([[0.0, 0.0], [0.3, 1.5], [0.0, 0.8]])


def mode(frequency, ratio=0.0, tip=1.0):
    return np.array([[frequency, ratio, tip]])


def cases_of(*frequencies):
    """Cases of one mode each."""
    return [OperatingPoint(np.zeros(1), 0.0, mode(each), mode(2.0 * each)) for each in frequencies]


def test_a_payload_changes_the_model_as_a_payload_of_the_arm_does():
    for mass in (0.0, 0.7):
        other = fm.build_model(fm.catalog.planar_2r(joint_stiffness=60.0, payload=fm.Payload(mass)), 1)
        loaded = excited_modes(varied_model(MODEL, payload_mass=mass), [0.2, 0.5])
        assert loaded == pytest.approx(excited_modes(other, [0.2, 0.5]), rel=1e-7, abs=1e-12)
    assert MODEL.constants.payload_mass[0] == 0.2, "the model itself stays as it is"


def test_cases_are_all_postures_with_all_payloads():
    cases = OperatingPoint.find(MODEL, POSTURES, [0.0, 0.4])
    assert [case.payload for case in cases] == [0.0] * 3 + [0.4] * 3
    for case in cases:
        loaded = varied_model(MODEL, payload_mass=case.payload)
        assert case.held == pytest.approx(excited_modes(loaded, case.posture)[:3])
        assert case.free == pytest.approx(excited_modes(loaded, case.posture, False)[:3])
    assert cases[0].held[0, 0] > cases[3].held[0, 0], "a heavier arm is slower"


def test_the_middle_case_has_the_middle_frequency():
    assert ShaperEvaluation.compare(cases_of(3.0, 1.0, 2.0)).median.held[0, 0] == 2.0


def test_what_is_left_is_the_closed_form_of_each_case():
    """Of one mode a shaper for it leaves its residual, weighed by how far each mode moves the tip."""
    cases = OperatingPoint.find(MODEL, POSTURES, [0.1, 0.4])
    median, answers, _ = ShaperEvaluation.compare(cases)
    middle = median.held
    assert [(each.name, each.modes) for each in answers] == [(name, count) for count in (1, 2) for name in SHAPERS]
    one = next(each for each in answers if (each.name, each.modes) == ("ei", 1))
    shaper = design_shaper("ei", *middle[0, :2])
    for row, case in enumerate(cases):
        left = np.array([shaper_residual(shaper, *each[:2]) for each in case.held])
        assert one.residuals[row] == pytest.approx(left[: one.residuals.shape[1]])
        assert one.tip[row] == pytest.approx(np.sum(left * case.held[:, 2]) / case.held[:, 2].sum())
    assert one.delay == shaper.times[-1]
    two = next(each for each in answers if (each.name, each.modes) == ("zvd", 2))
    row = next(i for i, case in enumerate(cases) if case is median)
    assert two.residuals[row, :2] == pytest.approx([0.0, 0.0], abs=1e-9) and two.delay > one.delay


@pytest.mark.parametrize(("name", "width"), [("zv", 0.06), ("zvd", 0.286), ("ei", 0.399), ("two-hump-ei", 0.726)])
def test_the_errors_that_are_borne_are_the_published_insensitivity(name, width):
    low, high = next(
        each.tolerated_errors for each in ShaperEvaluation.compare(cases_of(3.0)).evaluations if each.name == name
    )
    assert high - low == pytest.approx(width, abs=0.008) and low < 0.0 < high
    assert max(shaper_residual(design_shaper(name, 3.0), 3.0 * (1.0 + np.array([low, high])))) <= 5.1


def test_with_damping_the_errors_to_both_sides_differ_and_each_is_the_last_that_is_borne():
    shaper = design_shaper("zvd", 3.0, 0.1)
    cases = [OperatingPoint(np.zeros(1), 0.0, mode(3.0, 0.1), mode(6.0))]
    low, high = next(
        each.tolerated_errors for each in ShaperEvaluation.compare(cases).evaluations if each.name == "zvd"
    )
    assert shaper_residual(shaper, 3.0 * (1.0 + np.array([low, high])), 0.1) == pytest.approx([5.1, 5.1], abs=0.06)
    assert high > -low + 0.005


def test_the_recommendation_is_the_quickest_that_is_good_enough():
    spread = 0.045  # to either side: ZV leaves 7 %, MZV 4 %
    quick = ShaperEvaluation.compare(cases_of(1.0 - spread, 1.0, 1.0 + spread)).recommended
    assert (quick.name, quick.modes) == ("zv", 1) and quick.tip.max() <= TIP_VIBRATION_LIMIT
    _, answers, best = ShaperEvaluation.compare(cases_of(0.88, 1.0, 1.12))
    assert best.name == "zvd" and all(
        each.tip.max() > TIP_VIBRATION_LIMIT for each in answers if each.delay < best.delay
    )
    assert ShaperEvaluation.compare(cases_of(0.5, 1.0, 1.5)).recommended is None
