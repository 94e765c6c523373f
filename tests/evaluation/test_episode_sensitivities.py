"""Tests of derivatives of episodes: differences of rollouts extrapolated to zero, Taylor remainders, equal values."""

import sys
from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.control import network
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation import AgentSpec, find_agent
from flexman_gym.kernels import layout

SEED = 3
OUTPUTS = ("tip", "joint_rates", "elastic_energy", "gravitational_energy", "tip_error", "tip_vibration", "readings",
           "actions", "torques", "reward_terms", "return")  # fmt: skip
ROUNDING = 1e-14  # rounding error of an output, relative to its largest value
STEPS = np.array([4e-3, 5e-4, 6e-5])  # relative steps of the differences
SIZES = {"payload_mass": 0.1, "joint_stiffness": 50.0, "viscous_friction": 0.05, "coulomb_friction": 0.1,
         "link_stiffness_factor": 1.0, "initial_joint_angles": 0.3, "initial_joint_rates": 0.3, "motor_torques": 0.3,
         "tip_force": 3.0, "base_acceleration": 5.0, "stiffness": 10.0, "damping": 3.0}  # fmt: skip
PD = {"kind": "pd", "stiffness": [10.0, 12.0], "damping": [3.0, 0.6]}


def environment(id="FlexPlanar-v0", periods=20, **settings):
    named = Configuration(id, {})
    return Configuration(id, {"horizon": periods * named.control_period, "modes": 1, **settings})


def policy(size, outputs, algo="ppo", **interface):
    """Return an agent whose policy is a network with random weights."""
    random = np.random.default_rng(0)
    first, last = ("actor.latent_pi.", "actor.mu") if algo == "sac" else ("mlp_extractor.policy_net.", "action_net")
    shapes = {f"{first}0": (8, size), f"{first}2": (8, 8), last: (outputs, 8)}
    arrays = {f"{name}.weight": random.normal(0.0, 0.4, shape) for name, shape in shapes.items()}
    arrays |= {f"{name}.bias": random.normal(0.0, 0.1, shape[:1]) for name, shape in shapes.items()}
    law = network.Network(algo, None, arrays, {"mean": np.zeros(size), "var": np.full(size, 0.5)})
    return AgentSpec(algo, law, interface)


class Numpy:
    """NumPy in which float32 is float64: without the rounding of actions and observations to seven digits."""

    float32 = np.float64

    def __getattr__(self, name):
        return getattr(np, name)


@pytest.fixture
def unrounded(monkeypatch):
    for module in ("control.pd", "control.agent", "evaluation.rollout"):
        monkeypatch.setattr(sys.modules[f"flexman_gym.{module}"], "np", Numpy())


def change_plant(batch, name, index, steps):
    """Change a parameter of each arm of a batch by one of the steps."""
    model = batch.model
    n, d = model.n_joints, model.n_dof
    if name in batch.nominal:
        values = np.repeat(batch.nominal[name][None], len(steps), axis=0)
        values[(slice(None),) if index is None else (slice(None), index)] += steps
        batch.vary(np.arange(len(steps)), **{name: values})
    elif name.startswith("initial"):
        reset, first = batch.reset, d * name.endswith("rates")
        columns = sorted({first + index, first + int(model.motor_columns[index])})
        batch.reset = lambda arms, states: reset(arms, states + steps[:, None] * np.eye(2 * d)[columns].sum(axis=0))
    else:
        step, column = batch.step, {"motor_torques": 0, "tip_force": n, "base_acceleration": n + 3}[name] + index

        def changed_step(drive, moving):
            drive[:, column] = steps + drive[:, column] * (column < n)  # forces are not overwritten in each period
            step(drive, moving)

        batch.step = changed_step


def with_gain(agent, name, index, step):
    """Return an agent with a changed gain of its controller or of its servo."""
    given = dict(agent if isinstance(agent, dict) else agent.interface["actions"])
    given[name] = [each + step * (i == index) for i, each in enumerate(given[name])]
    return given if isinstance(agent, dict) else replace(agent, interface={**agent.interface, "actions": given})


def with_action(agent, column, number, steps):
    """Return an agent of which each arm has an action changed by one of the steps."""
    spec, count = find_agent(agent), [0]

    def law(observations):
        result = np.zeros((len(steps), 2)) if spec.law is None else np.array(spec.law(observations))
        result[:, column] += steps * (count[0] == number)
        count[0] += 1
        return result

    return replace(spec, law=law)


def outputs_of(agent, world, count, set_plant=None):
    """Return the outputs (count, T, m) of equal episodes, in the order of OUTPUTS."""
    parts = {name: [] for name in OUTPUTS}

    def record(episodes):
        view, outputs = episodes.view, episodes.batch.outputs.copy()
        begun, d = len(parts["tip"]) > 0, episodes.batch.model.n_dof
        reward = begun * episodes.rewards()[:, None]
        now = {
            "tip": outputs[:, layout.TIP],
            "joint_rates": episodes.batch.rows[:, d : d + view.n_joints],
            "elastic_energy": outputs[:, [layout.LINK_ENERGY, layout.JOINT_ENERGY]].sum(axis=1, keepdims=True),
            "gravitational_energy": outputs[:, [layout.GRAVITATIONAL]],
            "tip_error": view.tip_error[:, None],
            "tip_vibration": view.tip_vibration[:, None],
            "readings": episodes.measurements.read(),
            "actions": begun * view.action,
            "torques": begun * episodes.motors.torques,
            "reward_terms": begun * np.transpose([each * np.ones(count) for each in episodes.reward_terms.values()]),
            "return": reward + (parts["return"][-1] if begun else 0.0),
        }
        for name, values in now.items():
            parts[name].append(values.copy())

    fm.rollout(agent, world, [SEED] * count, record, set_plant)
    return np.concatenate([np.array(each) for each in parts.values()], axis=2).swapaxes(0, 1)


def changed(agent, world, text, steps):
    """Return the outputs (c, T, m) of episodes with a parameter changed by steps (c,)."""
    name, _, index = text.partition("[")
    index = int(index[:-1]) if index else None
    if name in ("stiffness", "damping"):
        return np.concatenate([outputs_of(with_gain(agent, name, index, step), world, 1) for step in steps])
    if name[-1].isdigit():
        return outputs_of(with_action(agent, int(name[-1]) - 1, index, steps), world, len(steps))
    return outputs_of(agent, world, len(steps), lambda batch: change_plant(batch, name, index, steps))


def extrapolated(agent, world, text):
    """Return derivatives (3, T, m) from central differences extrapolated to order six, and estimates of errors."""
    size = SIZES.get(text.partition("[")[0], 0.5)
    steps = size * STEPS[:, None] * np.array([1.0, 0.5, 0.25])
    every = changed(agent, world, text, np.concatenate([steps.ravel(), -steps.ravel()]))
    plus, minus = every.reshape(2, *steps.shape, *every.shape[1:])
    first, second, third = ((plus - minus) / (2.0 * steps[:, :, None, None])).swapaxes(0, 1)
    finer, coarser = (4.0 * third - second) / 3.0, (4.0 * second - first) / 3.0
    best = (16.0 * finer - coarser) / 15.0
    rounding = ROUNDING * np.abs(every).max(axis=(0, 1)) / steps[:, 2:]
    return best, np.abs(best - finer).max(axis=1) + rounding


LIMIT = {"torque_limit": [6.0, 2.0]}
ARM = fm.catalog.vertical_2r()
RUBBING = [replace(each, viscous_friction=0.1, coulomb_friction=0.2, coulomb_rate=0.5) for each in ARM.joints]
FRICTION = {"arm": replace(ARM, joints=RUBBING)}
DELAYED = [{"kind": "motor_encoders", "delay": 2}, {"kind": "strain", "every": 2}, "tip", "action", "command"]
BELLS, EXPONENTIAL = {"kind": "slew"}, {"kind": "slew", "reward": "exponential"}
CASES = {
    "PD at its torque limit": (environment(**LIMIT), PD,
        ("payload_mass", "joint_stiffness[0]", "initial_joint_angles[1]", "initial_joint_rates[0]", "motor_torques[1]",
         "tip_force[1]", "base_acceleration[0]", "stiffness[0]", "damping[1]", "torque_1[4]")),
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
        policy(60, 2, sensors="full", history=[0.1]), ("payload_mass", "tip_force[1]")),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_derivatives_are_those_of_extrapolated_differences(name, unrounded):
    world, agent, parameters = CASES[name]
    found = fm.sensitivities(world, OUTPUTS, parameters, agent=agent, seed=SEED)
    for column, text in enumerate(parameters):
        exact = found.jacobian[:, :, column]
        best, error = extrapolated(agent, world, text)
        scale = np.abs(exact).max(axis=0) + 1e-6 * np.abs(exact).max()
        deviation = np.abs(exact - best).max(axis=1)
        good = (deviation <= np.maximum(1e-8 * scale, 3.0 * error)).any(axis=0)
        assert good.all(), (text, np.array(found.outputs)[~good], (deviation / scale).min(axis=0)[~good])


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
    world, steps = environment(), 1e-2 * SIZES[text.partition("[")[0]] / np.array([1.0, 10.0, 100.0])
    found = fm.sensitivities(world, OUTPUTS, text, agent=PD, seed=SEED)
    linear = found.values + steps[:, None, None] * found.jacobian[:, :, 0]
    remainders = np.abs(changed(PD, world, text, steps) - linear).max(axis=(1, 2))
    orders = np.log10(remainders[:-1]) - np.log10(remainders[1:])
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
    ({"agent": None}, "agent: None is not allowed; give for an environment an agent alone: zero, pd"),
    ({"step": 0.001}, "step: 0.001 is not allowed; give for an environment an agent alone"),
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
