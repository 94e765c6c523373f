"""Named environments: each id keeps the contracts and takes the same keywords everywhere; none is easy or fragile."""

import inspect
import subprocess
import sys
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import flexman_gym as fm
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.config.settings import SETTINGS as DECLARED
from flexman_gym.envs.rendering import RENDER_KEYWORDS
from flexman_gym.envs.vector_env import OWN_KEYWORDS
from flexman_gym.metrics import settling_time

from oracles.assertions import same_alone_and_among_others

IDS = sorted(NAMED_ENVIRONMENTS)
NEW = ("FlexPlanar-v0", "FlexOne-v0")
SWITCHES = ("stiffening", "spinning_rotors", "rotary_inertia")


def episodes(name, count, act, **settings):
    """Rewards (T, count), tip errors (T + 1, count) and periods (count,) of an episode of each arm, from its seed."""
    env = gym.make_vec(name, count, "vector_entry_point", autoreset_mode="Disabled", **settings).unwrapped
    _, infos = env.reset(seed=9000)
    rewards, errors, lasted = [], [infos["tip_error"]], np.full(count, env.max_episode_steps)
    for step in range(env.max_episode_steps):
        _, worth, failed, _, infos = env.step(act(env.action_space))
        rewards.append(np.where(lasted < step, 0.0, worth))
        errors.append(infos["tip_error"])
        lasted[failed & (lasted > step)] = step + 1
        if failed.any() and step < env.max_episode_steps - 1:
            env.reset(options={"reset_mask": failed})
    return np.array(rewards), np.array(errors), lasted


def still(space):
    """No torque from the agent."""
    return np.zeros(space.shape, dtype=np.float32)


@pytest.mark.slow
def test_an_environment_is_read_at_its_first_use_and_once():
    program = (
        "import sys\nread = []\n"
        "sys.addaudithook(lambda name, info: read.append(str(info[0])) if name == 'open' else None)\n"
        "from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS as known\n"
        "known['FlexOne-v0'], known['FlexOne-v0'], 'FlexDeck-v0' in known, sorted(known)\n"
        "print(*(path.rpartition('/')[2] for path in read if path.endswith('-v0.yaml')))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "FlexOne-v0.yaml\n"


# Contracts


@pytest.mark.feature
@pytest.mark.parametrize("name", IDS)
def test_both_libraries_find_nothing_to_complain_about(name):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gym.make(name).unwrapped)
        checker.check_env(gym.make(name))
        checker.check_env(gym.make(name, sensors=("full", "fine"), action_repeat=5, base="pd"))


@pytest.mark.slow
@pytest.mark.parametrize("name", IDS)
def test_the_vector_environment_is_many_single_ones_bit_for_bit(name):
    same_alone_and_among_others(name, horizon=1.0, sensors=("full", "fine"), action_repeat=2)


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize(("period", "horizon", "periods"), [(None, 0.4, None), (0.04, 0.4, 10), (0.005, 0.1, 20)])
def test_an_episode_lasts_its_horizon_whatever_the_control_period(name, period, horizon, periods):
    env = gym.make(name, control_period=period, horizon=horizon)
    periods = periods or round(horizon / NAMED_ENVIRONMENTS[name].control_period)
    env.reset(seed=0)
    ends = [env.step(np.zeros(env.action_space.shape, dtype=np.float32))[2:4] for _ in range(periods)]
    assert ends == [(False, False)] * (periods - 1) + [(False, True)]
    assert env.unwrapped.simulator.time == pytest.approx(horizon)


@pytest.mark.parametrize("name", IDS)
def test_without_keywords_an_environment_is_its_entry(name):
    setup, named = gym.make(name).unwrapped.configuration, NAMED_ENVIRONMENTS[name]
    assert (setup.arm, setup.task, setup.limits) == (named.arm, named.task, named.limits)
    assert (setup.control_period, setup.horizon) == (named.control_period, named.horizon)
    assert setup.torque_limit == tuple(joint.torque_limit or 0.0 for joint in named.arm.joints)
    assert setup.max_periods == named.horizon / named.control_period
    assert (setup.action_repeat, setup.base) == (1, None)


# Keywords


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("switch", SWITCHES)
def test_every_switch_of_the_model_reaches_it(name, switch):
    """As `build_model` with the same keyword gives it, and not as without."""
    changed = {switch: not DECLARED[switch].default}
    models = {}
    for kind in ("single", "vector"):
        make = gym.make if kind == "single" else lambda *a, **k: gym.make_vec(*a, 1, "vector_entry_point", **k)
        env = make(name, modes=2, **changed).unwrapped
        models[kind] = env.simulator.model if kind == "single" else env.batch.model
    expected = fm.build_model(NAMED_ENVIRONMENTS[name].arm, 2, 2, **changed)
    plain = fm.build_model(NAMED_ENVIRONMENTS[name].arm, 2, 2)
    state, torque = np.linspace(0.1, 1.0, 2 * expected.n_dof), np.ones(expected.n_joints)
    wanted = fm.acceleration(expected, state, torque)
    for model in models.values():
        assert np.array_equal(fm.acceleration(model, state, torque), wanted)
    # Rotors with a fixed axis, and no rotor.
    fixed = name in ("FlexOne-v0", "FlexRotary-v0", "FlexGantry-v0") and switch == "spinning_rotors"
    if name != "FlexTwoMass-v0" and not fixed:  # a rigid link has neither foreshortening nor sections
        assert (fm.acceleration(plain, state, torque) != wanted).any()


def test_the_switches_are_all_that_build_model_has():
    own = set(inspect.signature(fm.build_model).parameters) - {"arm", "flexible_links", "flexible_joints"}
    assert own - {"elements", "modes"} == set(SWITCHES)
    assert own <= DECLARED.keys()


SETTINGS = {
    "settings": "named",
    "arm": fm.catalog.vertical_2r(), "task": fm.Slew(), "sensors": "fine", "limits": fm.Limits(rate=9.0),
    "history": 2, "gains": {"stiffness": (9.0, 3.0), "damping": (2.0, 1.0)}, "info_keys": ("motor_angles",),
    "torque_limit": (9.0, 3.0), "control_period": 0.02, "horizon": 0.1, "slew_time": 0.5, "base": "pd",
    "action_repeat": 3, "fidelity": "default", "actions": {"kind": "torque"}, "drive_bandwidth": 30.0,
    "reward": {"effort": 2.0}, "tolerance": None, "elements": 1, "modes": 2, "method": "implicit_midpoint",
    "step": 0.01, "stiffening": True,
    "spinning_rotors": True, "rotary_inertia": False, "energy_alarm": 0.2, "randomisation": {"delay": (0, 2)},
    "clip_actions": True, "render_mode": None, "render_size": (64, 48), "render_camera": (10.0, 20.0),
    "render_gain": 2.0, "render_overlays": False,
}  # fmt: skip


def test_gym_make_and_gym_make_vec_take_the_same_keywords():
    """All of them at once, none of them the default; both give the same episode."""
    # safety refuses the lag of drive_bandwidth; a foundation has an action of its own, see toolbox.foundations
    assert DECLARED.keys() - {"safety", "foundation"} == SETTINGS.keys() - {*RENDER_KEYWORDS}
    assert set(OWN_KEYWORDS) - {
        "num_envs",
        "threads",
        "max_episode_steps",
        "autoreset_mode",
        "infos",
        "seed_stride",
    } == {*RENDER_KEYWORDS}
    single = gym.make("FlexPlanar-v0", **SETTINGS)
    many = gym.make_vec("FlexPlanar-v0", 2, "vector_entry_point", **SETTINGS)
    seen, others = single.reset(seed=3)[0], many.reset(seed=3)[0]
    assert np.array_equal(seen, others[0])
    for _ in range(2):
        one, two = single.step(np.full(2, 0.3)), many.step(np.full((2, 2), 0.3))
        assert np.array_equal(one[0], two[0][0]) and one[1] == two[1][0] and one[3] == two[3][0]


# Neither easy nor fragile


@pytest.mark.slow
@pytest.mark.parametrize("name", NEW)
def test_pd_settles_and_doing_nothing_earns_little(name):
    """50 episodes: within 1 % of the reach in at least half of them; zero action earns less than 40 % of that."""
    reach = sum(link.length for link in NAMED_ENVIRONMENTS[name].arm.links)
    rewards, errors, lasted = episodes(name, 50, still, base="pd")
    assert (lasted == NAMED_ENVIRONMENTS[name].horizon / NAMED_ENVIRONMENTS[name].control_period).all()
    settled = [settling_time(error, 0.01 * reach, NAMED_ENVIRONMENTS[name].control_period) for error in errors.T]
    assert np.isfinite(settled).mean() >= 0.5
    nothing = episodes(name, 50, still)[0]
    assert nothing.sum() < 0.4 * rewards.sum() and rewards.sum() > 0


@pytest.mark.parametrize("name", IDS)
def test_random_actions_do_not_end_an_episode_at_once(name):
    random = np.random.default_rng(0)
    lasted = episodes(name, 30, lambda space: random.uniform(-1.0, 1.0, space.shape), horizon=1.0)[2]
    assert np.median(lasted) * NAMED_ENVIRONMENTS[name].control_period >= 0.5
