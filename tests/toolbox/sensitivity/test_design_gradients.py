"""Metrics of a design: the values of the arm built anew, and gradients that differences confirm."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

import flexman_gym as fm
from flexman_gym.model.dynamics import RICHARDSON
from flexman_gym.toolbox.sensitivity.design_gradients import (
    SOFT_POWER,
    SPEED_TIME,
    DesignLoop,
    DesignModel,
    divide_links,
    resized,
)

FORCE = np.array([0.3, 2.0, -5.0])
STEP = 2e-4  # of the differences


def arm_of_two_kinds():
    """A strip with a lumped mass and a tube, on a geared and a direct joint, under gravity; both kinds of damping."""
    motor = fm.Motor(gear_ratio=50.0, torque_constant=0.05, rotor_inertia=2e-5, current_limit=4.0)
    joints = (fm.Joint((0, 0, 1), stiffness=80.0, motor=motor), fm.Joint((0, -1, 0), 0.02, 60.0, torque_limit=6.0))
    links = (
        fm.Link.strip(
            0.5, 0.04, 0.006, masses=(fm.LumpedMass(0.05, 0.3),), orientation=[[0, 0, -1], [0, 1, 0], [1, 0, 0]]
        ),
        fm.Link.tube(0.4, 0.02, 0.002),
    )
    damping = {"stiffness_proportional_damping": 1e-4, "modal_damping_ratio": (0.01, 0.02)}
    return divide_links(fm.Arm(links, joints, fm.Payload(0.2), (0, 0, -9.81), **damping), 2)


POSTURES = np.array([[0.2, -0.5], [0.4, 0.9]])
LOOP = DesignLoop(np.array([0.4, 0.3]), np.array([10.0, 6.0]), np.array([4.0, 2.0]), 1e-5)


@pytest.fixture(scope="module")
def design():
    return DesignModel(arm_of_two_kinds(), POSTURES)


@pytest.fixture(scope="module")
def x():
    return np.random.default_rng(1).uniform(-0.4, 0.3, 6)


def rebuilt(design, x):
    return fm.build_model(resized(design.arm, np.exp(x[:4]), np.exp(x[4:])), elements=1)


def test_values_are_those_of_the_arm_built_anew(design, x):
    """Soft minimum of all frequencies, 0.2 % below the first at most; masses and static deflection."""
    model = rebuilt(design, x)
    expected = fm.frequencies(model, POSTURES, lock_joints=True)
    soft = expected.min() * ((expected.min() / expected) ** (2 * SOFT_POWER)).sum() ** (-0.5 / SOFT_POWER)
    assert design.frequency(x)[0] == pytest.approx(soft, rel=1e-10) and 0.998 < soft / expected.min() <= 1.0
    parts = [sum(part.mass for part in link.sections) for link in model.arm.links]
    assert design.link_masses(x)[0] == pytest.approx(parts)
    sags = []
    for posture in POSTURES:
        linear = fm.linearize(
            model, state=model.initial_state(posture), outputs=("tip",), inputs=("tip_force", "base_acceleration")
        )
        free = np.setdiff1d(np.arange(model.n_dof), model.motor_columns)
        load = linear.balance.forces[:, 2 * model.n_dof :] @ np.concatenate([FORCE, [0.0, 0.0, 9.81]])
        bent = np.linalg.solve(fm.stiffness_matrix(model)[np.ix_(free, free)], load[free])
        sags.append(linear.C[:, free] @ bent @ FORCE / np.linalg.norm(FORCE))
    assert design.deflection(x, FORCE)[0] == pytest.approx(np.mean(sags), rel=1e-9)


def test_the_settling_time_leaves_the_residual_in_a_simulation_of_the_loop(design, x):
    """Integral by Simpson's rule of squared tip error and speed of the rebuilt arm, exact from sample to sample."""
    single = DesignModel(design.arm, POSTURES[:1])
    shares = np.log([0.5, 0.6, 0.8, 0.7])
    time = single.settling_time(np.concatenate([x, shares]), LOOP)[0]
    model, gears = rebuilt(design, x), np.exp(x[4:])
    weightless = replace(model, constants=model.constants._replace(gravity=np.zeros(3)))
    A, B, C, _ = fm.linearize(weightless, POSTURES[0], outputs=("tip", "tip_velocity"))
    C[3:] *= SPEED_TIME
    d, motors = model.n_dof, model.motor_columns
    gain = np.zeros((2, 2 * d))
    gain[[0, 1], motors] = LOOP.stiffness * gears * np.exp(shares[:2])
    gain[[0, 1], d + motors] = LOOP.damping * gears**2 * np.exp(shares[2:])
    start = np.zeros((2 * d, 2))
    for i in range(2):
        start[[i, motors[i]], i] = LOOP.slews[i]
    period, samples = 0.002, 6001
    step, state, squares = expm(period * (A - B @ gain)), expm(time * (A - B @ gain)) @ start, []
    for _ in range(samples):
        squares.append(((C @ state) ** 2).sum())
        state = step @ state
    weights = np.r_[1.0, np.tile([4.0, 2.0], samples // 2)[:-1], 1.0] * period / 3.0
    assert squares[-1] < 1e-9 * squares[0]
    assert weights @ squares == pytest.approx(LOOP.residual, rel=1e-5)


@pytest.mark.parametrize("metric", ["frequency", "deflection", "link_masses", "settling_time"])
def test_gradients_are_those_of_differences(metric, design, x):
    """Of order six, along three directions; with two postures, gravity, gears, and gains for the settling time."""
    at = np.concatenate([x, np.log([0.5, 0.6, 0.8, 0.7])]) if metric == "settling_time" else x
    directions = np.random.default_rng(2).normal(size=(3, len(at)))

    def value(each):
        arguments = {"deflection": (FORCE,), "settling_time": (LOOP, 2.0)}.get(metric, ())
        return getattr(design, metric)(each, *arguments)

    slopes = [
        sum(
            w / (2.0 * k * STEP) * (value(at + k * STEP * each)[0] - value(at - k * STEP * each)[0])
            for k, w in RICHARDSON
        )
        for each in directions
    ]
    exact = directions @ value(at)[1].T
    assert np.abs(exact - slopes).max() < 1e-6 * np.abs(exact).max()


def test_a_gear_changes_rotor_and_torque_limit_with_its_motor():
    given = arm_of_two_kinds()
    arm = resized(given, np.ones(4), [2.0, 0.5])
    geared, direct = arm.joints
    assert geared.motor.gear_ratio == 100.0 and geared.torque_limit == 2.0 * given.joints[0].torque_limit
    assert geared.rotor_inertia == pytest.approx(4.0 * given.joints[0].rotor_inertia)
    assert direct.rotor_inertia == 0.005 and direct.torque_limit == 3.0
