"""Fine sensors: the full state again as arcsinh of quantity over scale, within bounds that hold."""

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs import NAMED
from flexman_gym.envs.env import FlexManEnv

BOTH = ("full", "fine")
SCALES = {
    "motor_rates": 0.02, "joint_twists": 0.004, "joint_twist_rates": 0.02, "link_deflections": 0.004,
    "link_deflection_rates": 0.02, "angle_errors": 0.01, "target_error": 0.02, "tip_velocity": 0.05,
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(NAMED))
def test_they_say_what_the_full_state_says(name):
    """Scales as in the docstring for FlexRRR-v0; elsewhere of the limits and the reach of the arm."""
    env = gym.make(name, sensors=BOTH, horizon=2.0).unwrapped
    places, setup = env.sensors.slices, env.setup
    assert {each.removeprefix("fine_") for each in places if each.startswith("fine_")} == SCALES.keys()
    reach, old = sum(link.length for link in setup.arm.links) / 8.5, fm.Limits()
    rate, twist = setup.limits.rate / old.rate, setup.limits.twist / old.twist
    factors = dict.fromkeys(SCALES, reach) | {
        "motor_rates": rate, "joint_twists": twist, "joint_twist_rates": rate,
        "angle_errors": setup.limits.angle / old.angle,
    }  # fmt: skip
    env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(30):
        seen = env.step(env.action_space.sample())[0].astype(float)
        for entry, scale in SCALES.items():
            expected = np.arcsinh(seen[places[entry]] / (scale * factors[entry]))
            assert seen[places[f"fine_{entry}"]] == pytest.approx(expected, rel=1e-4, abs=1e-4), entry


def test_half_of_a_millimetre_is_seen_and_twice_as_far_adds_no_more_than_a_constant():
    """Slope 1 / scale at zero; far away the logarithm of twice the distance is ln 2 more."""
    env = FlexManEnv(sensors="fine")
    place = env.sensors.slices["fine_angle_errors"]
    seen = {}
    for error in (0.0, 0.0005, 0.7, 1.4):
        start = np.array([0.1, 0.2, 0.3])
        seen[error] = env.reset(options={"start": start, "goal_angles": start + error})[0][place]
    assert seen[0.0] == pytest.approx(np.zeros(3), abs=1e-12)
    assert seen[0.0005] == pytest.approx(np.full(3, 0.05), rel=1e-3)
    assert seen[1.4] - seen[0.7] == pytest.approx(np.full(3, np.log(2.0)), abs=1e-3)


@pytest.mark.parametrize("name", sorted(NAMED))
def test_their_bounds_hold_and_are_those_of_the_quantities(name):
    """Full power in turns, until limits end many episodes; a bound is what the largest quantity becomes."""
    env = gym.make_vec(name, 32, "vector_entry_point", sensors=BOTH, limits=fm.Limits(rate=1.5)).unwrapped
    env.reset(seed=0)
    random, high, failures = np.random.default_rng(0), env.observation_space.high, 0
    for step in range(200):
        if step % 10 == 0:
            actions = np.sign(random.uniform(-1.0, 1.0, env.action_space.shape))
        seen, _, failed, *_ = env.step(actions)
        failures += failed.sum()
        assert (np.abs(seen) <= high).all()
    assert failures > 10
    places, bound = env.sensors.slices, env.sensors.bound
    for entry in SCALES:
        fine, full = bound[places[f"fine_{entry}"]], bound[places[entry]]
        scale = full / np.sinh(fine)
        assert scale == pytest.approx(np.full(len(scale), scale[0]) if entry != "link_deflections" else scale, rel=1e-5)
        assert (np.arcsinh(full / scale) <= fine * (1 + 1e-9)).all() and (fine < 15).all()


def test_a_quantity_on_its_bound_is_within():
    """Rounding to single precision of the largest posture error must not leave the space."""
    env = FlexManEnv(sensors="fine")
    env.reset(seed=0)
    view, sensors = env.episodes.view, env.sensors
    view.motion[:], view.goal_angles[:], view.motor_angles[:] = 0.0, 4.0, -4.0
    view.motor_rates[:] = 10.0
    sensors.read()
    assert (np.abs(sensors.observations) <= sensors.bound).all()
    assert env.observation_space.contains(sensors.observations[0].astype(np.float32))
