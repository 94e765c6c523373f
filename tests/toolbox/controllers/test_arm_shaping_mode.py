"""Reference shaping in units of the arm: observations that scaling and number of joints do not change."""

import math

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.envs.vector_env import FlexManVectorEnv
from flexman_gym.toolbox.controllers.arm_scales import ArmScales
from flexman_gym.toolbox.controllers.arm_shaping_mode import ACTIONS_PER_SLEW, SCALING_TIMES_PER_SLEW, action_periods
from flexman_gym.toolbox.controllers.references import adaptive_references

from oracles.assertions import refusal

BASE = {"kind": "privileged-lqr", "design": "arm"}
SHAPED = {"actions": {"kind": "shaping", "units": "arm", "pace": 0.7}, "sensors": (), "base": BASE}
SIZE, DEVIATIONS = 26, slice(19, 22)  # number of observed quantities, and place of the deviations
TWICE = adaptive_references.DURATION_FACTOR**16  # about 2; durations that are tried are powers of this factor


def chain(joints, length=1.0, mass=1.0, time=1.0, springs=True, gravity=True):
    """An arm with links of 0.5 m, 60 N m and more, in units of length (m), mass (kg) and time (s)."""
    force, inertia = mass * length / time**2, mass * length**2
    links = [
        fm.Link(0.5 * length, 1e-4 * length**2, 2e-9 * length**4, 3e-9 * length**4, 4e-9 * length**4,
                7e10 * force / length**2, 2.6e10 * force / length**2, 2700.0 * mass / length**3)
        for _ in range(joints)
    ]  # fmt: skip
    torques = 60.0 / 3.0 ** np.arange(joints)
    axes = [(0.0, 0.0, 1.0), *[(0.0, -1.0, 0.0)] * (joints - 1)] if joints > 1 else [(0.0, -1.0, 0.0)]
    joint = [
        fm.Joint(axis, rotor_inertia=0.02 * inertia, stiffness=1500.0 * force * length if springs else None,
                 damping=1.0 * force * length * time if springs else 0.0, torque_limit=float(torque) * force * length)
        for axis, torque in zip(axes, torques, strict=True)
    ]  # fmt: skip
    weight = (0.0, 0.0, -9.81 * length / time**2 if gravity else 0.0)
    return fm.Arm(links, joint, fm.Payload(0.2 * mass), gravity=weight, modal_damping_ratio=0.01)


def seen(joints, length=1.0, mass=1.0, time=1.0, springs=True, doubt=False, actions=(0.5, -0.8, 1.0, 0.3)):
    """Observations of two episodes at the start and after each action, each held for its control periods."""
    arm = chain(joints, length, mass, time, springs)
    ranges = {"payload_mass": [0.0, 0.4 * mass], "link_stiffness_factor": [0.7, 1.3]}
    settings = {
        **SHAPED, "arm": arm, "control_period": 0.005 * time, "horizon": 5.0 * time, "step": 0.0025 * time,
        "limits": fm.Limits(rate=20.0 / time, deflection_rate=50.0 * length / time, tip_speed=50.0 * length / time),
        "slew_time": 0.5 * time, "randomisation": ranges, "base": {**BASE, "doubt": doubt},
    }  # fmt: skip
    plain = Configuration("FlexRRR-v0", settings)
    repeat = action_periods(make_plant(plain, resolve_fidelity(plain).model))
    env = FlexManVectorEnv(2, name="FlexRRR-v0", action_repeat=repeat, **settings)
    found = [env.reset(seed=3)[0].copy()]
    for action in actions:
        found.append(env.step(np.full((2, 1), action, dtype=np.float32))[0].copy())
    return np.array(found)


@pytest.mark.parametrize("joints", [1, 2, 3])
@pytest.mark.parametrize(("springs", "doubt"), [(True, False), (False, True)])
@pytest.mark.parametrize("units", [(4.0, 1.0, 1.0), (1.0, 8.0, 1.0), (1.0, 1.0, TWICE), (0.25, 4.0, TWICE)])
def test_units_of_length_mass_and_time_do_not_change_the_observation(joints, springs, doubt, units, monkeypatch):
    expected = seen(joints, springs=springs, doubt=doubt)
    time = units[2]  # constants in s and 1/s^2 at which references are differentiated
    monkeypatch.setattr(adaptive_references, "DIFFERENCE_STEP", time * adaptive_references.DIFFERENCE_STEP)
    acceleration = adaptive_references.TYPICAL_ACCELERATION / time**2
    monkeypatch.setattr(adaptive_references, "TYPICAL_ACCELERATION", acceleration)
    found = seen(joints, *units, springs=springs, doubt=doubt)
    if doubt:  # whose errors are seeded by last digits of parameters; their deviations are not
        found, expected = ([each[0], each[..., DEVIATIONS]] for each in (found, expected))
        assert (expected[1] > 0.0).any()
    for each, other in zip(found, expected, strict=True):
        assert each == pytest.approx(other, rel=1e-5, abs=1e-5)  # single precision


@pytest.mark.parametrize("joints", [1, 2, 3])
def test_names_and_sizes_do_not_depend_on_the_number_of_joints(joints):
    env = FlexManVectorEnv(1, name="FlexRRR-v0", arm=chain(joints), **SHAPED)
    mode = env.episodes.agent.mode
    assert mode.names == ("pace",) and sum(mode.observation_sizes.values()) == SIZE
    assert list(mode.observation_sizes) == ["clock", "tip", "torques", "parameters", "deviations", "arm", "action"]
    assert env.single_observation_space.shape == (SIZE,)


def parts(env, observations):
    """The observed quantities by name."""
    sizes = env.episodes.agent.mode.observation_sizes
    ends = np.cumsum(list(sizes.values()))
    return {name: observations[:, end - size : end] for (name, size), end in zip(sizes.items(), ends, strict=True)}


def test_the_observation_at_the_start_has_its_closed_forms():
    arm = chain(2, gravity=False)
    env = FlexManVectorEnv(1, name="FlexRRR-v0", arm=arm, **SHAPED)
    first = parts(env, env.reset(seed=2)[0])
    configuration = env.configuration
    plant = make_plant(configuration, resolve_fidelity(configuration).model)
    scales = ArmScales.of(plant.model, plant.torque_scales, plant.rate_limit)
    progress, speed, _, remaining, whole, scaling = first["clock"][0]
    assert (progress, speed, scaling) == (0.0, 0.0, 1.0) and remaining == whole > 0.0
    assert first["tip"][0, :2] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert first["torques"][0, 1:4].max() <= 0.95 + 1e-6  # the fraction of the limits that a slew may have
    assert first["torques"][0, 4:] == pytest.approx([0.0, 0.0], abs=1e-6)  # weightless at the goal; nothing applied
    assert first["parameters"] == pytest.approx(np.ones((1, 3)))
    assert not first["deviations"].any() and not first["action"].any()
    assert first["arm"][0] == pytest.approx([
        math.log(scales.torque_ratio), scales.vibration / scales.slew, ACTIONS_PER_SLEW * plant.period / scales.slew,
    ])  # fmt: skip


def test_an_action_is_held_for_a_share_of_the_slew_and_moves_the_time_scaling_exponentially():
    env = FlexManVectorEnv(1, name="FlexRRR-v0", arm=chain(2), **SHAPED)
    observation = parts(env, env.reset(seed=2)[0])
    configuration = env.configuration
    plant = make_plant(configuration, resolve_fidelity(configuration).model)
    slew, periods = ArmScales.of(plant.model, plant.torque_scales, plant.rate_limit).slew, action_periods(plant)
    assert periods * plant.period == pytest.approx(slew / ACTIONS_PER_SLEW, abs=plant.period / 2.0) and periods > 1
    for command in (1.0, *[-1.0] * (periods - 1)):  # commands between two actions are ignored
        assert observation["action"][0, 0] == 0.0
        observation = parts(env, env.step(np.full((1, 1), command, dtype=np.float32))[0])
    share = 1.0 - math.exp(-SCALING_TIMES_PER_SLEW * plant.period * periods / slew)
    assert observation["action"][0, 0] == 1.0
    assert observation["clock"][0, 5] == pytest.approx(1.0 + share * (math.exp(0.7) - 1.0), rel=1e-6)


def test_held_commands_and_repeated_actions_are_the_same_motion():
    arm = chain(2)
    single = FlexManVectorEnv(2, name="FlexRRR-v0", arm=arm, **SHAPED)
    configuration = single.configuration
    periods = action_periods(make_plant(configuration, resolve_fidelity(configuration).model))
    repeated = FlexManVectorEnv(2, name="FlexRRR-v0", arm=arm, action_repeat=periods, **SHAPED)
    assert np.array_equal(single.reset(seed=5)[0], repeated.reset(seed=5)[0])
    for command in (0.4, -0.9, 0.7):
        actions = np.full((2, 1), command, dtype=np.float32)
        for _ in range(periods):
            last = single.step(actions)[0]
        assert np.array_equal(last, repeated.step(actions)[0])


def test_an_action_of_zero_is_the_base_controller_to_the_bit():
    arm, periods = chain(2), 40
    plain = FlexManVectorEnv(2, name="FlexRRR-v0", arm=arm, base=BASE)
    shaped = FlexManVectorEnv(2, name="FlexRRR-v0", arm=arm, **SHAPED)
    torques = []
    for env, size in ((plain, 2), (shaped, 1)):
        asked: list[np.ndarray] = []
        env.reset(seed=1)
        env.episodes.callback = lambda asked=asked, env=env: asked.append(env.episodes.view.action.copy())
        for _ in range(periods):
            env.step(np.zeros((2, size), dtype=np.float32))
        torques.append(np.array(asked))
    assert np.array_equal(*torques)


def test_what_needs_the_number_of_joints_is_refused():
    for name, value in (("offset", 0.08), ("torque", 0.5), ("fading", 0.05)):
        actions = {**SHAPED["actions"], name: value}
        text = f"actions.{name}: {value} is not allowed; give 0 with units: arm, whose only action is the pace"
        env = {**SHAPED, "actions": actions}
        assert refusal(lambda env=env: FlexManVectorEnv(1, name="FlexRRR-v0", arm=chain(2), **env)) == text
    wrong = {**SHAPED, "actions": {"kind": "shaping", "units": "metre"}}
    assert refusal(lambda: FlexManVectorEnv(1, name="FlexRRR-v0", arm=chain(2), **wrong)).startswith("actions.units:")
