"""FlexCrane-v0: a loader crane whose load hangs from a universal joint without motors."""

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import condition_names
from flexman_gym.model.dynamics import tip_jacobian

ID, PASSIVE = "FlexCrane-v0", [3, 4]
GRAVITY = 9.81  # m/s^2
SHACKLE, ROPE = 0.05, 1.0  # m
DAMPER = 8.0  # N m s/rad; viscous friction of a passive joint
POSTURES = np.array([[0.0, 0.0, 0.0, 0.0, 0.0], [0.5, 0.6, -0.4, 0.0, 0.0], [-0.7, -0.3, 0.8, 0.0, 0.0]])


@pytest.fixture(scope="module")
def env():
    return gym.make(ID).unwrapped


def sideways(model, state):
    """Return the heights (2,), m, by which the tip rises for an angle of 1 rad of each passive joint; 0 if plumb."""
    columns = model.motor_columns[PASSIVE]
    return tip_jacobian(model, state[: model.n_dof])[2, columns]


def test_the_actions_are_torques_of_the_three_motors(env):
    assert env.action_space.shape == (3,) and env.torque_limit.tolist() == [2000.0, 10000.0, 5000.0, 0.0, 0.0]
    env.reset(seed=0)
    env.step(np.array([0.1, 0.2, 0.3], dtype=np.float32))
    np.testing.assert_allclose(env.episodes.motors.torques, [[200.0, 2000.0, 1500.0, 0.0, 0.0]], rtol=1e-6)


def test_torque_limits_hold_twice_the_load_at_full_reach():
    model = fm.build_model(fm.catalog.loader_crane(fm.Payload(200.0)))
    stretched = [0.0, -np.pi / 6, np.pi / 6, 0.0, 0.0]  # both booms horizontal
    share = np.abs(fm.holding_torques(model, stretched))[:3] / (2000.0, 10000.0, 5000.0)
    assert share[0] < 1e-6 and 0.6 < share[1] < 0.8 and 0.6 < share[2] < 0.8


@pytest.mark.parametrize("seed", range(3))
def test_the_load_hangs_plumb_at_start_and_goal(env, seed):
    """A rotation about each passive joint moves the load horizontally: it is below both axes."""
    env.reset(seed=seed)
    view, model = env.episodes.view, env.episodes.batch.model
    goal = fm.rest_state(model, view.goal_angles[0])
    for state in (view.state[0], goal):
        np.testing.assert_allclose(sideways(model, state), 0.0, atol=1e-9)
        lengths = np.linalg.norm(tip_jacobian(model, state[: model.n_dof])[:, model.motor_columns[PASSIVE]], axis=0)
        np.testing.assert_allclose(lengths, [SHACKLE + ROPE, ROPE], atol=1e-9)
    hold = fm.holding_torques(model, view.goal_angles[0])
    np.testing.assert_allclose(fm.acceleration(model, goal, hold), 0.0, atol=1e-5)


def test_frequencies_of_the_swing_are_those_of_a_compound_pendulum():
    """On a rigid crane: w^2 = m g c / I about each passive axis, from masses, centres and inertias of the file.

    A damper d lowers it to sqrt(w^2 - (d / 2 I)^2).
    """
    shackle, hook, load = (1.0, 0.025), (6.0, 0.9166666666666666), (100.0, ROPE)  # kg and m below the joint
    moment = hook[0] * hook[1] + load[0] * load[1]
    inertia = 0.22 + hook[0] * hook[1] ** 2 + load[0] * load[1] ** 2
    roll = np.sqrt(GRAVITY * moment / inertia - (DAMPER / (2.0 * inertia)) ** 2) / (2.0 * np.pi)
    moment = shackle[0] * shackle[1] + sum(m * (c + SHACKLE) for m, c in (hook, load))
    inertia = 5e-4 + shackle[0] * shackle[1] ** 2 + 0.22 + sum(m * (c + SHACKLE) ** 2 for m, c in (hook, load))
    pitch = np.sqrt(GRAVITY * moment / inertia - (DAMPER / (2.0 * inertia)) ** 2) / (2.0 * np.pi)
    rigid = fm.build_model(fm.catalog.loader_crane(), flexible_links=False, flexible_joints=False)
    found = fm.modes(rigid, np.zeros(5), motors="held").frequencies
    np.testing.assert_allclose(found, [pitch, roll], rtol=1e-6)


@pytest.mark.parametrize("posture", POSTURES)
def test_the_swing_of_the_flexible_crane_is_near_that_of_a_point_mass(posture):
    """sqrt(g / L), L from joint to load.

    The hook, 6 % of the mass, raises it by less than 0.3 %; booms and drives, with a first vertical frequency of at
    least 1.8 Hz, lower it: a horizontal compliance c of the boom tip acts as a rope longer by m g c, up to 3 %.
    """
    model = fm.build_model(fm.catalog.loader_crane())
    found = fm.modes(model, posture, motors="held").frequencies[:2]
    points = [np.sqrt(GRAVITY / length) / (2.0 * np.pi) for length in (ROPE + SHACKLE, ROPE)]
    np.testing.assert_allclose(found, points, rtol=0.035)
    assert fm.modes(model, posture, motors="held").frequencies[2] > 1.5


def test_friction_of_the_passive_joints_damps_the_swing_as_stated():
    """Damping ratio d / (2 omega I) = 1.2 % of a pendulum on the crane with held motors."""
    ratios = fm.modes(fm.build_model(fm.catalog.loader_crane()), POSTURES[0], motors="held").damping_ratios[:2]
    omega = np.sqrt(GRAVITY / ROPE)
    np.testing.assert_allclose(ratios, DAMPER / (2.0 * omega * 106.0 * ROPE**2), rtol=0.1)


def test_the_swing_of_the_load_lowers_the_reward(env):
    """Equal motor angles at the goal; a load that swings by 0.1 rad is off the target and moves."""
    rewards = {}
    for swing in (0.0, 0.1):
        _, info = env.reset(seed=1, options={"start": [0.1, 0.2, 0.1, 0.0, 0.0], "goal_angles": [0.1, 0.2, 0.1, 0, 0]})
        model, state = env.episodes.batch.model, env.episodes.view.state[0].copy()
        state[model.motor_columns[PASSIVE]] += swing
        env.episodes.batch.place(np.arange(1), state[None])
        hold = fm.holding_torques(model, env.episodes.view.goal_angles[0])[:3] / env.torque_limit[:3]
        _, rewards[swing], _, _, info = env.step(hold.astype(np.float32))
        assert info["tip_error"] == pytest.approx(swing * np.hypot(ROPE, ROPE + SHACKLE), abs=3e-3)
    assert rewards[0.0] > 0.99 and rewards[0.1] < 0.8


def test_an_unknown_payload_is_that_of_the_episode():
    env = gym.make(ID, condition="payload", info_keys=()).unwrapped
    weights = {}
    for seed in range(3):
        _, info = env.reset(seed=seed)
        drawn, view = info["drawn"]["payload_mass"], env.episodes.view
        assert 0.0 <= drawn <= 200.0
        episode = fm.build_model(fm.catalog.loader_crane(fm.Payload(float(drawn))))
        usual = fm.holding_torques(fm.build_model(fm.catalog.loader_crane()), view.goal_angles[0])
        weights[seed] = fm.holding_torques(episode, view.goal_angles[0])[1] - usual[1]
        assert np.sign(weights[seed]) == np.sign(drawn - 100.0)
    assert len(set(weights.values())) == 3


@pytest.mark.parametrize("condition", condition_names(ID))
def test_a_condition_runs_and_leaves_the_hook_without_motor(condition):
    env = gym.make(ID, condition=condition, base="pd", horizon=0.2)
    env.reset(seed=0)
    observation, *_ = env.step(np.zeros(3, dtype=np.float32))
    assert np.isfinite(observation).all()
    assert [joint.passive for joint in Configuration.find(f"{ID}/{condition}").arm.joints] == [False] * 3 + [True] * 2
