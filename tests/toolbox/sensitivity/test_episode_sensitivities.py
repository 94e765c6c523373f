"""Tests of derivatives of episodes: differences of rollouts extrapolated to zero, Taylor remainders, equal values."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import flexman_gym as fm
import flexman_gym.evaluation.rollouts  # loaded before `unrounded` changes it
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.agent_spec import AgentSpec
from studies.derivatives.differences import allowed, deviations, remainder_orders
from studies.derivatives.episodes import OUTPUTS, SEED, ChangedEpisode, environment, policy, size_of, unrounded

PD = {"kind": "pd", "stiffness": [10.0, 12.0], "damping": [3.0, 0.6]}


@pytest.fixture(name="unrounded")
def without_rounding():
    with unrounded():
        yield


LIMIT = {"torque_limit": [6.0, 2.0]}
ARM = fm.catalog.vertical_2r()
RUBBING = [replace(each, viscous_friction=0.1, coulomb_friction=0.2, coulomb_rate=0.5) for each in ARM.joints]
FRICTION = {"arm": replace(ARM, joints=RUBBING)}
DELAYED = [{"kind": "motor_encoders", "delay": 2}, {"kind": "strain", "every": 2}, "tip", "action", "command"]
BELLS, EXPONENTIAL = {"kind": "slew"}, {"kind": "slew", "reward": "exponential"}
CASES = {
    "PD at its torque limit": (environment(**LIMIT), PD,
        ("payload_mass", "joint_stiffness[0]", "initial_joint_angles[1]", "initial_joint_rates[0]", "motor_torques[1]",
         "tip_force[2]", "base_acceleration[0]", "stiffness[0]", "damping[1]", "torque_1[4]")),
    "delay and lag": (environment(task=BELLS, randomisation={"delay": (2, 2)}, drive_bandwidth=20.0), PD,
        ("payload_mass", "stiffness[1]", "torque_2[3]")),
    "torque feedback and friction": (environment(task=EXPONENTIAL, **FRICTION), "pd-torque",
        ("viscous_friction[0]", "link_stiffness_factor[1]", "torque_1[12]")),
    "regulator and friction": (environment(**FRICTION), "lqr", ("coulomb_friction[0]", "torque_2[12]")),
    "tracking": (environment(reward={"distance": 2.0}), "lqr-tracking", ("payload_mass", "initial_joint_angles[0]")),
    "shaped command": (environment(), {**PD, "kind": "pd-shaped"}, ("payload_mass", "damping[0]")),
    "position servo": (environment(), policy(22, 2, sensors="fine", actions={**PD, "kind": "position"}),
        ("payload_mass", "stiffness[0]", "position_2[5]")),
    "velocity servo": (environment(periods=26, **LIMIT),
        policy(27, 2, actions={**PD, "kind": "velocity", "range": 10.0}),
        ("payload_mass", "stiffness[1]", "damping[0]", "velocity_2[5]")),
    "policy with sensors, history and base": (environment(),
        policy(50, 2, "sac", sensors=DELAYED, history=2, action_repeat=2, base=PD),
        ("payload_mass", "joint_stiffness[1]", "torque_1[3]")),
    "moving goal": (environment(task={"kind": "track", "preview": [0.1]}),
        policy(60, 2, sensors="full", history=[0.1]), ("payload_mass", "tip_force[2]")),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_derivatives_are_those_of_extrapolated_differences(name, unrounded):
    world, agent, parameters = CASES[name]
    found = fm.sensitivities(world, OUTPUTS, parameters, agent=agent, seed=SEED)
    episode = ChangedEpisode(agent, world)
    for column, text in enumerate(parameters):
        exact = found.jacobian[:, :, column]
        deviation, error = deviations(exact, partial(episode.outputs, text), size_of(text))
        good = deviation <= allowed(error)
        assert good.all(), (text, np.array(found.outputs)[~good], deviation[~good])


def test_values_have_the_bits_of_a_rollout():
    world = environment(sensors="lab", randomisation={"delay": (1, 1), "sensor_noise": (0.001, 0.001)}, **LIMIT)
    names = ("tip", "tip_error", "readings", "actions", "torques", "return")
    found = fm.sensitivities(world, names, "payload_mass", agent=PD, seed=SEED)
    run = fm.rollout(PD, world, [SEED])
    ends = np.column_stack([run.actions[0], run.torques[0], np.cumsum(run.rewards[0])])
    expected = np.column_stack([run.tips[0], run.errors[0], run.readings[0], np.vstack([0.0 * ends[:1], ends])])
    assert np.array_equal(found.values, expected)
    assert np.array_equal(found.time, run.period * np.arange(len(expected)))
    at_limit = np.abs(run.actions[0]) == 1.0
    counts = [int(np.count_nonzero(at_limit[1:, i] != at_limit[:-1, i])) for i in range(2)]
    assert found.kinks == {f"torque_limit[{i}]": count for i, count in enumerate(counts)} and sum(counts) > 0


def test_derivatives_hold_at_drawn_parameters_and_for_flawed_measurements(unrounded):
    """Noise and bias do not depend on the drawn parameters; gain errors of gauges multiply.

    Modal damping grows with the square root of the stiffness of a link: its derivative is not that of the nominal arm.
    """
    agent = policy(24, 2, sensors="lab", base=PD)

    def drawn(payload, joint, link):
        flaws = {"sensor_noise": (0.002, 0.002), "sensor_bias": (0.002, 0.002), "gauge_gain_factor": (1.1, 1.1)}
        ranges = {"payload_mass": (payload,) * 2, "joint_stiffness_factor": (joint,) * 2, "delay": (1, 1)}
        ranges |= {"link_stiffness_factor": (link,) * 2}
        return environment(arm=replace(ARM, modal_damping_ratio=0.1), randomisation=flaws | ranges)

    names, nominal = ("payload_mass", "joint_stiffness", "link_stiffness_factor"), np.array([0.2, 1.3, 1.5])
    found = fm.sensitivities(drawn(*nominal), ("readings", "return"), names, agent=agent, seed=SEED)
    stiffness = [joint.stiffness for joint in ARM.joints]
    exact = found.jacobian @ np.array([[1, 0, 0], *([0, each, 0] for each in stiffness), [0, 0, 1], [0, 0, 1]])

    def differences(step):
        worlds = [drawn(*nominal + sign * step * unit) for unit in np.eye(3) for sign in (1.0, -1.0)]
        runs = [fm.rollout(agent, world, [SEED]) for world in worlds]
        ends = [np.column_stack([run.readings[0], np.append(0.0, np.cumsum(run.rewards[0]))]) for run in runs]
        return np.moveaxis(np.array(ends[::2]) - np.array(ends[1::2]), 0, 2) / (2.0 * step)

    best = (4.0 * differences(1e-3) - differences(2e-3)) / 3.0
    np.testing.assert_allclose(exact, best, atol=1e-7 * np.abs(exact).max())


@pytest.mark.parametrize("text", ["payload_mass", "stiffness[0]"])
def test_the_taylor_remainder_is_of_second_order(text, unrounded):
    """It falls by a hundred over a decade of the change, over two decades."""
    world = environment()
    found = fm.sensitivities(world, OUTPUTS, text, agent=PD, seed=SEED)
    changed = partial(ChangedEpisode(PD, world).outputs, text)
    orders = remainder_orders(
        found.values, found.jacobian[:, :, 0], changed, size_of(text), np.geomspace(1e-2, 1e-4, 3)
    )
    assert ((orders > 1.9) & (orders < 2.1)).all(), orders


def test_the_compliance_of_a_settled_pd_is_the_reciprocal_of_its_stiffness():
    world = environment("FlexOne-v0", 400, elements=1)
    names = ("motor_torques", "initial_joint_rates", "damping")
    found = fm.sensitivities(world, ("motor_angles", "actions"), names, agent="pd")
    expected = np.zeros((2, 3))
    expected[:, 0] = 1.0 / world.pd_gains["stiffness"][0], -1.0 / world.torque_limit[0]
    np.testing.assert_allclose(found.jacobian[-1], expected, atol=1e-10)


def test_a_step_along_the_gradient_changes_the_return_as_the_gradient_says():
    world = Configuration("FlexRRR-v0", {"horizon": 2.0})
    found = fm.sensitivities(world, "return", ("stiffness", "damping"), agent="pd")
    gains = np.concatenate([world.pd_gains["stiffness"], world.pd_gains["damping"]])
    step = 1e-3 * found.jacobian[-1, 0] * gains**2
    predicted = found.jacobian[-1, 0] @ step
    stiffness, damping = (gains + step).reshape(2, 3).tolist()
    run = fm.rollout({"kind": "pd", "stiffness": stiffness, "damping": damping}, world, [9000])
    assert predicted > 0.0
    assert run.rewards.sum() - found.values[-1, 0] == pytest.approx(predicted, rel=0.01)


def test_an_episode_that_fails_has_the_cause_as_status():
    found = fm.sensitivities(environment(limits={"rate": 0.5}), "return", "payload_mass", agent=PD, seed=SEED)
    assert "motor_rates" in found.status and 1 < len(found.time) < 21 and np.isfinite(found.jacobian).all()


OPEN = AgentSpec("open", None, None)  # no torques, with the sensors of the environment


class Heavy:
    """Sensor of the user."""

    measures = ()

    def entries(self, view, limits):
        return [("weight", 1, "N", 1.0)]

    def read(self, view, out):
        out[:] = 0.5


@pytest.mark.parametrize("arguments, words", [
    ({"agent": "adaptive-lqr"}, "agent: 'adaptive-lqr' is not allowed; give one with derivatives: zero, pd"),
    ({"agent": "mpc"}, "one with derivatives"),
    ({"agent": None}, "agent: None is not allowed; give an agent for an environment: zero, pd"),
    ({"step": 0.001}, "step: 0.001 is not allowed; give none for an environment"),
    ({"of": "strain"}, "of: 'strain' is not allowed"),
    ({"to": "gain"}, "to: 'gain' is not allowed; give one of payload_mass"),
    ({"to": "stiffness[2]", "agent": PD}, "to: 2 is not allowed"),
    ({"to": "torque_1[20]"}, "to: 20 is not allowed"),
    ({"to": "coulomb_friction"}, "without Coulomb friction"),
    ({"scene": environment(sensors="accelerometer")}, "sensors of this library without accelerations"),
    ({"scene": environment(sensors=[Heavy()])}, "sensors of this library without accelerations"),
    ({"scene": environment(sensors={"kind": "strain", "dropped": 0.1})}, "sensors.dropped: 0.1 is not allowed"),
    ({"scene": environment(randomisation={"dropped_samples": (0.1, 0.1)})}, "lost samples have no derivatives"),
    ({"scene": environment(reward=lambda view: view.tip_error), "of": "return"}, "a reward of a task of this library"),
    ({"scene": environment(method="dop853", step=0.001)}, "method: 'dop853' is not allowed"),
    ({"scene": fm.catalog.paper_scene("rr"), "agent": "pd"},
     "give None: a scene has no agent"),
])  # fmt: skip
def test_bad_arguments_are_refused_in_one_line(arguments, words):
    with pytest.raises(ValueError) as raised:
        fm.sensitivities(**{"scene": environment(), "agent": OPEN, **arguments})
    assert words in str(raised.value) and "\n" not in str(raised.value)
