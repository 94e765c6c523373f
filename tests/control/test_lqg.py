"""LQG: a filter with the tracking law settles arms by what a laboratory sees, and is LQR where nothing is hidden."""

import numpy as np
import pytest

from flexman_gym.control.bases import BASES, make_base
from flexman_gym.control.controller import Episode, checked_controller
from flexman_gym.envs.description import Description
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.evaluation import rollout
from flexman_gym.metrics import settling_time

from oracles.refusals import refusal
from oracles.worlds import POSTURES, World, plant

SEEDS = range(70, 74)


def planar(condition="", **settings):
    """The planar arm, for a short while."""
    return Description(f"FlexPlanar-v0{condition}" if condition else "FlexPlanar-v0", settings)


def acted(base, noise, delay=0):
    """Actions (b, T, n) and errors (b, T + 1) m of an LQR on an arm whose instruments have some noise."""
    ranges = {"sensor_noise": (noise, noise), "delay": (delay, delay)}
    result = rollout(base, planar(randomisation=ranges, horizon=1.2), SEEDS)
    return result.actions, result.errors


@pytest.mark.parametrize("late", [0, 1])
def test_it_tends_to_the_regulator_that_is_told_all_as_noise_goes_to_zero(late):
    """In every torque of slews, in proportion to the noise; with none but for rounding."""
    told, _ = acted("privileged-lqr", 0.0, late)
    off = [np.abs(acted("lqg", noise, late)[0] - told).max() for noise in (1e-4, 1e-5, 1e-6, 0.0)]
    assert off[3] < 1e-6 and off[2] < 1e-3
    assert off[0] / off[1] == pytest.approx(10.0, rel=0.3) and off[1] / off[2] == pytest.approx(10.0, rel=0.05)


@pytest.mark.parametrize("condition", ["", "/delay"])
def test_it_settles_arms_by_the_sensors_of_a_laboratory(condition):
    described = Description.find(f"FlexPlanar-v0{condition}")
    result = rollout("lqg", Description(described.id, {**(described.settings or {}), "horizon": 4.0}), SEEDS)
    assert all(record.failure == "" for record in result.records)
    assert all(settling_time(each.errors, each.band, each.period) < 2.0 for each in result.records)


def test_a_delay_that_is_not_told_is_missed():
    """The filter that is told of one period too few is far from where the arm is."""
    off = []
    for told in (0, 1):
        world, lqg = World(plant(delay=(1, 1))), make_base("lqg", plant(delay=(told, told)))
        lqg.reset(world.arms, Episode(POSTURES, POSTURES + 0.5, 0.01))
        for _ in range(20):
            world.step(lqg.act(world.readings(), world.last, np.ones(3, dtype=bool)))
        lqg.act(world.readings(), world.last, np.ones(3, dtype=bool))
        off.append(np.abs(lqg.observer.states - world.batch.state).max())
    assert off[1] < 1e-6 < 1e-2 < off[0]


def test_a_constant_torque_is_taken_away():
    """Which nobody tells of: at the goal the arm is where it should be, and without that state it is not."""
    off = []
    for disturbed in (False, True):
        given = plant()
        world, lqg = World(given), make_base({"kind": "lqg", "disturbed": disturbed}, given)
        world.goals, world.offset = POSTURES + 0.1, np.array([0.4, -0.1])
        world.begin(lqg)
        for _ in range(500):
            world.step(lqg.act(world.readings(), world.last, np.ones(3, dtype=bool)))
        motors = world.batch.state[:, given.model.motor_columns]
        off.append(np.abs(motors - world.goals).max())
    assert off[1] < 1e-3 < 0.01 < off[0]


def test_it_starts_where_its_encoders_say_and_is_told_no_more():
    """Its sensors do not read the state, and it does not look where an episode says that it starts."""
    given, actions = plant(), []
    for told in (POSTURES, POSTURES + 0.3):
        world, lqg = World(given), make_base("lqg", given)
        lqg.reset(world.arms, Episode(told, POSTURES + 0.1, given.period))
        for _ in range(3):
            action = lqg.act(world.readings(), world.last, np.ones(3, dtype=bool))
            world.step(action)
        actions.append(action)
    assert np.array_equal(*actions) and BASES["lqg"].knows == ("model",)
    assert set(lqg.sensors) == {"motor_encoders", "joint_encoders", "strain"}


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
    assert said.startswith("sensors: ('tip',) is not allowed; give motor_encoders, beside which") and "\n" not in said


def test_a_state_holds_what_it_remembers():
    """In the middle of a slew, with torques on their way."""
    settings = {
        "name": "FlexPlanar-v0",
        "base": "lqg",
        "randomisation": {"delay": (1, 1), "sensor_noise": (1e-3, 1e-3)},
    }
    one, other = FlexManEnv(**settings), FlexManEnv(**settings)
    still, asked = np.zeros(2, dtype=np.float32), []
    one.reset(seed=1)
    for _ in range(23):
        one.step(still)
    other.reset(seed=2)
    other.set_state(one.get_state())
    for env in (one, other):
        rows = []
        for _ in range(20):
            env.step(still)
            rows.append(env.episodes.view.action.copy())
        asked.append(rows)
    assert np.array_equal(*asked) and np.abs(asked).max() > 0.1
