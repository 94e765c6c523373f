"""Perturbed models: parameter vectors, simulations with one perturbed entry each, and least-squares fits."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from flexman_gym.agent.controller import Plant
from flexman_gym.common.arrays import Array, BoolArray, IntArray, row_dots
from flexman_gym.common.checks import mapping, number_array
from flexman_gym.common.errors import value_error
from flexman_gym.model.friction import friction_coefficients
from flexman_gym.model.model import Model
from flexman_gym.simulation.physical_parameters import ARM, PARAMETERS, UNCERTAIN, varied_model
from flexman_gym.toolbox.controllers.internal_model import InternalModels

PARAMETER_STEP = 0.0003  # fraction of a range; perturbation; 0.03 would shift the phase by a radian in 2 s
RANGE_MARGIN = 0.35  # fraction of a range by which an estimate may exceed the range
MIN_FACTOR = 0.5  # smallest estimate / lower end of the range
FRICTION_RANGE = (0.0, 1.5)  # factors on the friction of a model; assumed range of friction without a given range
STIFFNESS_RANGE = (0.5, 1.5)  # factors on the joint stiffness of a model; assumed range without a given range
KNOWN_RANGE = 1e-3  # fraction of the value, or of 1 for the value 0; assumed width of a range of zero width


def uncertain_ranges(plant: Plant) -> Mapping[str, tuple[float, float]]:
    """Return the ranges of the uncertain parameters of a plant, with assumed ranges of joint stiffness and friction."""
    viscous, coulomb = friction_coefficients(plant.model)
    assumed = {"joint_stiffness_factor": STIFFNESS_RANGE}
    assumed |= {
        f"{name}_factor": FRICTION_RANGE
        for name, values in (("viscous_friction", viscous), ("coulomb_friction", coulomb))
        if values.any()
    }
    return assumed | dict(plant.unknown)


class UncertainParameters:
    """Uncertain parameters of an arm as a vector theta (p,), with an entry for each joint or link of a parameter.

    Args:
        model: model of the arm.
        ranges: name -> (low, high), with names as in `physical_parameters.UNCERTAIN`: in the unit of the parameter,
            or as factors of the nominal value, for each joint or link.

    Attributes:
        names: (p,) name of the physical parameter of each entry.
        joints: (p,) index of the joint or link of each entry; 0 for a parameter of the whole arm.
        scales: (p,) physical value per unit of each entry: the nominal value where the entry is a factor.
        ranges: (p, 2) range of each entry.
        mean: (p,) mean of a uniform distribution over the range.
        deviation: (p,) standard deviation of this distribution.
        step: (p,) perturbation for finite differences.
        low: (p,) smallest estimate.
        high: (p,) largest estimate.
    """

    def __init__(self, model: Model, ranges: Mapping[str, tuple[float, float]]) -> None:
        names, joints, scales, spans = [], [], [], []
        for key, span in mapping("unknown", ranges, tuple(UNCERTAIN)).items():
            low, high = number_array(f"unknown.{key}", span, (2,), "a range (low, high)")
            if not 0.0 <= low <= high:
                raise value_error(f"unknown.{key}", span, "a range (low, high) with 0 <= low <= high")
            name, row = UNCERTAIN[key], PARAMETERS[UNCERTAIN[key]]
            nominal = np.atleast_1d(row.nominal(model))
            free = ~row.fixed(model) if row.shape(model.n_joints) else np.ones(1, dtype=bool)
            entries = np.flatnonzero(free & (nominal > 0.0 if row.factor else free))
            for joint in entries:
                names.append(name)
                joints.append(int(joint))
                scales.append(float(nominal[joint]) if row.factor else 1.0)
                spans.append((low, high))
        self.ranges = np.array(spans).reshape(-1, 2)
        low, high = self.ranges.T
        width = np.where(high > low, high - low, KNOWN_RANGE * np.where(high > 0.0, high, 1.0))
        self.names, self.joints, self.scales = tuple(names), np.array(joints, dtype=np.int64), np.array(scales)
        self.mean, self.deviation, self.step = 0.5 * (low + high), width / np.sqrt(12.0), PARAMETER_STEP * width
        self.low: Array = np.maximum(low - RANGE_MARGIN * width, MIN_FACTOR * low)
        self.high: Array = high + RANGE_MARGIN * width

    def values(self, model: Model, theta: Array) -> dict[str, Array]:
        """Return the physical parameters, name -> (r, ...) in their units, for parameter vectors (r, p)."""
        result = {}
        for name in dict.fromkeys(self.names):
            row, columns = PARAMETERS[name], np.flatnonzero(np.array(self.names) == name)
            values = theta[:, columns] * self.scales[columns]
            if row.shape(model.n_joints):
                complete = np.repeat(np.asarray(row.nominal(model))[None], len(theta), axis=0)
                complete[:, self.joints[columns]] = values
                result[name] = complete
            else:
                result[name] = values[:, 0]
        return result

    def varied_model(self, model: Model, theta: Array) -> Model:
        """Return a model with the parameters of a vector (p,), see `physical_parameters.varied_model`."""
        return varied_model(model, **{name: rows[0] for name, rows in self.values(model, theta[None]).items()})

    def deviations(self, deviations: Array) -> dict[str, Array]:
        """Convert standard deviations (r, p) of theta to a mapping NAME_deviation -> (r,) or (r, entries), SI units."""
        result = {}
        for name in dict.fromkeys(self.names):
            columns = np.flatnonzero(np.array(self.names) == name)
            values = deviations[:, columns] * self.scales[columns]
            result[f"{name}_deviation"] = values[:, 0] if PARAMETERS[name].of == ARM else values
        return result


ANGLE_STEP = 1e-3  # rad; perturbation of a start angle
BATCH_ARMS = 32  # number of arms whose models are simulated together; limits the memory
DIAGONAL_OFFSET = 1e-12  # dimensionless; added to the unit diagonal of a scaled matrix against rounding
MAX_ITERATIONS = 8  # Levenberg-Marquardt iterations of a fit
MIN_DECREASE = (2.0, 0.02)  # dimensionless; predicted decrease of the cost, total and per period, that ends a fit
INITIAL_DAMPING = 1e-3  # dimensionless; damping of the first Levenberg-Marquardt step


class Prior(NamedTuple):
    """Prior distribution of a parameter vector (p,), normal and independent, within bounds.

    Attributes:
        mean: (p,) mean.
        deviation: (p,) standard deviation.
        low: (p,) lower bound.
        high: (p,) upper bound.
    """

    mean: Array
    deviation: Array
    low: Array
    high: Array

    @property
    def information(self) -> Array:
        """Information matrix (p, p) of the prior."""
        return np.diag(1.0 / self.deviation**2)

    def cost(self, theta: Array) -> Array:
        """Return the squared deviations (r,) of parameter vectors (r, p) from the mean, in standard deviations."""
        result: Array = ((self.mean - theta) ** 2 * (1.0 / self.deviation**2)).sum(axis=1)
        return result

    def clip(self, theta: Array) -> Array:
        """Return parameter vectors (r, p) clipped to the bounds."""
        return np.clip(theta, self.low, self.high)

    def constrain(self, theta: Array, change: Array, information: Array) -> Array:
        """Return the most probable changes (r, p) within the bounds, for the most probable unbounded changes (r, p).

        Entries beyond a bound are set to it, and the other entries to their conditional means.

        Args:
            theta: (r, p) parameter vectors.
            change: (r, p) most probable changes without bounds.
            information: (r, p, p) information matrices.
        """
        excess = self.clip(theta + change) - (theta + change)
        rows = np.flatnonzero((excess != 0.0).any(axis=1))
        if not len(rows):
            return change
        fixed = excess[rows] != 0.0
        matrices = np.where(fixed[:, :, None] | fixed[:, None, :], np.eye(theta.shape[1]), information[rows])
        forces = np.where(fixed, excess[rows], -row_dots(information[rows], excess[rows][:, None]))
        result = change.copy()
        result[rows] += solve_scaled(matrices, forces)
        return result


class Resimulation(NamedTuple):
    """Result of a simulation of r arms from their start, compared with the measurements.

    Attributes:
        states: (r, 1 + s, 2 d) final states of the estimated model and the s perturbed models of each arm.
        information: (r, p, p) information matrix of the measurements for theta, the Gauss-Newton matrix.
        gradient: (r, p) half the negative gradient of the cost.
        cost: (r,) sum of squared residuals, in standard deviations.
    """

    states: Array
    information: Array
    gradient: Array
    cost: Array

    def select(self, arms: BoolArray | IntArray) -> "Resimulation":
        """Return the results of the flagged arms, or of arms with the indices (r,)."""
        return Resimulation(*(values[arms] for values in self))

    def step(self, theta: Array, prior: Prior, damping: Array | float = 0.0) -> tuple[Array, Array]:
        """Return the changes (r, p) of parameter vectors (r, p) in a Levenberg-Marquardt step.

        Returns:
            The changes, and the predicted decreases (r,) of the cost and of the cost of the prior together.
        """
        precision = 1.0 / prior.deviation**2
        posterior, each = self.information.copy(), np.arange(theta.shape[1])
        posterior[:, each, each] += precision
        gradient = self.gradient + precision * (prior.mean - theta)
        damped = posterior.copy()
        damped[:, each, each] *= 1.0 + np.reshape(damping, (-1, 1))
        change = solve_scaled(damped, gradient)
        return change, (change * gradient).sum(axis=1)


class PerturbedModels:
    """Estimated model and s perturbed models of each arm, for a parameter vector theta (p,).

    Theta consists of uncertain parameters and start angles, s entries that affect the motion, of biases, which are
    added to the measurements, and of relative gain errors of strain gauges.

    Args:
        plant: plant model with method and step.
        uncertain: uncertain parameters of the arm.
        matrix: (m, 2 d) measurement matrix.
        biased: True for biases of all measurements in theta.
        gauges: (g,) indices of the measurements with a gain error in theta.
    """

    def __init__(
        self,
        plant: Plant,
        uncertain: UncertainParameters,
        matrix: Array,
        biased: bool,
        gauges: Sequence[int] | IntArray = (),
    ) -> None:
        model = self.model = plant.model
        self.models, self.uncertain, self.matrix = InternalModels(plant), uncertain, matrix
        n, count = model.n_joints, len(uncertain.names)
        self._gauges = np.array(gauges, dtype=np.int64)
        self.dynamic = count + n  # s
        self._first_gain = self.dynamic + biased * len(matrix)
        self.size = self._first_gain + len(self._gauges)  # p
        self.steps = np.concatenate([uncertain.step, np.full(n, ANGLE_STEP)])
        self._rotations = model.at_rest(np.eye(n))  # states after rotation by 1 rad, joint by joint

    def perturb(self, theta: Array, steps: Array | None = None) -> Array:
        """Return the parameter vectors (r, 1 + s, p) of all models: the estimate (r, p) and its perturbations."""
        result = np.repeat(theta[:, None], 1 + self.dynamic, axis=1)
        each = np.arange(self.dynamic)
        result[:, 1 + each, each] += self.steps if steps is None else steps
        return result

    def initial_states(self, origin: Array, theta: Array) -> Array:
        """Return the start states (r, 1 + s, 2 d) of the models.

        Args:
            origin: (r, 2 d) start states to which the rotation by the start angles in theta is added.
            theta: (r, p) parameter vectors.
        """
        angles = self.perturb(theta)[:, :, len(self.uncertain.names) : self.dynamic]
        return origin[:, None] + (angles[..., None] * self._rotations).sum(axis=2)

    def parameters(self, theta: Array) -> dict[str, Array]:
        """Return the physical parameters, name -> (r, ...) in their units, for parameter vectors (r, p)."""
        return self.uncertain.values(self.model, theta)

    def jacobian(self, states: Array, steps: Array) -> Array:
        """Return the Jacobian (r, 2 d, s) of the states with respect to the perturbed entries of theta.

        Args:
            states: (r, 1 + s, 2 d) states of the estimated model and the s perturbed models of each arm.
            steps: (r, s) perturbations of theta.
        """
        return ((states[:, 1:] - states[:, :1]) / steps[..., None]).transpose(0, 2, 1)

    def measurement_jacobian(self, states: Array, steps: Array, theta: Array) -> Array:
        """Return the Jacobian (r, m, p) of the measurements with respect to theta (r, p); see `jacobian`."""
        jacobian = self.matrix @ self.jacobian(states, steps)
        if self.size == self.dynamic:
            return jacobian
        return self._add_sensor_errors(jacobian, row_dots(self.matrix, states[:, :1]), theta)

    def read(self, states: Array, theta: Array) -> Array:
        """Return the predicted measurements (r, m) for states (r, 2 d) and parameter vectors (r, p)."""
        return self._distort(row_dots(self.matrix, states[:, None]), theta)

    def _distort(self, exact: Array, theta: Array) -> Array:
        """Return exact measurements (r, ..., m) with the gain errors and biases of parameter vectors (r, p)."""
        if self.size == self.dynamic:
            return exact
        theta = np.expand_dims(theta, tuple(range(1, exact.ndim - 1)))
        if len(self._gauges):
            exact = exact.copy()
            exact[..., self._gauges] *= 1.0 + theta[..., self._first_gain :]
        biases = theta[..., self.dynamic : self._first_gain]
        return exact + biases if biases.shape[-1] else exact

    def _add_sensor_errors(self, jacobian: Array, exact: Array, theta: Array) -> Array:
        """Return a Jacobian (r, ..., m, p) of measurements with the columns of biases and gain errors added.

        Args:
            jacobian: (r, ..., m, s) Jacobian of exact measurements.
            exact: (r, ..., m) exact measurements.
            theta: (r, p) parameter vectors.
        """
        m, gauges = len(self.matrix), self._gauges
        result = np.zeros((*jacobian.shape[:-1], self.size))
        result[..., : self.dynamic] = jacobian
        if self._first_gain > self.dynamic:
            result[..., self.dynamic : self._first_gain] = np.eye(m)
        if len(gauges):
            gains = 1.0 + np.expand_dims(theta, tuple(range(1, exact.ndim - 1)))[..., self._first_gain :]
            result[..., gauges, : self.dynamic] *= gains[..., None]
            result[..., gauges, self._first_gain + np.arange(len(gauges))] = exact[..., gauges]
        return result

    def resimulate(self, origin: Array, theta: Array, torques: Array, readings: Array, weights: Array) -> Resimulation:
        """Simulate r arms from their start over k control periods and compare them with the measurements.

        Args:
            origin: (r, 2 d) start states, see `initial_states`.
            theta: (r, p) parameter vectors.
            torques: (r, k, n) torques applied in each period, N m.
            readings: (r, k + 1, m) measurements from the start.
            weights: (r, k + 1, m) weights of the squared residuals, 1 / variance; 0 to ignore a measurement.

        Returns:
            Final states, information matrix, gradient and cost.
        """
        parts = [slice(first, first + BATCH_ARMS) for first in range(0, len(origin), BATCH_ARMS)]
        results = [self._resimulate_batch(origin[p], theta[p], torques[p], readings[p], weights[p]) for p in parts]
        return Resimulation(*(np.concatenate(each) for each in zip(*results, strict=True)))

    def _resimulate_batch(
        self, origin: Array, theta: Array, torques: Array, readings: Array, weights: Array
    ) -> Resimulation:
        arms, periods, n = torques.shape
        start = self.initial_states(origin, theta)
        models = start.shape[1]
        batch, used = self.models("resimulate", arms * models), np.arange(arms * models)
        flat = self.perturb(theta).reshape(arms * models, -1)
        batch.vary(used, **self.parameters(flat))
        batch.place(used, start.reshape(arms * models, -1))
        drives = np.zeros((arms * models, periods, n + 6))  # torques, tip force, base acceleration
        drives[:, :, :n] = np.repeat(torques, models, axis=0)
        rolled = batch.roll(drives)[0].reshape(arms, models, periods, -1)
        states = np.concatenate([start[:, :, None], rolled], axis=2)
        read = (states @ self.matrix.T).transpose(0, 2, 3, 1)  # (r, k + 1, m, 1 + s)
        jacobian = (read[..., 1:] - read[..., :1]) / self.steps
        if self.size > self.dynamic:
            jacobian = self._add_sensor_errors(jacobian, read[..., 0], theta)
        error = readings - self._distort(read[..., 0], theta)
        root = np.sqrt(weights)
        jacobian = (jacobian * root[..., None]).reshape(arms, -1, self.size)
        error = (error * root).reshape(arms, -1)
        across = jacobian.transpose(0, 2, 1)
        gradient = row_dots(across, error[:, None])
        return Resimulation(states[:, :, -1].copy(), across @ jacobian, gradient, row_dots(error, error))

    def fit(
        self, origin: Array, theta: Array, prior: Prior, data: tuple[Array, Array, Array]
    ) -> tuple[Array, Resimulation]:
        """Fit the parameter vectors of r arms to all measurements by a few Levenberg-Marquardt iterations.

        Args:
            origin: (r, 2 d) start states, see `initial_states`.
            theta: (r, p) initial guess.
            prior: prior of theta.
            data: torques, measurements and weights, see `resimulate`.

        Returns:
            Fitted parameter vectors (r, p) and the simulation of the arms with these parameters.
        """
        rows, damping = np.arange(len(origin)), np.full(len(origin), INITIAL_DAMPING)
        best, result = theta.copy(), self.resimulate(origin, theta, *data)
        least = np.nan_to_num(result.cost + prior.cost(theta), nan=np.inf)
        for _ in range(MAX_ITERATIONS - 1):
            change, decrease = result.select(rows).step(best[rows], prior, damping[rows])
            unfinished = decrease >= max(MIN_DECREASE[0], MIN_DECREASE[1] * data[0].shape[1])
            rows, candidate = rows[unfinished], prior.clip(best[rows] + change)[unfinished]
            if not len(rows):
                break
            simulation = self.resimulate(origin[rows], candidate, *(each[rows] for each in data))
            cost = np.nan_to_num(simulation.cost + prior.cost(candidate), nan=np.inf)
            better = cost < least[rows]
            improved, damping[rows] = rows[better], np.where(better, 0.3, 20.0) * damping[rows]
            least[improved], best[improved] = cost[better], candidate[better]
            for values, new in zip(result, simulation, strict=True):
                values[improved] = new[better]
        return best, result


def solve_scaled(matrices: Array, vectors: Array) -> Array:
    """Return the solutions (r, p) of matrices (r, p, p) x = vectors (r, p), after scaling; 0 for non-finite systems."""
    finite: BoolArray = np.logical_and(np.isfinite(matrices).all(axis=(1, 2)), np.isfinite(vectors).all(axis=1))
    matrix, scale = _unit_diagonal(np.where(finite[:, None, None], matrices, np.eye(matrices.shape[1])))
    result: Array = (
        scale * np.linalg.solve(matrix, (scale * np.where(finite[:, None], vectors, 0.0))[..., None])[..., 0]
    )
    return result


def standard_deviations(information: Array) -> Array:
    """Return standard deviations (r, p) for information matrices (r, p, p); infinite for non-finite matrices."""
    finite: BoolArray = np.all(np.isfinite(information), axis=(1, 2))
    matrix, scale = _unit_diagonal(np.where(finite[:, None, None], information, np.eye(information.shape[1])))
    variances = np.diagonal(np.linalg.inv(matrix), axis1=1, axis2=2)
    return np.where(finite[:, None], scale * np.sqrt(np.maximum(variances, 0.0)), np.inf)


def covariance_factors(information: Array) -> Array:
    """Return Cholesky factors L (r, p, p) of the covariances L L^T for information matrices (r, p, p).

    They are inverses of the factors U^T of the scaled information U U^T, as an inverse of a nearly singular matrix need
    not be positive definite after rounding. Factors of non-finite matrices are 0.
    """
    finite: BoolArray = np.all(np.isfinite(information), axis=(1, 2))
    matrix, scale = _unit_diagonal(np.where(finite[:, None, None], information, np.eye(information.shape[1])))
    upper = np.linalg.cholesky(matrix[:, ::-1, ::-1])[:, ::-1, ::-1]
    result: Array = scale[:, :, None] * np.linalg.inv(upper).transpose(0, 2, 1)
    return np.where(finite[:, None, None], result, 0.0)


def _unit_diagonal(matrices: Array) -> tuple[Array, Array]:
    """Return matrices (r, p, p) scaled to unit diagonals, and the scales (r, p)."""
    each = np.arange(matrices.shape[1])
    scale = 1.0 / np.sqrt(matrices[:, each, each])
    result = matrices * scale[:, :, None] * scale[:, None]
    result[:, each, each] = 1.0 + DIAGONAL_OFFSET
    return result, scale
