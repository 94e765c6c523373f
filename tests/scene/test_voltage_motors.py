"""Tests of motors with a voltage input: steady speed, time constant and energy in closed form."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from scipy.integrate import simpson

import flexman_gym as fm

Z = (0.0, 0.0, 1.0)
MOTOR = fm.Motor(gear_ratio=70.0, torque_constant=7.68e-3, rotor_inertia=3.9e-7, efficiency=0.6, resistance=2.6,
                 back_emf_constant=7.5e-3, voltage_limit=10.0)  # fmt: skip
REST = fm.Initial((0.0,), (0.0,))
BAR = fm.Link.rod(0.3, 0.01)


def spin_up(motor, friction=0.0, volts=6.0, duration=1.0):
    """Return the motion of a rigid bar from rest at a constant voltage, and its moment of inertia at the joint."""
    arm = fm.Arm([BAR], [fm.Joint(Z, viscous_friction=friction, motor=motor)])
    choice = fm.ModelChoice(False, 1)
    torque = fm.ConstantTorque((motor.torque_per_volt * volts,))
    scene = fm.Scene(arm, choice, torque, REST, duration=duration, output_step=duration / 1000)
    run = fm.simulate(scene, method="dop853", rtol=1e-10, atol=1e-12)
    model = fm.build_model(arm, flexible_links=False)
    return run, float(fm.mass_matrix(model, np.zeros(2))[0, 0])


def test_speed_follows_the_closed_form():
    """The speed is V kt n e / (R b + kt ke n^2 e) (1 - exp(-t / T)) with T = J R / (R b + kt ke n^2 e)."""
    friction, volts = 0.015, 6.0
    run, inertia = spin_up(MOTOR, friction, volts)
    n, kt, ke, e, resistance = 70.0, 7.68e-3, 7.5e-3, 0.6, 2.6
    divisor = resistance * friction + kt * ke * n**2 * e
    steady, constant = volts * kt * n * e / divisor, inertia * resistance / divisor
    exact = steady * (1.0 - np.exp(-run.time / constant))
    np.testing.assert_allclose(run.states[:, 1], exact, atol=1e-7 * steady)


def test_energy_of_a_spin_up_is_half_heat_and_half_motion():
    """Without friction and gear losses, half of the electrical energy of a spin-up is heat of the winding."""
    motor, volts = replace(MOTOR, efficiency=1.0, back_emf_constant=None), 6.0
    run, inertia = spin_up(motor, volts=volts, duration=3.0)
    current = (volts - motor.torque_constant * 70.0 * run.states[:, 1]) / motor.resistance
    electrical, heat = simpson(volts * current, x=run.time), simpson(motor.resistance * current**2, x=run.time)
    kinetic = 0.5 * inertia * run.states[-1, 1] ** 2
    assert heat == pytest.approx(kinetic, rel=1e-4)
    assert electrical == pytest.approx(2.0 * kinetic, rel=1e-4)
    assert run.work[-1] - run.dissipation[-1] == pytest.approx(kinetic, rel=1e-9)


def test_voltage_actions_are_fractions_of_the_voltage_limit():
    arm = fm.Arm([BAR], [fm.Joint(Z, motor=MOTOR)])
    env = gym.make("FlexOne-v0", arm=arm, actions="voltage", control_period=0.002, gains={"stiffness": [1.0],
                   "damping": [0.1]})  # fmt: skip
    assert env.unwrapped.torque_limit.tolist() == [MOTOR.torque_per_volt * 10.0]
    env.reset(seed=0)
    simulator = env.unwrapped.simulator
    start = simulator.state[1]
    for _ in range(200):
        env.step(np.array([0.3]))
    damping, inertia = MOTOR.back_emf_damping, fm.mass_matrix(simulator.model, np.zeros_like(simulator.state))[0, 0]
    steady = MOTOR.torque_per_volt * 3.0 / damping
    exact = steady + (start - steady) * np.exp(-0.4 * damping / inertia)
    assert simulator.state[simulator.model.n_dof] == pytest.approx(exact, rel=1e-2)


def test_the_torque_limit_is_the_lower_one_of_current_and_voltage():
    stall, ampere = MOTOR.torque_per_volt * 10.0, MOTOR.torque_per_ampere
    for current, expected in ((1.0, min(stall, ampere)), (1e3, stall)):
        assert replace(MOTOR, current_limit=current).joint_torque_limit == pytest.approx(expected)
    assert ampere < stall == MOTOR.stall_torque
    assert replace(MOTOR, voltage_limit=None, current_limit=1.0).joint_torque_limit == ampere


def test_voltage_actions_saturate_at_the_torque_of_the_current_limit():
    limited = replace(MOTOR, current_limit=1.0)
    env = gym.make("FlexOne-v0", arm=fm.Arm([BAR], [fm.Joint(Z, motor=limited)]), actions="voltage",
                   info_keys=["action"])  # fmt: skip
    env.reset(seed=0)
    for fraction in (0.1, 1.0):
        info = env.step(np.array([fraction]))[-1]
        torque = min(fraction * limited.stall_torque, limited.joint_torque_limit)
        assert info["action"][0] * limited.joint_torque_limit == pytest.approx(torque, rel=1e-6)


def test_actions_of_another_input_are_refused():
    current = replace(MOTOR, resistance=None, back_emf_constant=None, voltage_limit=None, current_limit=1.0)
    for motor, actions in ((MOTOR, "current"), (current, "voltage")):
        with pytest.raises(ValueError, match=f"actions: '{actions}'"):
            gym.make("FlexOne-v0", arm=fm.Arm([BAR], [fm.Joint(Z, motor=motor, torque_limit=motor.joint_torque_limit)]),
                     actions=actions)  # fmt: skip


@pytest.mark.parametrize("field", ["back_emf_constant", "voltage_limit"])
def test_voltage_needs_a_resistance(field):
    with pytest.raises(ValueError, match=rf"Motor\.{field}.*resistance"):
        fm.Motor(10.0, 0.1, 1e-6, **{field: 1.0})


def test_files_keep_the_winding(tmp_path):
    arm = fm.Arm([BAR], [fm.Joint(Z, motor=MOTOR)])
    scene = fm.Scene(arm, fm.ModelChoice(True, 1), fm.ConstantTorque((0.0,)), REST, duration=0.1, output_step=0.1)
    scene.save(tmp_path / "scene.json")
    assert fm.Scene.load(tmp_path / "scene.json") == scene
