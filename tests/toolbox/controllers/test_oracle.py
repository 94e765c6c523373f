"""Oracle observer: state, parameters and delay of the true arm."""

import numpy as np
import pytest

from flexman_gym.envs.vector_env import FlexManVectorEnv
from flexman_gym.toolbox.controllers.observers.oracle import Oracle

from oracles.observed_arms import SMALL, small_plant

DRAWN = {
    "payload_mass": (0.0, 0.2), "joint_stiffness_factor": (0.7, 1.3), "link_stiffness_factor": (0.7, 1.3),
    "torque_limit_factor": (0.8, 1.2),
}  # fmt: skip


class Asking:
    """A base that asks for given torques and keeps what an observer says."""

    def __init__(self, observer, asked):
        self.observer, self.sensors, self.asked, self.said = observer, observer.sensors, asked, []

    def reset(self, arms, episode, count):
        self.observer.reset(arms, episode, count)

    def act(self, readings, applied, active):
        estimate = self.observer.estimate(readings, applied, active)
        self.said.append(copied(estimate))
        return self.asked[len(self.said) - 1]


def copied(estimate):
    """A copy that nobody writes into."""
    parameters = {name: values.copy() for name, values in estimate.parameters.items()}
    return estimate._replace(states=estimate.states.copy(), lead=estimate.lead.copy(), parameters=parameters)


def played(delay, periods=24, horizon=4.0, arms=4, told=None):
    """What Truth says in each period, the states of the arms then, and what they drew.

    Its plant has the delay `told`, None for that of the arms.
    """
    randomisation = {**DRAWN, "delay": delay}
    settings = {"name": "FlexPlanar-v0", **SMALL, "randomisation": randomisation, "horizon": horizon}
    asked = np.random.default_rng(0).uniform(-0.5, 0.5, (periods, arms, 2))
    base = Asking(Oracle(small_plant("FlexPlanar-v0", randomisation | ({"delay": told} if told else {}))), asked)
    env = FlexManVectorEnv(arms, base=base, **settings)
    _, infos = env.reset(seed=3)
    states = []
    for _ in range(periods):
        states.append(env.episodes.batch.state.copy())
        env.step(np.zeros((arms, 2), dtype=np.float32))
    return base.said, np.array(states), infos["drawn"]


def test_the_delay_of_an_episode_may_be_longer_than_that_of_its_plant():
    for ours, longer in zip(played((2, 3), told=(0, 0))[0], played((2, 3))[0], strict=True):
        assert np.array_equal(ours.states, longer.states) and np.array_equal(ours.lead, longer.lead)


@pytest.mark.parametrize("delay", [(0, 0), (1, 1), (0, 3)])
def test_it_predicts_through_the_delay_to_the_last_bit(delay):
    """With payload, stiffness and torque limits of each arm, each as late as it is."""
    said, states, drawn = played(delay)
    late = drawn["delay"]
    assert delay[0] <= late.min() and late.max() <= delay[1] and (len(np.unique(late)) > 1) == (delay == (0, 3))
    for period, estimate in enumerate(said):
        assert estimate.lead.tolist() == late.tolist()
        for arm, lead in enumerate(late.tolist()):
            if period + lead < len(states):
                assert np.array_equal(estimate.states[arm], states[period + lead, arm]), (period, arm)


def test_it_tells_the_parameters_of_each_arm():
    said, _, drawn = played((0, 0), periods=2)
    for name in ("payload_mass", "joint_stiffness", "link_stiffness_factor"):
        assert np.array_equal(said[1].parameters[name], drawn[name]) and len(np.unique(drawn[name])) >= 4
    assert set(said[1].parameters) == {"payload_mass", "joint_stiffness", "link_stiffness_factor"}


def test_a_new_episode_is_one_of_another_arm():
    """Which forgets the torques of the episode before, and has its own parameters."""
    said, states, _ = played((2, 2), periods=14, horizon=0.06)
    masses = np.array([estimate.parameters["payload_mass"] for estimate in said])
    assert len(np.unique(masses[:, 0])) >= 2
    moves = [
        period for period in range(10) if np.array_equal(masses[period], masses[period + 2])
        and np.array_equal(said[period].states, states[period + 2])
    ]  # fmt: skip
    assert len(moves) >= 4
