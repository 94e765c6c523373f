"""Holding: the task to hold a tip against disturbances, and an arm that has to hold its own weight."""

from itertools import product

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.agent.pd import PD
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.vector_env import FlexManVectorEnv

OFF = {"tip_impulse": None, "tip_load": None, "base_sway": None}


def drives(env, steps):
    """What moved the arms (T, b, n + 6), without torques."""
    result, step = [], env.batch.step
    env.batch.step = lambda drive, playing: result.append(drive.copy()) or step(drive, playing)
    for _ in range(steps):
        env.step(np.zeros(env.action_space.shape))
    env.batch.step = step
    return np.array(result)


def test_without_disturbances_a_held_arm_stays_where_it_is():
    env = FlexManEnv(name="FlexRRR-Hold-v0", randomisation=OFF)
    _, info = env.reset(seed=1)
    for _ in range(50):
        _, reward, _, _, info = env.step(np.zeros(3))
        assert info["tip_error"] < 1e-12 and reward == pytest.approx(1.0)
    assert info["drawn"] == {}


def test_the_reward_of_a_moved_hold_is_the_same_with_weights_of_one():
    """The terms in Python are those of the compiled reward."""
    rewards = []
    for weights in (None, {"distance": 1.0}):
        env = FlexManEnv(name="FlexRRR-Hold-v0", randomisation=OFF, reward=weights)
        env.reset(seed=1)
        rewards.append([env.step(np.full(3, 0.3))[1] for _ in range(50)])
    assert rewards[1] == pytest.approx(rewards[0], rel=1e-9) and np.ptp(rewards[0]) > 0.3


def test_a_hold_names_its_disturbances_and_a_randomisation_goes_before_them():
    env = FlexManEnv(name="FlexRRR-Hold-v0", randomisation={"base_sway": (0.3, 0.3), "payload_mass": (1.0, 2.0)})
    _, info = env.reset(seed=1)
    assert info["drawn"].keys() == {"base_sway", "payload_mass"} and info["drawn"]["base_sway"] == 0.3
    assert FlexManEnv(name="FlexRRR-Hold-v0").configuration.disturbances.base_sway == (0.0, 0.1)
    assert env.configuration.disturbances.tip_load == (0.0, 10.0) and env.configuration.disturbances.impulse_gap == 3.0
    assert env.configuration.randomisation.tip_load is None, "what was given stays as it was given"


def test_loads_stay_until_they_change():
    """Sizes fill their range, directions every way, and times between changes are those of even chances."""
    gap, period, arms, steps = 0.2, 0.02, 40, 400
    env = FlexManVectorEnv(
        arms, modes=1, max_episode_steps=10**6, randomisation={"tip_load": (1.0, 3.0), "impulse_gap": gap}
    )
    env.reset(seed=0)
    forces = drives(env, steps)[..., 3:6]
    sizes = np.linalg.norm(forces, axis=2)
    assert sizes.min() >= 1.0 - 1e-12 and sizes.max() <= 3.0 + 1e-12 and np.ptp(sizes) > 1.9
    changed = (np.diff(forces, axis=0) != 0.0).any(axis=2)
    share = period / gap
    many = changed.size
    assert changed.mean() == pytest.approx(share, abs=5 * np.sqrt(share * (1 - share) / many))
    ways = (forces / sizes[..., None])[1:][changed]
    assert np.abs(ways.mean(axis=0)).max() < 5 / np.sqrt(3 * len(ways))
    waits = np.concatenate([np.diff(np.flatnonzero(column)) for column in changed.T])
    assert waits.std() == pytest.approx(np.sqrt(1.0 - share) / share, rel=0.15), "geometric, as without memory"


@pytest.mark.slow
def test_a_base_sways_as_a_sine():
    """One frequency an episode, between 0.3 and 3 times that of the first mode, in one direction."""
    arms, steps, period = 60, 800, 0.02
    env = FlexManVectorEnv(arms, modes=1, max_episode_steps=10**6, randomisation={"base_sway": (0.1, 0.2)})
    infos = env.reset(seed=0)[1]
    first = env.episodes.view.first_frequency
    shaken = drives(env, steps)[..., 6:]
    times, result = period * (np.arange(steps) + 0.5), []
    for arm in range(arms):
        ways = np.linalg.svd(shaken[:, arm], full_matrices=False)
        assert ways[1][1] < 1e-9 * ways[1][0], "one direction"
        wave = shaken[:, arm] @ ways[2][0]
        curvature = -np.diff(wave, 2)[np.argmax(np.abs(wave[1:-1]))] / wave[1:-1][np.argmax(np.abs(wave[1:-1]))]
        frequency = np.arccos(1.0 - curvature / 2.0) / (2.0 * np.pi * period)
        fit = np.column_stack([np.cos(2 * np.pi * frequency * times), np.sin(2 * np.pi * frequency * times)])
        factors, *_ = np.linalg.lstsq(fit, wave, rcond=None)
        assert wave == pytest.approx(fit @ factors, abs=1e-6)
        assert np.hypot(*factors) == pytest.approx(infos["drawn"]["base_sway"][arm], rel=1e-5)
        result.append(frequency / first)
    assert 0.3 - 1e-6 <= min(result) < 0.5 and 2.0 < max(result) <= 3.0 + 1e-6
    assert np.median(result) == pytest.approx(np.sqrt(0.3 * 3.0), rel=0.4), "evenly on a logarithmic scale"


def test_the_energy_of_disturbances_is_in_the_ledger():
    """Without motors all energy of a disturbed arm comes from them: none is left over."""
    for effect, span in (("tip_load", (20.0, 20.0)), ("base_sway", (0.5, 0.5))):
        env = FlexManEnv(randomisation={effect: span})
        env.reset(seed=2)
        for _ in range(100):
            info = env.step(np.zeros(3))[4]
        assert env.simulator.energy > 0.3 and abs(info["energy_residual"]) < 0.01 * env.simulator.energy, effect


# Gravity


def test_the_arm_holds_every_posture_of_its_task_with_a_full_payload():
    """All corners of the range of its motors, and the outstretched arm, with 20 kg; a fifth of the torque is left."""
    setup = FlexManEnv(name="FlexRRR-Gravity-v0").configuration
    arm = NAMED_ENVIRONMENTS["FlexRRR-Gravity-v0"].arm
    heavy = fm.Arm(arm.links, arm.joints, fm.Payload(20.0), arm.gravity, modal_damping_ratio=0.005)
    model = fm.build_model(heavy, 2)
    reach = setup.task.start + setup.task.slew
    corners = [*product((-reach, reach), repeat=3), *product((0.0,), (-reach, 0.0, reach), (-reach, 0.0, reach))]
    torques = np.abs([fm.holding_torques(model, corner) for corner in corners])
    assert (torques <= 0.8 * np.array(setup.torque_limit)).all()
    # the whole arm stretched out, by hand: half of each link's weight at its middle, the payload at the end
    weights = 9.81 * np.array([66.024, 23.1084, 20.0])
    shoulder, elbow = weights @ [2.0, 5.75, 7.5], weights[1:] @ [1.75, 3.5]
    assert torques[corners.index((0.0, 0.0, 0.0)), 1:] == pytest.approx([shoulder, elbow], rel=0.02)


@pytest.mark.slow
def test_without_integral_action_a_pd_leaves_the_offset_that_statics_says():
    """Motors rest where stiffness x offset is the torque that holds the arm there."""
    env = FlexManEnv(name="FlexRRR-Gravity-v0", sensors="servo", horizon=60.0)
    stiffness, damping = np.array([8730.0, 20100.0, 6810.0]), np.array([8210.0, 9480.0, 1730.0])
    controller = PD(stiffness, damping, env.torque_limit)
    posture = [0.2, 0.3, -0.4]
    observation, _ = env.reset(seed=0, options={"start": posture, "goal_angles": posture})
    for _ in range(4000):
        readings = {name: observation[place] for name, place in env.sensors.slices.items()}
        observation, _, terminated, _, info = env.step(controller.act(readings))
        assert not terminated, info["failure"]
    angles = env.simulator.state[env.simulator.model.motor_columns]
    held = fm.holding_torques(env.simulator.model, angles)
    assert stiffness * (np.array(posture) - angles) == pytest.approx(held, abs=2.0)
    assert np.abs(held).max() > 2000.0


def test_the_joints_have_the_stiffness_that_is_advertised():
    assert [joint.stiffness for joint in NAMED_ENVIRONMENTS["FlexRRR-Gravity-v0"].arm.joints] == [6e4] * 3
