"""Problem: residuals of records and their slopes, what of a record counts, and noise that is estimated beside them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

import flexman_gym as fm
from flexman_gym.model.dynamics import frequencies
from flexman_gym.toolbox.identification.fitting import SOLVED_STARTS, SPREAD, parameter_covariance
from flexman_gym.toolbox.identification.least_squares import FreeParameters, LeastSquaresProblem
from flexman_gym.toolbox.identification.measurement import SimulatedResponse
from flexman_gym.toolbox.identification.ringing import Ringing

from oracles.turned import BENT, CHOICE, PERIOD, STIFFNESS, STRAIN, sprung, turned

TIMES = PERIOD * np.arange(121)


def problem_of(*records, free="joint_stiffness", corner=""):
    arm = fm.catalog.one_joint()
    return LeastSquaresProblem(
        FreeParameters(arm, free), [], [SimulatedResponse(arm, each, None) for each in records], CHOICE, corner
    )


@pytest.mark.parametrize("corner", ["", BENT])
def test_slopes_are_those_of_the_residuals(corner):
    """By stiffness, gain, offset and corner of a filter that is looked for, at none of which they start."""
    problem = problem_of(turned((BENT,), gains=(BENT,), offsets=(BENT,)), corner=corner)
    x = problem.start + np.array([0.1, 0.7, 2e-3, 0.3])[: len(problem.start)]
    assert len(x) == (4 if corner else 3)
    slopes = problem.evaluate(x)[1].copy()
    for i, unit in enumerate(np.eye(len(x))):
        ahead, behind = (problem.evaluate(x + sign * 1e-3 * unit)[0].copy() for sign in (1.0, -1.0))
        difference = (ahead - behind) / 2e-3
        assert slopes[:, i] == pytest.approx(difference, abs=2e-3 * np.abs(difference).max())
        assert np.abs(difference).max() > 0.1


def test_what_the_arm_did_before_does_not_count():
    """Samples of the settling say nothing: neither to the fit nor to its offset, its score and its noise."""
    record, spoilt = turned(), round(0.3 / PERIOD)
    values = record.outputs[BENT] + 3e-3
    record = replace(record, offsets=(BENT,), settling=0.3, outputs={BENT: values})
    values[:spoilt] += 0.1 * np.random.default_rng(0).uniform(0.0, 1.0, spoilt)
    found = fm.fit(sprung(0.7), "joint_stiffness", records=[record], starts=0, **CHOICE)
    assert found.values["joint_stiffness"] == pytest.approx([STIFFNESS], rel=1e-4)
    assert found.score(record)[BENT] > 0.9999 and found.scores[f"record 0, {BENT}"] > 0.9999
    shown = found.predicted(record)[BENT][spoilt:]
    assert shown == pytest.approx(values[spoilt:], abs=1e-3 * np.ptp(values[spoilt:]))  # at a smaller step
    assert not found.warnings


def test_noise_is_that_of_each_output_over_all_records():
    """White noise of two sizes in metres, pooled, and of another in strain; three hundred samples tell it to 4 %."""
    random, sizes = np.random.default_rng(1), ({BENT: 2e-4, STRAIN: 3e-6}, {BENT: 4e-4, STRAIN: 3e-6})
    clean = turned((BENT, STRAIN))
    records = [
        replace(clean, outputs={name: each + size[name] * random.standard_normal(len(TIMES))
                                for name, each in clean.outputs.items()}) for size in sizes
    ]  # fmt: skip
    problem = problem_of(*records)
    problem.solve(problem.start)
    assert [(part.record, part.name) for part in problem.blocks] == [(0, BENT), (0, STRAIN), (1, BENT), (1, STRAIN)]
    expected = np.array([np.sqrt(10.0) * 1e-4, 3e-6] * 2)
    assert np.array([part.sigma[0] for part in problem.blocks]) == pytest.approx(expected, rel=0.15)


@pytest.mark.parametrize("hold", ["zero", "linear"])
def test_every_torque_of_a_record_drives_the_arm(hold):
    """Motors that are driven in turn, one alone at a time, at samples at which the other's torque stays."""
    arm = fm.catalog.planar_2r()
    torques = np.zeros((len(TIMES), 2))
    torques[20:50, 0], torques[60:90, 1], torques[70:80, 0] = 0.4, -0.2, 0.1
    record = fm.Measurement(
        TIMES, {"torque_1": torques[:, 0], "torque_2": torques[:, 1]},
        {"motor_angle_1": 0.0 * TIMES, "motor_angle_2": 0.0 * TIMES}, hold=hold,
    )  # fmt: skip
    flexible = (False,) * 2
    model = fm.build_model(arm, 1, flexible_links=False)
    shown = SimulatedResponse(arm, record, None).signals(model, {"payload_mass": model.constants.payload_mass[:1]})[0]
    scene = fm.Scene(
        arm, fm.ModelChoice(flexible, (1, 1)), fm.SampledTorque(TIMES, torques, hold),
        fm.Initial([0.0] * 2, [0.0] * 2), TIMES[-1], PERIOD,
    )  # fmt: skip
    expected = fm.simulate(scene, rtol=1e-9, atol=1e-12).motor_angles
    assert np.abs(shown.T - expected).max() < 1e-4 * np.ptp(expected)
    assert np.ptp(expected, axis=0).min() > 0.01


def test_one_frequency_that_is_wrong_is_a_poor_fit(monkeypatch):
    """A fit whose residuals are all within three deviations is not repeated from other starts."""
    starts = []
    monkeypatch.setattr(LeastSquaresProblem, "solve", lambda self, x: starts.append(x) or x)
    arm = fm.catalog.one_joint()
    known = frequencies(fm.build_model(arm, **CHOICE), lock_joints=True)[:2]
    for factors, poor in (((1.0, 1.0), False), ((1.0, 1.012), False), ((1.0, 1.03), True), ((0.97, 1.0), True)):
        starts.clear()
        fm.fit(arm, "joint_stiffness", known * factors, **CHOICE)
        assert len(starts) == (1 + SOLVED_STARTS if poor else 1)


def test_the_best_of_other_starts_is_followed(monkeypatch):
    """Where no place can be left, the result is the best of all that may be tried."""
    free = FreeParameters(fm.catalog.planar_2r(), "link_stiffness_factor")
    known = frequencies(fm.build_model(free.build_arm(np.array([2.0, 0.5])), 1), lock_joints=True)
    problem, random = LeastSquaresProblem(free, [Ringing(known[:2])], [], {"elements": 1}), np.random.default_rng(0)
    monkeypatch.setattr(LeastSquaresProblem, "solve", lambda self, x: x)
    places = [problem.start, *(problem.start + random.uniform(-SPREAD, SPREAD, 2) for _ in range(12))]
    misfits = [np.mean(problem.evaluate(place)[0] ** 2) for place in places]
    found = fm.fit(free.arm, "link_stiffness_factor", known[:2], elements=1)
    best = places[int(np.argmin(misfits))]
    assert found.values["link_stiffness_factor"].tolist() == problem.values(best).tolist()
    assert min(misfits) < 0.5 * misfits[0]


def test_gains_and_offsets_are_solved_for_at_once():
    """Residuals are linear in them."""
    clean = turned((BENT,), gains=(BENT,), offsets=(BENT,))
    problem = problem_of(replace(clean, outputs={BENT: 1.7 * clean.outputs[BENT] - 2e-3}))
    assert problem._solve_sensors(problem.start) == pytest.approx([0.0, 1.7, -2e-3], abs=1e-9)


def test_an_arm_that_diverges_fits_worse_than_any(monkeypatch):
    problem = problem_of(turned())
    far = np.sum(problem.evaluate(problem.start + 2.0)[0] ** 2)
    monkeypatch.setattr(problem.responses[0], "signals", lambda *_: np.full((2, 1, len(TIMES)), np.nan))
    residuals, slopes = problem.evaluate(problem.start)
    assert np.sum(residuals**2) > 10.0 * far and not slopes.any()


def test_steps_are_halved_until_they_matter_no_more():
    """Samples of an exact motion every 0.04 s, at which alone a fit would be off by far more than its noise."""
    times, arm = 0.04 * np.arange(41), fm.catalog.one_joint()
    hub = 0.3 * np.sin(2.0 * np.pi * 0.9 * times) ** 3
    scene = fm.Scene(
        arm, fm.ModelChoice((True,), (1,), (1,)), fm.ConstantTorque([0.0]), fm.Initial([0.0], [0.0]), times[-1], 0.04,
        prescribed=[fm.SampledAngles(times, hub)],
    )  # fmt: skip
    columns = fm.simulate(scene, rtol=1e-9, atol=1e-12).columns()
    bent = next(values for head, values in columns.items() if head.startswith(BENT))
    record = fm.Measurement(times, {"motor_angle_1": hub}, {BENT: bent}, deviations={BENT: 1e-5})
    found = fm.fit(sprung(0.9), "joint_stiffness", records=[record], starts=0, check=False, **CHOICE)
    assert abs(found.values["joint_stiffness"][0] - STIFFNESS) < 2.0 * found.deviations["joint_stiffness"][0]
    assert found.step < 0.04


def test_an_arm_rests_at_first_where_it_is_said_to():
    """Else where its encoder begins, which may be off."""
    record = fm.Measurement(TIMES, {}, {"motor_angle_1": 0.2 + 0.0 * TIMES})
    model = fm.build_model(fm.catalog.one_joint(), **CHOICE)
    for start, angle in ((None, 0.2), ([0.5], 0.5)):
        response = SimulatedResponse(model.arm, replace(record, start=start), None)
        shown = response.signals(model, {"payload_mass": model.constants.payload_mass[:1]})[0, 0]
        assert shown == pytest.approx(np.full(len(TIMES), angle), abs=1e-9)


def signals_of(arm, record):
    """What a rigid arm shows in place of the outputs of a record, by name."""
    model = fm.build_model(arm, 1, flexible_links=False)
    shown = SimulatedResponse(arm, record, None).signals(model, {"payload_mass": model.constants.payload_mass[:1]})[0]
    return dict(zip(record.outputs, shown, strict=True))


def test_a_current_drives_as_its_torque_does():
    """Gear ratio times torque constant, N m for each ampere (Spong)."""
    arm, current = fm.catalog.planar_2r(), 0.3 * np.sin(7.0 * TIMES)
    motor = fm.Motor(gear_ratio=50.0, torque_constant=0.04, rotor_inertia=1e-6)
    inertia = motor.reflected_inertia
    arm = replace(arm, joints=[replace(each, motor=motor, rotor_inertia=inertia) for each in arm.joints])
    outputs = {"motor_angle_1": 0.0 * TIMES, "motor_angle_2": 0.0 * TIMES}
    by_current = signals_of(arm, fm.Measurement(TIMES, {"current_1": current, "torque_2": current}, outputs))
    by_torque = signals_of(arm, fm.Measurement(TIMES, {"torque_1": 2.0 * current, "torque_2": current}, outputs))
    for name, values in by_torque.items():
        assert by_current[name] == pytest.approx(values, abs=1e-9) and np.ptp(values) > 0.01


def test_an_accelerometer_feels_the_torque_up_to_its_sample():
    """Of a rigid arm that is pushed from a sample on: nothing is felt there, and all of it one sample later."""
    torque = 0.3 * (np.arange(len(TIMES)) >= 20)
    record = fm.Measurement(TIMES, {"torque_1": torque}, dict.fromkeys(("tip_acceleration_y", "tip_y"), TIMES))
    shown = signals_of(fm.catalog.planar_2r(), record)
    assert shown["tip_acceleration_y"][:21] == pytest.approx(0.0, abs=1e-9)
    pushed = 2.0 * shown["tip_y"][21] / PERIOD**2  # from rest, over the first period
    assert shown["tip_acceleration_y"][21] == pytest.approx(pushed, rel=0.01) and pushed > 0.1


def test_a_signal_passes_all_of_its_filters():
    filters = fm.Filter.low_pass(4.0, 0.8), fm.Filter.low_pass(2.0)
    both = turned((BENT,)), replace(turned((BENT,)), filters={BENT: filters})
    model = fm.build_model(fm.catalog.one_joint(), **CHOICE)
    bare, shown = (
        SimulatedResponse(model.arm, each, None).signals(model, {"payload_mass": model.constants.payload_mass[:1]})[
            0, 0
        ]
        for each in both
    )
    assert shown == pytest.approx(filters[1].applied(filters[0].applied(bare, PERIOD), PERIOD), abs=1e-12)


def test_a_damaged_sample_is_named_by_its_time():
    """Not by that of its neighbour, which stands out from it; one of 91 is enough."""
    record = replace(turned((BENT,)), settling=0.3)
    values = record.outputs[BENT] + 1e-4 * np.random.default_rng(0).standard_normal(len(TIMES))
    values[70] += 0.05
    record = replace(record, outputs={BENT: values})
    found = fm.fit(fm.catalog.one_joint(), "joint_stiffness", records=[record], starts=0, **CHOICE)
    assert any("the first at 0.7 s" in line for line in found.warnings), found.warnings


def coloured(random, size, kept):
    """Noise e_k = kept e_(k-1) + w_k (AR(1)) of deviation 1, (size,); the first 200 of it are left out."""
    white = random.standard_normal(size + 200) * np.sqrt(1.0 - kept**2)
    return lfilter([1.0], [1.0, -kept], white)[200:]


def linear(rows, slopes, record=0):
    """A problem that is linear in its unknowns, at their place of the least residuals."""
    part = SimpleNamespace(record=record, name="linear", measured=rows, sigma=np.ones(len(rows)), known=False)
    return SimpleNamespace(blocks=[part], evaluate=lambda x: (rows, slopes), split=lambda values: [values])


@pytest.mark.parametrize("kept", [0.0, 0.5, 0.8, 0.9])
def test_the_mean_of_coloured_noise_is_as_uncertain_as_its_closed_form(kept):
    """The variance s^2 / m (1 + kept) / (1 - kept), whatever the deviation s that the fit assumed."""
    m = 100_000
    rows = 0.3 * coloured(np.random.default_rng(1), m, kept)
    variance = parameter_covariance(linear(rows, np.ones((m, 1))), np.zeros(1))
    assert variance[0, 0] == pytest.approx(0.09 / m * (1.0 + kept) / (1.0 - kept), rel=0.1)


def correlation_length(rows):
    """Return the number of residuals equivalent to one, from the variance of their mean."""
    m = len(rows)
    return parameter_covariance(linear(rows, np.ones((m, 1))), np.zeros(1))[0, 0] * (m - 1.0) / np.mean(rows**2)


@pytest.mark.parametrize("kept", [0.0, 0.5, 0.9])
def test_the_memory_of_an_autoregression_is_that_of_its_closed_form(kept):
    """The sum over all lags of kept^|lag|: (1 + kept) / (1 - kept), whatever size and mean of the residuals."""
    rows = coloured(np.random.default_rng(0), 200_000, kept)
    assert correlation_length(rows) == pytest.approx((1.0 + kept) / (1.0 - kept), rel=0.1)
    assert correlation_length(3.0 * rows + 5.0) == pytest.approx(correlation_length(rows))


def test_numbers_that_a_fit_uses_up_count():
    """Of m samples of white noise u are lost to u unknowns: the variance has the divisor m - u."""
    m, u, random = 60, 20, np.random.default_rng(2)
    slopes = np.linalg.qr(random.standard_normal((m, u)))[0]
    found = []
    for _ in range(300):
        rows = random.standard_normal(m)
        rows -= slopes @ (slopes.T @ rows)
        found.append(parameter_covariance(linear(rows, slopes), np.zeros(u))[0, 0] / correlation_length(rows))
    assert np.mean(found) == pytest.approx(1.0, rel=0.05)


def test_given_deviations_are_those_of_frequencies():
    """A part of ringing is not rescaled by what is left of it: one residual tells no noise."""
    variance = parameter_covariance(linear(np.array([3.0, -3.0]), np.array([[2.0], [0.0]]), record=-1), np.zeros(1))
    assert variance[0, 0] == pytest.approx(0.25, rel=1e-6)


@pytest.mark.slow
def test_deviations_cover_what_fits_of_coloured_records_miss():
    """Of 25 fits the squares of errors in deviations have mean 1; 99.9 % of such means are from 0.3 to 2.1."""
    clean = turned((BENT,), samples=401, gains=(BENT,))
    random, squares = np.random.default_rng(3), []
    for _ in range(25):
        noise = 0.03 * np.std(clean.outputs[BENT]) * coloured(random, 401, 0.9)
        record = replace(clean, outputs={BENT: clean.outputs[BENT] + noise})
        found = fm.fit(fm.catalog.one_joint(), "joint_stiffness", records=[record], starts=0, check=False, **CHOICE)
        gain, deviation = found.gains[BENT]
        miss = (found.values["joint_stiffness"][0] - STIFFNESS) / found.deviations["joint_stiffness"][0]
        squares.append([miss**2, ((gain - 1.0) / deviation) ** 2])
    assert (np.mean(squares, axis=0) > 0.3).all() and (np.mean(squares, axis=0) < 2.1).all(), np.mean(squares, axis=0)
