"""Agent as a controller: sensors, history, action repeat, law and base, under another agent."""

import numpy as np
import pytest

from flexman_gym.agent.action_modes import TorqueMode
from flexman_gym.agent.agent import Agent
from flexman_gym.agent.base_controllers import make_base
from flexman_gym.agent.controller import EpisodeInfo
from flexman_gym.agent.network import Network
from flexman_gym.agent.pd import PD
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.sensors import ServoErrors, find_sensors
from flexman_gym.envs.vector_env import FlexManVectorEnv

from oracles.assertions import refusal
from oracles.random_inputs import asked_after_a_state

SETTINGS = {"name": "FlexPlanar-v0", "horizon": 0.3}


def network(size, joints=2, seed=0):
    """Made-up layers of a policy."""
    random = np.random.default_rng(seed)
    shapes = {"mlp_extractor.policy_net.0": (5, size), "action_net": (joints, 5)}
    layers = {f"{name}.weight": random.normal(size=shape, scale=0.4) for name, shape in shapes.items()}
    layers |= {f"{name}.bias": random.normal(size=shape[0], scale=0.1) for name, shape in shapes.items()}
    return Network("ppo", None, layers, {"mean": np.zeros(size), "var": np.ones(size)})


@pytest.mark.parametrize("sensors", [("full",), ("servo",), ({"kind": "full", "delay": 1, "every": 2}, "command")])
@pytest.mark.parametrize("history", [1, 3, (0.05, 0.2)])
@pytest.mark.parametrize("base", [None, "pd"])
def test_it_acts_as_an_agent_that_sees_and_holds_as_it_does(sensors, history, base):
    """Commands of a trainer, of the law of the agent itself, and the same agent as the base of a plain environment."""
    beside = FlexManVectorEnv(3, **SETTINGS, sensors=sensors, history=history, action_repeat=4, base=base)
    size = beside.single_observation_space.shape[0]
    acting = network(size)
    controller = make_base(base, make_plant(beside.configuration, beside.batch.model)) if base else None
    observed, mode = find_sensors(sensors), TorqueMode(2, controller)
    policy = Agent(observed, len(beside.sensors.bound), mode, controller, beside.configuration.history, 4, acting)
    alone = FlexManVectorEnv(3, **SETTINGS, base=policy)
    seen, asked, played = beside.reset(seed=3)[0], [], []
    beside.episodes.callback = lambda: asked.append(beside.episodes.view.action.copy())
    alone.episodes.callback = lambda: played.append(alone.episodes.view.action.copy())
    alone.reset(seed=3)
    for _ in range(6):
        seen, *_ = beside.step(acting(seen).astype(np.float32))
    for _ in range(24):
        alone.step(np.zeros((3, 2), dtype=np.float32))
    within, own = FlexManVectorEnv(3, **SETTINGS, sensors=sensors, history=history, action_repeat=4, base=base), []
    within.episodes.agent.set_law(acting)
    within.episodes.callback = lambda: own.append(within.episodes.view.action.copy())
    within.reset(seed=3)
    for _ in range(6):
        within.episodes.step()
    assert np.array_equal(asked, played) and np.array_equal(asked, own) and np.abs(asked).max() > 0.01
    if base is None:
        assert [bool(each.any()) for each in np.diff(played, axis=0)[:5]] == [False] * 3 + [True, False], "it is held"


def test_its_base_reads_what_its_instruments_measure():
    """The errors that a PD beside a policy feels are those of the policy's encoders, which have a bias."""
    biased = find_sensors(({"kind": "motor_encoders", "bias": 0.05},))
    pd = PD([5.0, 2.0], [0.0, 0.0], [12.0, 4.0])
    env = FlexManEnv(**SETTINGS, base=Agent(biased, 4, TorqueMode(2, pd), pd, law=network(4)))
    env.reset(seed=0)
    readings, view = env.episodes.measurements.readings, env.episodes.view
    assert list(readings) == ["motor_angles", "motor_rates", "angle_errors", "goal_rates"], "an entry of both once"
    assert (readings["motor_angles"] != view.motor_angles).all()
    assert readings["angle_errors"] == pytest.approx(view.goal_angles - readings["motor_angles"], abs=1e-12)


def test_a_state_holds_what_a_policy_remembers():
    """In the middle of a held action, with a history."""
    policies = [Agent(find_sensors("full"), 18, TorqueMode(2), None, 3, 4, network(54)) for _ in range(2)]
    one, other = (FlexManEnv(**SETTINGS, base=policy) for policy in policies)
    asked = asked_after_a_state(one, other, 6, 7)
    assert np.array_equal(*asked) and np.abs(asked).max() > 0.0


def readings_of(*errors):
    """What arms with these errors read."""
    still = np.zeros((len(errors), 2))
    return {"angle_errors": still + np.array(errors)[:, None], "motor_rates": still, "goal_rates": still}


def remembering():
    """A policy that observes three instants, two periods apart."""
    return Agent((ServoErrors(),), 6, TorqueMode(2), None, 3, 2, network(18))


def begun(policy, *arms):
    """The policy with new episodes of some arms."""
    goal = np.zeros((len(arms), 2))
    policy.reset(np.array(arms), EpisodeInfo(goal, goal, 0.01), max(arms) + 1)
    return policy


def asked(policy, *errors):
    """What it asks of as many arms, all of which play."""
    return policy.act(readings_of(*errors), np.zeros((len(errors), 2)), np.ones(len(errors), dtype=bool))


def test_a_new_episode_begins_anew():
    """In the middle of a held action, which ends there; what it remembered of the old episode is gone."""
    policy = begun(remembering(), 0)
    for error in (0.1, 0.2, 0.3):
        asked(policy, error)
    assert np.array_equal(asked(begun(policy, 0), 0.5), asked(begun(remembering(), 0), 0.5))


def test_arms_that_come_later_change_nothing_for_those_before():
    """Action and memory of the first one stay its own; the second one begins at once."""
    both, alone = (begun(remembering(), 0) for _ in range(2))
    for error in (0.1, 0.2, 0.3):
        assert np.array_equal(asked(both, error), asked(alone, error))
    begun(both, 1)
    for error in (0.4, 0.5, 0.6):
        result, expected = asked(both, error, 0.9), asked(alone, error)
        assert np.array_equal(result[:1], expected) and (result[1] != result[0]).any()


def test_another_arm_and_other_sensors_are_refused_in_one_line():
    env = FlexManEnv(base=Agent(find_sensors("servo"), 6, TorqueMode(2), law=network(6)))
    assert refusal(env.reset) == "base: 'a policy for 2 motors' is not allowed; give one for 3"
    said = refusal(lambda: Agent(find_sensors("servo"), 6, TorqueMode(2), law=network(7)))
    assert (
        said
        == "base: 'a policy with 7 inputs' is not allowed; give one with 6, the number of values of its sensors here"
    )
    env = FlexManEnv(**SETTINGS, base=Agent(find_sensors("servo"), 7, TorqueMode(2), law=network(7)))
    env.reset(seed=0)
    said = refusal(env.step, np.zeros(2, dtype=np.float32))
    assert (
        said
        == "base: 'a policy with 7 inputs' is not allowed; give one with 6, the number of values of its sensors here"
    )
