"""Environments of arms with passive joints, such as a load that hangs: actions, goals, gains and refusals."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.agent.base_controllers import BASES
from flexman_gym.envs.config.configuration import Configuration

from oracles.assertions import refusal

ID, Y, X = "FlexPlanar-v0", (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)
SERVED = (
    "pd", "lqr", "lqr-tracking", "lqg", "adaptive-lqr", "adaptive-planned", "privileged-lqr", "privileged-planned",
    "pd-shaped",
)  # fmt: skip
DOWN = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
pytestmark = pytest.mark.filterwarnings("ignore:.*radius of gyration")


def crane(load=0.5, spring=None, **motor):
    """Return an arm of a flexible boom on an elastic drive, and a rope of 0.4 m with a load on two passive joints."""
    thin = np.eye(3) * 1e-4
    boom = fm.Link.tube(0.8, 0.03, 0.001, "aluminium")
    links = [boom, fm.Link.rigid(0.02, 0.05, (0.0, 0.0, 0.0), thin),
             fm.Link.rigid(0.4, 0.02, (0.2, 0.0, 0.0), thin, orientation=DOWN)]  # fmt: skip
    drive = fm.Joint(Y, rotor_inertia=0.2, stiffness=2000.0, damping=2.0, **{"torque_limit": 30.0} | motor)
    passive = [fm.Joint(axis, passive=True, viscous_friction=0.02, stiffness=spring) for axis in (Y, X)]
    return fm.Arm(links, [drive, *passive], fm.Payload(load), gravity=(0.0, 0.0, -9.81), modal_damping_ratio=0.01)


@pytest.fixture(scope="module")
def env():
    return gym.make(ID, arm=crane()).unwrapped


def test_an_action_has_an_entry_for_each_motor_and_passive_joints_have_no_torque(env):
    assert env.action_space.shape == (1,) and env.torque_limit.tolist() == [30.0, 0.0, 0.0]
    env.reset(seed=1)
    env.step(np.array([0.5], dtype=np.float32))
    episodes = env.episodes
    assert episodes.motors.torques.tolist() == [[15.0, 0.0, 0.0]] and episodes.view.action.tolist() == [[0.5, 0.0, 0.0]]


def test_start_and_goal_hang_below_the_boom(env):
    env.reset(seed=2)
    view, model = env.episodes.view, env.episodes.batch.model
    for angles, tip in ((view.motor_angles, view.tip), (view.goal_angles, view.target)):
        rest = fm.rest_state(model, angles[0])
        np.testing.assert_allclose(angles[0], rest[model.motor_columns], atol=1e-9)
        pitch = rest[0]  # of the boom at its root; a boom that bends hangs lower
        assert tip[0, 2] == pytest.approx(0.82 * np.sin(pitch) - 0.4, abs=0.03)
    hold = fm.holding_torques(model, view.motor_angles[0])
    np.testing.assert_allclose(fm.acceleration(model, view.state[0], hold), 0.0, atol=1e-6)


def test_an_episode_moves_as_a_simulated_scene(env):
    """The torques of the actions on the same model, from the start of the episode."""
    env.reset(seed=3, options={"start": [0.2, 0.0, 0.0]})
    configuration, view = env.configuration, env.episodes.view
    start, tips = view.state[0].copy(), []
    for _ in range(50):
        env.step(np.array([0.3], dtype=np.float32))
        tips.append(view.tip[0].copy())
    simulator, found = (
        fm.Simulator(env.episodes.batch.model, step=1e-4, control_period=configuration.control_period),
        [],
    )
    simulator.reset(state=start)
    for _ in range(50):
        simulator.step([0.3 * 30.0, 0.0, 0.0])
        found.append(simulator.tip.copy())
    np.testing.assert_allclose(tips, found, atol=1e-5)


def test_gains_of_the_motors_have_margins_and_stop_the_load():
    configuration = Configuration(ID, {"arm": crane()})
    gains = configuration.pd_gains
    assert gains["stiffness"][0] > 0.0 and gains["stiffness"][1:] == gains["damping"][1:] == (0.0, 0.0)
    result = fm.evaluate("pd", configuration, seeds=range(4))
    assert result["settled"] == 1.0 and result["error"] < 1e-3


def test_each_arm_of_a_batch_moves_as_one_alone():
    arms = gym.make_vec(ID, 3, "vector_entry_point", arm=crane(), base="pd")
    arms.reset(seed=[5, 6, 7])
    single = gym.make(ID, arm=crane(), base="pd")
    single.reset(seed=6)
    for _ in range(20):
        seen, *_ = arms.step(np.full((3, 1), 0.1, dtype=np.float32))
        alone, *_ = single.step(np.full(1, 0.1, dtype=np.float32))
    assert np.array_equal(seen[1], alone)


@pytest.mark.parametrize("limit", [20.0, [20.0], [20.0, 0.0, 0.0]])
def test_torque_limits_are_those_of_the_motors(limit, tmp_path):
    found = Configuration(ID, {"arm": crane(torque_limit=None), "torque_limit": limit})
    assert found.torque_limit == (20.0, 0.0, 0.0)
    found.save(tmp_path / "own.yaml")
    assert Configuration.load(tmp_path / "own.yaml").torque_limit == found.torque_limit
    assert refusal(Configuration, ID, {"arm": crane(), "torque_limit": [1.0, 2.0]}).startswith(
        "torque_limit: [1.0, 2.0]"
    )
    assert "have no torque_limit" in refusal(Configuration, ID, {"arm": crane(torque_limit=None)})


@pytest.mark.parametrize("condition", ["payload", "friction", "unknown-lab", "uncertain"])
def test_a_condition_concerns_the_motors_and_the_load(condition):
    found = Configuration(ID, {"arm": crane(), "condition": condition})
    assert found.arm.joints[1:] == crane().joints[1:]
    env = gym.make(ID, arm=crane(), condition=condition)
    env.reset(seed=0)
    assert np.isfinite(env.step(np.zeros(1, dtype=np.float32))[0]).all()


@pytest.mark.parametrize("base", sorted({*BASES} - {*SERVED}))
def test_a_controller_without_passive_joints_is_refused_in_one_line(base):
    line = refusal(lambda: gym.make(ID, arm=crane(), base=base))
    possible = f"{', '.join(SERVED)}, or a controller of your own, for an arm with passive joints"
    assert line == f"base: {base!r} is not allowed; give {possible}"


@pytest.mark.parametrize("base", SERVED)
def test_a_controller_stops_the_load(base):
    assert fm.evaluate({"kind": base}, Configuration(ID, {"arm": crane()}), seeds=range(2))["settled"] == 1.0


@pytest.mark.parametrize(
    "settings, begin",
    [({"safety": True}, "safety: True is not allowed; give False"), ({"task": "track"}, "task: Track("),
     ({"actions": "velocity"}, "actions: 'velocity' is not allowed; give 'torque'")],
)  # fmt: skip
def test_what_needs_a_motor_at_each_joint_is_refused_in_one_line(settings, begin):
    line = refusal(lambda: gym.make(ID, arm=crane(), **settings))
    assert line.startswith(begin) and line.endswith(": joint 2 of the arm is passive")


def test_an_arm_without_motors_is_refused():
    hinge = fm.Arm([fm.Link.rod(0.5, 0.01)], [fm.Joint(Y, passive=True)], gravity=(0.0, 0.0, -9.81))
    assert "a joint with a motor, or the setting foundation" in refusal(Configuration, ID, {"arm": hinge})


def test_a_description_names_passive_joints():
    lines = str(fm.describe(crane()))
    assert lines.count("passive: no motor") == 2 and "joint 1 holds" in lines


@pytest.mark.slow
@pytest.mark.feature
def test_a_policy_is_trained_and_evaluated_with_the_actions_of_the_motors(tmp_path):
    pytest.importorskip("stable_baselines3")
    from flexman_agents.guard import guard
    from flexman_agents.own_arm import fit_to_arm
    from flexman_agents.settings import find_recipe
    from flexman_agents.training import train

    settings = fit_to_arm(find_recipe("ppo_on_pd_minute"), crane())
    train(replace(settings, steps=2000, envs=4), tmp_path / "run", progress=False)
    assert "its base pd" in guard(tmp_path / "run", keep_worse=True)
    assert np.isfinite(fm.evaluate(str(tmp_path / "run"), settings.environment, seeds=range(2))["reward"])
