"""Tests of the map of a control period: bits of the batch, and derivatives against extrapolated differences."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.model.friction import coulomb_torques
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.integrator import default_step
from flexman_gym.simulation.period_map import PeriodMap, period_jacobian

PERIOD = (0.02, 3)


@pytest.fixture(scope="module")
def model():
    return fm.build_model(fm.catalog.paper_rrr(), modes=1)


def start(model):
    """Return a moving, deformed state and inputs."""
    state = model.initial_state([0.3, -0.5, 0.8])
    state += 0.01 * np.sin(1.0 + np.arange(len(state)))
    return state, np.array([40.0, -30.0, 20.0, 5.0, -4.0, 3.0, 0.1, -0.2, 0.3])


def batch_end(model, state, drive):
    batch = Batch(model, "midpoint_corrected_3", PERIOD[0] / PERIOD[1], PERIOD[0])
    batch.reset(np.zeros(1, dtype=np.int64), state[None])
    batch.step(drive[None])
    return batch.rows[0].copy(), batch.outputs[0].copy()


def test_values_have_the_bits_of_a_batch(model):
    state, drive = start(model)
    mapped = PeriodMap(model, fm.METHODS["midpoint_corrected_3"], PERIOD, [{}])
    d = model.n_dof
    end = mapped.advance(np.append(state, (0.0, 0.0)), drive, np.ones((1, 2 * d + 2)), np.zeros((1, 9)))
    row, outputs = batch_end(model, state, drive)
    assert np.array_equal(end.row, row)
    assert np.array_equal(end.outputs, outputs)
    assert not end.diverged


def test_the_jacobian_is_that_of_extrapolated_differences(model):
    state, drive = start(model)
    jacobian = period_jacobian(model, fm.METHODS["midpoint_corrected_3"], PERIOD, state, drive)
    given, size = np.append(state, drive), len(state)
    for column in (0, 4, size // 2, size - 1, size, size + 4, size + 8):
        results, largest = [], 4e-4 if column < size else 0.4  # rounding: a newton moves the arm by micrometres
        for step in (largest, largest / 2, largest / 4):
            moved = [given.copy(), given.copy()]
            moved[0][column] += step
            moved[1][column] -= step
            plus, minus = (batch_end(model, each[:size], each[size:])[0][:size] for each in moved)
            results.append((plus - minus) / (2.0 * step))
        first, second, third = results
        finer, coarser = (4.0 * third - second) / 3.0, (4.0 * second - first) / 3.0
        best = (16.0 * finer - coarser) / 15.0
        error = np.abs(best - finer).max() + 1e-14 * np.abs(plus).max() / step
        np.testing.assert_allclose(jacobian[:, column], best, atol=3.0 * error, rtol=1e-8)


@pytest.mark.parametrize("name", ["midpoint_3", "gauss_3"])
def test_the_map_tends_to_the_matrix_exponential_with_the_order_of_the_method(name):
    arm = fm.catalog.planar_2r(joint_stiffness=80.0)
    model, method = fm.build_model(arm, flexible_links=False), fm.METHODS[name]
    angles, period = (0.3, 0.8), 0.01
    state, torque = fm.rest_state(model, angles), fm.holding_torques(model, angles)
    exact = fm.linearize(model, state=state, torque=torque, inputs=("motor_torques", "tip_force")).discrete(period)
    expected, errors = np.hstack([exact.A, exact.B]), []
    for steps in (4, 8, 16):
        jacobian = period_jacobian(model, method, (period, steps), state, np.append(torque, np.zeros(6)))
        errors.append(np.abs(jacobian[:, : expected.shape[1]] - expected).max())
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx(method.order, abs=0.1)


def rubbing(model, coulomb):
    """Return the model with Coulomb friction that is smooth over a wide range of rates."""
    joints = tuple(replace(each, coulomb_friction=coulomb, coulomb_rate=0.5) for each in model.arm.joints)
    return fm.build_model(replace(model.arm, joints=joints), modes=1)


def test_a_discrete_model_is_the_derivative_of_a_step_of_the_simulator(model):
    """About a moving state with friction; of a sliding motor the friction is a torque that stays as it is."""
    state, drive = start(model)
    torque, period, d = drive[:3], 0.02, model.n_dof
    rubbed = rubbing(model, 5.0)
    constant = torque - coulomb_torques(rubbed, state[d + model.motor_columns])
    cases = ((rubbed, rubbed, torque, "at rest"), (rubbed, model, constant, "sliding"))
    for linearised, moved, applied, friction in cases:
        linear = fm.linearize(linearised, state=state, torque=torque, friction=friction, period=period)
        assert (linear.A.shape, linear.B.shape, linear.period) == ((2 * d, 2 * d), (2 * d, 3), period)
        simulator = fm.Simulator(moved, step=default_step(period), control_period=period)

        def end(change, simulator=simulator, applied=applied):
            simulator.reset(state=state + change[: 2 * d])
            assert simulator.step(applied + change[2 * d :]) == "ok"
            return simulator.state.copy()

        direction = np.cos(np.arange(2.0 * d + 3))
        direction[2 * d :] *= 100.0
        first, second = ((end(h * direction) - end(-h * direction)) / (2.0 * h) for h in (1e-4, 2e-4))
        expected, result = (4.0 * first - second) / 3.0, linear.A @ direction[: 2 * d] + linear.B @ direction[2 * d :]
        assert np.abs(result - expected).max() <= 1e-8 * np.abs(expected).max()
    assert np.array_equal(fm.linearize(model, state=state, torque=torque).C, linear.C)
