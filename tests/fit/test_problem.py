"""Problem: residuals of records and their slopes, what of a record counts, and noise that is estimated beside them."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.fit.fit import _poor
from flexman_gym.fit.free import Free
from flexman_gym.fit.problem import Problem
from flexman_gym.fit.response import Response
from flexman_gym.fit.ringing import Ringing
from flexman_gym.model.instant import frequencies

from oracles.turned import BENT, CHOICE, PERIOD, STIFFNESS, STRAIN, sprung, turned

TIMES = PERIOD * np.arange(121)


def problem_of(*records, free="joint_stiffness", corner=""):
    arm = fm.catalog.one_joint()
    return Problem(Free(arm, free), [], [Response(arm, each, None) for each in records], CHOICE, corner)


@pytest.mark.parametrize("corner", ["", BENT])
def test_slopes_are_those_of_the_residuals(corner):
    """By stiffness, gain, offset and corner of a filter that is looked for, where none has the value that it starts at."""
    problem = problem_of(turned((BENT,), gains=(BENT,), offsets=(BENT,)), corner=corner)
    x = problem.start + np.array([0.1, 0.7, 2e-3, 0.3])[: len(problem.start)]
    assert len(x) == (4 if corner else 3)
    slopes = problem.evaluated(x)[1].copy()
    for i, unit in enumerate(np.eye(len(x))):
        ahead, behind = (problem.evaluated(x + sign * 1e-3 * unit)[0].copy() for sign in (1.0, -1.0))
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
    problem.solved(problem.start)
    assert [(part.record, part.name) for part in problem.parts] == [(0, BENT), (0, STRAIN), (1, BENT), (1, STRAIN)]
    expected = np.array([np.sqrt(10.0) * 1e-4, 3e-6] * 2)
    assert np.array([part.sigma[0] for part in problem.parts]) == pytest.approx(expected, rel=0.15)


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
    shown = Response(arm, record, None).signals(model, {"payload_mass": model.constants.payload_mass[:1]})[0]
    scene = fm.Scene(
        arm, fm.ModelChoice(flexible, (1, 1)), fm.SampledTorque(TIMES, torques, hold),
        fm.Initial([0.0] * 2, [0.0] * 2), TIMES[-1], PERIOD,
    )  # fmt: skip
    expected = fm.simulate(scene, rtol=1e-9, atol=1e-12).motor_angles
    assert shown.T == pytest.approx(expected, abs=1e-4 * np.ptp(expected))
    assert np.ptp(expected, axis=0).min() > 0.01


def test_one_frequency_that_is_wrong_is_a_poor_fit():
    """And one of which all are within three deviations is none."""
    arm = fm.catalog.one_joint()
    known = frequencies(fm.build_model(arm, **CHOICE), lock_joints=True)[:2]
    for factors, poor in (((1.0, 1.0), False), ((1.0, 1.012), False), ((1.0, 1.03), True), ((0.97, 1.0), True)):
        problem = Problem(Free(arm, "joint_stiffness"), [Ringing(known * factors)], [], CHOICE)
        assert _poor(problem, problem.start) == poor
