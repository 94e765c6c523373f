"""Linear models against frequencies, closed forms, another library and differences of the accelerations."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.linalg import expm

import flexman_gym as fm
from flexman_gym.model.dynamics import inertial_forces, inertial_jacobian

from oracles.chains import QUICK, pinocchio_model, samples

ANGLES = (0.3, -0.7, 1.1)


def sprung_2r(**arm):
    """Two thin links with springs in their joints, reduced to three modes a link."""
    return fm.build_model(fm.catalog.planar_2r(joint_stiffness=80.0, **arm), modes=3)


def pendulum(angle, gravity=9.81):
    """Linear model of a rigid link on a horizontal axis at an angle (rad) below the horizontal, and m g L_c / J."""
    arm = fm.catalog.one_link(axis=(0.0, 1.0, 0.0), rotor_inertia=0.2, gravity=(0.0, 0.0, -gravity))
    model, link = fm.build_model(arm, flexible_links=False), arm.links[0]
    rod = link.mass * link.length**2 / 3 + link.density * link.length * link.second_moment_y
    return fm.linearize(model, [angle]), link.mass * gravity * link.length / 2 / (rod + 0.2)


@pytest.mark.parametrize("modes", [None, 4])
def test_eigenvalues_are_the_frequencies(modes):
    model = fm.build_model(fm.catalog.paper_rrr(), modes=modes)
    d, n = model.n_dof, model.n_joints
    linear = fm.linearize(model, ANGLES)
    assert [part.shape for part in linear] == [(2 * d, 2 * d), (2 * d, n), (3, 2 * d), (3, n)]
    squares = np.sort(-np.linalg.eigvals(linear.A[d:, :d]).real)
    assert np.sqrt(squares[n:]) / (2 * np.pi) == pytest.approx(fm.frequencies(model, ANGLES)[n:], rel=1e-6)
    assert (linear.A[d:, d:] == 0.0).all()
    assert (linear.A[:d] == np.eye(d, 2 * d, d)).all() and (linear.B[:d] == 0.0).all() and (linear.D == 0.0).all()


@pytest.mark.parametrize("payload", [None, fm.Payload(1.5)])
def test_a_modal_damping_ratio_is_that_of_every_mode_of_a_clamped_link(payload):
    ratio, heavy = 0.03, 1e12  # a rotor that does not move clamps the link
    arm = fm.catalog.one_link(rotor_inertia=heavy, payload=payload, modal_damping_ratio=ratio)
    model = fm.build_model(arm)
    d = model.n_dof
    kept = np.r_[1:d, d + 1 : 2 * d]
    roots = np.linalg.eigvals(fm.linearize(model).A[np.ix_(kept, kept)])
    assert (-roots.real / np.abs(roots)) == pytest.approx(np.full(2 * d - 2, ratio), rel=1e-6)


@pytest.mark.parametrize(("angle", "sign"), [(np.pi / 2, -1.0), (-np.pi / 2, 1.0)])
def test_a_pendulum_swings_when_it_hangs_and_falls_when_it_stands(angle, sign):
    linear, square = pendulum(angle)
    assert linear.A[1, 0] == pytest.approx(sign * square, rel=1e-12)
    roots = np.linalg.eigvals(linear.A)
    root = np.sqrt(square) * (1j if sign < 0 else 1.0)
    assert sorted(roots, key=lambda value: value.real + value.imag) == pytest.approx([-root, root], rel=1e-12)


def test_a_level_pendulum_has_no_stiffness():
    linear, square = pendulum(0.0)
    assert abs(linear.A[1, 0]) <= 1e-12 * square


@pytest.mark.slow
@settings(QUICK)
@given(samples())
def test_columns_of_b_are_those_of_the_inverse_mass_matrix(sample):
    (x, v), torque = sample.state(), sample.torque()
    model, state = sample.model, np.r_[x, v]
    linear, mass = fm.linearize(model, state=state, torque=torque), fm.mass_matrix(sample.model, state)
    scale = np.sqrt(np.diag(mass))
    unit = np.zeros((model.n_dof, model.n_joints))
    unit[model.motor_columns, np.arange(model.n_joints)] = 1.0
    assert (
        np.abs((mass @ linear.B[model.n_dof :] - unit) / scale[:, None]).max()
        <= 1e-9 * np.abs(unit / scale[:, None]).max()
    )
    # the recursion, at rest and without gravity, where nothing cancels
    weightless = replace(sample, arm=replace(sample.arm, gravity=(0.0, 0.0, 0.0))).model
    rest = weightless.initial_state(x[: model.n_joints])
    result = fm.linearize(weightless, x[: model.n_joints]).B[model.n_dof :]
    expected = np.transpose([fm.acceleration(weightless, rest, row) for row in np.eye(model.n_joints)])
    rounding = np.finfo(float).eps * np.linalg.cond(mass / np.outer(scale, scale))
    largest = np.abs(scale[:, None] * expected).max()
    assert np.abs(scale[:, None] * (result - expected)).max() <= max(1e-9, 10 * rounding) * largest


@pytest.mark.slow
@settings(QUICK)
@given(samples())
def test_a_holds_the_slopes_of_the_compiled_accelerations(sample):
    """As forces, M times the accelerations: the slope in a random direction, differenced twice for order four."""
    (x, v), torque, model = sample.state(), sample.torque(), sample.model
    state, d = np.r_[x, v], sample.model.n_dof
    linear = fm.linearize(model, state=state, torque=torque)
    mass = fm.mass_matrix(model, state)
    scale = np.sqrt(np.diag(mass))
    turn = np.random.default_rng(sample.seed + 2).uniform(-1.0, 1.0, 2 * d)
    turn[:d] *= scale.min() / scale  # metres and radians of fine elements weigh alike
    turn[d:] *= scale.min() / scale

    def difference(h):
        ends = [fm.acceleration(model, state + sign * h * turn, torque) for sign in (1.0, -1.0)]
        return (ends[0] - ends[1]) / (2 * h)

    expected = (4 * difference(1e-3) - difference(2e-3)) / 3
    forces = mass @ (linear.A[d:] @ turn - expected) / scale
    least = np.abs(scale * turn[d:]).max()  # what a slope of one a second would be: some arms have none
    assert np.abs(forces).max() <= 1e-6 * np.abs(scale * expected).max() + 1e-9 * least


@pytest.mark.slow
@settings(QUICK)
@given(samples())
def test_the_jacobian_of_inertial_forces_has_the_identities_of_mechanics(sample):
    """Without gravity the forces h are quadratic in the speeds, and v h is half of v (dM/dt) v, the rate of energy."""
    (x, v), d = sample.state(), sample.model.n_dof
    model = replace(sample, arm=replace(sample.arm, gravity=(0.0, 0.0, 0.0))).model
    rest, forces = np.zeros(d), inertial_forces(model)
    h = forces(x, v, rest)
    moving, pushed = (inertial_jacobian(model, np.array([x, *each])) for each in ((v, rest), (rest, v)))
    by_speed, by_place, mass = moving[:d, d : 2 * d], pushed[:d, :d], pushed[:d, 2 * d :]
    rounding = 1e-12 * np.abs(v).max() * (np.abs(mass) @ np.abs(v))
    assert (np.abs(by_speed @ v - 2.0 * h) <= rounding).all()
    assert (np.abs(mass @ v - forces(x, rest, v)) <= 1e-12 * (np.abs(mass) @ np.abs(v))).all()
    assert abs(v @ h - v @ by_place @ v / 2.0) <= rounding @ np.abs(v)


@pytest.mark.slow
@settings(QUICK)
@given(samples(flexible_links=False, flexible_joints=False))
def test_the_rigid_limit_is_pinocchio(sample):
    pin = pytest.importorskip("pinocchio")
    model = pinocchio_model(pin, sample.arm)
    (x, v), torque, d = sample.state(), sample.torque(), sample.model.n_dof
    linear = fm.linearize(sample.model, state=np.r_[x, v], torque=torque)
    data = model.createData()  # owns the slopes
    expected = pin.computeABADerivatives(model, data, x, v, torque)
    for result, slopes in zip((linear.A[d:, :d], linear.A[d:, d:], linear.B[d:]), expected, strict=True):
        least = 1e-4  # one joint without gravity has slopes of nothing but rounding
        assert np.abs(result - slopes).max() <= 1e-10 * max(np.abs(slopes).max(), least)


def test_the_linear_response_is_left_by_the_square_of_the_amplitude():
    model, duration = sprung_2r(stiffness_proportional_damping=1e-4), 0.2
    linear, d = fm.linearize(model, (0.3, 0.8)), model.n_dof
    size = 2 * d + model.n_joints
    flow = np.zeros((size, size))
    flow[: 2 * d] = np.hstack([linear.A, linear.B])
    rest, torque = model.initial_state((0.3, 0.8)), np.array([0.5, -0.2])
    rates = np.zeros(2 * d)
    rates[d + model.motor_columns] = (0.5, 1.0)
    simulator = fm.Simulator(model, "dop853", step=None, control_period=duration, rtol=1e-10, atol=1e-12)
    gaps = []
    for amplitude in (0.2, 0.1, 0.05):
        simulator.reset(state=rest + amplitude * rates)
        start = simulator.tip.copy()
        assert simulator.step(amplitude * torque) == "ok"
        response = (expm(duration * flow) @ np.r_[amplitude * rates, amplitude * torque])[: 2 * d]
        gaps.append(np.linalg.norm(simulator.tip - start - linear.C @ response))
    assert gaps[-1] < 0.1 * np.linalg.norm(linear.C @ response)
    assert np.divide(gaps[:-1], gaps[1:]) == pytest.approx([4.0, 4.0], rel=0.1)


@pytest.mark.slow
@settings(QUICK)
@given(samples())
def test_c_is_the_slope_of_the_tip(sample):
    (x, v), model = sample.state(), sample.model
    linear = fm.linearize(model, state=np.r_[x, v])
    assert (linear.C[:, model.n_dof :] == 0.0).all()
    result, expected = linear.C[:, : model.n_dof] @ v, sample.chain.tip_velocity(x, v)
    assert np.abs(result - expected).max() <= 1e-9 * np.abs(linear.C[:, : model.n_dof] * v).max()


@pytest.mark.parametrize("rate", [0.0, 0.004, -0.02, 50.0])
def test_coulomb_friction_has_no_slope_but_where_it_is_asked_for(rate):
    """The smoothed law c tanh(rate / r) has the slope c / (r cosh^2(rate / r)), a damper of the motor."""
    link, coulomb, width = fm.Link.strip(0.5, 0.04, 0.003), 2.0, 0.01
    joint = fm.Joint((0.0, 0.0, 1.0), 0.02, 60.0, coulomb_rate=width)
    smooth, rubbing = (
        fm.build_model(fm.Arm([link], [replace(joint, coulomb_friction=each)])) for each in (0.0, coulomb)
    )
    state, motor = np.zeros(2 * smooth.n_dof), smooth.n_dof + smooth.motor_columns[0]
    state[motor] = rate
    plain = fm.linearize(smooth, state=state)
    assert np.array_equal(fm.linearize(rubbing, state=state).A, plain.A)
    assert np.array_equal(fm.linearize(rubbing, state=state, friction="sliding").A, plain.A)
    change = fm.linearize(rubbing, state=state, friction="at rest").A - plain.A
    expected = np.zeros_like(change)
    slope = coulomb / width / np.cosh(min(abs(rate / width), 300.0)) ** 2
    expected[smooth.n_dof :, motor] = -slope * np.linalg.inv(fm.mass_matrix(smooth, state))[:, smooth.motor_columns[0]]
    assert change == pytest.approx(expected, rel=1e-6, abs=1e-9 * np.abs(plain.A).max())
