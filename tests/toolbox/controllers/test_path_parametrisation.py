"""Time-optimal path parametrisation: closed forms, bounds, replanning, and the choice of the timing."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.common.snapshot import get_state, set_state
from flexman_gym.model.friction import friction_torques
from flexman_gym.toolbox.controllers.arm_scales import SlewBounds, free_period
from flexman_gym.toolbox.controllers.references import path_parametrisation
from flexman_gym.toolbox.controllers.references.adaptive_references import SlewReferences
from flexman_gym.toolbox.controllers.references.path_parametrisation import (
    LEAST_PERIODS,
    LEAST_QUINTICS,
    SHARE_CHANGE,
    SHARES,
    STAGES,
    PathBounds,
    TimeOptimalMotions,
    average_windows,
    fastest_motion,
    is_time_optimal,
)
from flexman_gym.toolbox.controllers.references.trajectories import plan_slew

from oracles.assertions import refusal

ONE, ZERO, ROUNDING = np.array([0]), np.zeros(1), 1e-12
RIGID = fm.build_model(fm.catalog.vertical_2r(), 1, flexible_links=False, flexible_joints=False)
RUBBING = fm.build_model(
    replace(
        fm.catalog.vertical_2r(),
        joints=[replace(each, coulomb_friction=0.3, viscous_friction=0.2) for each in fm.catalog.vertical_2r().joints],
    ),
    1, flexible_links=False, flexible_joints=False,
)  # fmt: skip


@pytest.fixture
def whole_torque(monkeypatch):
    """Let motions take the whole torque to their ends."""
    monkeypatch.setattr(path_parametrisation, "SHARES", (1.0, 1.0))


def one_joint(inertia=2.0, limit=3.0, way=0.5, rates=np.inf):
    """Return the bounds of a rotor without other torques."""
    tables = np.zeros((1, 11, 3, 1))
    tables[:, :, 1] = inertia * way
    model = fm.build_model(fm.catalog.one_joint(), elements=1)
    return PathBounds(model, tables, np.full((1, 1), limit), np.full((1, 1), way), rates, np.zeros((1, 2, 1)))


def random_bounds(count, seed=0, model=RIGID, friction=(0.0, 0.0)):
    """Return the bounds of arms with two joints, with varying inertia, weight and speed torques."""
    random = np.random.default_rng(seed)
    phases = random.uniform(0.0, 6.0, (count, 1, 3, 2)) + random.uniform(-3.0, 3.0, (count, 1, 3, 2)) * np.linspace(
        0.0, 1.0, 11
    ).reshape(1, 11, 1, 1)
    tables = np.sin(phases) * np.array([1.0, 2.0, 1.5])[:, None]
    ways = random.uniform(0.3, 1.0, (count, 2))
    limits = random.uniform(3.0, 5.0, (count, 2))
    return PathBounds(model, tables, limits, ways, 2.0, np.tile(np.array(friction)[:, None], (count, 1, 2)))


def stages(bounds, profile, start=0.0):
    """Return path parameters, squared speeds, accelerations and torques at the middles of the stages of one arm."""
    width = (1.0 - start) / STAGES
    squares, middles = profile.speeds[0] ** 2, start + width * (np.arange(STAGES) + 0.5)
    change, square = np.diff(squares) / (2.0 * width), 0.5 * (squares[1:] + squares[:-1])
    layers = np.array(
        [[np.interp(middles, np.linspace(0.0, 1.0, 11), column) for column in layer.T] for layer in
         np.swapaxes(bounds.tables[0], 0, 1)]
    )  # fmt: skip
    return middles, square, change, layers[0].T, (layers[0] + layers[1] * change + layers[2] * square).T


def test_the_motion_of_a_rotor_is_bang_bang(whole_torque):
    """Half of the way it accelerates, half of it it brakes: in 2 sqrt(way inertia / torque)."""
    profile = fastest_motion(one_joint(), ZERO, ZERO)
    assert profile.feasible.all()
    assert profile.times[0, -1] == pytest.approx(2.0 * np.sqrt(0.5 * 2.0 / 3.0), rel=1e-12)
    assert profile.speeds[0, STAGES // 2] == pytest.approx(np.sqrt(3.0 / (2.0 * 0.5)), rel=1e-12)


def test_the_motion_of_a_rotor_with_a_speed_limit_is_a_trapezoid(whole_torque):
    """It takes the way over the speed, and a ramp."""
    limit, acceleration = 0.4, 3.0 / 2.0
    profile = fastest_motion(one_joint(rates=limit), ZERO, ZERO)
    assert profile.speeds.max() == pytest.approx(limit / 0.5, rel=1e-12)
    assert profile.times[0, -1] == pytest.approx(0.5 / limit + limit / acceleration, rel=1e-3)


def test_a_weight_takes_its_part_of_the_torque_on_one_side_only(whole_torque):
    """A constant weight of 1 N m: 2 N m accelerate, 4 N m brake; the acceleration lasts twice as long."""
    bounds = one_joint()
    bounds.tables[:, :, 0] = 1.0
    profile = fastest_motion(bounds, ZERO, ZERO)
    expected = np.sqrt(2.0 * 0.5 * 2.0 * (1.0 / 2.0 + 1.0 / 4.0))
    assert profile.times[0, -1] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("friction", [(0.0, 0.0), (0.2, 0.3)])
def test_torques_reach_the_share_of_their_limits_and_never_exceed_it(friction):
    """At every stage but where the speed has its bound one motor gives all that the share allows."""
    for seed in range(20):
        model = RUBBING if any(friction) else RIGID
        bounds = random_bounds(1, seed, model, friction)
        profile = fastest_motion(bounds, ZERO, ZERO)
        middles, square, _, rest, torques = stages(bounds, profile)
        share = np.interp(middles, SHARE_CHANGE, SHARES)[:, None]
        rates = 0.5 * (profile.speeds[0, 1:] + profile.speeds[0, :-1])[:, None] * bounds.displacement
        rubbed = torques + friction_torques(model, rates, bounds.friction[0])
        used = np.where(
            rubbed > rest, (rubbed - rest) / (bounds.limits - rest), (rest - rubbed) / (bounds.limits + rest)
        )
        fastest = 1.0 / (bounds.displacement / bounds.rates).max()
        bounded = np.sqrt(square) > (1.0 - 1e-6) * fastest
        largest = (used / share).max(axis=1)
        assert profile.feasible.all() and largest.max() <= 1.0 + (1e-3 if any(friction) else 1e-9)
        assert np.sqrt(square).max() <= fastest * (1.0 + 1e-9)
        assert (largest[~bounded] > 0.99).mean() > 0.9


def test_no_torque_within_the_limits_would_be_faster():
    """A search by bisection from the end: the largest s'^2 at each stage from which the end can be reached."""
    bounds = random_bounds(1, 3)
    profile = fastest_motion(bounds, np.array([0.6]), ZERO)
    assert profile.feasible.all() and (np.diff(profile.times[0]) > 0.0).all()
    slower = bounds._replace(limits=0.9 * bounds.limits)
    assert fastest_motion(slower, np.array([0.6]), ZERO).times[0, -1] > profile.times[0, -1]


def test_a_speed_from_which_no_torque_stops_the_arm_is_not_feasible():
    """With a given way left, a rotor stops from sqrt(2 way torque / inertia)."""
    bounds, left = one_joint(), 0.1
    share = SHARES[1]
    largest = np.sqrt(2.0 * left * share * 3.0 / (2.0 * 0.5))
    for factor, feasible in ((0.999, True), (1.001, False)):
        result = fastest_motion(bounds, np.array([1.0 - left]), np.array([factor * largest]))
        assert result.feasible.tolist() == [feasible]


def test_an_arm_whose_weight_is_above_its_limits_has_no_motion():
    bounds = one_joint()
    bounds.tables[:, 5, 0] = 4.0
    assert not fastest_motion(bounds, ZERO, ZERO).feasible.any()
    motions = TimeOptimalMotions()
    motions.allocate(1)
    motions.start(ONE, np.array([0.1]), bounds)
    assert motions.windows.tolist() == [0.0]


def started(bounds, window=0.1):
    """Return the smoothed motions of the arms of some bounds."""
    count = len(bounds.tables)
    motions = TimeOptimalMotions()
    motions.allocate(count)
    motions.start(np.arange(count), np.full(count, window), bounds)
    assert (motions.windows > 0.0).all()
    return motions


def sampled(motions, arm=0, count=4001):
    """Return times (T,) of a motion, and its path parameters, speeds and accelerations (3, T)."""
    times = np.linspace(-0.1, motions.durations[arm] + 0.2, count)
    return times, np.array(motions.at(times, np.full(count, arm)))


def test_a_smoothed_motion_is_monotone_continuous_and_ends_exactly_at_rest():
    """Its speed and acceleration are the derivatives of the path parameter and of the speed."""
    motions = started(random_bounds(5))
    for arm in range(5):
        times, (place, speed, change) = sampled(motions, arm)
        assert (np.diff(place) >= -ROUNDING).all() and not place[times <= 0.0].any()
        after = times >= motions.durations[arm]
        assert (place[after] == 1.0).all() and not speed[after].any() and not change[after].any()
        step = times[1] - times[0]
        assert np.diff(place) / step == pytest.approx(0.5 * (speed[1:] + speed[:-1]), abs=1e-3 * speed.max())
        assert np.diff(speed) / step == pytest.approx(0.5 * (change[1:] + change[:-1]), abs=0.02 * np.abs(change).max())
        assert np.abs(np.diff(change)).max() < 0.05 * np.abs(change).max(), "the acceleration has no jump"
        before = motions.at(motions.durations[arm : arm + 1] - 1e-9, np.array([arm]))
        assert [each[0] for each in before] == pytest.approx([1.0, 0.0, 0.0], abs=1e-6)


def test_a_smoothed_rotor_takes_the_window_longer(whole_torque):
    """And its path parameter is the mean of that of the bang-bang motion over the window."""
    window, lasting = 0.1, 2.0 * np.sqrt(0.5 * 2.0 / 3.0)
    motions = started(one_joint(), window)
    spacing = window / path_parametrisation.WINDOW_SAMPLES
    assert lasting + window <= motions.durations[0] <= lasting + window + 2.0 * spacing
    times, (place, _, change) = sampled(motions)
    peak = 3.0 / (2.0 * 0.5)

    def exact(now):
        now = np.clip(now, 0.0, lasting)
        return np.where(now < 0.5 * lasting, 0.5 * peak * now**2, 1.0 - 0.5 * peak * (lasting - now) ** 2)

    mean = np.mean([exact(times - part * window) for part in (np.arange(200) + 0.5) / 200], axis=0)
    assert place == pytest.approx(mean, abs=1e-3)
    assert np.abs(change).max() <= 1.01 * peak


@pytest.mark.parametrize("heavier", [0.8, 1.0, 1.5])
@pytest.mark.parametrize("part", [0.15, 0.4, 0.6])
def test_a_replanned_motion_continues_and_ends_at_rest(part, heavier):
    motions = started(random_bounds(3))
    arms, now = np.arange(3), part * motions.durations
    before = [sampled(motions, arm, 3001) for arm in arms]
    bounds = random_bounds(3)
    motions.replan(arms, now, bounds._replace(tables=heavier * bounds.tables))
    for arm in arms:
        times, old = before[arm]
        new = np.array(motions.at(times, np.full(len(times), arm)))
        past = times <= now[arm]
        assert np.array_equal(new[:, past], old[:, past])
        fine, (place, speed, change) = sampled(motions, arm, 20001)
        assert (np.diff(place) >= -ROUNDING).all() and place[-1] == 1.0
        scale, step = np.abs(old[2]).max(), fine[1] - fine[0]
        assert np.abs(np.diff(change)).max() < 4.0 * heavier * scale * step / motions.windows[arm]
        assert np.abs(np.diff(speed)).max() < 2.0 * heavier * scale * step
    changed = [not np.array_equal(before[arm][1], motions.at(before[arm][0], np.full(3001, arm))) for arm in arms]
    assert all(changed)


def test_a_motion_that_is_replanned_with_the_same_bounds_arrives_at_the_same_time():
    motions = started(one_joint())
    before = motions.durations.copy()
    motions.replan(ONE, 0.3 * before, one_joint())
    assert motions.durations == pytest.approx(before, abs=1.01 * 0.1 / path_parametrisation.WINDOW_SAMPLES)


def test_limits_that_a_moving_arm_cannot_keep_are_raised_for_it():
    """Five times the inertia while braking: it stops at the end of the path, by more torque than allowed."""
    motions = started(one_joint())
    now = 0.6 * motions.durations
    motions.replan(ONE, now, one_joint(inertia=10.0))
    _, (place, _, change) = sampled(motions)
    assert place[-1] == 1.0 and (np.diff(place) >= -ROUNDING).all()
    assert 10.0 * 0.5 * np.abs(change).max() > 3.0


def test_a_motion_at_its_end_is_not_replanned():
    motions = started(one_joint())
    state = get_state(motions)
    motions.replan(ONE, motions.durations - 0.15, one_joint(inertia=4.0))
    assert np.array_equal(state["_motions"], motions._motions)


def test_motions_do_not_depend_on_other_arms():
    """Alone and among 64, planned and replanned, with friction: equal to the bit."""
    whole = random_bounds(64, 7, RUBBING, (0.2, 0.3))
    motions = started(whole)
    motions.replan(np.arange(64), 0.4 * motions.durations, whole._replace(tables=1.2 * whole.tables))
    for arm in range(0, 64, 9):
        own = whole.rows(np.array([arm]))
        alone = started(own)
        alone.replan(ONE, 0.4 * alone.durations, own._replace(tables=1.2 * own.tables))
        assert np.array_equal(alone._motions[0], motions._motions[arm])
        assert alone.durations[0] == motions.durations[arm]


MODEL = fm.build_model(replace(fm.catalog.vertical_2r(), gravity=(0.0, 0.0, 0.0)), 1, modes=1)
LIMITS = 0.005 * np.array([12.0, 4.0])


def slews(timing, count=1, rates=np.inf, vibrations=0.0, limits=LIMITS):
    """Return references of slews that have begun."""
    bounds = SlewBounds(limits, 0.95, rates, vibrations).time_optimal(MODEL)
    result, random = SlewReferences(MODEL, bounds, (0.1, 0.15, 0.2), timing=timing), np.random.default_rng(1)
    result.allocate(count)
    starts, goals = random.uniform(-0.8, 0.8, (2, count, 2))
    arms = np.arange(count)
    result.begin(arms, starts, goals)
    result.adapt(arms, {})
    result.plan_timing(arms, np.zeros(count), first=True)
    return result


def test_a_slew_set_by_torques_is_quicker_than_the_quintic():
    """Within the torques that feed-forward may take, at a fine grid."""
    quick, quintic = slews("time-optimal", 8), slews("quintic", 8)
    ratios = quick.duration / quintic.duration
    assert (ratios < 1.0).all() and np.median(ratios) < 0.95 and (quick._motions.windows > 0.0).all()
    assert quick._motions.windows == pytest.approx(average_windows(np.full(8, quick._bounds.free), quintic.duration))
    for arm in range(8):
        now = np.linspace(0.0, quick.duration[arm], 400)
        torques = np.array([quick.motion(each, each, np.array([arm]))[1][0] for each in now[:, None]])
        assert 0.85 * 0.95 < np.abs(torques / LIMITS).max() <= 1.01 * 0.95


@pytest.mark.parametrize(
    "bounds", [{"rates": 0.1}, {"vibrations": 40.0}, {"limits": 1e3 * LIMITS}], ids=lambda each: next(iter(each))
)
def test_a_slew_that_torques_do_not_set_is_a_quintic_to_the_bit(bounds):
    """Rates, the first mode, or motors so strong that the slew is shorter than a few periods of a mode."""
    quick, quintic = slews("time-optimal", 8, **bounds), slews("quintic", 8, **bounds)
    assert not quick._motions.windows.any() and np.array_equal(quick.duration, quintic.duration)
    arms, now = np.arange(8), 0.4 * quintic.duration
    for first, second in zip(quick.motion(now, now, arms), quintic.motion(now, now, arms), strict=True):
        assert np.array_equal(first, second)
    for each in (quick, quintic):
        each.plan_timing(arms, now, first=False)
    later = now + 0.2 * quintic.duration
    assert np.array_equal(np.array(quick.at(later, arms)), np.array(quintic.at(later, arms)))


def test_a_slew_is_a_quintic_unless_it_is_longer_than_the_modes_allow_and_quicker():
    ones = np.ones(1)
    for duration, mode, quintic, shortest, expected in (
        (1.0, 0.1, 1.1, 0.0, True), (1.0, 0.1, 1.0, 0.0, False), (1.0, 1.01 / LEAST_PERIODS, 1.1, 0.0, False),
        (1.0, 0.1, 1.1, 1.01 / LEAST_QUINTICS, False),
    ):  # fmt: skip
        assert is_time_optimal(duration * ones, mode * ones, quintic * ones, shortest * ones).tolist() == [expected]


def test_time_optimal_slews_alone_and_among_others_are_equal_to_the_bit():
    """Some of them quintic, with a replanned timing, and continued from a snapshot."""

    def run(arms, resumed=False):
        bounds = SlewBounds(LIMITS, 0.95, 1.2).time_optimal(MODEL)
        result, random = (
            SlewReferences(MODEL, bounds, (0.1, 0.15, 0.2), timing="time-optimal"),
            np.random.default_rng(4),
        )
        result.allocate(6)
        starts, goals = random.uniform(-0.8, 0.8, (2, 6, 2))
        goals[::2] = starts[::2] + 0.2 * goals[::2]
        result.begin(arms, starts[arms], goals[arms])
        result.adapt(arms, {})
        result.plan_timing(arms, np.zeros(len(arms)), first=True)
        if resumed:
            state = get_state(result)
            result.plan_timing(arms, np.zeros(len(arms)), first=True)
            set_state("slews", result, state)
        chosen = result._motions.windows[arms] > 0.0
        result.adapt(arms, {"payload_mass": np.full(6, 0.19)})
        result.plan_timing(arms, 0.3 * result.duration[arms], first=False)
        now = 0.5 * result.duration[arms]
        return np.hstack(result.motion(now, now, arms)), chosen

    whole, chosen = run(np.arange(6))
    assert chosen.sum() > 0
    for arm in range(6):
        assert np.array_equal(run(np.array([arm]))[0][0], whole[arm])
    assert np.array_equal(run(np.arange(6), resumed=True)[0], whole)


def test_a_replanned_slew_keeps_its_torques_without_a_jump():
    quick = slews("time-optimal")
    now = 0.4 * quick.duration
    before = np.array(quick.at(now, ONE)), quick.motion(now, now, ONE)
    quick.plan_timing(ONE, now, first=False)
    assert np.array_equal(np.array(quick.at(now, ONE)), before[0])
    step = 1e-3 * quick.duration
    torques = [quick.motion(now + i * step, now + i * step, ONE)[1][0] for i in range(-20, 20)]
    assert np.abs(np.diff(torques, axis=0)).max() < 0.1 * LIMITS.max()


def test_a_planned_slew_is_quicker_and_ends_at_rest():
    """The plan of the tracking LQR, whose torques and states are those of the bent arm along the path."""
    bounds = SlewBounds(LIMITS, 0.95).time_optimal(MODEL)
    start, goal, period = np.array([-0.5, 0.3]), np.array([0.6, -0.4]), 0.01
    quintic, quick = (plan_slew(MODEL, start, goal, bounds, period, each) for each in ("quintic", "time-optimal"))
    assert len(quick.torques) < 0.97 * len(quintic.torques)
    assert np.abs(quick.torques / LIMITS).max() <= 0.96
    assert quick.states[0] == pytest.approx(fm.rest_state(MODEL, start))
    assert quick.states[-1] == pytest.approx(fm.rest_state(MODEL, goal))
    fractions = np.linspace(0.0, 1.0, 2001)
    angles, rates, _ = quick.path.motion(fractions)
    moved = (angles - angles[0]) @ (angles[-1] - angles[0])
    assert (np.diff(moved) >= -1e-12).all() and not rates[[0, -1]].any()
    assert angles[-1] == pytest.approx(quintic.path.motion(fractions[-1:])[0][0])


def test_the_free_period_of_a_rotor_and_a_load_on_a_spring():
    """2 pi sqrt(I J / (I + J) / k), whatever holds a motor; a pendulum motion of the whole arm is left out."""
    joint = fm.Joint((0.0, 0.0, 1.0), rotor_inertia=0.5, stiffness=20.0)
    link = fm.Link.rigid(length=1.0, mass=0.3, centre=(1.0, 0.0, 0.0))
    model = fm.build_model(fm.Arm([link], [joint]))
    expected = 2.0 * np.pi * np.sqrt(0.5 * 0.3 / 0.8 / 20.0)
    assert free_period(model, np.zeros(1)) == pytest.approx(expected, rel=1e-6)
    hanging = fm.build_model(fm.Arm([link], [joint], gravity=(9.81, 0.0, 0.0)))
    assert free_period(hanging, np.zeros(1)) < expected


def test_another_timing_is_refused_in_one_line():
    line = refusal(SlewReferences, MODEL, SlewBounds(LIMITS, 0.95), (0.1,), 3.0, False, "trapezoid")
    assert line == "timing: 'trapezoid' is not allowed; give one of time-optimal, quintic"
