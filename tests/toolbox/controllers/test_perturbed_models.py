"""Perturbed models and uncertain parameters, against independent simulations and sums."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.physical_parameters import varied_model
from flexman_gym.toolbox.controllers.observers.observer import MeasurementModel
from flexman_gym.toolbox.controllers.observers.perturbed_models import (
    PARAMETER_STEP,
    RANGE_MARGIN,
    PerturbedModels,
    Prior,
    Resimulation,
    UncertainParameters,
    covariance_factors,
    solve_scaled,
)

from oracles.assertions import refusal
from oracles.observed_arms import small_plant

RANGES = {"payload_mass": (0.0, 4.0), "joint_stiffness_factor": (0.7, 1.3), "joint_damping": (0.0, 2.0)}


def model(**changes):
    """The planar arm, whose second joint may be another one."""
    arm = fm.catalog.vertical_2r()
    return fm.build_model(replace(arm, joints=[arm.joints[0], replace(arm.joints[1], **changes)]), 1, 1)


def test_numbers_are_parameters_in_their_units():
    """Masses and dampings as they are, stiffness as parts of the nominal one of each joint."""
    own = model(stiffness=500.0)
    unknowns = UncertainParameters(own, RANGES)
    assert unknowns.names == ("payload_mass", *["joint_stiffness"] * 2, *["joint_damping"] * 2)
    assert unknowns.joints.tolist() == [0, 0, 1, 0, 1]
    values = unknowns.values(own, np.array([[3.0, 0.8, 1.1, 0.2, 0.4], [1.0, 1.0, 1.0, 0.5, 0.6]]))
    springs = own.constants.joint_stiffness
    assert values["payload_mass"].tolist() == [3.0, 1.0]
    assert values["joint_stiffness"] == pytest.approx(np.array([[0.8, 1.1], [1.0, 1.0]]) * springs)
    assert values["joint_damping"].tolist() == [[0.2, 0.4], [0.5, 0.6]]


def test_what_the_model_has_no_coordinate_for_stays_as_it_is():
    own = model(stiffness=None, damping=0.0)
    unknowns = UncertainParameters(own, RANGES)
    assert unknowns.names == ("payload_mass", "joint_stiffness", "joint_damping")
    values = unknowns.values(own, np.array([[1.0, 0.5, 0.3]]))
    assert values["joint_stiffness"][0] == pytest.approx([0.5, 1.0] * own.constants.joint_stiffness)
    assert values["joint_damping"][0].tolist() == [0.3, own.constants.joint_damping[1]]
    rubbing = model(viscous_friction=0.2)
    parts = UncertainParameters(rubbing, {"viscous_friction_factor": (0.5, 1.5)})
    assert parts.joints.tolist() == [1], "a factor on nothing says nothing"
    assert parts.values(rubbing, np.array([[1.5]]))["viscous_friction"] == pytest.approx(np.array([[0.0, 0.3]]))


def test_beforehand_all_of_a_range_is_as_likely():
    """Mean and deviation are those of numbers drawn from it; an estimate may leave it a little, not below 0."""
    unknowns = UncertainParameters(model(), RANGES)
    drawn = np.random.default_rng(0).uniform(0.7, 1.3, 100_000)
    assert unknowns.mean[1] == pytest.approx(drawn.mean(), abs=3e-3)
    assert unknowns.deviation[1] == pytest.approx(drawn.std(), rel=5e-3)
    assert unknowns.step[[0, 1]] == pytest.approx([4.0 * PARAMETER_STEP, 0.6 * PARAMETER_STEP])
    assert unknowns.low[[0, 1]] == pytest.approx([0.0, 0.7 - 0.6 * RANGE_MARGIN])
    assert unknowns.high[[0, 1]] == pytest.approx([4.0 + 4.0 * RANGE_MARGIN, 1.3 + 0.6 * RANGE_MARGIN])


def test_nothing_unknown_is_no_number():
    own = model()
    unknowns = UncertainParameters(own, {})
    assert unknowns.values(own, np.zeros((3, 0))) == {} and unknowns.mean.shape == (0,)


def test_a_range_has_the_name_and_the_unit_that_it_has_in_a_randomisation():
    """A factor is called one, and the parameter that follows from it has its own unit."""
    own = model(stiffness=500.0)
    found = UncertainParameters(own, {"joint_stiffness_factor": (0.5, 1.5), "link_stiffness_factor": (0.5, 1.5)})
    values = found.values(own, np.full((1, 4), 0.5))
    assert values["joint_stiffness"][0] == pytest.approx(0.5 * own.constants.joint_stiffness)
    assert values["link_stiffness_factor"].tolist() == [[0.5, 0.5]]


@pytest.mark.parametrize("span", [(0.13, 0.13), (0.0, 0.0)])
def test_a_range_of_one_number_is_a_number_that_is_known(span):
    """To a thousandth, or to a gram."""
    unknowns = UncertainParameters(model(), {"payload_mass": span})
    assert unknowns.mean == pytest.approx(span[:1]) and 0.0 < unknowns.deviation[0] < 1e-3
    assert 0.0 <= unknowns.low[0] <= span[0] < unknowns.high[0] and unknowns.step[0] > 0.0


@pytest.mark.parametrize(
    ("ranges", "line"),
    [
        ({"mass": (0.0, 1.0)}, "unknown: 'mass' is not allowed; give one of payload_mass, joint_stiffness_factor"),
        ({"payload_mass": 3.0}, "unknown.payload_mass: 3.0 is not allowed; give a range (low, high)"),
        (
            {"payload_mass": (2.0, 1.0)},
            "unknown.payload_mass: (2.0, 1.0) is not allowed; give a range (low, high) with",
        ),
        ({"payload_mass": (-1.0, 1.0)}, "unknown.payload_mass: (-1.0, 1.0) is not allowed; give a range (low, high) w"),
        ({"joint_stiffness_factor": (0.0, np.inf)}, "unknown.joint_stiffness_factor: (0.0, inf) is not allowed"),
    ],
)
def test_what_is_no_range_is_refused_in_one_line(ranges, line):
    said = refusal(UncertainParameters, model(), ranges)
    assert said.startswith(line), said


UNKNOWN = {"payload_mass": (0.0, 0.2), "joint_stiffness_factor": (0.7, 1.3), "link_stiffness_factor": (0.7, 1.3)}
PERIODS, ARMS = 12, 3
PLANT = small_plant("FlexPlanar-v0", UNKNOWN)
SENSORS = ("motor_encoders", "joint_encoders", "strain")


def made(biased=False):
    unknowns = UncertainParameters(PLANT.model, PLANT.unknown)
    read = MeasurementModel(PLANT, SENSORS)
    return PerturbedModels(PLANT, unknowns, read.matrix, biased), read


def numbers_of(trials, seed=0):
    """Numbers (ARMS, p) that are not where the prior has its mean."""
    random, unknowns = np.random.default_rng(seed), trials.uncertain
    result = np.zeros((ARMS, trials.size))
    known = len(unknowns.names)
    result[:, :known] = unknowns.mean + unknowns.deviation * random.uniform(-1.0, 1.0, (ARMS, known))
    result[:, known:] = 2e-3 * random.standard_normal((ARMS, trials.size - known))
    return result


def torques_of(seed=1):
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (ARMS, PERIODS, 2)) * PLANT.torque_limit * 0.3


ORIGIN = PLANT.model.at_rest(np.random.default_rng(2).uniform(-0.6, 0.6, (ARMS, 2)))


def simulated(trials, numbers, torques, origin):
    """Readings (T + 1, m) of one arm with numbers (p,) by the model with its parameters, alone."""
    known = len(trials.uncertain.names)
    values = trials.uncertain.values(PLANT.model, numbers[None])
    model = varied_model(PLANT.model, **{name: each[0] for name, each in values.items()})
    alone, start = Batch(model, *PLANT.integration, PLANT.period), origin.copy()
    for joint in range(2):  # both sides of the spring turn
        start[[joint, PLANT.model.motor_columns[joint]]] += numbers[known + joint]
    alone.reset(np.array([0]), start[None])
    states = [start]
    for torque in torques:
        alone.step(np.concatenate([torque, np.zeros(6)])[None])
        states.append(alone.state[0].copy())
    biases = numbers[trials.dynamic :] if trials.size > trials.dynamic else 0.0
    return np.array(states) @ trials.matrix.T + biases


@pytest.mark.parametrize("biased", [False, True])
def test_what_a_sweep_says_is_a_sum_over_readings_of_arms_simulated_one_by_one(biased):
    """Slopes by each number as differences over its step; information, gradient and cost by loops."""
    trials, read = made(biased)
    numbers, torques, random = numbers_of(trials), torques_of(), np.random.default_rng(3)
    readings = random.standard_normal((ARMS, PERIODS + 1, len(read.ranges))) * 0.01 * read.ranges
    weights = random.uniform(0.5, 2.0, readings.shape) / read.deviations**2
    weights[:, 0, :2] = 0.0
    sweep = trials.resimulate(ORIGIN, numbers, torques, readings, weights)
    steps = np.concatenate([trials.steps, np.ones(trials.size - trials.dynamic)])
    for arm in range(ARMS):
        base = simulated(trials, numbers[arm], torques[arm], ORIGIN[arm])
        slopes = [
            (simulated(trials, numbers[arm] + change, torques[arm], ORIGIN[arm]) - base) / change.sum()
            for change in np.diag(steps)
        ]
        columns, error = np.array(slopes).reshape(trials.size, -1), (readings[arm] - base).ravel()
        information, gradient, cost = np.zeros((trials.size,) * 2), np.zeros(trials.size), 0.0
        for column, wrong, weight in zip(columns.T, error, weights[arm].ravel(), strict=True):
            information += weight * np.outer(column, column)
            gradient += weight * column * wrong
            cost += weight * wrong**2
        size = np.sqrt(np.diag(information))
        assert sweep.information[arm] / np.outer(size, size) == pytest.approx(
            information / np.outer(size, size), abs=1e-6
        )
        assert sweep.gradient[arm] / size == pytest.approx(gradient / size, rel=1e-6, abs=1e-6 * np.sqrt(cost))
        assert sweep.cost[arm] == pytest.approx(cost, rel=1e-8)
        assert trials.matrix @ sweep.states[arm, 0] == pytest.approx(
            base[-1] - (numbers[arm, trials.dynamic :] if biased else 0.0), abs=1e-9
        )


def test_slopes_of_the_trials_are_those_of_central_differences():
    """Of the readings at the end, by central ones with other steps."""
    trials, read = made()
    numbers, torques = numbers_of(trials), torques_of()
    readings = np.zeros((ARMS, PERIODS + 1, len(read.ranges)))
    sweep = trials.resimulate(ORIGIN, numbers, torques, readings, np.ones_like(readings))
    slopes = trials.measurement_jacobian(sweep.states, np.tile(trials.steps, (ARMS, 1)), numbers)
    for number in range(trials.size):
        change = np.zeros(trials.size)
        change[number] = 3.0 * trials.steps[number]
        fine = [simulated(trials, numbers[0] + sign * change, torques[0], ORIGIN[0])[-1] for sign in (1.0, -1.0)]
        expected = (fine[0] - fine[1]) / (6.0 * trials.steps[number])
        scale = np.abs(slopes[0]).max(axis=1)
        assert (np.abs(slopes[0, :, number] - expected) <= 2e-3 * scale).all(), number


@pytest.mark.parametrize("biased", [False, True])
def test_a_fit_finds_the_numbers_from_readings_without_noise(biased):
    trials, read = made(biased)
    true, torques = numbers_of(trials, seed=5), np.tile(torques_of(), (1, 5, 1))
    readings = np.array([simulated(trials, *each) for each in zip(true, torques, ORIGIN, strict=True)])
    deviation = np.concatenate([trials.uncertain.deviation, np.full(trials.size - len(trials.uncertain.names), 1e-2)])
    mean = np.concatenate([trials.uncertain.mean, np.zeros(trials.size - len(trials.uncertain.names))])
    prior = Prior(mean, 1e4 * deviation, mean - 10.0 * deviation, mean + 10.0 * deviation)
    prior.low[0] = 0.0
    weights = np.broadcast_to((1e-4 * read.deviations) ** -2.0, readings.shape)
    found = np.tile(mean, (ARMS, 1))
    for _ in range(5):
        found, sweep = trials.fit(ORIGIN, found, prior, (torques, readings, weights))
    found += sweep.step(found, prior)[0]
    error = np.abs(found - true)
    assert error[:, : len(trials.uncertain.names)].max() < 1e-6
    assert error.max() < (1e-6 if not biased else 1e-5)


def test_a_fit_stays_between_its_bounds_and_never_gets_worse():
    trials, read = made()
    true, torques = numbers_of(trials, seed=6), torques_of()
    readings = np.array([simulated(trials, *each) for each in zip(true, torques, ORIGIN, strict=True)])
    mean = np.concatenate([trials.uncertain.mean, np.zeros(2)])
    spread = np.concatenate([trials.uncertain.deviation, np.full(2, 1e-3)])
    prior = Prior(mean, spread, mean - 0.1 * spread, mean + 0.1 * spread)
    weights = np.broadcast_to(read.deviations**-2.0, readings.shape)
    start = np.tile(mean, (ARMS, 1))
    found, sweep = trials.fit(ORIGIN, start, prior, (torques, readings, weights))
    assert (found >= prior.low).all() and (found <= prior.high).all()
    assert (sweep.cost < trials.resimulate(ORIGIN, start, torques, readings, weights).cost).all()


def test_an_arm_is_fitted_as_alone_whatever_others_need():
    """One that begins where it ends, beside one that is far off: to the bit."""
    trials, read = made()
    true, torques, random = numbers_of(trials, seed=5), torques_of(), np.random.default_rng(0)
    readings = np.array([simulated(trials, *each) for each in zip(true, torques, ORIGIN, strict=True)])
    readings += read.deviations * random.standard_normal(readings.shape)
    mean = np.concatenate([trials.uncertain.mean, np.zeros(2)])
    spread = np.concatenate([trials.uncertain.deviation, np.full(2, 1e-2)])
    prior = Prior(mean, spread, mean - 10.0 * spread, mean + 10.0 * spread)
    weights = np.broadcast_to(read.deviations**-2.0, readings.shape)
    start = np.vstack([true[:2], mean[None]])
    found, _ = trials.fit(ORIGIN, start, prior, (torques, readings, weights))
    for arm in range(3):
        data = tuple(each[arm : arm + 1] for each in (torques, readings, weights))
        alone, _ = trials.fit(ORIGIN[arm : arm + 1], start[arm : arm + 1], prior, data)
        assert np.array_equal(found[arm], alone[0]), arm


def test_many_arms_are_swept_as_each_alone():
    """More than are rolled at once, to the bit."""
    trials, _ = made()
    many = 35
    random = np.random.default_rng(0)
    origin = PLANT.model.at_rest(random.uniform(-0.5, 0.5, (many, 2)))
    numbers = np.tile(numbers_of(trials)[:1], (many, 1)) + 1e-3 * random.uniform(0.0, 1.0, (many, 1))
    torques = random.uniform(-2.0, 2.0, (many, 3, 2))
    readings = random.standard_normal((many, 4, len(trials.matrix)))
    data = origin, numbers, torques, readings, np.ones_like(readings)
    together = trials.resimulate(*data)
    for arm in (0, 31, 34):
        alone = trials.resimulate(*(each[arm : arm + 1] for each in data))
        for one, other in zip(together, alone, strict=True):
            assert np.array_equal(one[arm], other[0])


def test_a_step_is_that_of_the_normal_equations_with_the_prior():
    random = np.random.default_rng(0)
    slopes, errors = random.standard_normal((2, 30, 4)), random.standard_normal((2, 30))
    sweep = _sweep(slopes, errors)
    numbers = random.standard_normal((2, 4))
    prior = Prior(random.standard_normal(4), np.array([0.1, 1.0, 10.0, 2.0]), np.full(4, -9.0), np.full(4, 9.0))
    change, fall = sweep.step(numbers, prior)
    for arm in range(2):
        rows = np.vstack([slopes[arm], np.diag(1.0 / prior.deviation)])
        wanted = np.concatenate([errors[arm], (prior.mean - numbers[arm]) / prior.deviation])
        best, left, *_ = np.linalg.lstsq(rows, wanted, rcond=None)
        assert change[arm] == pytest.approx(best, rel=1e-9)
        assert fall[arm] == pytest.approx(wanted @ wanted - left[0], rel=1e-9), "by how much the cost falls"
    assert (np.abs(sweep.step(numbers, prior, 10.0)[0]).max(axis=1) < np.abs(change).max(axis=1)).all()


def _sweep(slopes, errors):
    across = slopes.transpose(0, 2, 1)
    gradient = (across @ errors[..., None])[..., 0]
    return Resimulation(np.zeros(0), across @ slopes, gradient, (errors**2).sum(axis=1))


def test_equations_in_units_far_apart_are_solved():
    """Numbers from 1e-8 to 1e8, and those that are not finite, which change nothing."""
    random = np.random.default_rng(1)
    root, scale = random.standard_normal((3, 5, 5)), 10.0 ** np.array([-8.0, -3.0, 0.0, 4.0, 8.0])
    matrices = (root @ root.transpose(0, 2, 1) + np.eye(5)) * np.outer(scale, scale)
    expected = random.standard_normal((3, 5)) / scale
    vectors = (matrices @ expected[..., None])[..., 0]
    assert solve_scaled(matrices, vectors) * scale == pytest.approx(expected * scale, rel=1e-7)
    matrices[1, 0, 0] = np.nan
    vectors[2, 1] = np.inf
    result = solve_scaled(matrices, vectors)
    assert result[0] * scale == pytest.approx(expected[0] * scale, rel=1e-7) and not result[1:].any()


def test_factors_of_covariances_are_those_of_the_inverse():
    random = np.random.default_rng(1)
    root, scale = random.standard_normal((3, 5, 5)), 10.0 ** np.array([-8.0, -3.0, 0.0, 4.0, 8.0])
    information = (root @ root.transpose(0, 2, 1) + np.eye(5)) * np.outer(scale, scale)
    factors = covariance_factors(information)
    assert factors[:, 0, 1:].any() == 0 and (np.diagonal(factors, axis1=1, axis2=2) > 0.0).all(), "lower triangles"
    product = (factors @ factors.transpose(0, 2, 1)) @ information
    assert product * scale[:, None] / scale == pytest.approx(np.tile(np.eye(5), (3, 1, 1)), abs=1e-6)
    information[1, 0, 0] = np.nan
    again = covariance_factors(information)
    assert not again[1].any() and np.array_equal(again[[0, 2]], factors[[0, 2]])


def test_factors_exist_where_measurements_determine_few_combinations_of_parameters():
    """By the identity of Woodbury; the offset of the diagonal limits the accuracy."""
    jacobian = np.random.default_rng(0).standard_normal((12, 3))
    for weight, error in ((1e4, 1e-6), (1e8, 1e-2), (1e14, 1.0)):
        information = np.eye(12) + weight * jacobian @ jacobian.T
        exact = np.eye(12) - jacobian @ np.linalg.solve(np.eye(3) / weight + jacobian.T @ jacobian, jacobian.T)
        factors = covariance_factors(information[None])[0]
        assert factors @ factors.T == pytest.approx(exact, abs=error)


def test_bounded_changes_minimise_the_cost_within_the_bounds():
    """An entry beyond its bound stays at it, and the gradient of the quadratic cost with respect to the others is 0."""
    random = np.random.default_rng(5)
    prior = Prior(np.zeros(3), np.ones(3), np.array([0.0, -9.0, -9.0]), np.full(3, 9.0))
    root = random.standard_normal((2, 3, 3))
    information = root @ root.mT + np.eye(3)
    theta, change = np.full((2, 3), 0.5), np.array([[-2.0, 0.3, 0.4], [0.1, 0.3, -0.2]])
    bounded = prior.constrain(theta, change, information)
    assert bounded[0, 0] == pytest.approx(-0.5), "at the bound"
    gradient = information[0] @ (bounded[0] - change[0])
    assert gradient[1:] == pytest.approx(np.zeros(2), abs=1e-9) and gradient[0] > 0.1
    assert np.array_equal(bounded[1], change[1]), "within the bounds nothing changes"
