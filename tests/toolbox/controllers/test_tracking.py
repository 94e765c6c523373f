"""Tracking law of an arm in one episode."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.agent.controller import EpisodeInfo
from flexman_gym.common.snapshot import get_state, set_state
from flexman_gym.simulation.physical_parameters import varied_model
from flexman_gym.toolbox.controllers.arm_scales import ArmScales
from flexman_gym.toolbox.controllers.cost_weights import CostWeights
from flexman_gym.toolbox.controllers.lqr import HOLDING_FACTOR, LQR
from flexman_gym.toolbox.controllers.observers.observer import Estimate
from flexman_gym.toolbox.controllers.tracking import Tracking

from oracles.observed_arms import small_plant

UNKNOWN = {"payload_mass": (0.0, 0.2), "joint_stiffness_factor": (0.7, 1.3), "link_stiffness_factor": (0.7, 1.3)}
ONE, ON = np.array([0]), np.ones(1, dtype=bool)
START, GOAL = np.array([[0.1, -0.3]]), np.array([[0.6, 0.4]])


def estimate(states, lead=0, **parameters):
    """Of one arm."""
    given = {name: np.array([value]) for name, value in parameters.items()}
    return Estimate(np.atleast_2d(states), np.array([lead]), given)


def law(start=START, goal=GOAL, randomisation=UNKNOWN, path=None):
    """A law in an episode of one arm, and its plant."""
    plant = small_plant("FlexPlanar-v0", randomisation)
    own = Tracking(plant)
    own.reset(ONE, EpisodeInfo(start, goal, plant.period, path), 1)
    return own, plant


def test_on_its_reference_it_only_feeds_forward():
    own, plant = law()
    rest = fm.rest_state(plant.model, START[0])
    own.torques(estimate(rest, payload_mass=0.1), ON)
    for period in range(1, 5):
        now = np.array([period * plant.period])
        state, forward = (
            own.slews.motion(now, now, ONE)[0],
            own.slews.motion(now + 0.5 * plant.period, now + 0.5 * plant.period, ONE)[1],
        )
        assert own.torques(estimate(state, payload_mass=0.1), ON) == pytest.approx(forward, abs=1e-9)


@pytest.mark.parametrize("lead", [0, 2])
def test_it_follows_the_reference_of_the_moment_in_which_torques_act(lead):
    """A slew begins when the first torque arrives; of a path that moves by itself the moment counts."""
    own, plant = law()
    rest = fm.rest_state(plant.model, START[0])
    first = own.torques(estimate(rest, lead), ON)
    other, _ = law()
    assert first == pytest.approx(other.torques(estimate(rest), ON)) and own.slews.start_time[0] == lead * plant.period
    way = np.sin(np.linspace(0.0, 1.5, 61))[:, None] ** 3 * [0.4, -0.5]
    follower, _ = law(way[:1], way[:1], path=lambda: way[None])
    for period in range(12):
        now = np.array([(period + lead) * plant.period])
        follower._paths.adapt(ONE, {})
        state, forward = follower._paths.at(now, ONE)
        assert follower.torques(estimate(state, lead), ON) == pytest.approx(forward, abs=1e-9)


@pytest.mark.parametrize("payload", [0.0, 0.2])
@pytest.mark.parametrize("held", [False, True])
def test_off_its_reference_it_is_the_regulator_of_the_arm_as_it_is_estimated(payload, held):
    """At a posture of the table; an arm that starts at its goal is held more tightly."""
    goal = 0.17 * np.array([[1.0, 2.0]])
    own, plant = law(goal if held else goal - 0.1, goal)
    own.torques(estimate(fm.rest_state(plant.model, (goal if held else goal - 0.1)[0]), payload_mass=payload), ON)
    own.limits = np.full(2, 1e9)  # so that nothing is cut off
    own._ages[:] = 3001  # long at the goal, and no period in which it looks at parameters
    true = varied_model(plant.model, payload_mass=payload)
    regulator = LQR(true, plant.torque_limit, plant.period, CostWeights.default(plant.model, ArmScales.of_plant(plant)))
    weights = regulator.weights._replace(tip=HOLDING_FACTOR * regulator.weights.tip) if held else regulator.weights
    gain = regulator.gain(goal[0], weights)
    state = own.slews.motion(np.array([60.0]), np.array([60.0]), ONE)[0]
    state[:, plant.model.motor_columns] = goal
    off = 1e-6 * np.random.default_rng(0).standard_normal(state.shape)
    off[:, plant.model.motor_columns] = 0.0
    torques = []
    for each in (state, state + off):
        own._ages[:] = 3001
        torques.append(own.torques(estimate(each, payload_mass=payload), ON)[0])
    assert torques[0] - torques[1] == pytest.approx(gain @ off[0], rel=1e-5, abs=1e-9)


def test_torques_are_within_the_limits_and_arms_that_rest_have_none():
    plant = small_plant("FlexPlanar-v0", UNKNOWN)
    own, arms = Tracking(plant), np.arange(2)
    own.reset(arms, EpisodeInfo(START.repeat(2, 0), GOAL.repeat(2, 0), plant.period), len(arms))
    far = np.array([fm.rest_state(plant.model, START[0])] * 2)
    active = np.array([True, False])
    own.torques(Estimate(far, np.zeros(2, dtype=int), {}), active)
    far[:, plant.model.n_dof + plant.model.motor_columns] = 50.0
    result = own.torques(Estimate(far, np.zeros(2, dtype=int), {}), active)
    assert result[0].tolist() == [-limit for limit in plant.torque_limit] and result[1].tolist() == [0.0, 0.0]
    assert own._ages.tolist() == [2, 0]


@pytest.mark.parametrize("unit", [1, 3])
def test_timing_is_replanned_in_time_units(unit, monkeypatch):
    """At 6, 12, 20, 30 and 45 units; the references are adapted every five."""
    plant = small_plant("FlexPlanar-v0", UNKNOWN)
    scales = ArmScales((1.0, 1.0), torque_slew=150.0 * unit * plant.period)
    own, planned, adapted = Tracking(plant, scales=scales), [], []
    own.reset(ONE, EpisodeInfo(START, GOAL, plant.period), 1)
    own.torques(estimate(fm.rest_state(plant.model, START[0]), payload_mass=0.1), ON)
    monkeypatch.setattr(own.slews, "plan_timing", lambda *_, first: planned.append(int(own._ages[0])))
    monkeypatch.setattr(own.slews, "adapt", lambda arms, _: adapted.extend(int(own._ages[0]) for _ in arms))
    monkeypatch.setattr(own.slews, "duration", np.array([1e3]))
    follow(own, plant, 50 * unit)
    assert planned == [unit * time for time in (6, 12, 20, 30, 45)]
    assert adapted == sorted({*planned, *range(5 * unit, 50 * unit + 1, 5 * unit)})


def follow(own, plant, periods):
    """Torques (T, 1, n) of a law whose arm stays where it is."""
    rest = fm.rest_state(plant.model, START[0])
    return np.array([own.torques(estimate(rest, payload_mass=0.1), ON) for _ in range(periods)])


@pytest.mark.parametrize("goal", [GOAL, START])
def test_a_law_made_alike_goes_on_from_what_it_kept(goal):
    """Amid a slew or a hold, while the other was at the other of these."""
    own, plant = law(goal=goal)
    other, _ = law(goal=START if goal is GOAL else GOAL)
    follow(own, plant, 4)
    follow(other, plant, 7)
    set_state("law", other, get_state(own))
    assert np.array_equal(follow(other, plant, 8), follow(own, plant, 8))


def test_an_episode_begins_as_the_first_did():
    """After a slew and after a hold, at a slew."""
    first, plant = law()
    expected = follow(first, plant, 8)
    for start, goal in ((START, GOAL), (GOAL, GOAL)):
        first.reset(ONE, EpisodeInfo(start, goal, plant.period), 1)
        follow(first, plant, 3)
        first.reset(ONE, EpisodeInfo(START, GOAL, plant.period), 1)
        assert np.array_equal(follow(first, plant, 8), expected)
