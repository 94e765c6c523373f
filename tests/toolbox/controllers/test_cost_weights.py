"""Cost weights of regulators: Riccati equations that are hard to solve, costs of torques and motor rates."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

import flexman_gym as fm
from flexman_gym.common.arrays import Array
from flexman_gym.model.state_space import LinearModel, discretize
from flexman_gym.simulation.physical_parameters import varied_model
from flexman_gym.toolbox.controllers.arm_scales import ArmScales
from flexman_gym.toolbox.controllers.cost_weights import CostWeights, NamedWeights, parse_weights

from oracles.assertions import refusal

PERIOD = 0.02
Z, Y = (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)


def manipulator(payload):
    """Arm of 15 m for zero gravity, 410 kg, with a payload (kg) that may outweigh it."""
    carbon = (110e9, 30e9, 1600.0)
    links = [fm.Link.tube(6.4, 0.33, 0.0025, carbon), fm.Link.tube(7.0, 0.33, 0.0025, carbon)]
    joints = [fm.Joint(axis, rotor_inertia=100.0, stiffness=1e6, damping=2e3, torque_limit=1e3) for axis in (Z, Y)]
    arm = fm.Arm(links, joints, fm.Payload(500.0, np.diag([80.0, 80.0, 80.0]).tolist(), (0.5, 0.0, 0.0)))
    return varied_model(fm.build_model(arm, 2, 2), payload_mass=payload), np.full(2, 1e3)


def closed_loop(model, limits, weights, period=PERIOD, angle=0.3) -> tuple[Array, Array, LinearModel]:
    """Gain, sampled transition under it, and linear model at a posture with equal motor angles (rad)."""
    posture = np.full(model.n_joints, angle)
    linear = fm.linearize(model, state=fm.rest_state(model, posture), torque=fm.holding_torques(model, posture))
    gain = weights.gain(linear, model.motor_columns, limits, period)
    transition, inputs = discretize(linear.A, linear.B, period)
    return gain, transition - inputs @ gain, linear


@pytest.mark.parametrize("kind", [CostWeights, NamedWeights])
@pytest.mark.parametrize("angle", [0.0, 0.3])
@pytest.mark.parametrize("payload", [0.0, 10.0, 1000.0, 50000.0])
def test_regulators_of_payloads_that_outweigh_the_arm_are_stable(payload, angle, kind):
    """Stretched with 50 t, the matrix pencil of the equation is too ill-conditioned for the solver of SciPy."""
    model, limits = manipulator(payload)
    loop = closed_loop(model, limits, kind(0.3, 1.5, 0.5), angle=angle)[1]
    assert np.abs(np.linalg.eigvals(loop)).max() < 1.0


@pytest.mark.parametrize("period", [0.002, 0.05])
def test_the_gain_satisfies_the_riccati_equation(period):
    """X = A' X (A - B K) + C' C, with X from the sum of the costs of all periods under the gain K."""
    model, limits = manipulator(500.0)
    weights = CostWeights(0.3, 1.5, 0.5, (0.1, 0.2), 0.4)
    gain, loop, linear = closed_loop(model, limits, weights, period)
    outputs = weights.outputs(linear, model.motor_columns)
    cost = outputs.T @ outputs + gain.T @ np.diag((0.4 * limits) ** -2.0) @ gain
    total, power = cost, loop
    for _ in range(30):
        total, power = total + power.T @ total @ power, power @ power
    transition, inputs = discretize(linear.A, linear.B, period)
    best = np.linalg.solve(np.diag((0.4 * limits) ** -2.0) + inputs.T @ total @ inputs, inputs.T @ total @ transition)
    assert np.abs(best - gain).max() <= 1e-7 * np.abs(gain).max()


def test_the_gain_of_a_mapping_is_that_of_the_solver_of_scipy():
    model, limits = manipulator(20.0)
    first, second = (closed_loop(model, limits, kind(0.3, 1.5, 0.5))[0] for kind in (CostWeights, NamedWeights))
    assert np.abs(first - second).max() <= 1e-6 * np.abs(second).max()


def test_the_design_named_has_the_gain_of_torques_in_newton_metres_to_the_bit():
    """The cost of torques as fractions of the limits is not quite the identity; stored policies were trained so."""
    model, weights = manipulator(20.0)[0], NamedWeights(0.3, 1.5, 0.5)
    limits = np.array([1.0e3, 7.0])
    cost = np.diag(1.0 / limits**2) * np.outer(limits, limits)
    assert (cost != np.eye(2)).any()
    gain, _, linear = closed_loop(model, limits, weights)
    transition, inputs = discretize(linear.A, linear.B, PERIOD)
    outputs, scaled = weights.outputs(linear, model.motor_columns), inputs * limits
    total = solve_discrete_are(transition, scaled, outputs.T @ outputs, cost)
    expected = np.linalg.solve(np.eye(2) + scaled.T @ total @ scaled, scaled.T @ total @ transition)
    assert np.array_equal(gain, limits[:, None] * expected)


def test_torques_below_the_limits_cost_more_and_are_smaller():
    """Half of the limits at unit cost is the regulator of an arm with half the limits."""
    model, limits = manipulator(100.0)
    weights = CostWeights(0.3, 1.5, 0.5)
    half = closed_loop(model, limits, weights._replace(torque=0.5))[0]
    assert np.array_equal(half, closed_loop(model, 0.5 * limits, weights)[0])
    assert np.abs(half).max() < np.abs(closed_loop(model, limits, weights)[0]).max()


def test_motor_rates_are_outputs_only_where_they_cost():
    model, _ = manipulator(100.0)
    linear = fm.linearize(model)
    d, motors = model.n_dof, model.motor_columns
    free, bounded = (CostWeights(0.3, 1.5, 0.5, rate).outputs(linear, motors) for rate in (np.inf, (0.1, 0.2)))
    assert free.shape == (8, 2 * d) and np.array_equal(bounded[:8], free)
    expected = np.zeros((2, 2 * d))
    expected[[0, 1], d + motors] = 10.0, 5.0
    assert bounded[8:] == pytest.approx(expected)


@pytest.mark.parametrize("generous", [0.5, 1.0, 4.0])
def test_motor_rates_cost_less_where_their_limits_are_generous(generous):
    """A planned rate of five times that of a slew is usual; below it, the rate of unit cost is in proportion to it."""
    model, slow = fm.build_model(fm.catalog.one_joint(), 1), ArmScales((np.inf,), vibration=1.0, torque_slew=2.0)
    rate = generous * 5.0 * slow.slew_rate
    result = CostWeights.default(model, slow._replace(rates=(rate,))).motor_rate
    assert result == pytest.approx((0.3 * rate * max(1.0, generous) ** 2,))
    assert CostWeights.default(model, slow).motor_rate == (np.inf,)


def test_weights_are_given_by_name():
    model = fm.build_model(fm.catalog.one_joint(), 1)
    scales, named = ArmScales.of(model, (1.0,)), ArmScales.of_design_named(model)
    given = {"tip": 0.1, "tip_speed": 0.7, "motor": 0.35}
    assert parse_weights(None, scales) is None
    assert parse_weights(given, scales) == CostWeights(0.1, 0.7, 0.35)
    assert isinstance(parse_weights(given, named), NamedWeights)
    assert parse_weights(given, named) == (0.1, 0.7, 0.35, np.inf, 1.0)
    more = parse_weights({**given, "torque": 0.5, "motor_rate": 2.0}, scales)
    assert more == CostWeights(0.1, 0.7, 0.35, 2.0, 0.5)
    assert refusal(parse_weights, {"tip": 0.1, "torque": 1.0}, scales).endswith(
        "give a mapping with tip (m), tip_speed (m/s) and motor (rad)"
    )
    assert refusal(parse_weights, {**given, "torque": 0.0}, scales).startswith("base.weights.torque: 0.0")
