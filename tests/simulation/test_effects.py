"""Effects: spinning rotors, friction, forces on the tip, a moving base and driven joints against the dense oracle."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings

import flexman_gym as fm
from flexman_gym.kernels import dynamics, inverse, layout, outputs

from oracles.affected import affected
from oracles.chains import QUICK

PRECISION = 1e-12  # of the forces of a difference, where each acceleration is weighed by its mass


def gap(case, x, actual, expected):
    """Force of a difference of accelerations over the largest inertial force, both weighed by masses."""
    mass = case.chain.mass_matrix(x)
    scale = np.sqrt(np.diag(mass))
    return np.abs(mass @ (actual - expected) / scale).max() / max(np.abs(scale * expected).max(), 1e-9)


@settings(QUICK, max_examples=50)
@given(affected())
def test_the_recursion_equals_the_dense_equations_with_every_effect(case):
    (x, v), work = case.sample.state(), layout.make_work(case.constants)
    expected, torques = case.expected(x, v)
    actual = np.zeros(case.model.n_dof)
    dynamics.accelerations(case.constants, work, x, v, case.drive(), actual)
    mass = case.chain.mass_matrix(x)
    free = np.ones(len(x), dtype=bool)
    free[case.model.motor_columns[list(case.held)]] = False
    scale = np.sqrt(np.diag(mass))
    weighed = (mass / np.outer(scale, scale))[np.ix_(free, free)]
    condition = np.linalg.cond(weighed) if free.any() else 1.0
    assert gap(case, x, actual, expected) <= max(PRECISION, np.finfo(float).eps * condition)
    largest = np.abs(scale * expected).max()
    np.testing.assert_allclose(
        scale * actual, scale * expected, rtol=0.0, atol=max(1e-9, 10 * np.finfo(float).eps * condition) * largest
    )
    for joint in case.held:
        result, size = work.motor_torque[joint], np.abs(mass @ actual).max() + np.abs(torques).max()
        assert abs(result - torques[joint]) <= max(1e-9, 10 * np.finfo(float).eps * condition) * size


@settings(QUICK, max_examples=20)
@given(affected())
def test_the_ledger_balances_with_every_effect(case):
    """Work of motors, tip force and base less what dampers and friction take is the change of energy."""
    duration = min(0.1, 30.0 / max(fm.frequencies(case.model).max(), 1.0))  # some periods of the fastest mode
    simulator = fm.Simulator(case.model, "dop853", None, duration, rtol=1e-11, atol=1e-12, prescribed=case.held)
    simulator.reset(state=np.concatenate(case.sample.state()))
    n, drive = case.model.n_joints, case.drive()
    held = np.isin(np.arange(n), case.held)
    torque, acceleration = np.where(held, 0.0, drive[:n]), np.where(held, drive[:n], 0.0)
    assert simulator.step(torque, acceleration, drive[n : n + 3], drive[n + 3 :]) == "ok"
    assert abs(simulator.energy_residual) <= 1e-8 * simulator.energy_turnover


@settings(QUICK)
@given(affected(held=False))
def test_kinetic_energy_and_inverse_dynamics_know_the_spinning_rotors(case):
    (x, v), d = case.sample.state(), case.model.n_dof
    mass = fm.mass_matrix(case.model, np.r_[x, v])
    np.testing.assert_allclose(mass, case.chain.mass_matrix(x), rtol=0.0, atol=1e-9 * np.abs(mass).max())
    row, work = np.zeros(layout.OUTPUTS), layout.make_work(case.constants)
    outputs.observe(case.constants, work, x, v, row)
    assert np.isclose(row[layout.KINETIC], v @ mass @ v / 2, rtol=1e-9)
    torque, demanded = case.sample.torque(), np.zeros(d)
    acceleration = fm.acceleration(case.model, np.r_[x, v], torque)
    inverse.inertial_forces(case.constants, work, x, v, acceleration, demanded)
    applied = replace(case.sample, arm=case.arm).applied(x, v, torque)
    motors = case.model.motor_columns
    for i, joint in enumerate(case.arm.joints):
        friction = joint.coulomb_friction * np.tanh(v[motors[i]] / joint.coulomb_rate)
        applied[motors[i]] -= joint.viscous_friction * v[motors[i]] + friction
    scale = np.sqrt(np.diag(mass))
    assert np.abs((demanded - applied) / scale).max() <= 1e-9 * np.abs(scale * acceleration).max()


def test_angular_momentum_with_spinning_rotors_is_the_torque_times_time():
    """About the vertical first axis every rotor now takes part: the momentum of all coordinates is 400 t."""
    scene = replace(fm.catalog.paper_scene("ff"), duration=1.0)
    model = fm.build_model(scene.arm, spinning_rotors=True)
    result = fm.simulate(scene, model, rtol=1e-9, atol=1e-11)
    for time, state in zip(result.time[::20], result.states[::20], strict=True):
        rates = state[model.n_dof :]
        mass = fm.mass_matrix(model, state)
        momentum = (mass[0] + mass[model.motor_columns[0]]) @ rates
        assert abs(momentum - 400.0 * time) < 1e-7
