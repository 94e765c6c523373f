"""Sensors: observations say what the simulator and the lines of the drawn arm say, at every fidelity the same size."""

from itertools import pairwise

import gymnasium as gym
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import flexman_gym as fm
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.sensors import FullState
from flexman_gym.envs.sensors.sensor_array import SensorArray
from flexman_gym.envs.view import View
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.simulator import Simulator

ARM = fm.catalog.paper_rrr()
REACH = sum(link.length for link in ARM.links)


def moving(model, size=0.05, seed=1):
    """A simulator at a random state: turning, wound up, bent and vibrating."""
    simulator = Simulator(model)
    simulator.reset(state=np.random.default_rng(seed).normal(0.0, size, 2 * model.n_dof))
    return simulator


def sensors_of(batch, limits=fm.Limits()):  # noqa: B008
    """The full state of a batch, and its view."""
    view = View(batch)
    return SensorArray([FullState()], view, limits), view


def sensors_for(limits=fm.Limits(), **choice):  # noqa: B008
    """The full state of one arm with a model of that choice."""
    return sensors_of(Batch(fm.build_model(ARM, **choice)), limits)[0]


def observe(simulator, posture=(0.0, 0.0, 0.0), target=(0.0, 0.0, 0.0)):
    """Slices of the observation of one arm, by name."""
    sensors, view = sensors_of(simulator.batch)
    view.goal_angles[:], view.target[:] = posture, target
    view.read()
    sensors.read()
    return {name: sensors.observations[0, part] for name, part in sensors.slices.items()}


def beam_frames(angles):
    """(3, 3) axes of each link of the undeformed arm, whose joint axes are given at zero angles in the base frame."""
    turn = Rotation.identity()
    for link, joint, angle in zip(ARM.links, ARM.joints, angles, strict=True):
        turn = turn * Rotation.from_rotvec(angle * np.array(joint.axis))
        yield turn.as_matrix() @ np.array(link.orientation)


def test_slices_follow_each_other_and_each_has_unit_and_bound():
    sensors = sensors_for(modes=2)
    parts = list(sensors.slices.values())
    assert parts[0].start == 0 and parts[-1].stop == len(sensors.bound)
    assert all(before.stop == after.start for before, after in pairwise(parts))
    assert sensors.units.keys() == sensors.slices.keys()
    assert (sensors.bound > 0.0).all()


@pytest.mark.parametrize("flexible_joints", [True, False])
def test_joints_and_goals_are_the_differences_they_claim(flexible_joints):
    model = fm.build_model(ARM, modes=3, flexible_joints=flexible_joints)
    simulator = moving(model)
    posture, target, d = np.array([0.3, -0.2, 0.5]), np.array([4.0, 1.0, 2.0]), model.n_dof
    x, v = simulator.state[:d], simulator.state[d:]
    result = observe(simulator, posture, target)
    for kind, vector in (("s", x), ("_rates", v)):
        motors = vector[3:6] if flexible_joints else vector[:3]  # the order that kernels.layout describes
        assert np.array_equal(result[f"motor_{'angles' if kind == 's' else 'rates'}"], motors)
        assert result[f"joint_twist{kind}"] == pytest.approx(motors - vector[:3], abs=1e-15)
    assert np.array_equal(result["angle_errors"], posture - result["motor_angles"])
    assert np.array_equal(result["target_error"], target - simulator.tip)
    reach, error = sum(link.length for link in ARM.links), target - simulator.tip
    assert result["target_nearness"] == pytest.approx(error / (0.1 / 8.5 * reach + np.linalg.norm(error)), rel=1e-12)
    assert np.array_equal(result["tip_velocity"], simulator.tip_velocity)


@pytest.mark.parametrize("modes", [None, 4, 2])
@pytest.mark.parametrize("link", [0, 1, 2])
def test_the_deflection_of_a_link_is_where_its_drawn_tip_went(link, modes):
    model = fm.build_model(ARM, modes=modes)
    angles = np.array([0.4, 0.5, -0.8])
    straight = model.initial_state(angles)
    bent = straight.copy()
    columns = model.elastic_columns(link)
    bent[columns] = np.random.default_rng(link).normal(0.0, 0.05, columns.stop - columns.start)
    simulator = Simulator(model)
    simulator.reset(state=bent)
    moved = fm.curves(model, bent, 16).positions[link, -1] - fm.curves(model, straight, 16).positions[link, -1]
    expected = np.zeros((3, 2))
    expected[link] = (moved @ list(beam_frames(angles))[link])[1:]
    assert np.abs(expected).max() > 1e-6
    assert observe(simulator)["link_deflections"] == pytest.approx(expected.ravel(), abs=1e-12)


@pytest.mark.parametrize("modes", [None, 4])
def test_rates_are_the_slopes_of_what_they_are_rates_of(modes):
    model = fm.build_model(ARM, modes=modes)
    simulator, d, step = moving(model), model.n_dof, 1e-6
    x, v = simulator.state[:d], simulator.state[d:]
    result = observe(simulator)
    before, after = Simulator(model), Simulator(model)
    for other, sign in ((before, -1.0), (after, 1.0)):
        other.reset(state=np.append(x + sign * step * v, v))
    earlier, later = observe(before), observe(after)
    for name, rate in (
        ("motor_angles", "motor_rates"),
        ("joint_twists", "joint_twist_rates"),
        ("link_deflections", "link_deflection_rates"),
    ):
        assert result[rate] == pytest.approx((later[name] - earlier[name]) / (2 * step), abs=1e-8)
    ends = [fm.curves(model, other.state, 16).positions[-1, -1] for other in (before, after)]
    assert result["tip_velocity"] == pytest.approx((ends[1] - ends[0]) / (2 * step), abs=1e-7)


@pytest.mark.parametrize("flexibility", [True, False, (True, False, True)])
@pytest.mark.parametrize("elements", [1, 2])
@pytest.mark.parametrize("modes", [0, 2, None])
def test_size_and_bounds_do_not_depend_on_the_fidelity(elements, modes, flexibility):
    reference = sensors_for()
    sensors = sensors_for(elements=elements, modes=modes, flexible_links=flexibility)
    assert sensors.slices == reference.slices
    assert np.array_equal(sensors.bound, reference.bound)


def test_a_batch_reads_what_its_rows_read():
    model = fm.build_model(ARM, modes=4)
    arms = [moving(model, seed=seed) for seed in range(5)]
    rng, batch = np.random.default_rng(0), Batch(model, arms=5)
    postures, targets, (sensors, view) = rng.normal(size=(5, 3)), rng.normal(size=(5, 3)), sensors_of(batch)
    batch.reset(np.arange(5), np.array([arm.state for arm in arms]))
    view.goal_angles[:], view.target[:] = postures, targets
    view.read()
    sensors.read()
    for arm, posture, target, row in zip(arms, postures, targets, sensors.observations, strict=True):
        assert np.array_equal(np.concatenate(list(observe(arm, posture, target).values())), row)


def test_an_observation_on_its_bound_is_inside_and_the_next_number_is_not():
    class Preset(FullState):
        shown = 0.0

        def read(self, view, out):
            out[:] = Preset.shown

    env = FlexManEnv(sensors=Preset(), modes=2)
    sensors = env.sensors

    def said(values):
        Preset.shown = 0.0
        env.reset(seed=0)
        Preset.shown = values
        return env.step(np.zeros(3))[4]["failure"]

    assert said(sensors.bound) == said(-sensors.bound) == ""
    for name, part in sensors.slices.items():
        for i in range(part.start, part.stop):
            for value in (np.nextafter(sensors.bound[i], np.inf), -2 * sensors.bound[i], np.inf, np.nan):
                observation = np.zeros(len(sensors.bound))
                observation[i] = value
                text = said(observation)
                assert text.startswith(f"{name} ") and sensors.units[name] in text


def test_bounds_are_the_limits():
    limits = fm.Limits(angle=1.0, rate=2.0, twist=3.0, deflection=0.5, deflection_rate=5.0, tip_speed=6.0)
    sensors = sensors_for(limits, modes=2)
    for name, expected in {
        "motor_angles": 1.0,
        "motor_rates": 2.0,
        "joint_twists": 3.0,
        "joint_twist_rates": 2.0,
        "link_deflections": 0.5 * np.repeat([link.length for link in ARM.links], 2),
        "link_deflection_rates": 5.0,
        "tip_velocity": 6.0,
    }.items():
        assert sensors.bound[sensors.slices[name]] == pytest.approx(expected)
    # Two postures within the limits are at most two limits apart, tip and target at most two reaches.
    assert sensors.bound[sensors.slices["angle_errors"]] == pytest.approx(2.0)
    assert sensors.bound[sensors.slices["target_error"]] == pytest.approx(2 * REACH)


BOTH = ("full", "fine")
SCALES = {
    "motor_rates": 0.02, "joint_twists": 0.004, "joint_twist_rates": 0.02, "link_deflections": 0.004,
    "link_deflection_rates": 0.02, "angle_errors": 0.01, "target_error": 0.02, "tip_velocity": 0.05,
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(NAMED_ENVIRONMENTS))
def test_they_say_what_the_full_state_says(name):
    """Scales as in the docstring for FlexRRR-v0; elsewhere of the limits and the reach of the arm."""
    env = gym.make(name, sensors=BOTH, horizon=2.0).unwrapped
    places, setup = env.sensors.slices, env.configuration
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


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(NAMED_ENVIRONMENTS))
def test_their_bounds_hold_and_are_those_of_the_quantities(name):
    """Full power in turns, until limits end many episodes; a bound is what the largest quantity becomes."""
    rate = {"FlexTwoMass-v0": 0.3, "FlexGantry-v0": 0.05}.get(name, 1.5)  # rad/s; two masses and a load are slow
    env = gym.make_vec(name, 32, "vector_entry_point", sensors=BOTH, limits=fm.Limits(rate=rate)).unwrapped
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
