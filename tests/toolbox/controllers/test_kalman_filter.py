"""Kalman filter of the simulated arm, and its Riccati recursion."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.stats import chi2

import flexman_gym as fm
from flexman_gym.agent.controller import EpisodeInfo
from flexman_gym.common.snapshot import get_state, set_state
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.model.linearization import LinearMeasurements
from flexman_gym.model.state_space import discretize
from flexman_gym.simulation.batch import Batch
from flexman_gym.toolbox.controllers.internal_model import DiscreteJacobians
from flexman_gym.toolbox.controllers.margins import sampled_loops
from flexman_gym.toolbox.controllers.observers.kalman_filter import (
    FORCE_NOISE,
    MISMATCH_FORCE_NOISE,
    OFFSET_DEVIATION,
    OFFSET_DRIFT,
    RELINEARISATION_INTERVAL,
    TORQUE_NOISE,
    KalmanFilter,
    measurement_update,
    stationary_covariance,
    time_update,
)
from flexman_gym.toolbox.controllers.observers.observer import MAX_BIAS, MeasurementModel

from oracles.assertions import refusal
from oracles.observed_arms import ALL, POSTURES, World, plant, random_actions

RUNS, PERIODS = 3000, 40


def system(seed, size=6, read=2, growth=1.02):
    """A made-up system: transition, noise, matrix, variances; some of its parts grow by themselves."""
    random = np.random.default_rng(seed)
    transition = growth * np.linalg.qr(random.normal(size=(size, size)))[0] @ np.diag(random.uniform(0.6, 1.0, size))
    driven = random.normal(size=(size, 2))
    return transition, driven @ driven.T, random.normal(size=(read, size)), random.uniform(0.1, 2.0, read)


def arm_system(delay=2, part=0.01):
    """A flexible arm about a posture, torques that come late, its encoders and gauges; transition, inputs and so on."""
    setup = Configuration.from_keywords({"name": "FlexPlanar-v0"})
    model = resolve_fidelity(setup).model
    loop = sampled_loops(model, [0.4, -0.7], setup.control_period, delay)[0]
    unit = LinearMeasurements(model).measure(np.eye(2 * model.n_dof))
    read = np.hstack([unit["motor_angles"], unit["motor_rates"], unit["root_strains"][:, [0, 1, 3, 4]]]).T
    matrix = np.hstack([read, np.zeros((len(read), len(loop.transition) - read.shape[1]))])
    reaching = sampled_loops(model, [0.4, -0.7], setup.control_period)[0].inputs * part * np.array(setup.torque_limit)
    driven = np.vstack([reaching, np.zeros((len(loop.transition) - len(reaching), 2))])
    return loop, driven, matrix, np.repeat([1e-3, 1e-2, 1e-5], [2, 2, 4])


@pytest.mark.parametrize("seed", range(4))
def test_many_periods_lead_to_it(seed):
    transition, noise, matrix, variances = system(seed)
    result = stationary_covariance(transition, noise, matrix, variances)
    covariance = np.eye(6)
    for _ in range(3000):
        covariance = time_update(measurement_update(covariance, matrix, variances)[1], transition, noise)
    assert np.abs(result - covariance).max() <= 1e-9 * np.abs(covariance).max()
    expected = solve_discrete_are(transition.T, matrix.T, noise, np.diag(variances))
    assert np.abs(result - expected).max() <= 1e-7 * np.abs(expected).max()


def test_systems_side_by_side_are_solved_as_alone():
    first, second = system(1), system(2)
    both = stationary_covariance(np.array([first[0], second[0]]), np.array([first[1], second[1]]), *first[2:])
    assert np.array_equal(both[0], stationary_covariance(first[0][None], first[1][None], *first[2:])[0])


def test_parts_that_are_forgotten_at_once_do_no_harm():
    """Eigenvalues of zero, as torques on their way have: nothing is divided by them."""
    loop, driven, matrix, deviations = arm_system(3)
    noise, size = driven @ driven.T, len(loop.transition)
    result = stationary_covariance(loop.transition, noise, matrix, deviations**2)
    after = time_update(measurement_update(result, matrix, deviations**2)[1], loop.transition, noise)
    assert np.abs(after - result).max() <= 1e-8 * np.abs(result).max()
    short = size - 6
    alone = stationary_covariance(
        loop.transition[:short, :short], noise[:short, :short], matrix[:, :short], deviations**2
    )
    assert np.array_equal(result[short:], np.zeros((6, size))) and result[:short, :short] == pytest.approx(alone)


def test_a_scalar_is_the_root_of_its_quadratic_equation():
    """p = a^2 p r / (p + r) + q."""
    a, q, r = 1.3, 0.7, 0.2
    half = 0.5 * (q + a * a * r - r)
    result = stationary_covariance(np.array([[a]]), np.array([[q]]), np.array([[1.0]]), np.array([r]))
    assert result[0, 0] == pytest.approx(half + np.sqrt(half**2 + q * r), rel=1e-12)


def test_what_readings_do_not_tell_is_infinite():
    """A second motor that nobody reads wanders off; the first is known."""
    transition = np.kron(np.eye(2), [[1.0, 0.1], [0.0, 1.0]])
    result = stationary_covariance(transition, np.eye(4), np.eye(1, 4), np.array([1.0]))
    assert np.isfinite(result[:2, :2]).all() and np.isinf(np.diag(result)[2:]).all()


def test_one_reading_of_one_number_is_the_weighted_mean():
    gain, left = measurement_update(np.array([[4.0]]), np.array([[1.0]]), np.array([1.0]))
    assert gain[0, 0] == pytest.approx(0.8) and left[0, 0] == pytest.approx(0.8)


def runs(loop, driven, matrix, deviations, steady):
    """Innovations in standard form (RUNS, PERIODS, m), and errors (RUNS, s) at the end with their covariance."""
    random, size = np.random.default_rng(7), len(matrix[0])
    noise, variances = driven @ driven.T, deviations**2
    covariance = (
        stationary_covariance(loop.transition, noise, matrix, variances) if steady else np.diag(np.full(size, 1e-4))
    )
    x = random.multivariate_normal(np.zeros(size), covariance, RUNS, method="svd")
    estimate, innovations = np.zeros((RUNS, size)), []
    for period in range(PERIODS):
        error = x @ matrix.T + deviations * random.normal(size=(RUNS, len(matrix))) - estimate @ matrix.T
        spread = np.linalg.cholesky(matrix @ covariance @ matrix.T + np.diag(variances))
        innovations.append(np.linalg.solve(spread, error.T).T)
        gain, covariance = measurement_update(covariance, matrix, variances)
        estimate = estimate + error @ gain.T
        if period < PERIODS - 1:
            torques = random.normal(size=(RUNS, 2))
            x = x @ loop.transition.T + torques @ loop.inputs.T + random.normal(size=(RUNS, 2)) @ driven.T
            estimate = estimate @ loop.transition.T + torques @ loop.inputs.T
            covariance = time_update(covariance, loop.transition, noise)
    return np.array(innovations).swapaxes(0, 1), x - estimate, covariance


@pytest.mark.parametrize("steady", [False, True])
@pytest.mark.parametrize("delay", [0, 2])
def test_innovations_are_white_and_as_large_as_they_should_be(delay, steady):
    """Sums of their squares are within the 99 % bounds of chi-square; neighbours in time do not know of each other."""
    innovations, _, _ = runs(*arm_system(delay), steady)
    total, count = np.square(innovations).sum(), innovations.size
    assert chi2.ppf(0.005, count) < total < chi2.ppf(0.995, count)
    neighbours = (innovations[:, 1:] * innovations[:, :-1]).sum(axis=(0, 1)) / innovations[:, 1:, 0].size ** 0.5
    assert np.abs(neighbours).max() < 4.0


@pytest.mark.parametrize("steady", [False, True])
def test_the_covariance_is_that_of_the_errors(steady):
    """Of each direction: normalised, all eigenvalues of the sample are within Marchenko and Pastur's bounds of 1."""
    _, errors, covariance = runs(*arm_system(0), steady)
    deviations = np.sqrt(np.diag(covariance))
    moved = deviations > 1e-9 * deviations.max()  # a planar arm does not leave its plane
    values, left = np.linalg.eigh((covariance / np.outer(deviations, deviations).clip(1e-300))[moved][:, moved])
    known = values > 1e-9
    scaled = (errors[:, moved] / deviations[moved]) @ left[:, known] / np.sqrt(values[known])
    sample = np.linalg.eigvalsh(scaled.T @ scaled / RUNS)
    edge = np.sqrt(scaled.shape[1] / RUNS)
    assert (1.0 - 1.15 * edge) ** 2 < sample[0] and sample[-1] < (1.0 + 1.15 * edge) ** 2 and scaled.shape[1] > 8


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
    read, size = MeasurementModel(given, ALL), 2 * given.model.n_dof
    batch = Batch(model, *given.integration, given.period)
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
        if period % RELINEARISATION_INTERVAL == 0:
            change = slopes(x, forces)
            Q = change[:, size:] @ np.diag(np.repeat(noise, (2, 3)) * scales) ** 2 @ change[:, size:].T
        x, P = moved(x, forces), change[:, :size] @ P @ change[:, :size].T + Q
        K = P @ read.matrix.T @ np.linalg.inv(read.matrix @ P @ read.matrix.T + variances)
        x, P = x + K @ (values - read.matrix @ x), P - K @ read.matrix @ P
        result.append(x)
    return np.array(result), P


@pytest.mark.parametrize(
    ("unknown", "noise"),
    [({}, (TORQUE_NOISE, FORCE_NOISE)), ({"payload_mass": (0.0, 1.0)}, (TORQUE_NOISE, MISMATCH_FORCE_NOISE))],
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
    scale = DiscreteJacobians(given).scales[-1]
    said = np.hypot(FORCE_NOISE, given.tip_force / scale)
    one, other = KalmanFilter(given), KalmanFilter(given, noise=(TORQUE_NOISE, said))
    assert given.tip_force == 0.5 and said > 2.0 * FORCE_NOISE and plant().tip_force == 0.0
    for kalman in (one, other):
        world = World(given)
        world.begin(kalman)
        world.play(kalman, random_actions(8))
    assert one.covariance == pytest.approx(other.covariance, rel=1e-6, abs=1e-15)


@pytest.mark.slow
def test_innovations_on_the_simulator_are_as_large_as_they_should_be():
    """Moving arms pushed by the forces of its process noise: normalised innovations have a mean square of 1.

    With seeds 0 to 5 and each method it is 0.968 to 0.984, as the filter is slightly conservative; its standard
    deviation is 0.009.
    """
    given, count, random = plant(delay=(1, 1)), 60, np.random.default_rng(4)
    world, kalman, slopes = (
        World(given, random.uniform(-1.0, 1.0, (count, 2))),
        KalmanFilter(given),
        DiscreteJacobians(given),
    )
    beside, read, size = Batch(given.model, *given.integration, given.period, arms=count), world.instruments, 20
    parts, drive, total = np.repeat((TORQUE_NOISE, FORCE_NOISE), (2, 3)) * slopes.scales, np.zeros((count, 8)), 0.0
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
        after = time_update(kalman.covariance, change[..., :size], inputs @ inputs.mT)
        error = world.numbers - beside.state @ read.matrix.T
        spread = read.matrix @ after @ read.matrix.T + np.diag(read.deviations**2)
        total += (error[:, None] @ np.linalg.solve(spread, error[..., None])).sum()
        kalman.estimate(world.readings(), world.last, np.ones(count, dtype=bool))
    degrees = 30 * count * len(read.ranges)
    assert total / degrees == pytest.approx(1.0, abs=0.04)


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
    given = plant(integration=("gauss_3", 0.0005))
    read = MeasurementModel(given, ALL)
    m, gains = len(read.matrix), []
    for posture in POSTURES[:2]:
        world = World(given, np.repeat(posture[None], m, axis=0))
        change = corrections(KalmanFilter(given, noise=(0.1, 0.0), fixed=True), world, np.diag(read.deviations))
        state, held = fm.rest_state(given.model, posture), fm.holding_torques(given.model, posture)
        linear = fm.linearize(given.model, state=state, torque=held)
        transition, inputs = discretize(linear.A, linear.B, given.period)
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
    walked = 40 * given.period * (OFFSET_DRIFT * limits) ** 2
    assert variances == pytest.approx(walked + (not known) * (OFFSET_DEVIATION * limits) ** 2, rel=1e-9)


@pytest.mark.parametrize("known", [False, True])
def test_a_bias_wanders_within_its_bounds(known):
    """Ornstein and Uhlenbeck: the variance is that of an even spread; from 0 it comes back as exp(-2 t / 30 s)."""
    given, variances = unread(known, biased=True)
    even = (MAX_BIAS * MeasurementModel(given, ALL).ranges) ** 2 / 3.0
    share = 1.0 - known * np.exp(-2.0 * 40 * given.period / 30.0)
    assert variances == pytest.approx(share * even, rel=1e-9)


@pytest.mark.parametrize("options", [{}, {"disturbed": True, "biased": True}, {"fixed": True}])
def test_an_arm_among_many_gets_what_an_arm_alone_gets_to_the_bit(options):
    """Arms that begin at different times, where the one alone is new, and of which some rest for a while."""
    given, random = plant(delay=(1, 1)), np.random.default_rng(2)
    many, singles = KalmanFilter(given, **options), {}
    m = len(MeasurementModel(given, ALL).ranges)
    begin, rest = {0: [0, 1, 2], 4: [1], 9: [0]}, {4: 1, 5: 2, 6: 2, 7: 2}
    last = np.zeros((3, 2))
    for period in range(16):
        if period in begin:
            arms = np.array(begin[period])
            last[arms] = 0.0
            many.reset(arms, EpisodeInfo(POSTURES[arms], POSTURES[arms], given.period), len(arms))
            for arm in begin[period]:
                singles[arm] = KalmanFilter(given, **options)
                singles[arm].reset(np.array([0]), EpisodeInfo(POSTURES[[arm]], POSTURES[[arm]], given.period), 1)
        values = 0.05 * random.normal(size=(3, m))
        read = {name: values[:, place] for name, place in many._instruments.places.items()}
        active = np.array([rest.get(period) != arm for arm in range(3)])
        estimate = many.estimate(read, last, active)
        for arm in np.flatnonzero(active).tolist():
            own = {name: each[[arm]] for name, each in read.items()}
            alone = singles[arm].estimate(own, last[[arm]], active[[arm]])
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
    set_state("observer", other, get_state(one))
    readings, active = world.readings(), np.ones(3, dtype=bool)
    for last in random_actions(6, seed=3):
        estimates = [kalman.estimate(readings, last, active) for kalman in (one, other)]
        assert np.array_equal(estimates[0].states, estimates[1].states)


def test_bad_arguments_are_refused_in_one_line():
    allowed = "give motor_encoders, and any of joint_encoders, strain, link_encoders: other sensors are not linear"
    for sensors in (("motor_encoders", "accelerometer"), ("strain",), "lab", ()):
        said = refusal(KalmanFilter, plant(), sensors)
        assert said.startswith("sensors: ") and allowed in said
    assert refusal(KalmanFilter, plant(), ALL, (-0.1, 0.1)).startswith("noise: -0.1 is not allowed; give")
    assert refusal(KalmanFilter, plant(), ALL, 0.1).startswith("noise: 0.1 is not allowed; give")
    assert refusal(KalmanFilter, plant(), ALL, None, 1).startswith("disturbed: 1 is not allowed; give")
