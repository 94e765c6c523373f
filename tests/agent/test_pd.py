"""Control: the PD controller as a formula, and on the arm."""

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import flexman_gym  # noqa: F401  registers the environments
from flexman_gym.agent.base_controllers import make_base
from flexman_gym.agent.controller import Controller, EpisodeInfo
from flexman_gym.agent.pd import PD
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.envs.sensors import SENSORS
from flexman_gym.model.statics import holding_torques

numbers = st.floats(-10, 10)


@given(st.tuples(numbers, numbers, numbers, numbers))
def test_pd_is_linear_until_the_motors_saturate(values):
    readings = {"angle_errors": np.array(values[:2]), "motor_rates": np.array(values[2:])}
    expected = np.array([100.0, 200.0]) * readings["angle_errors"] - np.array([10.0, 20.0]) * readings["motor_rates"]
    for limit in (400.0, (400.0, 100.0)):
        pd = PD((100.0, 200.0), (10.0, 20.0), limit)
        action = pd.act(readings)
        assert action.dtype == np.float32
        np.testing.assert_allclose(action, np.clip(expected / np.array(limit), -1.0, 1.0), rtol=1e-6, atol=1e-7)
        many = pd.act({name: np.array([value, -value, value]) for name, value in readings.items()})
        np.testing.assert_array_equal(many, [action, -action, action])


def test_damping_brakes_the_motion_beside_that_of_the_posture():
    """A motor that turns as fast as its posture and where it is needs no torque, a resting one is pulled along."""
    pd, still = PD((100.0,), (10.0,), 400.0), np.zeros(1)
    readings = {"angle_errors": still, "motor_rates": np.array([3.0]), "goal_rates": np.array([3.0])}
    assert pd.act(readings) == [0.0] and pd.act(readings | {"motor_rates": still}) == pytest.approx([30.0 / 400.0])


def test_arms_that_come_later_change_nothing_for_those_before():
    model = resolve_fidelity(Configuration.from_keywords({"name": "FlexPlanar-v0"})).model
    postures, pd = np.array([[0.0, 0.0], [0.5, -0.8], [-0.7, 0.3]]), PD((1.0, 1.0), (0.0, 0.0), 12.0, model)
    for arm in range(3):
        pd.reset(np.array([arm]), EpisodeInfo(postures[arm : arm + 1], postures[arm : arm + 1], 0.02), arm + 1)
    held = np.array([holding_torques(model, posture) for posture in postures])
    still = {"angle_errors": np.zeros((3, 2)), "motor_rates": np.zeros((3, 2))}
    assert pd.act(still) == pytest.approx(held / 12.0, abs=1e-6)


@pytest.mark.parametrize("delay", [0, 2])
def test_the_damping_that_a_warning_names_is_the_most_that_it_does_not_warn_of(delay):
    """Of each motor its own: their rotors are not alike."""
    model = resolve_fidelity(Configuration.from_keywords({"name": "FlexPlanar-v0"})).model
    for motor in range(2):
        damping = np.zeros(2)
        damping[motor] = 1e3
        said = PD((1.0, 1.0), damping, 12.0).unstable(model, 0.01, delay)
        assert said.startswith(f"PD.damping[{motor}]: ")
        named = float(said.split("which is ")[1].split(" N m s/rad")[0])
        for part, silent in ((0.99, True), (1.01, False)):
            damping[motor] = part * named
            assert (PD((1.0, 1.0), damping, 12.0).unstable(model, 0.01, delay) == "") == silent


def test_pd_is_a_controller_and_reads_sensors_that_there_are():
    pd = PD((1.0,), (1.0,), 1.0)
    assert isinstance(pd, Controller) and set(pd.sensors) <= set(SENSORS)


def test_pd_takes_energy_out_of_a_swinging_arm_that_is_already_at_its_posture():
    env = gym.make("FlexRRR-v0").unwrapped
    start = np.array([0.2, -0.3, 0.4])
    observation, _ = env.reset(seed=0, options={"start": start, "goal_angles": start})
    pd = PD((811.0, 369.0, 2972.0), (854.0, 384.0, 349.0), env.torque_limit)
    for _ in range(25):
        observation, *_ = env.step(np.array([0.5, -0.5, 0.5], dtype=np.float32))
    disturbed = env.simulator.energy
    for _ in range(200):
        readings = {name: observation[place] for name, place in env.sensors.slices.items()}
        observation, *_ = env.step(pd.act(readings))
    assert env.simulator.energy < 0.5 * disturbed


def test_pd_with_gravity_holds_an_arm_at_rest_where_it_is():
    """What it adds is what holds the goal posture, of each arm its own; without it the arm sinks."""
    arms = gym.make_vec("FlexPlanar-v0", 3, "vector_entry_point", base="pd", autoreset_mode="Disabled").unwrapped
    postures = np.array([[0.0, 0.0], [0.5, -0.8], [-0.7, 0.3]])
    arms.reset(seed=0, options={"start": postures, "goal_angles": postures})
    for _ in range(100):
        *_, infos = arms.step(np.zeros((3, 2)))
    assert (infos["tip_error"] < 1e-6).all()  # actions are single precision
    held = np.array([holding_torques(arms.batch.model, posture) for posture in postures])
    assert arms.episodes.view.action == pytest.approx(held / arms.torque_limit, abs=1e-6)
    still = {"angle_errors": np.zeros(2), "motor_rates": np.zeros(2)}
    alone = make_base("pd", make_plant(arms.configuration, arms.batch.model))
    alone.reset(np.array([0]), EpisodeInfo(postures[1:2], postures[1:2], 0.02), 1)
    assert alone.act(still) == pytest.approx(held[1] / arms.torque_limit, abs=1e-6)
    arms.episodes.base.gravity_model = None
    for _ in range(100):
        *_, infos = arms.step(np.zeros((3, 2)))
    assert (infos["tip_error"] > 0.05).all()


@pytest.mark.parametrize(
    "arguments, field",
    [
        (((-1.0,), (1.0,), 400.0), "PD.stiffness[0]: -1.0 is not allowed; give a finite number >= 0"),
        (((1.0,), (float("nan"),), 400.0), "PD.damping[0]: nan is not allowed; give a finite number"),
        (((1.0,), (1.0, 2.0), 400.0), "PD.damping: (1.0, 2.0) is not allowed; give 1 numbers"),
        (((1.0,), (1.0,), 0.0), "PD.torque_limit: 0.0 is not allowed; give a finite number > 0"),
        (((1.0,), (1.0,), (1.0, 2.0)), "PD.torque_limit: (1.0, 2.0) is not allowed; give 1 numbers (N m)"),
    ],
)
def test_bad_gains_are_named(arguments, field):
    with pytest.raises(ValueError) as caught:
        PD(*arguments)
    assert field in str(caught.value)
    assert "\n" not in str(caught.value)
