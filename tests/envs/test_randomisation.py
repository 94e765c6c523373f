"""Randomisation: each effect draws from its own stream within its range, and does what it says to an episode."""

import warnings
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from hypothesis import given, settings
from hypothesis import strategies as st

import flexman_gym as fm
from flexman_gym.envs.config.randomisation import Randomisation
from flexman_gym.envs.effects import SIGNALS
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.vector_env import FlexManVectorEnv
from flexman_gym.scene.joint import Motor
from flexman_gym.simulation.physical_parameters import PARAMETERS

from oracles.random_inputs import EVERYTHING, FRICTION, GEARS, actions

EFFECTS = (*PARAMETERS, *SIGNALS)
RANGES = {name: (EVERYTHING | FRICTION | GEARS)[Randomisation.range_name(name)] for name in EFFECTS}
BARE = FlexManEnv().unwrapped.simulator.model.arm
WORN = {
    "viscous_friction": 5.0,
    "coulomb_friction": 9.0,
    "static_friction": 11.0,
    "backlash": 0.0,
    "stiffness_pieces": ((40.0, 1.0),),
}
RUBBING = replace(
    BARE, modal_damping_ratio=0.01,
    joints=[replace(joint, rotor_inertia=0.0, **WORN,
                    motor=Motor(100.0, 0.05, joint.rotor_inertia / 1e4, ripple_cycles=1.0)) for joint in BARE.joints],
)  # fmt: skip
QUICK = settings(deadline=None, derandomize=True, max_examples=15)
STILL = {"start": [0.3, 0.4, -0.5], "goal_angles": [0.3, 0.4, -0.5]}
PUSH = np.array([0.5, -0.3, 0.2])


def env_with(*effects, **more):
    """An environment with some of the effects, within the ranges above."""
    return FlexManEnv(
        arm=RUBBING, randomisation={Randomisation.range_name(name): RANGES[name] for name in effects} | more
    )


def episodes(env, seeds):
    """What the episodes of these seeds, None to go on, drew and where they began."""
    infos = [env.reset(seed=seed)[1] for seed in seeds]
    return [{"start": env.simulator.state[:3].copy(), "goal": info["goal_angles"], **info["drawn"]} for info in infos]


@pytest.mark.slow
@QUICK
@given(st.sets(st.sampled_from(EFFECTS)), st.sampled_from(EFFECTS), st.integers(0, 2**32))
def test_an_effect_changes_neither_the_draws_of_others_nor_start_and_goal(effects, another, seed):
    without, with_it = env_with(*effects - {another}), env_with(*effects | {another})
    plain = FlexManEnv()
    for one, other in zip(*(episodes(env, [seed, None, None]) for env in (without, with_it)), strict=True):
        for name in one:
            assert np.array_equal(one[name], other[name]), name
    plain.reset(seed=seed)
    without.reset(seed=seed)
    assert np.array_equal(plain.simulator.state[:3], without.simulator.state[:3])


def test_draws_do_not_depend_on_what_happened_in_episodes_before():
    idle, busy = env_with(*EFFECTS), env_with(*EFFECTS)
    for env in (idle, busy):
        env.reset(seed=3)
    for action in actions(1, 15):
        busy.step(action[0])
    result, expected = (episodes(env, [None])[0] for env in (busy, idle))
    for name in expected:
        assert np.array_equal(result[name], expected[name]), name
    # and neither do noise and impulses of the next episode
    seen = [[env.step(0.1 * PUSH)[0] for _ in range(40)] for env in (idle, busy)]
    assert np.array_equal(*seen)


@pytest.mark.slow
def test_draws_lie_in_their_ranges_and_fill_them():
    env = FlexManVectorEnv(
        400, arm=RUBBING, modes=1, randomisation={Randomisation.range_name(name): span for name, span in RANGES.items()}
    )
    drawn, nominal = env.reset(seed=1)[1]["drawn"], env.batch.nominal
    scale = {name: nominal[name] for name in PARAMETERS if PARAMETERS[name].factor} | {"torque_limit": 400.0}
    for name, (low, high) in RANGES.items():
        if name not in drawn:
            assert name in ("tip_impulse", "tip_load"), "drawn on the way"
            continue
        values = drawn[name] / scale.get(name, 1.0)
        values = np.linalg.norm(values, axis=-1) if name == "initial_vibration" else values
        width, rounding = high - low, 1e-12 * high
        assert (
            low - rounding <= values.min() < low + 0.05 * width
            and high - 0.05 * width < values.max() <= high + rounding
        )
        if values.ndim > 1:
            own = np.corrcoef(values.T) - np.eye(values.shape[1])
            assert np.abs(own).max() < 0.25, "each joint, link and sensor for itself"


@pytest.mark.parametrize("name", PARAMETERS)
def test_what_is_drawn_is_what_moves(name):
    """The same episode with the drawn values given as parameters."""
    drawn, set_by_hand = env_with(name), FlexManEnv(arm=RUBBING)
    values = drawn.reset(seed=5)[1]["drawn"][name]
    set_by_hand.reset(seed=5, options={"parameters": {name: values}})
    nominal = FlexManEnv(arm=RUBBING)
    nominal.reset(seed=5)
    for _ in range(10):
        observations = [env.step(PUSH)[0] for env in (drawn, set_by_hand, nominal)]
    assert np.array_equal(observations[0], observations[1]) and (observations[0] != observations[2]).any()


def test_given_parameters_go_before_drawn_ones_and_are_said():
    env, plain = env_with("payload_mass", "rotor_inertia"), env_with("payload_mass", "rotor_inertia")
    info = env.reset(seed=2, options={"parameters": {"payload_mass": 4.5}})[1]
    assert info["drawn"]["payload_mass"] == 4.5
    expected = [plain.reset(seed=seed)[1]["drawn"] for seed in (2, None)]
    assert np.array_equal(info["drawn"]["rotor_inertia"], expected[0]["rotor_inertia"])
    assert env.reset()[1]["drawn"]["payload_mass"] == expected[1]["payload_mass"]


def test_torque_limits_scale_the_torques():
    env, plain = env_with("torque_limit"), FlexManEnv(arm=RUBBING)
    factors = env.reset(seed=4)[1]["drawn"]["torque_limit"] / 400.0
    plain.reset(seed=4)
    for _ in range(5):
        result, expected = env.step(PUSH)[0], plain.step(PUSH * factors)[0]
    assert result == pytest.approx(expected, rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("periods", [0, 1, 3])
def test_torques_come_late_by_whole_periods(periods):
    late, plain = FlexManEnv(randomisation={"delay": (periods, periods)}), FlexManEnv()
    commands = np.random.default_rng(0).uniform(-1.0, 1.0, (12, 3))
    for _ in range(2):  # also after an episode that left commands behind
        assert late.reset(seed=6)[1]["drawn"] == {"delay": periods}
        plain.reset(seed=6)
        waiting = np.concatenate([np.zeros((periods, 3)), commands])
        for command, arriving in zip(commands, waiting, strict=False):
            result, expected = late.step(command), plain.step(arriving)
            assert np.array_equal(result[0], expected[0])


@pytest.mark.parametrize("modes", ["assembled", None, 3])
def test_the_initial_vibration_deflects_each_tip_as_drawn_and_starts_at_rest(modes):
    env = FlexManEnv(modes=modes, randomisation={"initial_vibration": (0.01, 0.02)})
    for seed in range(3):
        observation, info = env.reset(seed=seed)
        tips = info["drawn"]["initial_vibration"]
        sizes = np.linalg.norm(tips, axis=1)
        assert (sizes <= 0.02 + 1e-12).all() and (modes is not None or (sizes >= 0.01 - 1e-12).all())
        assert observation[env.sensors.slices["link_deflections"]] == pytest.approx(tips.ravel(), rel=1e-5, abs=1e-8)
        assert not env.simulator.state[env.simulator.model.n_dof :].any()
        assert info["energy_residual"] == 0.0 < info["elastic_energy"]
    for _ in range(20):
        info = env.step(np.zeros(3))[4]
    assert info["tip_vibration"] > 0.0


def test_the_initial_shape_is_the_one_of_a_force_on_the_tip():
    """With all coordinates of one link: the cubic of a cantilever, W (3 s^2 - s^3) / 2 at the part s of its length."""
    arm = fm.catalog.one_link(rotor_inertia=1.0)
    env = FlexManEnv(arm=arm, modes=None, torque_limit=1.0, randomisation={"initial_vibration": (0.01, 0.01)})
    _, info = env.reset(seed=0, options={"start": [0.0], "goal_angles": [0.0]})
    model, state = env.simulator.model, env.simulator.state
    bent = fm.curves(model, state, 16).positions[0] - fm.curves(model, model.initial_state([0.0]), 16).positions[0]
    part = fm.curves(model, model.initial_state([0.0]), 16).positions[0] @ np.array(arm.links[0].orientation)[:, 0]
    part = part / arm.links[0].length
    expected = (3 * part**2 - part**3) / 2 * np.linalg.norm(info["drawn"]["initial_vibration"])
    assert np.linalg.norm(bent, axis=1) == pytest.approx(expected, abs=1e-9)


def test_a_strip_bends_where_it_is_thin():
    """A strip 40 mm wide and 5 mm thick resists 64 times more across its width: (40 / 5) squared, Euler-Bernoulli."""
    env = FlexManVectorEnv(200, name="FlexPlanar-v0", modes=None, randomisation={"initial_vibration": (0.01, 0.01)})
    tips = env.reset(seed=0)[1]["drawn"]["initial_vibration"]
    stiff, soft = tips[..., 0], tips[..., 1]
    np.testing.assert_allclose((64.0 * stiff) ** 2 + soft**2, 0.01**2, rtol=1e-9)
    assert np.abs(soft).max() > 0.0099 and np.abs(stiff).max() > 0.99 * 0.01 / 64.0


LAB = ["motor_encoders", "strain"]


def lab_readings(periods, **ranges):
    """Readings (T, size) of a moving arm with laboratory sensors, the slices of the entries, and the environment."""
    env = FlexManEnv(sensors=LAB, randomisation=ranges)
    rows = [env.reset(seed=3)[0]] + [env.step(0.1 * PUSH * (-1) ** (k // 10))[0] for k in range(periods)]
    return np.array(rows, dtype=float), env.sensors.slices, env


def test_a_bias_stays_for_an_episode_and_is_the_drawn_part_of_each_range():
    exact, _, env = lab_readings(10)
    biased, _, other = lab_readings(10, sensor_bias=(-0.02, 0.03))
    drawn = other.episodes.effects.drawn["sensor_bias"][0]
    assert drawn.shape == env.sensors.bound.shape
    np.testing.assert_allclose(biased - exact, np.tile(drawn * env.sensors.bound, (11, 1)), atol=1e-5)


def test_gains_scale_the_strains_alone():
    exact, slices, _ = lab_readings(10)
    scaled, _, env = lab_readings(10, gauge_gain_factor=(0.8, 1.2))
    gains = env.episodes.effects.drawn["gauge_gain"][0]
    strains = slices["root_strains"]
    np.testing.assert_allclose(scaled[:, strains], gains * exact[:, strains], rtol=1e-5)
    assert np.array_equal(np.delete(scaled, np.r_[strains], axis=1), np.delete(exact, np.r_[strains], axis=1))


def test_a_sensor_loses_whole_samples_as_often_as_drawn_and_never_the_first():
    rows, slices, _ = lab_readings(400, dropped_samples=(0.1, 0.1), sensor_noise=(0.001, 0.001))
    same = rows[1:] == rows[:-1]
    encoders = np.r_[slices["motor_angles"], slices["motor_rates"]]
    lost = {"encoders": same[:, encoders], "strain": same[:, slices["root_strains"]]}
    assert all((each.all(axis=1) == each.any(axis=1)).all() for each in lost.values()), "all numbers or none"
    shares = [each[:, 0].mean() for each in lost.values()]
    assert shares == pytest.approx([0.1, 0.1], abs=0.06)
    assert not np.array_equal(lost["encoders"][:, 0], lost["strain"][:, 0]), "each sensor for itself"
    assert rows[0].any()


def test_friction_may_be_none_but_a_stiffness_not():
    env = FlexManEnv(arm=RUBBING, randomisation={"coulomb_friction_factor": (0.0, 0.0)})
    assert not env.reset(seed=0)[1]["drawn"]["coulomb_friction"].any()
    with pytest.raises(ValueError, match="joint_stiffness_factor"):
        fm.Randomisation(joint_stiffness_factor=(0.0, 1.0))


@pytest.mark.slow
def test_impulses_come_with_their_gap_and_their_size():
    """Momentum of the whole arm is hard to see; the force that the simulator was given is not."""
    period, gap = 0.02, 0.1
    env = FlexManVectorEnv(
        50, modes=1, max_episode_steps=10**6, randomisation={"tip_impulse": (1.0, 2.0), "impulse_gap": gap}
    )
    env.reset(seed=0)
    drives, step = [], env.batch.step
    env.batch.step = lambda drive, playing: drives.append(drive.copy()) or step(drive, playing)
    for _ in range(400):
        env.step(np.zeros((50, 3)))
    drives = np.array(drives)
    forces = drives[..., 3:6]
    sizes = np.linalg.norm(forces, axis=2) * period
    hit = sizes > 0.0
    assert ((sizes[hit] >= 1.0 - 1e-12) & (sizes[hit] <= 2.0 + 1e-12)).all()
    count = hit.sum()
    assert count == pytest.approx(50 * 400 * period / gap, abs=5 * np.sqrt(50 * 400 * 0.2 * 0.8))
    ways = forces[hit] / np.linalg.norm(forces[hit], axis=1)[:, None]
    assert np.abs(ways.mean(axis=0)).max() < 5 / np.sqrt(3 * count)
    assert not drives[..., :3].any() and not drives[..., 6:].any()


def test_an_impulse_pushes_the_tip():
    calm, pushed = FlexManEnv(), FlexManEnv(randomisation={"tip_impulse": (5.0, 5.0), "impulse_gap": 0.02})
    for env in (calm, pushed):
        env.reset(seed=1, options=STILL)
        info = env.step(np.zeros(3))[4]
        assert (info["tip_vibration"] > 1e-3) == (env is pushed)


@pytest.mark.slow
def test_noise_is_normal_with_the_drawn_deviation_and_stays_in_the_space():
    env, plain = FlexManEnv(randomisation={"sensor_noise": (0.02, 0.02)}), FlexManEnv()
    assert env.observation_space == plain.observation_space
    measured = np.r_[:24, 33:36]  # the rest is derived from it
    noise = []
    for seed in range(4):
        observations = [each.reset(seed=seed, options=STILL)[0] for each in (env, plain)]
        for _ in range(200):
            noise.append(((observations[0] - observations[1]) / plain.sensors.bound / 0.02)[measured])
            observations = [each.step(0.01 * PUSH)[0] for each in (env, plain)]
            assert env.observation_space.contains(observations[0])
            assert np.array_equal(env.simulator.state, plain.simulator.state), "noise moves nothing"
    values = np.array(noise)
    assert np.abs(values).max() < 4.001
    many = values.size
    assert abs(values.mean()) < 5 / np.sqrt(many) and abs(values.std() - 1.0) < 5 / np.sqrt(2 * many) + 0.001
    assert np.abs(np.corrcoef(values.T) - np.eye(values.shape[1])).max() < 6 / np.sqrt(len(values))
    assert abs((values[1:] * values[:-1]).mean()) < 5 / np.sqrt(many), "one step tells nothing of the next"


def test_limits_are_judged_without_noise():
    """On a motor rate that noise lifts over the limit half of the time."""
    limits = fm.Limits(rate=0.3)
    noisy, plain = (FlexManEnv(limits=limits, randomisation=given) for given in ({"sensor_noise": (0.1, 0.1)}, None))
    for env in (noisy, plain):
        env.reset(seed=1, options=STILL)
    for _ in range(100):
        results = [env.step(PUSH) for env in (noisy, plain)]
        assert results[0][2] == results[1][2] and results[0][4]["failure"] == results[1][4]["failure"]
        if results[0][2]:
            break
    assert results[0][2]


@pytest.mark.feature
def test_checkers_find_nothing_to_complain_about():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gym.make("FlexRRR-v0", randomisation=EVERYTHING).unwrapped)
        checker = pytest.importorskip("stable_baselines3.common.env_checker")
        checker.check_env(gym.make("FlexRRR-v0", randomisation=EVERYTHING))
        env = gym.make("FlexRRR-v0", randomisation=fm.Randomisation(**EVERYTHING))
        env.reset(seed=0)
        for action in actions(1, 10):
            env.step(action[0])


def test_nothing_is_drawn_where_nothing_is_asked():
    assert fm.Randomisation().effects == ()
    assert "drawn" not in FlexManEnv().reset(seed=0)[1]
    assert FlexManEnv(randomisation=fm.Randomisation()).reset(seed=0)[1]["drawn"] == {}
