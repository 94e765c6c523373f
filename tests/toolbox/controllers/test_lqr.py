"""Linear-quadratic regulators: sampled model, optimal gain, control at the goal and along a slew."""

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import flexman_gym as fm
from flexman_gym.agent.controller import Controller, EpisodeInfo
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.sensors import SENSORS
from flexman_gym.model.state_space import LinearModel, discretize
from flexman_gym.toolbox.controllers.arm_scales import ArmScales
from flexman_gym.toolbox.controllers.cost_weights import CostWeights
from flexman_gym.toolbox.controllers.lqr import FEEDFORWARD_FRACTION, LQR, TrackingLQR
from flexman_gym.toolbox.controllers.references.trajectories import TIMING_NAMES, TIMINGS, plan_path, plan_slew

from oracles.assertions import refusal
from oracles.chains import QUICK, samples

PERIOD = 0.02


def linear_model(A, B, C):
    """A linear model of plain matrices."""
    return LinearModel(np.array(A), np.array(B), np.array(C), np.zeros((len(C), len(B[0]))))


def double_integrator(inertia, length=1.0):
    """A rigid link on a motor: angle and rate, moved by a torque; its tip moves along y."""
    return linear_model([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1 / inertia]], [[0, 0], [length, 0], [0, 0]])


@given(st.floats(1e-3, 10.0), st.floats(1e-3, 1.0))
def test_a_sampled_double_integrator_is_its_closed_form(inertia, period):
    linear = double_integrator(inertia)
    transition, inputs = discretize(linear.A, linear.B, period)
    assert transition == pytest.approx(np.array([[1.0, period], [0.0, 1.0]]), rel=1e-12)
    assert inputs == pytest.approx(np.array([[period**2 / 2], [period]]) / inertia, rel=1e-12)


def test_the_transition_is_the_finely_integrated_solution():
    """Of a flexible arm in a bent posture under gravity, from a random state with constant torques."""
    model = fm.build_model(fm.catalog.vertical_2r(), 1, 2)
    posture, rng = np.array([0.4, -0.7]), np.random.default_rng(0)
    held = fm.holding_torques(model, posture)
    linear = fm.linearize(model, state=fm.rest_state(model, posture), torque=held)
    x, torque = rng.standard_normal(2 * model.n_dof), rng.standard_normal(2)
    transition, inputs = discretize(linear.A, linear.B, PERIOD)

    def rate(time, state):
        return linear.A @ state + linear.B @ torque

    result = solve_ivp(rate, (0.0, PERIOD), x, "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    assert np.abs(transition @ x + inputs @ torque - result).max() <= 1e-8 * np.abs(result).max()


@settings(QUICK, max_examples=10)
@given(samples(most_links=2, flexible_joints=True), st.floats(1e-4, 1e-3))
def test_two_half_periods_are_a_period(sample, period):
    linear = fm.linearize(sample.model)
    whole, half = discretize(linear.A, linear.B, period), discretize(linear.A, linear.B, period / 2)
    for result, expected in zip(whole, (half[0] @ half[0], half[0] @ half[1] + half[1]), strict=True):
        assert np.abs(result - expected).max() <= 1e-8 * np.abs(expected).max()


@given(st.floats(0.2, 3.0), st.floats(0.1, 100.0), st.floats(0.05, 5.0))
def test_the_gain_of_a_scalar_is_the_root_of_its_quadratic_equation(fall, limit, speed):
    """Only the rate is moved: p = q + a^2 p - (a b p)^2 / (r + b^2 p), so k = a b p / (r + b^2 p)."""
    linear = linear_model([[-1.0, 0.0], [0.0, -fall]], [[0.0], [2.0]], [[0, 0], [1, 0], [0, 0]])
    weights = CostWeights(tip=1.0, tip_speed=speed, motor=1.0)
    gain = weights.gain(linear, np.array([0]), np.array([limit]), 0.1)
    a, b = np.exp(-0.1 * fall), 2.0 * (1 - np.exp(-0.1 * fall)) / fall
    q, r = 1 / speed**2, 1 / limit**2
    half = (r - a * a * r - b * b * q) / (2 * b * b)
    p = -half + np.sqrt(half**2 + q * r / b**2)
    assert gain == pytest.approx(np.array([[0.0, a * b * p / (r + b * b * p)]]), rel=1e-7, abs=1e-9)


def cost(linear, gain, weights, limit, x):
    """The cost of an episode from x, by its definition."""
    transition, inputs = discretize(linear.A, linear.B, PERIOD)
    total = 0.0
    for _ in range(3000):
        torque = -gain @ x
        tip, speed = linear.C[:, : len(x) // 2] @ x[: len(x) // 2], linear.C[:, : len(x) // 2] @ x[len(x) // 2 :]
        total += tip @ tip / weights.tip**2 + speed @ speed / weights.tip_speed**2
        total += (x[0] / weights.motor) ** 2 + (torque @ torque) / limit**2
        x = transition @ x + inputs @ torque
    return total


def test_no_gain_nearby_costs_less():
    linear, weights, limit = double_integrator(0.5, 2.0), CostWeights(0.2, 1.0, 0.5), 3.0
    gain = weights.gain(linear, np.array([0]), np.array([limit]), PERIOD)
    x = np.array([1.0, -0.5])
    best = cost(linear, gain, weights, limit, x)
    for change in ([0.03, 0.0], [-0.03, 0.0], [0.0, 0.03], [0.0, -0.03]):
        assert cost(linear, gain * (1 + np.array(change)), weights, limit, x) > best * (1 + 1e-6)


def test_the_angle_of_a_motor_weighs_wherever_it_stands_in_the_state():
    """Beside a coordinate that nothing moves, which comes to rest by itself, its gain is that of the motor alone."""
    weights, limit = CostWeights(0.2, 1.0, 0.5), np.array([3.0])
    alone = weights.gain(double_integrator(0.5, 0.0), np.array([0]), limit, PERIOD)
    A = [[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0], [-9.0, 0.0, -3.0, 0.0], [0.0, 0.0, 0.0, 0.0]]
    beside = linear_model(A, [[0.0], [0.0], [0.0], [1 / 0.5]], np.zeros((3, 2)))
    gain = weights.gain(beside, np.array([1]), limit, PERIOD)
    assert gain[:, [1, 3]] == pytest.approx(alone, rel=1e-8) and gain[:, [0, 2]] == pytest.approx(0.0, abs=1e-9)


def test_units_of_torque_do_not_matter():
    """Inertia and limits a thousand times as large ask for a thousand times the torque."""
    weights = CostWeights(0.2, 1.0, 0.5)
    one, many = (
        weights.gain(double_integrator(scale), np.array([0]), np.array([3.0 * scale]), PERIOD)
        for scale in (1.0, 1000.0)
    )
    assert many == pytest.approx(1000.0 * one, rel=1e-8)


def test_a_period_that_is_none_is_refused():
    line = refusal(discretize, np.zeros((2, 2)), np.zeros((2, 1)), 0.0)
    assert line == "period: 0.0 is not allowed; give a finite number > 0 (s)"


PERIOD, ALL = 0.02, np.arange(3)


def designed(kind, name="FlexPlanar-v0"):
    """A controller of the arm of a named environment."""
    setup = Configuration.from_keywords({"name": name})
    return kind(resolve_fidelity(setup).model, setup.torque_limit, setup.control_period)


def postures(controller, count, seed=0):
    """Starts and goals (count, n) rad."""
    return np.random.default_rng(seed).uniform(-0.8, 0.8, (2, count, controller.model.n_joints))


@pytest.mark.parametrize("name", sorted({*NAMED_ENVIRONMENTS} - {"FlexGantry-v0"}))  # the gantry has no motor
def test_the_sampled_closed_loop_is_stable_at_any_posture(name):
    lqr = designed(LQR, name)
    for posture in postures(lqr, 2)[0]:
        state, held = fm.rest_state(lqr.model, posture), fm.holding_torques(lqr.model, posture)
        linear = fm.linearize(lqr.model, state=state, torque=held)
        transition, inputs = discretize(linear.A, linear.B, lqr.period)
        open_loop, closed = (
            np.abs(np.linalg.eigvals(transition - inputs @ gain[lqr.model.constants.passive == 0])).max()
            for gain in (np.zeros((len(held), len(state))), lqr.gain(posture))
        )
        assert closed < 0.9999 and open_loop > 0.9999


@pytest.mark.parametrize("kind", [LQR, TrackingLQR])
def test_an_arm_at_rest_on_its_goal_is_held_and_nothing_else(kind):
    controller = designed(kind)
    goals = postures(controller, 3)[1]
    controller.reset(ALL, EpisodeInfo(goals, goals, PERIOD), len(ALL))
    states = np.array([fm.rest_state(controller.model, goal) for goal in goals])
    held = np.array([fm.holding_torques(controller.model, goal) for goal in goals])
    for _ in range(3):
        assert controller.act({"state": states}) == pytest.approx(held / controller.limits, abs=1e-9)


@pytest.mark.parametrize("kind", [LQR, TrackingLQR])
def test_an_arm_among_many_gets_what_an_arm_alone_gets_to_the_bit(kind):
    many, rng = designed(kind), np.random.default_rng(3)
    starts, goals = postures(many, 3)
    many.reset(ALL, EpisodeInfo(starts, goals, PERIOD), len(ALL))
    singles = [designed(kind) for _ in ALL]
    for single, start, goal in zip(singles, starts, goals, strict=True):
        single.reset(np.array([0]), EpisodeInfo(start[None], goal[None], PERIOD), 1)
    for _ in range(5):
        states = 0.1 * rng.standard_normal((3, 2 * many.model.n_dof))
        actions = many.act({"state": states})
        for action, single, state in zip(actions, singles, states, strict=True):
            assert np.array_equal(single.act({"state": state}), action)
        assert (np.abs(actions) <= 1.0).all() and actions.shape == (3, 2)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [LQR, TrackingLQR])
def test_a_new_episode_of_one_arm_changes_nothing_for_the_others(kind):
    one, other = designed(kind), designed(kind)
    starts, goals = postures(one, 3)
    for each in (one, other):
        each.reset(ALL, EpisodeInfo(starts, goals, PERIOD), len(ALL))
    states = np.array([fm.rest_state(one.model, start) for start in starts])
    for _ in range(4):
        assert np.array_equal(one.torques(states), other.torques(states))
    one.reset(np.array([1]), EpisodeInfo(goals[1:2], starts[1:2], PERIOD), 2)
    again, before = one.torques(states), other.torques(states)
    assert np.array_equal(again[[0, 2]], before[[0, 2]]) and (again[1] != before[1]).any()
    fresh = designed(kind)
    fresh.reset(np.array([0]), EpisodeInfo(goals[1:2], starts[1:2], PERIOD), 1)
    assert np.array_equal(fresh.torques(states[1:2])[0], again[1]), "it begins at the beginning"


def bounds_of(controller):
    """The bounds of the slews of a tracking LQR."""
    return controller.scales.bounds(controller.limits, FEEDFORWARD_FRACTION).time_optimal(controller.model)


def followed_gains(controller, start, goal):
    """The gains (T + 1, 2 d) in the periods of a slew of one joint, and the motor angles (T + 1,) of its plan.

    They are what the torques of arms that are off the plan in one number each differ by.
    """
    model, size = controller.model, 2 * controller.model.n_dof
    slew = plan_slew(model, start, goal, bounds_of(controller), controller.period, controller.timing)
    off = np.vstack([np.zeros(size), np.eye(size)])
    goals = np.repeat(goal[None], size + 1, 0)
    controller.reset(np.arange(size + 1), EpisodeInfo(np.repeat(start[None], size + 1, 0), goals, PERIOD), size + 1)
    torques = np.array([controller.torques(state + off)[:, 0] for state in slew.states])
    return torques[:, :1] - torques[:, 1:], slew.states[:, model.motor_columns[0]]


@pytest.mark.slow
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
    holding, slewing = designed(TrackingLQR), designed(TrackingLQR)
    regulator = LQR(holding.model, holding.limits, holding.period, holding.weights)
    goal = np.array([[0.3, -0.2]])
    off = fm.rest_state(regulator.model, goal[0])[None]
    off[0, regulator.model.motor_columns] += 0.01
    for controller, start in ((regulator, goal), (holding, goal), (slewing, goal - 0.1)):
        controller.reset(np.array([0]), EpisodeInfo(start, goal, PERIOD), 1)
    slewing._now += 10**6
    loose, tight, after = (
        each.torques(off)[0] - regulator._holding_torques[0] for each in (regulator, holding, slewing)
    )
    assert (loose < 0.0).all() and (tight < 1.2 * loose).all() and after == pytest.approx(loose, rel=1e-6)


def test_feed_forward_leaves_a_part_of_the_limits_for_feedback():
    controller = designed(TrackingLQR)
    starts, goals = postures(controller, 1, seed=3)  # a slew that the torques limit
    controller.reset(np.array([0]), EpisodeInfo(starts, goals, PERIOD), 1)
    asked = np.array([controller.act({"state": state}) for state in controller._schedules[0].states])
    assert 0.95 * FEEDFORWARD_FRACTION < np.abs(asked).max() <= 1.01 * FEEDFORWARD_FRACTION < 0.97


def test_along_a_path_gains_and_torques_are_those_of_the_moment():
    """A path that turns steadily: half way on, the gain is that of half of the turn and the torque that of a plan."""
    controller = designed(TrackingLQR)
    model, periods = controller.model, 48  # a design at every other period
    way = TIMINGS["quintic"].at(np.linspace(0.0, 1.0, periods + 1))[0]
    path, one = way[:, None] * [0.4, -0.8], np.array([0])
    controller.reset(one, EpisodeInfo(path[None, 0], path[None, 0], PERIOD, lambda: path[None]), 1)
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
    controller.reset(np.array([0]), EpisodeInfo(starts, goals, PERIOD), 1)
    states, torques, gains, _ = controller._schedules[0]
    assert len(torques) == len(states) and len(gains) == 3
    for state, torque in zip(states, torques, strict=True):
        assert np.array_equal(controller.act({"state": state}), torque / controller.limits)
    assert torques[-1] == pytest.approx(fm.holding_torques(controller.model, goals[0]))


@pytest.mark.parametrize(
    "name",
    sorted(
        name
        for name, named in NAMED_ENVIRONMENTS.items()
        if isinstance(named.task, fm.Slew) and not all(joint.passive for joint in named.arm.joints)
    ),
)
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


def test_weights_of_the_design_named_are_parts_of_the_reach():
    """The same weights in metres, given by hand; their Riccati equation is solved otherwise."""
    model, limits = resolve_fidelity(Configuration.from_keywords({})).model, (400.0,) * 3
    posture = np.array([0.1, 0.2, -0.3])
    first = LQR(model, limits, 0.02, scales=ArmScales.of_design_named(model))
    second = LQR(model, limits, 0.02, CostWeights(0.2, 1.0, 0.5))
    assert first.weights == second.weights
    gain = first.gain(posture)
    assert np.abs(second.gain(posture) - gain).max() <= 1e-9 * np.abs(gain).max()


@pytest.mark.parametrize("law", TIMING_NAMES)
def test_a_slew_has_the_law_that_is_asked_for(law):
    plain = designed(TrackingLQR)
    controller = TrackingLQR(plain.model, plain.limits, PERIOD, timing=law)
    starts, goals = postures(controller, 1)
    controller.reset(np.array([0]), EpisodeInfo(starts, goals, PERIOD), 1)
    slew = plan_slew(controller.model, starts[0], goals[0], bounds_of(controller), PERIOD, law)
    assert np.array_equal(controller._schedules[0].states, slew.states)
    assert (plain.timing == law) == (law == "time-optimal")


def test_bad_arguments_are_refused_in_one_line():
    model = resolve_fidelity(Configuration.from_keywords({"name": "FlexOne-v0"})).model
    assert refusal(LQR, "arm", 1.0, 0.02) == "model: 'arm' is not allowed; give a Model, from build_model"
    assert refusal(LQR, model, -1.0, 0.02).startswith("torque_limit: -1.0 is not allowed; give a finite number > 0")
    assert refusal(TrackingLQR, model, (1.0, 2.0), 0.02).startswith("torque_limit: (1.0, 2.0) is not allowed; give 1")
    assert refusal(TrackingLQR, model, 1.0, 0.02, None, "s").startswith("timing: 's' is not allowed; give one of t")
    assert refusal(LQR, model, 1.0, 0).startswith("period: 0 is not allowed; give a finite number > 0 (s)")


@pytest.mark.slow
def test_tracking_settles_a_fast_arm_with_strong_motors():
    """Two strips on direct drives: at the torque limits a slew takes less than half of a period of the first mode."""
    links = [
        fm.Link.strip(0.25, 0.04, 0.003, masses=[fm.LumpedMass(0.6, 0.25)]), fm.Link.strip(0.25, 0.03, 0.002),
    ]  # fmt: skip
    joints = [
        fm.Joint((0.0, 0.0, 1.0), rotor_inertia=4e-3, torque_limit=12.0),
        fm.Joint((0.0, 0.0, 1.0), 5e-4, torque_limit=4.0),
    ]
    arm = fm.Arm(links, joints, fm.Payload(0.2), modal_damping_ratio=0.005)
    setup = Configuration("FlexPlanar-v0", {"arm": arm, "elements": 1, "control_period": 0.005, "horizon": 2.0})
    for record in fm.rollout("lqr-tracking", setup, 3).records:
        assert not record.failure and record.errors[-200:].max() < record.band
