"""Output feedback: observers with the tracking law, in environments and alone."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from flexman_gym.agent.base_controllers import BASES, make_base
from flexman_gym.agent.controller import EpisodeInfo, checked_controller
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.vector_env import FlexManVectorEnv
from flexman_gym.evaluation.rollouts import rollout
from flexman_gym.metrics import settling_time
from flexman_gym.toolbox.controllers.observers.observer import Estimate
from flexman_gym.toolbox.controllers.output_feedback import OutputFeedback
from flexman_gym.toolbox.controllers.tracking import Tracking

from oracles.assertions import refusal, same_side_by_side
from oracles.observed_arms import POSTURES, SMALL, World, plant
from oracles.random_inputs import asked_after_a_state

UNKNOWN = {"payload_mass": (0.0, 0.2), "joint_stiffness_factor": (0.7, 1.3), "link_stiffness_factor": (0.7, 1.3)}
LAB = {**UNKNOWN, "delay": (0, 2), "sensor_noise": (0.001, 0.001)}
ONE, ON = np.array([0]), np.ones(1, dtype=bool)
START, GOAL = np.array([[0.1, -0.3]]), np.array([[0.6, 0.4]])
SETTINGS = {
    "adaptive": {"base": "adaptive-lqr", "randomisation": LAB},
    "biased": {"base": {"kind": "adaptive-lqr", "biased": True}, "randomisation": LAB},
    "nothing unknown": {"base": "adaptive-lqr"},
    "privileged": {"base": "privileged-lqr", "randomisation": LAB},
    "pushed": {"base": "adaptive-lqr", "randomisation": {**LAB, "tip_load": (0.0, 0.3)}},
    "path": {"base": "adaptive-lqr", "randomisation": LAB, "name": "FlexPlanar-Track-v0"},
}


@pytest.mark.slow
@pytest.mark.parametrize("which", SETTINGS)
def test_one_arm_gets_the_same_bits_alone_and_among_others(which):
    settings = {**SMALL, "horizon": 0.24, **SETTINGS[which]}
    name = settings.pop("name", "FlexPlanar-v0")
    arms = gym.make_vec(name, 3, "vector_entry_point", autoreset_mode="SameStep", **settings)
    singles = gym.make_vec(name, 3, "sync", vector_kwargs={"autoreset_mode": AutoresetMode.SAME_STEP}, **settings)
    still = np.zeros((40, *arms.action_space.shape), dtype=np.float32)
    assert sum(same_side_by_side(arms, singles, still, 2)) >= 3, "new episodes were seen"


@pytest.mark.slow
@pytest.mark.parametrize("which", SETTINGS)
def test_an_environment_made_alike_goes_on_from_a_state(which):
    """To the last bit, with trials, filters and references on their way."""
    settings = {**SMALL, "name": "FlexPlanar-v0", "horizon": 3.0, **SETTINGS[which]}
    env, other = (FlexManVectorEnv(2, **settings) for _ in range(2))
    env.reset(seed=1)
    other.reset(seed=5)
    zero = np.zeros(env.action_space.shape, dtype=np.float32)
    for _ in range(33):
        env.step(zero)
    for _ in range(8):
        other.step(zero)
    other.set_state(env.get_state())
    for period in range(20):
        assert np.array_equal(env.step(zero)[0], other.step(zero)[0]), period


@pytest.mark.slow
@pytest.mark.parametrize("which", ["adaptive", "nothing unknown", "privileged"])
def test_it_brings_an_arm_to_its_goal(which):
    settings = {**SMALL, "name": "FlexPlanar-v0", "horizon": 4.0, **SETTINGS[which]}
    env = FlexManVectorEnv(3, **settings)
    _, infos = env.reset(seed=9000)
    zero = np.zeros(env.action_space.shape, dtype=np.float32)
    for _ in range(300):
        *_, infos = env.step(zero)
    assert not env.episodes.failures
    assert (infos["tip_error"] < {"adaptive": 0.01, "nothing unknown": 2e-3, "privileged": 1e-2}[which]).all()
    observer = env.episodes.base.observer
    if which == "adaptive":
        assert np.array_equal(observer.delays, env.episodes.effects.drawn["delay"])


def test_what_is_said_to_be_unknown_counts_for_observer_and_law():
    """Ranges given by hand replace those of the environment; joint stiffness is estimated in any case."""
    base = {"kind": "adaptive-lqr", "unknown": {"payload_mass": (0.0, 0.2)}}
    env = FlexManVectorEnv(1, name="FlexPlanar-v0", base=base, **SMALL)
    assert env.episodes.base.observer.uncertain.names == ("joint_stiffness", "joint_stiffness", "payload_mass")
    assert env.episodes.base.law.slews._payloads.tolist() == [0.0, 0.1, 0.2]


SEEDS = range(70, 74)


def planar(condition="", **settings):
    """The planar arm, for a short while."""
    return Configuration(f"FlexPlanar-v0{condition}" if condition else "FlexPlanar-v0", settings)


def acted(base, noise, delay=0):
    """Actions (b, T, n) and errors (b, T + 1) m of an LQR on an arm whose instruments have some noise."""
    ranges = {"sensor_noise": (noise, noise), "delay": (delay, delay)}
    result = rollout(base, planar(randomisation=ranges, horizon=1.2), SEEDS)
    return result.actions, result.errors


@pytest.mark.slow
@pytest.mark.parametrize("late", [0, 1])
def test_it_tends_to_the_regulator_that_is_told_all_as_noise_goes_to_zero(late):
    """In every torque of slews, in proportion to the noise; with none but for rounding."""
    told, _ = acted("privileged-lqr", 0.0, late)
    off = [np.abs(acted("lqg", noise, late)[0] - told).max() for noise in (1e-4, 1e-5, 1e-6, 0.0)]
    assert off[3] < 1e-6 and off[2] < 1e-3
    assert off[0] / off[1] == pytest.approx(10.0, rel=0.3) and off[1] / off[2] == pytest.approx(10.0, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("condition", ["", "/delay"])
def test_it_settles_arms_by_the_sensors_of_a_laboratory(condition):
    described = Configuration.find(f"FlexPlanar-v0{condition}")
    result = rollout("lqg", Configuration(described.id, {**described.given, "horizon": 4.0}), SEEDS)
    assert all(record.failure == "" for record in result.records)
    assert all(settling_time(each.errors, each.band, each.period) < 2.0 for each in result.records)


def test_a_delay_that_is_not_told_is_missed():
    """The filter that is told of one period too few is far from where the arm is."""
    off = []
    for told in (0, 1):
        world, lqg = World(plant(delay=(1, 1))), make_base("lqg", plant(delay=(told, told)))
        lqg.reset(world.arms, EpisodeInfo(POSTURES, POSTURES + 0.5, 0.01), len(world.arms))
        for _ in range(20):
            world.step(lqg.act(world.readings(), world.last, np.ones(3, dtype=bool)))
        lqg.act(world.readings(), world.last, np.ones(3, dtype=bool))
        off.append(np.abs(lqg.observer.states - world.batch.state).max())
    assert off[1] < 1e-6 < 1e-2 < off[0]


@pytest.mark.slow
def test_a_constant_torque_is_taken_away():
    """Which nobody tells of: at the goal the arm is where it should be, and without that state it is not."""
    off = []
    for disturbed in (False, True):
        given = plant()
        world, lqg = World(given), make_base({"kind": "lqg", "disturbed": disturbed}, given)
        world.goals, world.offset = POSTURES + 0.1, np.array([0.2, -0.05])
        world.begin(lqg)
        for _ in range(500):
            world.step(lqg.act(world.readings(), world.last, np.ones(3, dtype=bool)))
        motors = world.batch.state[:, given.model.motor_columns]
        off.append(np.abs(motors - world.goals).max())
    assert off[1] < 1e-6 < 0.01 < off[0]


def test_it_starts_where_its_encoders_say_and_is_told_no_more():
    """Its sensors do not read the state, and it does not look where an episode says that it starts."""
    given, actions = plant(), []
    for told in (POSTURES, POSTURES + 0.3):
        world, lqg = World(given), make_base("lqg", given)
        lqg.reset(world.arms, EpisodeInfo(told, POSTURES + 0.1, given.period), len(world.arms))
        for _ in range(3):
            action = lqg.act(world.readings(), world.last, np.ones(3, dtype=bool))
            world.step(action)
        actions.append(action)
    assert np.array_equal(*actions) and BASES["lqg"].information == ("model",)
    assert set(lqg.sensors) == {"motor_encoders", "joint_encoders", "strain"}


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"disturbed": True}, {"fixed": True}])
def test_an_arm_among_many_is_moved_as_an_arm_alone_to_the_bit(options):
    base = {"kind": "lqg", **options}
    described = planar(randomisation={"sensor_noise": (1e-3, 1e-3), "delay": (1, 1)}, horizon=0.5)
    many = rollout(base, described, SEEDS)
    for row, seed in enumerate(SEEDS):
        assert np.array_equal(rollout(base, described, [seed]).actions[0], many.actions[row])


def test_a_name_with_arguments_makes_it():
    made = make_base({"kind": "lqg", "sensors": ("motor_encoders",), "noise": (0.1, 0.0)}, plant())
    assert made.sensors == ("motor_encoders",) and checked_controller("base", made) is made
    said = refusal(lambda: FlexManEnv(base={"kind": "lqg", "sensors": ("tip",)}))
    assert said.startswith("sensors: ('tip',) is not allowed; give motor_encoders, and any of") and "\n" not in said


@pytest.mark.slow
def test_a_state_holds_what_it_remembers():
    """In the middle of a slew, with torques on their way."""
    noise = {"delay": (1, 1), "sensor_noise": (1e-3, 1e-3)}
    one, other = (FlexManEnv(name="FlexPlanar-v0", base="lqg", randomisation=noise) for _ in range(2))
    asked = asked_after_a_state(one, other, 23, 20)
    assert np.array_equal(*asked) and np.abs(asked).max() > 0.1


class Doubtful:
    """Observer of an arm at rest, with flags that a test sets; as fallback it asks for a ninth of the limits."""

    sensors = ()

    def __init__(self, plant, start):
        self.state, self.inconsistent, self.consistent = plant.model.at_rest(start), ~ON, ON

    def reset(self, arms, episode, count):
        pass

    def estimate(self, readings, applied, active):
        return Estimate(self.state, np.zeros(1, dtype=np.int64), {})

    def act(self, readings, applied, active):
        return np.full((1, 2), 1.0 / 9.0)


def test_a_fallback_ends_when_the_model_has_explained_the_readings_for_a_second():
    """The slew is then planned from where the arm is; a doubt on the way begins the second anew."""
    given = plant("FlexPlanar-v0")
    observer = Doubtful(given, START)
    controller = OutputFeedback(observer, Tracking(given), observer)
    controller.reset(ONE, EpisodeInfo(START, GOAL, given.period), 1)
    periods, fallen = round(1.0 / given.period), []
    for period in range(10 + 2 * periods):
        observer.inconsistent = ON & (period == 5)
        observer.consistent = ON & (period not in (5, 8))
        fallen.append(bool((controller.act({}, np.zeros((1, 2)), ON) == 1.0 / 9.0).all()))
        if period == 20:
            observer.state = given.model.at_rest(START + 0.1)
    assert fallen == [False] * 5 + [True] * (3 + periods) + [False] * (2 + periods)
    assert controller.law.slews.at(np.zeros(1), ONE)[0] == 0.0
    begin = controller.law.slews.motion(np.zeros(1), np.zeros(1), ONE)[0][:, given.model.motor_columns]
    assert begin == pytest.approx(START + 0.1)
