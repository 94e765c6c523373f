"""LQR: stable about its goal, exact at rest, within the limits, and the same for an arm alone and among many."""

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.control import LQR, Controller, Episode, TrackingLQR
from flexman_gym.control.discrete import Weights, zero_order_hold
from flexman_gym.control.lqr import SHARE
from flexman_gym.control.reference import plan_path, plan_slew
from flexman_gym.control.timing import LAWS, minimum_jerk
from flexman_gym.envs.catalog import NAMED
from flexman_gym.envs.sensors import SENSORS
from flexman_gym.envs.setup import build, setup_of

from oracles.refusals import refusal

PERIOD, ALL = 0.02, np.arange(3)


def designed(kind, name="FlexPlanar-v0"):
    """A controller of the arm of a named environment."""
    setup = setup_of({"name": name})
    return kind(build(setup).model, setup.torque_limit, setup.control_period)


def postures(controller, count, seed=0):
    """Starts and goals (count, n) rad."""
    return np.random.default_rng(seed).uniform(-0.8, 0.8, (2, count, controller.model.n_joints))


@pytest.mark.parametrize("name", sorted(NAMED))
def test_the_sampled_closed_loop_is_stable_at_any_posture(name):
    lqr = designed(LQR, name)
    for posture in postures(lqr, 2)[0]:
        state, held = fm.rest_state(lqr.model, posture), fm.holding_torques(lqr.model, posture)
        transition, inputs = zero_order_hold(fm.linearize(lqr.model, state=state, torque=held), lqr.period)
        open_loop, closed = (
            np.abs(np.linalg.eigvals(transition - inputs @ gain)).max()
            for gain in (np.zeros((len(held), len(state))), lqr.gain(posture))
        )
        assert closed < 0.9999 and open_loop > 0.9999


@pytest.mark.parametrize("kind", [LQR, TrackingLQR])
def test_an_arm_at_rest_on_its_goal_is_held_and_nothing_else(kind):
    controller = designed(kind)
    goals = postures(controller, 3)[1]
    controller.reset(ALL, Episode(goals, goals, PERIOD))
    states = np.array([fm.rest_state(controller.model, goal) for goal in goals])
    held = np.array([fm.holding_torques(controller.model, goal) for goal in goals])
    for _ in range(3):
        assert controller.act({"state": states}) == pytest.approx(held / controller.limits, abs=1e-9)


@pytest.mark.parametrize("kind", [LQR, TrackingLQR])
def test_an_arm_among_many_gets_what_an_arm_alone_gets_to_the_bit(kind):
    many, rng = designed(kind), np.random.default_rng(3)
    starts, goals = postures(many, 3)
    many.reset(ALL, Episode(starts, goals, PERIOD))
    singles = [designed(kind) for _ in ALL]
    for single, start, goal in zip(singles, starts, goals, strict=True):
        single.reset(np.array([0]), Episode(start[None], goal[None], PERIOD))
    for _ in range(5):
        states = 0.1 * rng.standard_normal((3, 2 * many.model.n_dof))
        actions = many.act({"state": states})
        for action, single, state in zip(actions, singles, states, strict=True):
            assert np.array_equal(single.act({"state": state}), action)
        assert (np.abs(actions) <= 1.0).all() and actions.shape == (3, 2)


@pytest.mark.parametrize("kind", [LQR, TrackingLQR])
def test_a_new_episode_of_one_arm_changes_nothing_for_the_others(kind):
    one, other = designed(kind), designed(kind)
    starts, goals = postures(one, 3)
    for each in (one, other):
        each.reset(ALL, Episode(starts, goals, PERIOD))
    states = np.array([fm.rest_state(one.model, start) for start in starts])
    for _ in range(4):
        assert np.array_equal(one.torques(states), other.torques(states))
    one.reset(np.array([1]), Episode(goals[1:2], starts[1:2], PERIOD))
    again, before = one.torques(states), other.torques(states)
    assert np.array_equal(again[[0, 2]], before[[0, 2]]) and (again[1] != before[1]).any()
    fresh = designed(kind)
    fresh.reset(np.array([0]), Episode(goals[1:2], starts[1:2], PERIOD))
    assert np.array_equal(fresh.torques(states[1:2])[0], again[1]), "it begins at the beginning"


def followed_gains(controller, start, goal):
    """The gains (T + 1, 2 d) in the periods of a slew of one joint, and the motor angles (T + 1,) of its plan.

    They are what the torques of arms that are off the plan in one number each differ by.
    """
    model, size = controller.model, 2 * controller.model.n_dof
    slew = plan_slew(model, start, goal, controller.limits, SHARE, controller.period)
    off = np.vstack([np.zeros(size), np.eye(size)])
    goals = np.repeat(goal[None], size + 1, 0)
    controller.reset(np.arange(size + 1), Episode(np.repeat(start[None], size + 1, 0), goals, PERIOD))
    torques = np.array([controller.torques(state + off)[:, 0] for state in slew.states])
    return torques[:, :1] - torques[:, 1:], slew.states[:, model.motor_columns[0]]


def test_gains_on_the_way_lie_between_those_of_start_middle_and_goal():
    """By how far the motor has come, which is late at first and early at last: gains change with the posture."""
    one = fm.build_model(fm.catalog.one_link((0.0, -1.0, 0.0), 0.3, 5e3, gravity=(0.0, 0.0, -9.81)), 1, modes=2)
    controller, start, goal = TrackingLQR(one, 60.0, 0.02), np.array([-1.2]), np.array([0.4])
    result, angles = followed_gains(controller, start, goal)
    ways = (angles - start[0]) / (goal[0] - start[0])
    designs = np.array([controller.gain(posture)[0] for posture in (start, 0.5 * (start + goal), goal)])
    expected = np.array([np.interp(ways, [0.0, 0.5, 1.0], column) for column in designs.T]).T
    assert np.abs(ways - np.linspace(0.0, 1.0, len(ways))).max() > 0.08, "way is not time"
    assert np.abs(result - expected).max() <= 1e-3 * np.abs(np.diff(designs, axis=0)).max()


def test_an_arm_that_starts_at_its_goal_is_held_more_tightly():
    """Than by the one at the goal, and than at the end of a slew."""
    regulator, holding, slewing = designed(LQR), designed(TrackingLQR), designed(TrackingLQR)
    goal = np.array([[0.3, -0.2]])
    off = fm.rest_state(regulator.model, goal[0])[None]
    off[0, regulator.model.motor_columns] += 0.01
    for controller, start in ((regulator, goal), (holding, goal), (slewing, goal - 0.1)):
        controller.reset(np.array([0]), Episode(start, goal, PERIOD))
    slewing._now += 10**6
    loose, tight, after = (each.torques(off)[0] - regulator._held[0] for each in (regulator, holding, slewing))
    assert (loose < 0.0).all() and (tight < 1.2 * loose).all() and after == pytest.approx(loose, rel=1e-6)


def test_feed_forward_leaves_a_part_of_the_limits_for_feedback():
    controller = designed(TrackingLQR)
    starts, goals = postures(controller, 1)
    controller.reset(np.array([0]), Episode(starts, goals, PERIOD))
    asked = np.array([controller.act({"state": state}) for state in controller._plans[0].states])
    assert 0.9 * SHARE < np.abs(asked).max() <= 1.01 * SHARE < 0.97


def test_along_a_path_gains_and_torques_are_those_of_the_moment():
    """A path that turns steadily: half way on, the gain is that of half of the turn and the torque that of a plan."""
    controller = designed(TrackingLQR)
    model, periods = controller.model, 48  # a design at every other period
    way = minimum_jerk(np.linspace(0.0, 1.0, periods + 1))[0]
    path, one = way[:, None] * [0.4, -0.8], np.array([0])
    controller.reset(one, Episode(path[None, 0], path[None, 0], PERIOD, lambda: path[None]))
    slew = plan_path(model, path, controller.period)
    on_it = np.array([controller.torques(state[None])[0] for state in slew.states])
    assert on_it[:-1] == pytest.approx(slew.torques, abs=1e-9)
    for period in (0, 24, 48):
        result = []
        for off in 1e-3 * np.eye(2 * model.n_dof):
            controller._now[0] = period
            result.append(1e3 * (on_it[period] - controller.torques((slew.states[period] + off)[None])[0]))
        expected = controller.gain(path[period]).T
        assert np.abs(np.array(result) - expected).max() <= 1e-6 * np.abs(expected).max()


def test_on_its_plan_the_tracking_one_only_feeds_forward():
    """Following the planned states to the digit it gives the planned torques, then those that hold."""
    controller = designed(TrackingLQR)
    starts, goals = postures(controller, 1)
    controller.reset(np.array([0]), Episode(starts, goals, PERIOD))
    states, torques, gains, _ = controller._plans[0]
    assert len(torques) == len(states) and len(gains) == 3
    for state, torque in zip(states, torques, strict=True):
        assert np.array_equal(controller.act({"state": state}), torque / controller.limits)
    assert torques[-1] == pytest.approx(fm.holding_torques(controller.model, goals[0]))


@pytest.mark.parametrize("name", sorted(name for name, named in NAMED.items() if isinstance(named.task, fm.Slew)))
def test_the_tracking_one_stops_the_arm_where_it_should_be(name):
    """Alone, in an environment that lasts 8 s: what is left is far below a thousandth of the reach."""
    env = gym.make(name, base="lqr-tracking", horizon=8.0).unwrapped
    _, info = env.reset(seed=9000)
    first, zero, ended = info["tip_error"], np.zeros(env.action_space.shape), False
    while not ended:
        _, _, failed, ended, info = env.step(zero)
        assert not failed
    assert info["tip_error"] < 1e-4 * env.episodes.view.reach < 0.01 * first
    assert info["tip_vibration"] < 1e-4 * env.episodes.view.reach


@pytest.mark.parametrize("name", ["FlexOne-v0", "FlexPlanar-v0"])
def test_the_one_at_the_goal_brings_the_arm_there(name):
    """From a start beside the goal: what is left after 6 s is far below a thousandth of the reach."""
    env = gym.make(name, base="lqr", horizon=6.0).unwrapped
    n = env.action_space.shape[0]
    _, info = env.reset(seed=0, options={"start": [0.2] * n, "goal_angles": [0.35] * n})
    first, ended = info["tip_error"], False
    while not ended:
        _, _, failed, ended, info = env.step(np.zeros(n))
        assert not failed
    assert info["tip_error"] < 1e-4 * env.episodes.view.reach < 0.01 * first


def test_they_are_controllers_that_read_the_state():
    for kind in (LQR, TrackingLQR):
        assert isinstance(designed(kind, "FlexOne-v0"), Controller) and set(kind.sensors) <= set(SENSORS)


def test_weights_are_parts_of_the_reach():
    """The same weights in metres, given by hand."""
    model, limits = build(setup_of({})).model, (400.0,) * 3
    posture = np.array([0.1, 0.2, -0.3])
    assert np.array_equal(
        LQR(model, limits, 0.02).gain(posture), LQR(model, limits, 0.02, Weights(0.2, 1.0, 0.5)).gain(posture)
    )


@pytest.mark.parametrize("law", LAWS)
def test_a_slew_has_the_law_that_is_asked_for(law):
    plain = designed(TrackingLQR)
    controller = TrackingLQR(plain.model, plain.limits, PERIOD, law=law)
    starts, goals = postures(controller, 1)
    controller.reset(np.array([0]), Episode(starts, goals, PERIOD))
    slew = plan_slew(controller.model, starts[0], goals[0], controller.limits, SHARE, PERIOD, law)
    assert np.array_equal(controller._plans[0].states, slew.states) and (plain.law == law) == (law == "minimum-jerk")


def test_bad_arguments_are_refused_in_one_line():
    model = build(setup_of({"name": "FlexOne-v0"})).model
    assert refusal(LQR, "arm", 1.0, 0.02) == "model: 'arm' is not allowed; give a Model, from build_model"
    assert refusal(LQR, model, -1.0, 0.02).startswith("torque_limit: -1.0 is not allowed; give a finite number > 0")
    assert refusal(TrackingLQR, model, (1.0, 2.0), 0.02).startswith("torque_limit: (1.0, 2.0) is not allowed; give 1")
    assert refusal(TrackingLQR, model, 1.0, 0.02, None, "s").startswith("law: 's' is not allowed; give one of minimum-")
    assert refusal(LQR, model, 1.0, 0).startswith("period: 0 is not allowed; give a finite number > 0 (s)")
