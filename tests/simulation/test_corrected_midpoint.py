"""Corrected midpoint rule: the linear map of a step, stability, order 4, reversibility, statics and ledger."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

import flexman_gym as fm
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.methods import METHODS, IteratedGauss
from flexman_gym.simulation.stability import amplification_factors, spectral_radii

CORRECTED = ["midpoint_corrected_2", "midpoint_corrected_3"]
SHARE = 1.0 / 6.0
SMALL = 1e-7  # amplitude at which quadratic terms are rounding


def step_matrix(mass, damping, stiffness, step, correction=SHARE):
    """Map of (x, v) over a step of M w + C v + K x = 0, written down with dense inverses."""
    size, g = len(mass), 0.5 * step
    filtered = np.linalg.inv(mass + g * damping + g * g * stiffness)
    zero, one = np.zeros((size, size)), np.eye(size)
    at_start = np.hstack([one, g * one]), np.hstack([zero, one])  # x0 + g v0 and v0
    first = -filtered @ (stiffness @ at_start[0] + damping @ at_start[1])  # accelerations of the midpoint rule
    middle = at_start[1] + g * first
    smooth = filtered @ mass @ filtered @ (mass @ first - 0.5 * damping @ middle)
    w = first + filtered @ (correction * step * step * stiffness @ smooth)
    return np.vstack([np.hstack([one, step * one]) + step * g * w, np.hstack([zero, one]) + step * w])


def arm_of_one_link(damping_ratio=0.0, joint_damping=0.0):
    """A flexible link on a flexible joint without weight: linear for small motions about rest."""
    arm = fm.catalog.one_link(rotor_inertia=0.05, joint_stiffness=30.0)
    return replace(
        arm,
        joints=[replace(arm.joints[0], damping=joint_damping)],
        modal_damping_ratio=damping_ratio,
        gravity=(0, 0, 0),
    )


def matrices(model):
    """Mass, damping and stiffness matrix (d, d) at rest."""
    state = np.zeros(2 * model.n_dof)
    return fm.mass_matrix(model, state), fm.damping_matrix(model), fm.stiffness_matrix(model)


def advanced(model, method, step, state, number):
    """State (2 d,) after a number of steps without torque."""
    batch = Batch(model, method, step, step)
    batch.reset(np.arange(1), state[None])
    for _ in range(number):
        batch.step(np.zeros((1, model.n_joints + 6)))
    return batch.state[0].copy()


@pytest.mark.parametrize("method", CORRECTED)
@pytest.mark.parametrize(("ratio", "joint"), [(0.0, 0.0), (0.02, 0.0), (0.3, 5.0)])
def test_a_small_step_is_the_linear_map(method, ratio, joint):
    model = fm.build_model(arm_of_one_link(ratio, joint), 2, 3)
    state = SMALL * np.random.default_rng(0).normal(size=2 * model.n_dof)
    for step in (1e-3, 1e-2, 0.1):
        expected = step_matrix(*matrices(model), step) @ state
        np.testing.assert_allclose(
            advanced(model, method, step, state, 1), expected, rtol=0.0, atol=1e-6 * abs(expected).max()
        )


@pytest.mark.parametrize("method", CORRECTED)
def test_the_amplification_factors_are_those_of_the_linear_map(method):
    for angle in (0.1, 1.0, 2.0, 30.0):
        matrix = step_matrix(np.eye(1), np.zeros((1, 1)), np.array([[angle**2]]), 1.0)
        expected = np.sort_complex(np.linalg.eigvals(matrix))
        np.testing.assert_allclose(np.sort_complex(amplification_factors(METHODS[method], angle)), expected, atol=1e-12)


def test_no_vibration_grows_whatever_its_frequency_and_damping():
    assert spectral_radii(METHODS[CORRECTED[0]], np.geomspace(1e-3, 1e5, 5000)).max() < 1.0 + 1e-12
    for ratio in (0.0, 0.005, 0.1, 1.0, 10.0, 1e4):
        for angle in np.geomspace(2e-3, 2e5, 300):
            matrix = step_matrix(np.eye(1), np.array([[2.0 * ratio * angle]]), np.array([[angle**2]]), 1.0)
            assert np.abs(np.linalg.eigvals(matrix)).max() < 1.0 + 1e-9, (ratio, angle)


def test_no_motion_grows_with_matrices_that_do_not_commute():
    """Random mass, damping and stiffness over ten powers of ten; an eigenvalue 1 that is double has rounding errors."""
    random = np.random.default_rng(0)
    for _ in range(500):
        size = random.integers(2, 6)
        mass, damping, stiffness = (
            (factor := random.normal(size=(size, size)) * 10.0 ** random.uniform(-3, 2, size)) @ factor.T
            for _ in range(3)
        )
        mass += 1e-6 * np.trace(mass) * np.eye(size)
        step = 10.0 ** random.uniform(-4, 1)
        radius = np.abs(np.linalg.eigvals(step_matrix(mass, damping, stiffness, step))).max()
        assert radius < 1.0 + 1e-6


def test_beyond_its_largest_correction_a_vibration_grows():
    """Stable while 4 a u / (1 + u)^3 <= 1 / u for all u = (omega h / 2)^2, that is a <= 27 / 16, at u = 2."""
    largest = 27.0 / 16.0
    for correction, grows in ((0.99 * largest, False), (1.01 * largest, True)):
        matrix = step_matrix(np.eye(1), np.zeros((1, 1)), np.array([[8.0]]), 1.0, correction)
        assert (np.abs(np.linalg.eigvals(matrix)).max() > 1.0 + 1e-9) == grows


@pytest.mark.parametrize("method", CORRECTED)
@pytest.mark.parametrize(("joint_damping", "order"), [(0.0, 4), (2.0, 2)])
def test_positions_after_a_release_from_rest_have_order_four_without_dampers(method, joint_damping, order):
    """Against the matrix exponential; dampers that do not commute leave order two."""
    model = fm.build_model(arm_of_one_link(0.0, joint_damping), 1, 1)
    mass, damping, stiffness = matrices(model)
    d = model.n_dof
    state = SMALL * np.r_[np.linspace(1.0, 2.0, d), np.zeros(d)]
    zero, one = np.zeros_like(mass), np.eye(d)
    system = np.block([[zero, one], [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)]])
    duration = 8.0 / np.abs(np.linalg.eigvals(system)).max()
    exact = (expm(system * duration) @ state)[:d]
    errors = [
        np.linalg.norm(advanced(model, method, duration / number, state, number)[:d] - exact) for number in (16, 32)
    ]
    assert np.log2(errors[0] / errors[1]) > order - 0.3


def test_rates_of_a_vibration_have_a_bounded_error_of_order_two():
    """The ratio of rate to position amplitude is omega (1 + (omega h)^2 / 12 + ...); the phase has order four."""
    for angle in (0.1, 0.05):
        matrix = step_matrix(np.eye(1), np.zeros((1, 1)), np.array([[angle**2]]), 1.0)
        ratio = np.sqrt(-matrix[1, 0] / matrix[0, 1])  # semi-axes of the ellipse of a free vibration
        assert ratio / angle - 1.0 == pytest.approx(angle**2 / 12.0, rel=0.01)
        assert np.arccos(0.5 * np.trace(matrix)) / angle - 1.0 == pytest.approx(0.0, abs=0.1 * angle**4)


@pytest.mark.parametrize("method", CORRECTED)
def test_undamped_motion_returns_when_the_rates_are_reversed(method):
    model = fm.build_model(arm_of_one_link(), 2, 3)
    d = model.n_dof
    state = SMALL * np.random.default_rng(1).normal(size=2 * d)
    there = advanced(model, method, 0.01, state, 50)
    there[d:] *= -1.0
    back = advanced(model, method, 0.01, there, 50)
    back[d:] *= -1.0
    np.testing.assert_allclose(back, state, rtol=0.0, atol=1e-5 * abs(there).max())


@pytest.mark.parametrize("method", CORRECTED)
def test_an_arm_at_rest_under_its_weight_stays(method):
    model = fm.build_model(fm.catalog.vertical_2r(), 2, 3)
    angles = [0.3, -0.4]
    simulator = fm.Simulator(model, method, 0.01, 0.02)
    state = fm.rest_state(model, angles)
    simulator.batch.reset(np.arange(1), state[None])
    for _ in range(25):
        assert simulator.step(fm.holding_torques(model, angles)) == "ok"
    np.testing.assert_allclose(simulator.state, state, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("method", CORRECTED)
def test_the_ledger_counts_the_power_of_the_correction(method):
    """A released link: without that power the residual is several per cent of the energy, with it a tenth of one."""
    model = fm.build_model(arm_of_one_link(0.005), 2, 3)
    state = np.zeros(2 * model.n_dof)
    state[model.elastic_columns(0)] = 0.02 * np.linspace(
        1.0, 0.2, model.elastic_columns(0).stop - model.elastic_columns(0).start
    )
    scale = 1.0 / np.sqrt(np.abs(state[: model.n_dof] @ fm.stiffness_matrix(model) @ state[: model.n_dof]))
    simulator = fm.Simulator(model, method, 0.01, 0.02)
    simulator.batch.reset(np.arange(1), 0.1 * scale * state[None])
    for _ in range(100):
        assert simulator.step([0.0]) == "ok"
    assert abs(simulator.energy_residual) < 0.01 * simulator.energy_turnover


@pytest.mark.slow
@pytest.mark.parametrize("prescribed", [False, True])
def test_the_arm_of_the_paper_moves_ten_times_closer_than_by_the_midpoint_rule(prescribed):
    """Steps of 2.5 ms of the flexible arm, against the Gauss method at 0.6 ms; also with a prescribed joint."""
    scene = replace(fm.catalog.paper_scene("ff"), duration=1.0)
    if prescribed:
        motion = [fm.Signal(0.2, 3.0, 0.0, 0.0), None, None]
        scene = replace(scene, torque=fm.ConstantTorque([0.0, 200.0, 100.0]), prescribed=motion)
    exact = fm.simulate(scene, method="gauss_3", step=0.000625).tip
    errors = [
        np.abs(fm.simulate(scene, method=name, step=0.0025).tip - exact).max()
        for name in ("midpoint_corrected_3", "midpoint_3")
    ]
    assert errors[0] < 0.1 * errors[1]


@pytest.mark.parametrize("iterations", [2, 3])
def test_a_vanishing_correction_leaves_the_midpoint_rule(iterations):
    """Of a large motion of the flexible arm: the geometry of the second iteration is that of the first one's result."""
    scene = replace(fm.catalog.paper_scene("ff"), duration=0.2)
    tiny = IteratedGauss("tiny", 2, "", iterations, correction=1e-13)
    states = [
        fm.simulate(scene, method=method, step=0.01).states[-1] for method in (tiny, METHODS[f"midpoint_{iterations}"])
    ]
    np.testing.assert_allclose(states[0], states[1], rtol=0.0, atol=1e-8 * np.abs(states[1]).max())
