"""Extensions: tasks, sensors, arms, controllers, effects and named environments from outside the package."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import flexman_gym as fm
from flexman_gym.agent.base_controllers import make_base
from flexman_gym.agent.controller import Controller
from flexman_gym.common import files
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.envs.effects import SIGNALS
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.sensors import Entry
from flexman_gym.envs.tasks import Goal, Hold
from flexman_gym.envs.vector_env import FlexManVectorEnv

from oracles.random_inputs import actions


class Bearing:
    """What a task tells of its goal: where the target is, in reaches, and how fast it moves."""

    def entries(self, view, limits):
        return [Entry("target", 3, "reach", 2.0), Entry("pace", 1, "rad/s", 10.0)]

    def read(self, view, out):
        out[:, :3] = view.target / view.reach
        out[:, 3] = view.episode_parameters["pace"][:, 0]


class Follow:
    """The target moves with the tip of the rigid arm whose joints sway."""

    sensors = (Bearing(),)
    moves = True

    def draw(self, random, view):
        return {"start": random.uniform(-0.5, 0.5, view.n_joints), "pace": random.uniform(0.5, 2.0, 1)}

    def goal(self, plan, time, view):
        posture = plan["start"] + 0.3 * np.sin(plan["pace"] * time[:, None])
        return Goal(view.rest_tips(posture), posture)

    def reward_terms(self, view):
        near = 1.0 / (1.0 + (view.tip_error / (0.1 * view.reach)) ** 2)
        return {"near": near, "steady": -0.01 * np.abs(view.motor_rates).max(axis=-1), "failure": -1.0 * view.failed}

    def info(self, view):
        return {"height": view.tip[..., 2] / view.reach}


class Encoders:
    """Motor encoders, and nothing else."""

    def entries(self, view, limits):
        return [Entry("encoders", view.n_joints, "rad", limits.angle)]

    def read(self, view, out):
        out[:] = view.motor_angles


class Brake:
    """A controller that works against the rates of the motors."""

    sensors = ("full",)

    def reset(self, arms, episode, count):
        pass

    def act(self, readings, applied=None, playing=None):
        return np.clip(-0.5 * readings["motor_rates"], -1.0, 1.0)


class SensorBias:
    """A constant part of its range by which each quantity is measured too large throughout an episode."""

    kind, shape = float, ()

    def __init__(self, stage, span):
        self._span, self._bound, self._bias = span, stage.bound, np.zeros((len(stage.torque_limits), 1))

    @staticmethod
    def checked(field, value):
        return float(value)

    def draw(self, arm, stream):
        return stream.uniform(*self._span)

    def begin(self, arms, drawn):
        self._bias[arms, 0] = drawn[arms]

    def measure(self, values, arms):
        return values + self._bias[arms] * self._bound


def strips(*limits):
    """Two strips whose joints have torque limits."""
    joints = [fm.Joint((0.0, 0.0, 1.0), 0.1, torque_limit=limit) for limit in limits]
    return fm.Arm(fm.catalog.planar_2r().links, joints)


def of_arm(infos, arm):
    """The info of one arm from those of all, without their masks."""
    values = {name: value for name, value in infos.items() if not name.startswith("_")}
    return {name: of_arm(value, arm) if isinstance(value, dict) else value[arm] for name, value in values.items()}


def same(result, expected):
    """Whether two values, arrays or dicts of them have the same bits."""
    if isinstance(expected, dict):
        return result.keys() == expected.keys() and all(same(result[key], value) for key, value in expected.items())
    return np.array_equal(result, expected)


@pytest.mark.parametrize("settings", [{"task": Follow()}, {"task": Follow(), "sensors": (Encoders(), "full")}])
def test_a_task_and_sensors_of_ones_own_are_the_same_alone_and_among_others(settings):
    env = FlexManEnv(**settings)
    check_env(env, skip_render_check=True)
    vector = FlexManVectorEnv(3, **settings)
    observation, info = env.reset(seed=4)
    observations, infos = vector.reset(seed=[3, 4, 5])
    for action in actions(3, 60):
        assert np.array_equal(observations[1], observation) and observation in env.observation_space
        assert same(of_arm(infos, 1), info)
        observation, reward, *_, info = env.step(action[1])
        observations, rewards, *_, infos = vector.step(action)
        assert rewards[1] == reward == sum(info["reward_terms"].values())


def test_a_goal_that_moves_is_where_the_task_says_at_every_observation():
    env, task = FlexManEnv(task=Follow()), Follow()
    env.reset(seed=1, options={"pace": [2.0]})
    for step in range(1, 30):
        observation, _, _, _, info = env.step(np.zeros(3))
        view = env.episodes.view
        goal = task.goal(view.episode_parameters, np.array([0.02 * step]), view)
        assert info["target"] == pytest.approx(goal.target[0]) and info["goal_angles"] == pytest.approx(goal.angles[0])
        assert observation[env.sensors.slices["target"]] == pytest.approx(goal.target[0] / 8.5, rel=1e-6)
        assert info["height"] == info["tip"][2] / 8.5
    assert observation[env.sensors.slices["pace"]] == 2.0


def test_limits_hold_whatever_an_agent_sees():
    blind, seeing = FlexManEnv(sensors=Encoders()), FlexManEnv()
    assert blind.observation_space.shape == (3,)
    ends = []
    for env in (blind, seeing):
        env.reset(seed=0)
        for step in range(500):  # noqa: B007
            _, _, terminated, _, info = env.step(np.ones(3))
            if terminated:
                break
        ends.append((step, info["failure"]))
    assert ends[0] == ends[1] and ends[0][1].split()[0] in seeing.sensors.slices


def test_an_observation_beyond_its_own_bound_ends_the_episode_and_is_named():
    class Narrow(Encoders):
        def entries(self, view, limits):
            return [Entry("encoders", view.n_joints, "rad", 0.31)]

    env = FlexManEnv(sensors=Narrow())
    env.reset(options={"start": [0.3, 0.3, 0.3], "goal_angles": [0.0, 0.0, 0.0]})
    terminated = False
    while not terminated:
        observation, _, terminated, _, info = env.step(np.ones(3))
        assert observation in env.observation_space
    assert info["failure"].startswith("encoders 0.3") and "rad beyond 0.31" in info["failure"]


@pytest.mark.parametrize("plan", [{}, {"start": [0.0]}, [0.0, 0.0, 0.0]])
def test_a_task_that_says_no_start_is_refused_in_one_line(plan):
    class Lost(Follow):
        def draw(self, random, view):
            return plan

    with pytest.raises(ValueError) as error:
        FlexManEnv(task=Lost()).reset(seed=0)
    allowed = 'a dict with "start", 3 motor angles (rad)'
    assert str(error.value) == f"task.draw: {plan!r} is not allowed; give {allowed}"


def test_what_a_task_says_of_a_step_stays_as_it_was():
    class Watching(Follow):
        def info(self, view):
            return {"angles": view.motor_angles, "height": view.tip[..., 2]}

    for env in (FlexManEnv(task=Watching()), FlexManVectorEnv(2, task=Watching())):
        env.reset(seed=0)
        said = env.step(np.ones(env.action_space.shape))[4]["angles"]
        before = said.copy()
        env.step(np.ones(env.action_space.shape))
        assert np.array_equal(said, before)


def test_a_named_environment_is_one_entry(monkeypatch):
    entry = type(NAMED_ENVIRONMENTS["FlexPlanar-v0"])(
        fm.Arm(fm.catalog.planar_2r().links, [fm.Joint((0, 0, 1), 0.1, torque_limit=limit) for limit in (3, 1)]),
        {"stiffness": (2.0, 1.0), "damping": (1.0, 0.5)},
        control_period=0.01,
    )
    monkeypatch.setitem(NAMED_ENVIRONMENTS, "FlexOther-v0", entry)
    env = FlexManEnv(name="FlexOther-v0")
    observation, _ = env.reset(seed=0)
    assert env.torque_limit.tolist() == [3.0, 1.0] and env.simulator.control_period == 0.01
    readings = {name: observation[place] for name, place in env.sensors.slices.items()}
    assert make_base("pd", make_plant(env.configuration, env.simulator.model)).act(readings).shape == (2,)


def test_a_named_environment_is_a_file_that_may_extend_another(tmp_path):
    arm = {"catalog": "planar_2r", "joints": {"torque_limit": [3.0, 1.0]}}
    pd = {"stiffness": [2.0, 1.0], "damping": [1.0, 0.5]}
    files.write_data(tmp_path / "First-v0.yaml", {"arm": arm, "pd": pd, "limits": {"rate": 9.0}, "sensors": ["lab"]})
    files.write_data(tmp_path / "Second-v0.yaml", {"extends": "First-v0", "task": "hold", "horizon": 3.0})
    load = NAMED_ENVIRONMENTS["FlexPlanar-v0"].load
    first, second = (load(tmp_path / f"{name}-v0.yaml") for name in ("First", "Second"))
    assert [joint.torque_limit for joint in first.arm.joints] == [3.0, 1.0] and first.sensors == ("lab",)
    assert first.arm.links == fm.catalog.planar_2r().links and first.pd["damping"] == (1.0, 0.5)
    assert second == replace(first, task=Hold(), horizon=3.0)
    for data, line in (
        ({"extends": "First-v0", "horizn": 3.0}, "Third-v0.yaml: environment: 'horizn' is not allowed"),
        ({"extends": "First-v0", "limits": {"rate": 0.0}}, "Third-v0.yaml: Limits.rate: 0.0 is not allowed"),
        ({"arm": arm}, "Third-v0.yaml: environment: ['arm'] is not allowed; give a mapping with arm and pd"),
    ):
        files.write_data(tmp_path / "Third-v0.yaml", data)
        with pytest.raises(ValueError) as error:
            load(tmp_path / "Third-v0.yaml")
        assert str(error.value).startswith(line) and "\n" not in str(error.value)


def test_a_controller_is_known_by_what_it_can_do():
    assert isinstance(Brake(), Controller) and not isinstance(Encoders(), Controller)
    env = FlexManEnv()
    observation, _ = env.reset(seed=0)
    energies = []
    for step in range(100):
        readings = {name: observation[place] for name, place in env.sensors.slices.items()}
        observation, *_ = env.step(np.full(3, 0.3) if step < 20 else Brake().act(readings))
        energies.append(env.simulator.energy)
    assert energies[-1] < 0.1 * energies[19]


def test_a_signal_effect_is_one_entry(monkeypatch):
    monkeypatch.setitem(SIGNALS._own, "sensor_bias", SensorBias)
    biased, plain = FlexManEnv(randomisation={"sensor_bias": (0.01, 0.02)}), FlexManEnv()
    result, info = biased.reset(seed=0)
    expected, _ = plain.reset(seed=0)
    bias, places = info["drawn"]["sensor_bias"], plain.sensors.slices
    assert 0.01 <= bias <= 0.02
    angles, errors = places["motor_angles"], places["angle_errors"]
    for action in actions(1, 20):
        off = bias * plain.sensors.bound[angles]
        assert result[angles] == pytest.approx(expected[angles] + off, rel=1e-6, abs=1e-6)
        assert result[errors] == pytest.approx(expected[errors] - off, rel=1e-6, abs=1e-6)
        result, expected = biased.step(action[0])[0], plain.step(action[0])[0]
    assert biased.observation_space == plain.observation_space


def test_torque_limits_are_those_of_the_joints_unless_told_otherwise():
    joints = [fm.Joint((0.0, 0.0, 1.0), 0.1, torque_limit=limit) for limit in (5.0, 2.0)]
    arm = fm.Arm(fm.catalog.planar_2r().links, joints)
    for keywords, expected in (
        ({}, (5.0, 2.0)),
        ({"torque_limit": 3.0}, (3.0, 3.0)),
        ({"torque_limit": [4, 1]}, (4, 1)),
    ):
        env = FlexManEnv(arm=arm, **keywords)
        env.reset(seed=0)
        env.step(np.ones(2))
        assert np.array_equal(env.torque_limit, expected)
        other = FlexManEnv(arm=arm, torque_limit=1.0)
        other.reset(seed=0)
        assert env.action_space == other.action_space
        work = env.simulator.batch.rows[0, -2]
        assert work > 0.0
    assert np.array_equal(gym.make("FlexRRR-v0").unwrapped.torque_limit, [400.0] * 3)
