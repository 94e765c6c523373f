"""Kalman: the filter is the textbook's, on the simulator; torques come late as they do, and constants are found."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.stats import chi2

import flexman_gym as fm
from flexman_gym.control.controller import Episode
from flexman_gym.control.discrete import zero_order_hold
from flexman_gym.control.instruments import BIAS, make_instruments
from flexman_gym.control.kalman import DRIFT, EVERY, FORCE, OFFSET, TORQUE, UNLIKE, KalmanFilter
from flexman_gym.control.riccati import predicted
from flexman_gym.control.slopes import Slopes
from flexman_gym.envs.snapshot import give, take
from flexman_gym.simulation.batch import Batch

from oracles.refusals import refusal
from oracles.worlds import ALL, POSTURES, World, plant, random_actions


@pytest.mark.parametrize("late", [0, 1, 3])
@pytest.mark.parametrize("fixed", [False, True])
def test_without_noise_it_knows_where_the_arm_is_and_will_be(late, fixed):
    """Torques of three arms that come late by any number of periods; now, and when a new torque begins to act."""
    given = plant(delay=(late, late))
    world, kalman = World(given), KalmanFilter(given, fixed=fixed)
    world.begin(kalman)

    def watch(estimate):
        assert kalman.states == pytest.approx(world.batch.state, abs=1e-9)
        assert (estimate.lead == late).all() and not estimate.parameters

    said, true = world.play(kalman, random_actions(20), watch)
    for now, later in zip(said, true[late:], strict=False):
        assert now.states == pytest.approx(later, abs=1e-9)
    assert np.abs(true[-1] - true[0]).max() > 0.1


def test_of_a_range_of_delays_it_takes_the_middle():
    assert [KalmanFilter(plant(delay=span)).delay for span in ((0, 0), (1, 1), (0, 2), (1, 2))] == [0, 1, 1, 2]


def textbook(given, postures, actions, readings, noise):
    """The extended Kalman filter of one arm as books have it, with differences to both sides; states after readings."""
    model, limits = given.model, np.array(given.torque_limit)
    read, size = make_instruments(given, ALL), 2 * given.model.n_dof
    batch = Batch(model, *given.moved, given.period)
    scales = np.append(limits, np.full(3, limits.max() / model.constants.length.sum()))
    variances = np.diag(read.deviations**2)

    def moved(x, forces):
        drive = np.zeros((1, len(forces) + 3))
        drive[0, : len(forces)] = forces
        batch.place(np.arange(1), x[None])
        batch.step(drive)
        return batch.state[0].copy()

    def slopes(x, forces):
        unit = np.eye(size + len(forces))
        steps = np.append(np.full(size, 1e-5), 1e-3 * scales)
        both = list(zip(unit, steps, strict=True))
        sides = [[moved(x + h * row[:size], forces + h * row[size:]) for row, h in both]]
        sides += [[moved(x - h * row[:size], forces - h * row[size:]) for row, h in both]]
        return (np.array(sides[0]) - np.array(sides[1])).T / (2 * steps)

    x = fm.rest_state(model, postures)
    held = np.append(fm.holding_torques(model, postures), np.zeros(3))
    change = slopes(x, held)
    Q = change[:, size:] @ np.diag(np.repeat(noise, (2, 3)) * scales) ** 2 @ change[:, size:].T
    P = solve_discrete_are(change[:, :size].T, read.matrix.T, Q, variances)
    turns = np.eye(size)[:2] + np.eye(size)[model.motor_columns]
    P = P + turns.T @ variances[:2, :2] @ turns
    result = [x]
    for period, (action, values) in enumerate(zip(actions, readings[1:], strict=False), 1):
        forces = np.append(action * limits, np.zeros(3))
        if period % EVERY == 0:
            change = slopes(x, forces)
            Q = change[:, size:] @ np.diag(np.repeat(noise, (2, 3)) * scales) ** 2 @ change[:, size:].T
        x, P = moved(x, forces), change[:, :size] @ P @ change[:, :size].T + Q
        K = P @ read.matrix.T @ np.linalg.inv(read.matrix @ P @ read.matrix.T + variances)
        x, P = x + K @ (values - read.matrix @ x), P - K @ read.matrix @ P
        result.append(x)
    return np.array(result), P


@pytest.mark.parametrize(
    ("unknown", "noise"), [({}, (TORQUE, FORCE)), ({"payload_mass": (0.0, 1.0)}, (TORQUE, UNLIKE))]
)
def test_it_is_the_filter_of_the_textbooks(unknown, noise):
    given = plant(unknown=unknown)
    world, random = World(given, POSTURES[:1]), np.random.default_rng(1)
    kalman, actions, read, states = KalmanFilter(given), random_actions(14, 1), [], []
    world.noise = 3.0 * world.instruments.deviations * random.normal(size=(1, len(world.instruments.ranges)))
    encoders = world.readings()["motor_angles"][0]
    world.begin(kalman)

    def watch(estimate):
        read.append(np.concatenate([each[0] for each in world.readings().values()]))
        states.append(kalman.states[0].copy())
        world.noise = 3.0 * world.instruments.deviations * random.normal(size=(1, len(read[0])))

    world.play(kalman, actions, watch)
    expected, covariance = textbook(given, encoders, actions[:, 0], np.array(read), noise)
    deviations = np.sqrt(np.diag(covariance))
    assert (np.abs(states - expected) <= 5e-3 * deviations).all() and np.ptp(expected, axis=0).max() > 0.1
    assert (np.abs(kalman.covariance[0] - covariance) <= 5e-3 * np.outer(deviations, deviations)).all()


def test_what_the_tip_may_be_pushed_by_is_reckoned_with():
    """A task that pushes says how much; the noise is then that of as large a force in place of what is usual."""
    given = plant("FlexPlanar-Hold-v0")
    scale = Slopes(given).scales[-1]
    said = np.hypot(FORCE, given.push / scale)
    one, other = KalmanFilter(given), KalmanFilter(given, noise=(TORQUE, said))
    assert given.push == 0.5 and said > 2.0 * FORCE and plant().push == 0.0
    for kalman in (one, other):
        world = World(given)
        world.begin(kalman)
        world.play(kalman, random_actions(8))
    assert one.covariance == pytest.approx(other.covariance, rel=1e-6, abs=1e-15)


def test_innovations_on_the_simulator_are_as_large_as_they_should_be():
    """Moving arms pushed by the forces that it reckons with: sums of squares within the 99 % bounds of chi-square."""
    given, count, random = plant(delay=(1, 1)), 60, np.random.default_rng(4)
    world, kalman, slopes = World(given, random.uniform(-1.0, 1.0, (count, 2))), KalmanFilter(given), Slopes(given)
    beside, read, size = Batch(given.model, *given.moved, given.period, arms=count), world.instruments, 20
    parts, drive, total = np.repeat((TORQUE, FORCE), (2, 3)) * slopes.scales, np.zeros((count, 8)), 0.0
    world.noise = read.deviations * random.normal(size=(count, len(read.ranges)))
    world.begin(kalman)
    kalman.estimate(world.readings(), world.last, np.ones(count, dtype=bool))
    for action in random_actions(30, count):
        pushed = parts * random.normal(size=(count, 5))
        world.offset, world.force = pushed[:, :2], pushed[:, 2:]
        world.step(action)
        world.noise = read.deviations * random.normal(size=(count, len(read.ranges)))
        drive[:, :2] = world.asked[0]
        beside.place(world.arms, kalman.states)
        beside.step(drive)
        change, _ = slopes(kalman.states, drive[:, :2])
        inputs = change[..., size:] * parts
        after = predicted(kalman.covariance, change[..., :size], inputs @ inputs.mT)
        error = world.numbers - beside.state @ read.matrix.T
        spread = read.matrix @ after @ read.matrix.T + np.diag(read.deviations**2)
        total += (error[:, None] @ np.linalg.solve(spread, error[..., None])).sum()
        kalman.estimate(world.readings(), world.last, np.ones(count, dtype=bool))
    degrees = 30 * count * len(read.ranges)
    assert chi2.ppf(0.005, degrees) < total < chi2.ppf(0.995, degrees)


def corrections(kalman, world, errors):
    """What readings (m, m) that are off by a row each change in as many arms that rest."""
    world.begin(kalman)
    held = np.array([fm.holding_torques(world.plant.model, each) for each in world.goals])
    actions = np.repeat(held[None] / world.plant.torque_limit, 2, axis=0)
    before = []
    world.play(kalman, actions, lambda _: (before.append(kalman.states.copy()), setattr(world, "noise", errors)))
    return before[1] - before[0]


def test_a_fixed_gain_is_the_stationary_one_at_the_goal():
    """Of SciPy's Riccati equation of the exact hold there; at another posture it is another one."""
    given = plant(moved=("gauss_3_sweeps", 0.0005))
    read = make_instruments(given, ALL)
    m, gains = len(read.matrix), []
    for posture in POSTURES[:2]:
        world = World(given, np.repeat(posture[None], m, axis=0))
        change = corrections(KalmanFilter(given, noise=(0.1, 0.0), fixed=True), world, np.diag(read.deviations))
        state, held = fm.rest_state(given.model, posture), fm.holding_torques(given.model, posture)
        linear = fm.linearize(given.model, state=state, torque=held)
        transition, inputs = zero_order_hold(linear, given.period)
        driven = inputs * 0.1 * np.array(given.torque_limit)
        variances = np.diag(read.deviations**2)
        P = solve_discrete_are(transition.T, read.matrix.T, driven @ driven.T, variances)
        gain = P @ read.matrix.T @ np.linalg.inv(read.matrix @ P @ read.matrix.T + variances)
        gains.append(gain * read.deviations)
        assert (np.abs(change.T - gains[-1]) <= 1e-2 * np.abs(gains[-1]).max(axis=1, keepdims=True) + 1e-9).all()
    assert (np.abs(gains[1] - gains[0]).max(axis=1) > 0.06 * np.abs(gains[0]).max(axis=1)).sum() > 5


def test_a_constant_torque_is_found():
    """Beside what the motors are asked for; the estimate, also of what comes until a new torque acts, is nearer."""
    given, offset, off = plant(delay=(1, 1)), np.array([0.6, -0.2]), []
    for disturbed in (False, True):
        world, kalman = World(given), KalmanFilter(given, disturbed=disturbed)
        world.offset = offset
        world.begin(kalman)
        said, true = world.play(kalman, random_actions(60))
        off.append(np.abs(said[-2].states - true[-1]).max())
        assert said[-1].disturbance == pytest.approx(np.tile(disturbed * offset, (3, 1)), rel=0.02, abs=1e-12)
    assert off[1] < 0.1 * off[0]


def test_a_bias_is_found_where_readings_tell_it():
    """Of twists and strains at rest; the encoders' own shows nowhere. The state is nearer for it."""
    given, off = plant(), []
    for biased in (False, True):
        world, kalman = World(given), KalmanFilter(given, biased=biased)
        places, ranges = world.instruments.places, world.instruments.ranges
        told = np.r_[places["joint_twists"], places["root_strains"]]
        world.bias = np.zeros(len(ranges))
        world.bias[told] = 0.004 * ranges[told] * np.resize([1.0, -1.0], len(told))
        world.begin(kalman)
        _, true = world.play(kalman, random_actions(80, size=0.1))
        off.append(np.abs(kalman.states[:, : 2 * given.model.n_dof] - true[-1]).max())
    found = kalman.states[:, 2 * given.model.n_dof :][:, told]
    bent = [i for i, each in enumerate(told) if np.abs(world.instruments.matrix[each]).max() > 0]
    assert np.abs(found - world.bias[told])[:, bent].max() < 0.25 * np.abs(world.bias[told][bent]).max()
    assert off[1] < 0.5 * off[0]


def test_a_bias_is_kept_for_half_a_minute():
    """It falls by 1 / e in 30 s: biases that do are predicted to the digit."""
    given = plant()
    world, kalman = World(given), KalmanFilter(given, biased=True)
    first, size = 0.003 * world.instruments.ranges, 2 * given.model.n_dof
    world.begin(kalman)
    world.play(kalman, random_actions(1))
    kalman.states[:, size:] = first
    for period in range(1, 30):
        world.bias = first * np.exp(-period * given.period / 30.0)
        world.play(kalman, random_actions(1, seed=period))
        assert kalman.states[:, size:] == pytest.approx(np.tile(world.bias, (3, 1)), rel=1e-7)


def unread(known, **options):
    """Variances (c,) of the constants that a filter estimates, after 40 periods in which no reading says anything.

    They begin as at a start, or known.
    """
    given = plant()
    world, kalman, size = World(given), KalmanFilter(given, **options), 2 * given.model.n_dof
    world.begin(kalman)
    world.play(kalman, random_actions(1))
    kalman._matrix = 0.0 * kalman._matrix
    if known:
        kalman.covariance[:, size:], kalman.covariance[:, :, size:] = 0.0, 0.0
    world.play(kalman, random_actions(40))
    return given, np.diagonal(kalman.covariance[0])[size:]


@pytest.mark.parametrize("known", [False, True])
def test_a_constant_torque_drifts_as_a_random_walk(known):
    """Its variance grows by that of a second's drift times the time that passes (Wiener)."""
    given, variances = unread(known, disturbed=True)
    limits = np.array(given.torque_limit)
    walked = 40 * given.period * (DRIFT * limits) ** 2
    assert variances == pytest.approx(walked + (not known) * (OFFSET * limits) ** 2, rel=1e-9)


@pytest.mark.parametrize("known", [False, True])
def test_a_bias_wanders_within_its_bounds(known):
    """Ornstein and Uhlenbeck: the variance is that of an even spread; from 0 it comes back as exp(-2 t / 30 s)."""
    given, variances = unread(known, biased=True)
    even = (BIAS * make_instruments(given, ALL).ranges) ** 2 / 3.0
    share = 1.0 - known * np.exp(-2.0 * 40 * given.period / 30.0)
    assert variances == pytest.approx(share * even, rel=1e-9)


@pytest.mark.parametrize("options", [{}, {"disturbed": True, "biased": True}, {"fixed": True}])
def test_an_arm_among_many_gets_what_an_arm_alone_gets_to_the_bit(options):
    """Arms that begin at different times, where the one alone is new, and of which some rest for a while."""
    given, random = plant(delay=(1, 1)), np.random.default_rng(2)
    many, singles = KalmanFilter(given, **options), {}
    m = len(make_instruments(given, ALL).ranges)
    begin, rest = {0: [0, 1, 2], 4: [1], 9: [0]}, {4: 1, 5: 2, 6: 2, 7: 2}
    last = np.zeros((3, 2))
    for period in range(16):
        if period in begin:
            arms = np.array(begin[period])
            last[arms] = 0.0
            many.reset(arms, Episode(POSTURES[arms], POSTURES[arms], given.period))
            for arm in begin[period]:
                singles[arm] = KalmanFilter(given, **options)
                singles[arm].reset(np.array([0]), Episode(POSTURES[[arm]], POSTURES[[arm]], given.period))
        values = 0.05 * random.normal(size=(3, m))
        read = {name: values[:, place] for name, place in many._instruments.places.items()}
        playing = np.array([rest.get(period) != arm for arm in range(3)])
        estimate = many.estimate(read, last, playing)
        for arm in np.flatnonzero(playing).tolist():
            own = {name: each[[arm]] for name, each in read.items()}
            alone = singles[arm].estimate(own, last[[arm]], playing[[arm]])
            assert np.array_equal(alone.states[0], estimate.states[arm])
            assert np.array_equal(alone.disturbance[0], estimate.disturbance[arm])
        last = random.uniform(-1.0, 1.0, (3, 2))


@pytest.mark.parametrize("options", [{}, {"disturbed": True}, {"fixed": True}])
def test_it_goes_on_from_what_it_kept(options):
    given = plant(delay=(2, 2))
    world, one, other = World(given), KalmanFilter(given, **options), KalmanFilter(given, **options)
    world.begin(one)
    world.play(one, random_actions(7))
    world.begin(other)
    give("observer", other, take(one))
    readings, playing = world.readings(), np.ones(3, dtype=bool)
    for last in random_actions(6, seed=3):
        estimates = [kalman.estimate(readings, last, playing) for kalman in (one, other)]
        assert np.array_equal(estimates[0].states, estimates[1].states)


def test_bad_arguments_are_refused_in_one_line():
    allowed = "give motor_encoders, beside which may stand joint_encoders, strain: what else there is does not follow"
    for sensors in (("motor_encoders", "accelerometer"), ("strain",), "lab", ()):
        said = refusal(KalmanFilter, plant(), sensors)
        assert said.startswith("sensors: ") and allowed in said
    assert refusal(KalmanFilter, plant(), ALL, (-0.1, 0.1)).startswith("noise: -0.1 is not allowed; give")
    assert refusal(KalmanFilter, plant(), ALL, 0.1).startswith("noise: 0.1 is not allowed; give")
    assert refusal(KalmanFilter, plant(), ALL, None, 1).startswith("disturbed: 1 is not allowed; give")
