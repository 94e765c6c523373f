"""Slew references adapted to estimated parameters."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.model.dynamics import acceleration
from flexman_gym.model.friction import friction_torques, frictionless
from flexman_gym.model.statics import rest_tips
from flexman_gym.simulation.physical_parameters import varied_model
from flexman_gym.toolbox.controllers.arm_scales import SlewBounds, ringing_period
from flexman_gym.toolbox.controllers.references.adaptive_references import (
    PathReferences,
    SlewReferences,
    candidate_durations,
)
from flexman_gym.toolbox.controllers.references.trajectories import plan_slew

ONE, LIMITS, SHARE = np.array([0]), np.array([12.0, 4.0]), 0.9
BOUNDS = SlewBounds(LIMITS, SHARE)
PAYLOADS = (0.0, 0.1, 0.2)
RUBBING = {"viscous_friction": 0.4, "coulomb_friction": 0.3}
START, GOAL = np.array([[0.2, -0.3]]), np.array([[0.7, 0.5]])


def arm(**joint):
    """The planar arm in the vertical plane, with other joints."""
    whole = fm.catalog.vertical_2r()
    return replace(whole, joints=[replace(each, **joint) for each in whole.joints])


def model(rigid=False, **joint):
    flexible = {"flexible_links": not rigid, "flexible_joints": not rigid}
    return fm.build_model(arm(**joint), 1, None if rigid else 1, **flexible)


def begun(own, payloads=PAYLOADS, parameters=None, start=START, goal=GOAL, bounds=BOUNDS):
    """A slew of one arm that begins at 0 s."""
    slews = SlewReferences(own, bounds, payloads)
    slews.allocate(1)
    slews.begin(ONE, start, goal)
    slews.adapt(ONE, parameters or {})
    slews.plan_timing(ONE, np.zeros(1), first=True)
    return slews


def times(slews, count=60):
    return np.linspace(0.0, slews.start_time[0] + slews.duration[0], count)


def test_torques_of_a_rigid_arm_are_those_that_accelerate_it_so():
    """Weight and inertia, by the equations of motion without friction at the state of each moment."""
    own = model(rigid=True, **RUBBING)
    slews = begun(own, (own.constants.payload_mass[0],))
    gone = []
    for now in times(slews)[1:-1, None]:
        place, speed, change = (each[0] for each in slews.at(now, ONE))
        way = (GOAL - START)[0]
        state = np.concatenate([START[0] + place * way, speed * way])
        gone.append(acceleration(frictionless(own), state, slews.motion(now, now, ONE)[1][0]) - change * way)
        assert slews.motion(now, now, ONE)[0][0] == pytest.approx(state, abs=5e-3)
    assert np.abs(gone).max() < 0.02 * np.abs(slews.displacement).max() * 5.77 / slews.duration[0] ** 2


def test_a_slew_without_an_estimate_of_the_payload_is_that_of_the_model():
    own = varied_model(model(), payload_mass=0.1)
    said, usual = begun(own, parameters={"payload_mass": np.array([0.1])}), begun(own)
    light = begun(own, parameters={"payload_mass": np.array([0.0])})
    now = times(said)[20:21]
    forward = [each.motion(now, now, ONE)[1].tobytes() for each in (said, usual, light)]
    assert forward[0] == forward[1] != forward[2]


def test_a_flexible_arm_is_bent_as_on_a_minimum_jerk_slew():
    """Without weight; what a planned slew solves for at each moment comes from tables here, linear in the inertia."""
    own = fm.build_model(replace(arm(), gravity=(0.0, 0.0, 0.0)), 1, 1)
    slews = begun(own, (own.constants.payload_mass[0],))
    path = plan_slew(own, START[0], GOAL[0], BOUNDS, 0.02).path
    lasting, d = slews.duration[0], own.n_dof
    result, expected = [], []
    for now in times(slews, 21)[:, None]:
        state = slews.motion(now, now, ONE)[0][0]
        assert state[d : d + 2] == pytest.approx(slews.at(now, ONE)[1] * slews.displacement[0], abs=0.01)
        result.append(np.concatenate([state[:d], slews.motion(now, now, ONE)[1][0]]))
        expected.append(np.concatenate([each[0] for each in path.at(now / lasting, lasting)]))
    bent = np.array(expected)
    bent[:, 2:4] -= bent[:, :2]  # motors against links
    gone, size = np.abs(np.array(result) - expected), np.abs(bent[:, 2:]).max(axis=0)
    assert (gone[:, 2:] <= 0.03 * size).all() and gone[:, :2].max() < 1e-12


@pytest.mark.parametrize("rubbing", [{}, RUBBING])
@pytest.mark.parametrize("payload", [0.0, 0.2])
def test_no_torque_is_above_the_share_of_the_limits_and_the_way_is_not_slower_than_that(rubbing, payload):
    """Durations are tried in steps of 4.5 %, by which torques of inertia change by 9 %."""
    own = model(**rubbing)
    slews = begun(own, parameters={"payload_mass": np.array([payload])})
    shares = []
    for now in times(slews, 200)[:, None]:
        rates = slews.at(now, ONE)[1] * slews.displacement[0]
        shares.append(np.abs((slews.motion(now, now, ONE)[1][0] + friction_torques(own, rates)) / LIMITS).max())
    assert 0.85 * SHARE < max(shares) < 1.01 * SHARE
    assert slews.durations[0] < slews.duration[0] < slews.durations[-1]


STEP = 1.045  # ratio of two durations that are tried


@pytest.mark.parametrize("rates", [(0.2, 9.0), (9.0, 0.2), (0.5, 0.5)])
def test_rates_of_a_slew_are_within_their_bounds_and_reach_them(rates):
    """In steps of the durations that are tried; at a new timing amid the slew, too."""
    own = model()
    slews = begun(own, bounds=SlewBounds(LIMITS, SHARE, np.array(rates)))
    for part in (0.0, 0.4):
        if part:
            slews.plan_timing(ONE, part * slews.duration, first=False)
        now = times(slews, 300)
        speeds = np.array([slews.at(each, ONE)[1][0] for each in now[:, None]])
        shares = np.abs(speeds[:, None] * slews.displacement) / rates
        assert 0.93 < shares.max() < 1.01


@pytest.mark.parametrize("part", [0.1, 0.5])
def test_a_slew_is_not_shorter_than_the_periods_of_its_bounds_at_any_planning(part):
    """Of an arm with strong motors, from its start to its end; the period is that of the estimated payload."""
    own = varied_model(model(), payload_mass=0.1)
    bounds = SlewBounds(1e3 * LIMITS, SHARE, vibrations=1.6)
    slews = begun(own, bounds=bounds)
    expected = 1.6 * ringing_period(own, GOAL[0])
    assert expected <= slews.duration[0] <= STEP * expected * (1.0 + 1e-9)
    now = part * slews.duration
    slews.plan_timing(ONE, now, first=False)
    longest = now[0] + STEP * max(expected - now[0], slews.durations[0])
    assert expected <= (slews.start_time + slews.duration)[0] <= longest


@pytest.mark.parametrize("payload", [0.0, 0.2])
def test_the_shortest_slew_follows_the_estimated_payload_and_stiffness(payload):
    own, bounds, factors = model(), SlewBounds(1e3 * LIMITS, SHARE, vibrations=1.6), np.full(2, 0.8)
    soft = own.constants.joint_stiffness * 0.8
    true = varied_model(own, payload_mass=payload, link_stiffness_factor=factors, joint_stiffness=soft)
    parameters = {"payload_mass": np.array([payload]), "joint_stiffness": soft[None]}
    parameters["link_stiffness_factor"] = factors[None]
    slews, expected = begun(own, parameters=parameters, bounds=bounds), 1.6 * ringing_period(true, GOAL[0])
    assert expected / 1.02 <= slews.duration[0] <= 1.02 * STEP * expected


@pytest.mark.parametrize("slew", [0.03, 3.0, 300.0])
def test_durations_that_are_tried_are_in_proportion_to_the_slew(slew):
    """All from one sequence, so that the grid of an arm is that of another arm, moved."""
    tried = candidate_durations(slew)
    assert slew / 16.0 < tried[0] < slew / 14.0 and 7.5 * slew < tried[-1] < 8.5 * slew
    steps = np.log(tried / candidate_durations(3.0)[0]) / np.log(STEP)
    assert steps == pytest.approx(np.round(steps), abs=1e-6) and candidate_durations(3.0)[0] == 0.2


@pytest.mark.parametrize("part", [0.2, 0.5, 0.7])
def test_timed_anew_on_its_way_it_goes_on_without_a_jump_and_stops_at_the_end(part):
    own = model()
    slews = begun(own, parameters={"payload_mass": np.array([0.2])})
    slews.adapt(ONE, {"payload_mass": np.array([0.02])})
    now, before = part * slews.duration, slews.duration.copy()
    motion, (state, torque) = np.array(slews.at(now, ONE)), slews.motion(now, now, ONE)
    slews.plan_timing(ONE, now, first=False)
    assert np.array(slews.at(now, ONE)) == pytest.approx(motion, rel=1e-9)
    assert slews.motion(now, now, ONE)[1] == pytest.approx(torque, rel=1e-9)
    d = own.n_dof
    again, links = slews.motion(now, now, ONE)[0], slice(d, d + 2)  # whose speed has no part of the third derivative
    assert again[:, :d] == pytest.approx(state[:, :d], abs=1e-9)
    assert again[:, links] == pytest.approx(state[:, links], abs=0.02 * np.abs(state[:, links]).max())
    end = slews.start_time + slews.duration
    assert slews.start_time == pytest.approx(now) and (end < before).all(), "a lighter arm is there sooner"
    assert np.array(slews.at(end - 1e-6, ONE))[:, 0] == pytest.approx([1.0, 0.0, 0.0], abs=1e-2)
    assert np.array(slews.at(end + 0.5, ONE))[:, 0].tolist() == [1.0, 0.0, 0.0]
    assert not slews.motion(end + 0.5, end + 0.5, ONE)[0][0, d:].any()


def test_arms_on_their_ways_do_not_touch_each_other():
    """Three arms, timed anew at different times, and each alone, to the bit."""
    own, random = model(**RUBBING), np.random.default_rng(3)
    starts, goals = random.uniform(-0.5, 0.5, (2, 3, 2))
    masses = {"payload_mass": np.array([0.0, 0.13, 0.2])}

    def run(arms):
        slews = SlewReferences(own, BOUNDS, PAYLOADS)
        slews.allocate(3)
        slews.begin(arms, starts[arms], goals[arms])
        slews.adapt(arms, {})
        slews.plan_timing(arms, np.zeros(len(arms)), first=True)
        slews.adapt(arms, masses)
        for arm, now in ((0, 0.1), (2, 0.2)):
            some = arms[arms == arm]
            slews.plan_timing(some, np.full(len(some), now), first=False)
        later = np.full(len(arms), 0.3)
        return np.hstack(slews.motion(later, later, arms))

    assert np.array_equal(run(np.arange(3)), np.concatenate([run(np.array([arm])) for arm in range(3)]))


NODE = np.array([0.1])


def adapted(own, nodes, parameters, arms):
    """Interpolation weights and compliance of arms (r,) on paths that rest, as they are estimated."""
    paths = PathReferences(own, 0.02, nodes)
    paths.begin(int(arms[-1]), np.tile(START, (6, 1)))
    paths.adapt(arms, parameters)
    return paths._weights[arms], paths._compliance[arms]


def weights_of(nodes, masses):
    """Interpolation weights of arms with payloads (r,) kg."""
    return adapted(model(), nodes, {"payload_mass": masses}, np.arange(len(masses)))[0]


def test_payloads_between_nodes_are_weighed_by_a_parabola():
    nodes, masses = 0.05 * np.array([1.0, 2.0, 4.0]), 0.05 * np.array([1.0, 2.0, 4.0, 3.3, 9.0])
    weights = weights_of(nodes, masses)
    assert weights[:3] == pytest.approx(np.eye(3)) and np.array_equal(weights[4], weights[2]), "none beyond the last"
    assert weights @ nodes**2 == pytest.approx(np.minimum(masses, nodes[2]) ** 2)
    assert np.array_equal(weights_of(nodes, masses[3:4]), weights[3:4])
    assert weights_of(nodes[:1], masses).tolist() == [[1.0]] * 5


TRUE = {"payload_mass": 0.13, "joint_stiffness": [0.8, 1.25], "link_stiffness_factor": [0.75, 1.3]}


def true_parameters(own):
    """Of one arm: as an estimate gives them, (1, ...)."""
    return {
        "payload_mass": np.array([TRUE["payload_mass"]]),
        "joint_stiffness": np.array([TRUE["joint_stiffness"]]) * own.constants.joint_stiffness,
        "link_stiffness_factor": np.array([TRUE["link_stiffness_factor"]]),
    }


def test_the_tip_of_an_arm_that_is_known_rests_where_that_of_the_model_would():
    """Under its weight, which bends it more or less than the model: the motors make up for that."""
    own = model()
    slews = begun(own)
    true = varied_model(own, **{name: values[0] for name, values in true_parameters(own).items()})
    slews.adapt(ONE, true_parameters(own))
    state = slews.motion(np.array([60.0]), np.array([60.0]), ONE)[0][0]
    motors = state[own.motor_columns][None]
    wanted, plain, turned = rest_tips(own, GOAL)[0], rest_tips(true, GOAL)[0], rest_tips(true, motors)[0]
    missed = np.linalg.norm(turned - wanted) / np.linalg.norm(plain - wanted)
    assert missed < 0.03 and np.linalg.norm(plain - wanted) > 1e-3
    expected = fm.rest_state(true, motors[0])
    assert state == pytest.approx(expected, abs=0.05 * np.abs(expected - own.at_rest(motors)[0]).max())
    held = fm.holding_torques(true, motors[0])
    assert slews.motion(np.array([60.0]), np.array([60.0]), ONE)[1][0] == pytest.approx(held, abs=0.01 * held.max())


def test_softness_is_how_much_further_springs_and_links_bend():
    """The same load: a rigid joint and links' sides of joints stay."""
    own = model()
    assert adapted(own, NODE, {}, ONE)[1].tolist() == [[1.0] * own.n_dof]
    true = true_parameters(own)
    estimated = {name: true[name] for name in ("joint_stiffness", "link_stiffness_factor")}
    result = adapted(own, NODE, estimated, ONE)[1][0]
    assert result[:2] == pytest.approx([1.25, 0.8]) and result[own.motor_columns] == pytest.approx([1.25, 0.8])
    for link, factor in enumerate(TRUE["link_stiffness_factor"]):
        assert result[own.elastic_columns(link)] == pytest.approx(1.0 / factor)
    stiff = fm.build_model(arm(stiffness=None, damping=0.0), 1, 1)
    given = {"joint_stiffness": np.zeros((1, 2))}
    assert adapted(stiff, NODE, given, ONE)[1].tolist() == [[1.0] * stiff.n_dof]


def test_a_slew_is_timed_with_the_friction_that_was_found():
    """More friction, a longer slew; its torques are those of the motion without friction."""
    found = {"viscous_friction": np.array([[1.5, 1.7]])}
    slow, usual = begun(model(**RUBBING), parameters=found), begun(model(**RUBBING))
    assert slow.duration[0] > usual.duration[0] > begun(model()).duration[0]
    usual.adapt(ONE, found)
    assert usual.motion(*[0.5 * usual.duration] * 2, ONE)[1] == pytest.approx(
        begun(model(**RUBBING)).motion(*[0.5 * usual.duration] * 2, ONE)[1]
    )


@pytest.mark.parametrize("goal", [(0.7, 0.5), (0.4, 0.12)])
def test_a_slew_ends_in_the_equilibrium_of_the_estimated_arm_with_the_tip_of_the_nominal_arm(goal):
    """The second goal is nearly stretched: its tip moves along the arm by large rotations only."""
    own, goal = model(), np.array(goal)
    given = {"payload_mass": 0.2, "joint_stiffness": 0.7 * own.constants.joint_stiffness}
    parameters = {name: np.array([value]) for name, value in given.items()}
    slews = SlewReferences(own, BOUNDS, PAYLOADS, equilibrium=True)
    slews.allocate(1)
    slews.begin(ONE, START, goal[None])
    slews.adapt(ONE, parameters)
    linear = slews.motion(np.array([9.0]), np.array([9.0]), ONE)[0][0]
    for _ in range(3):
        slews.end_in_equilibrium(ONE, parameters)
    slews.plan_timing(ONE, np.zeros(1), first=True)
    late = slews.duration + 1.0
    (state,), (torques,) = slews.motion(late, late, ONE)
    estimated, end = varied_model(own, **given), goal + slews.shift[0]
    assert state == pytest.approx(fm.rest_state(estimated, end), abs=1e-9)
    assert torques == pytest.approx(fm.holding_torques(estimated, end), abs=1e-9)
    (tip,), (target,) = rest_tips(estimated, end[None]), rest_tips(own, goal[None])
    assert tip == pytest.approx(target, abs=1e-4)
    assert np.abs(linear - state).max() > 1e-3
    slews.adapt(ONE, parameters)
    assert slews.motion(late, late, ONE)[0][0] == pytest.approx(state, abs=1e-12)


def test_a_slew_keeps_its_end_for_an_estimated_arm_that_cannot_hold_its_weight():
    own = model()
    slews = SlewReferences(own, BOUNDS, PAYLOADS, equilibrium=True)
    slews.allocate(1)
    slews.begin(ONE, START, GOAL)
    slews.adapt(ONE, {})
    slews.end_in_equilibrium(ONE, {"payload_mass": np.array([0.2])})
    before = slews.shift.copy()
    assert before.any()
    slews.end_in_equilibrium(ONE, {"joint_stiffness": np.full((1, 2), 1e-3)})
    assert np.array_equal(slews.shift, before)
