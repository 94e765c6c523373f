"""Actions: what an agent's numbers mean is a part that can be exchanged, and torques are the usual one."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.agent.action_modes import ACTIONS, ActionModeEntry, TorqueMode
from flexman_gym.agent.agent import Agent
from flexman_gym.agent.base_controllers import make_base
from flexman_gym.agent.network import Network
from flexman_gym.common.arrays import pad_rows
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.vector_env import FlexManVectorEnv

from oracles.assertions import refusal

SETTINGS = {"name": "FlexPlanar-v0", "horizon": 0.3}


class Winding:
    """A mode of one's own with a memory: a single number turns all motors, more with each control period."""

    state_fields = ("wound",)
    names, sensors = ("winding",), ("servo",)

    def __init__(self, plant, base, rate=0.01):
        self.joints, self.base, self.rate = len(plant.torque_limit), base, rate
        self.wound = np.zeros(0)

    def reset(self, arms, episode, count):
        self.wound = pad_rows(self.wound, count)
        self.wound[arms] = 0.0
        self.base.reset(arms, episode, count)

    def act(self, actions, readings, applied, active):
        self.wound += self.rate * actions[:, 0] * active
        turned = self.wound[:, None] - 0.01 * readings["motor_rates"]
        return np.clip(self.base.act(readings, applied, active) + turned, -1.0, 1.0)


WINDING = ActionModeEntry(Winding, ("rate",))


@pytest.fixture
def winding(monkeypatch):
    monkeypatch.setitem(ACTIONS._own, "winding", f"{__name__}:WINDING")
    return {**SETTINGS, "actions": {"kind": "winding", "rate": 0.02}, "base": "pd"}


def test_a_mode_says_how_many_numbers_an_action_has_and_acts_in_every_period(winding):
    env = FlexManVectorEnv(2, **winding, action_repeat=4)
    assert env.single_action_space.shape == (1,) and env.action_space.shape == (2, 1)
    env.reset(seed=0)
    for step in range(1, 4):
        env.step(np.array([[0.5], [-1.0]], dtype=np.float32))
        assert env.episodes.agent.mode.wound == pytest.approx([0.04 * step, -0.08 * step])
    env.reset(seed=1)
    assert not env.episodes.agent.mode.wound.any(), "a new episode begins anew"
    said = refusal(env.step, np.zeros((2, 2), dtype=np.float32))
    assert said.endswith("give 2 rows of 1 numbers from -1 to 1")


def test_a_state_holds_what_a_mode_remembers(winding):
    one, other = FlexManEnv(**winding), FlexManEnv(**winding)
    one.reset(seed=1)
    for _ in range(5):
        one.step(np.ones(1, dtype=np.float32))
    other.reset(seed=2)
    other.set_state(one.get_state())
    asked = []
    for env in (one, other):
        env.step(np.zeros(1, dtype=np.float32))
        asked.append(env.episodes.view.action.copy())
    assert np.array_equal(*asked) and other.episodes.agent.mode.wound == pytest.approx([0.1])


def test_a_policy_acts_in_its_mode_wherever_it_plays(winding):
    """As an agent in its own environment, and as the base of one where actions are torques."""
    beside = FlexManVectorEnv(3, **winding, action_repeat=2, sensors="servo")
    random = np.random.default_rng(0)
    layers = {"action_net.weight": random.normal(size=(1, 6)), "action_net.bias": np.ones(1)}
    network = Network("ppo", None, layers, {"mean": np.zeros(6), "var": np.ones(6)})
    base = make_base("pd", make_plant(beside.configuration, beside.batch.model))
    mode = Winding(make_plant(beside.configuration, beside.batch.model), base, 0.02)
    policy = Agent(beside.configuration.sensors, 6, mode, base, action_repeat=2, law=network)
    alone = FlexManVectorEnv(3, **SETTINGS, base=policy)
    asked, played = [], []
    beside.episodes.callback = lambda: asked.append(beside.episodes.view.action.copy())
    alone.episodes.callback = lambda: played.append(alone.episodes.view.action.copy())
    seen = beside.reset(seed=3)[0]
    alone.reset(seed=3)
    for _ in range(5):
        seen, *_ = beside.step(network(seen).astype(np.float32))
    for _ in range(10):
        alone.step(np.zeros((3, 2), dtype=np.float32))
    assert np.array_equal(asked, played) and np.abs(asked).max() > 0.01
    said = refusal(lambda: Agent(beside.configuration.sensors, 6, TorqueMode(2), law=network))
    expected = "give an action mode of 1 numbers, the number of outputs of the policy"
    assert said == f"actions: ('torque_1', 'torque_2') is not allowed; {expected}"


def test_torques_are_added_to_a_base_up_to_the_limits():
    class Half:
        sensors = ()

        def reset(self, arms, episode, count):
            pass

        def act(self, readings, applied, active):
            return np.full((2, 2), 0.75)

    given = np.array([[0.5, -0.5], [-1.0, 0.125]])
    active = np.ones(2, dtype=bool)
    assert TorqueMode(2).act(given, {}, given, active) is given, "without a base they are what they are"
    assert TorqueMode(2, Half()).act(given, {}, given, active).tolist() == [[1.0, 0.25], [-0.25, 0.875]]
    assert TorqueMode(2).names == ("torque_1", "torque_2")


@pytest.mark.parametrize("shape", [(2,), (1, 2), (3, 1), ()])
def test_actions_of_a_controller_are_not_broadcast_to_the_arms(shape):
    class Flat:
        sensors = ("servo",)

        def reset(self, arms, episode, count):
            pass

        def act(self, readings, applied, active):
            return np.full(shape, 0.1)

    text = f"base.act: 'an array of shape {shape}' is not allowed; give actions of shape (3, 2), a row for each arm"
    assert refusal(lambda: fm.evaluate(Flat(), "FlexPlanar-v0", range(3))) == text


@pytest.mark.parametrize(
    ("value", "line"),
    [
        ("torques", "actions: 'torques' is not allowed; give one of torque"),
        ({"kind": "torque", "rate": 1.0}, "actions: 'rate' is not allowed; give "),
        ({"kind": "spin"}, "actions.kind: 'spin' is not allowed; give one of torque"),
        (3, "actions: 3 is not allowed; give a name, or a mapping with the name under kind and its arguments"),
    ],
)
def test_other_modes_are_refused_in_one_line(value, line):
    assert refusal(lambda: FlexManEnv(**SETTINGS, actions=value)).startswith(line)
