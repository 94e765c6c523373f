"""Extended Kalman filter with the simulator as its model, and the Riccati recursion of its covariance."""

from collections.abc import Sequence

import numpy as np

from flexman_gym.agent.controller import EpisodeInfo, Plant, Readings
from flexman_gym.common.arrays import Array, BoolArray, IntArray, Vector, pad_rows, row_dots
from flexman_gym.common.checks import flag, non_negative, vector
from flexman_gym.common.errors import value_error
from flexman_gym.model.linearization import LINEAR_SENSORS
from flexman_gym.model.statics import holding_torques, rest_state
from flexman_gym.toolbox.controllers.internal_model import DelayCompensation, DiscreteJacobians, InternalModels
from flexman_gym.toolbox.controllers.observers.observer import MAX_BIAS, Estimate, MeasurementModel, default_sensors

MAX_DOUBLINGS = 20  # number of doublings, for 2^20 periods, about a million
SMALL_POWER = 1e-8  # entry of a power of the transition matrix whose square is below a rounding error
VARIANCE_TOLERANCE = 1e-6  # relative growth of a variance in the last doubling above which it counts as infinite


def time_update(covariance: Array, transition: Array, noise: Array) -> Array:
    """Return covariances (..., s, s) after a period, for state matrices and process noise covariances (..., s, s)."""
    return _symmetric_part(transition @ covariance @ transition.mT + noise)


def measurement_update(covariance: Array, matrix: Array, variances: Array) -> tuple[Array, Array]:
    """Return Kalman gains (..., s, m) and the updated covariances (..., s, s).

    Kalman, Journal of Basic Engineering 82 (1960), 35, in Joseph's form, which stays positive semidefinite under
    rounding.

    Args:
        covariance: (..., s, s) covariances before the measurement.
        matrix: (m, s) measurement matrix.
        variances: (m,) variances of the measurement noise.
    """
    across = matrix @ covariance
    gain: Array = np.asarray(np.linalg.solve(across @ matrix.T + np.diag(variances), across), dtype=float).mT
    complement = np.eye(matrix.shape[1]) - gain @ matrix
    return gain, _symmetric_part(complement @ covariance @ complement.mT + (gain * variances) @ gain.mT)


def stationary_covariance(transition: Array, noise: Array, matrix: Array, variances: Array) -> Array:
    """Return the stationary covariances (..., s, s) before a measurement; entries of unobservable states are infinite.

    Arguments as in `time_update` and `measurement_update`.
    """
    result, before = late_covariances(transition, noise, matrix, variances)
    now, earlier = (np.diagonal(each, axis1=-2, axis2=-1) for each in (result, before))
    unbounded = now > (1.0 + VARIANCE_TOLERANCE) * earlier
    return np.where(unbounded[..., None] | unbounded[..., None, :], np.inf, result)


def late_covariances(transition: Array, noise: Array, matrix: Array, variances: Array) -> tuple[Array, Array]:
    """Return the covariances (..., s, s) after 2^MAX_DOUBLINGS periods, and after half as many.

    Each iteration of the doubling algorithm doubles the number of periods and needs no eigenvalues (Anderson,
    International Journal of Control 28, 1978, 295). Arguments as in `stationary_covariance`.
    """
    alpha, information, result = transition.mT, (matrix.T / variances) @ matrix, noise
    before, eye = result, np.eye(matrix.shape[1])
    for _ in range(MAX_DOUBLINGS):
        before = result
        solved = np.linalg.solve(
            eye + information @ result, np.concatenate([alpha, np.broadcast_to(information, alpha.shape)], -1)
        )
        size = len(eye)
        product, weighted = solved[..., :size], solved[..., size:]
        result = _symmetric_part(result + alpha.mT @ result @ product)
        if np.abs(alpha).max() < SMALL_POWER and np.array_equal(result, before):  # what follows changes no digit
            break
        information, alpha = _symmetric_part(information + alpha @ weighted @ alpha.mT), alpha @ product
    return result, before


def _symmetric_part(matrix: Array) -> Array:
    """Return the symmetric parts of matrices (..., s, s)."""
    result: Array = 0.5 * (matrix + matrix.mT)
    return result


TORQUE_NOISE = 0.005  # fraction of the torque limits; standard deviation of random torques in each period
FORCE_NOISE = 0.005  # fraction of the force scale; standard deviation of random tip forces in each period
MISMATCH_FORCE_NOISE = 0.03  # replaces FORCE_NOISE for uncertain plants, whose model errors act like forces
OFFSET_DEVIATION = 0.1  # fraction of the torque limits; initial standard deviation of a constant torque
OFFSET_DRIFT = 0.05  # fraction of the torque limits, s^(-1/2); random walk of a constant torque
BIAS_TIME_CONSTANT = 30.0  # s; correlation time of a measurement bias (first-order Markov process)
RELINEARISATION_INTERVAL = 5  # control periods between two evaluations of the Jacobians


class KalmanFilter:
    """Extended Kalman filter: the simulator predicts the state, and innovations correct it.

    The covariance follows the Jacobians of the simulated motion; its initial value is the stationary covariance at
    rest. Process noise consists of random torques on the motors and forces on the tip. The state may be augmented by
    constant torques on the motors, which a controller then compensates (integral action), and by biases of measurements
    (Anderson and Moore, Optimal Filtering, 1979, chapters 3, 8 and 9).

    The arm starts at rest at the measured motor angles. For a range of delays, the mean delay is assumed.

    Args:
        plant: plant model with the delay of the torques and the noise of the instruments.
        sensors: see `MeasurementModel`; None for all in `model.linearization.LINEAR_SENSORS`, or the link encoders of a
            plant with these.
        noise: standard deviations of the random torques, as a fraction of the torque limits, and of the tip forces, as
            a fraction of the force that the strongest motor balances at full reach. None for 0.005 and 0.005, or 0.005
            and 0.03 for a plant with uncertain parameters, and in addition the plant's `tip_force`.
        disturbed: True to estimate constant torques on the motors.
        biased: True to estimate biases of the measurements, up to 0.5 % of their ranges.
        fixed: True for the stationary gain at the goal throughout an episode; faster, for arms near their goal.

    Attributes:
        delay: assumed delay of the torques, control periods.
        quantities: names of the measured quantities in the order of the measurement vector.
        states: (b, s) estimates after the last measurement: state, constant torques (N m) and biases.
        covariance: (b, s, s) error covariances of these estimates; the initial ones with a fixed gain.
    """

    state_fields = ("states", "covariance", "_transition", "_noise", "_prediction", "_ages")

    def __init__(
        self,
        plant: Plant,
        sensors: Sequence[str] | None = None,
        noise: Vector | None = None,
        disturbed: bool = False,
        biased: bool = False,
        fixed: bool = False,
    ) -> None:
        sensors = default_sensors(plant, tuple(LINEAR_SENSORS)) if sensors is None else sensors
        self._instruments = instruments = MeasurementModel(plant, sensors)
        self.sensors, self._plant, self._jacobians = tuple(sensors), plant, DiscreteJacobians(plant)
        self.quantities = instruments.names
        self._prediction, self._models = DelayCompensation(plant), InternalModels(plant)
        self._disturbed, self._biased, self._fixed = (
            flag(name, value) for name, value in (("disturbed", disturbed), ("biased", biased), ("fixed", fixed))
        )
        n, limits, period = plant.model.n_joints, np.array(plant.torque_limit), plant.period
        self.delay, self._size, self._limits = (sum(plant.delay) + 1) // 2, 2 * plant.model.n_dof, limits
        default = (TORQUE_NOISE, MISMATCH_FORCE_NOISE if plant.unknown else FORCE_NOISE)
        fractions = default if noise is None else [non_negative("noise", each) for each in vector("noise", noise, 2)]
        self._forces = (np.repeat(fractions, (n, 3)) * self._jacobians.scales) ** 2
        if noise is None:
            self._forces[n:] += plant.tip_force**2
        self._variances, motors, m = instruments.deviations**2, self._disturbed * n, len(instruments.ranges)
        self._offsets = slice(self._size, self._size + motors)
        biases = np.eye(m, self._biased * m)
        self._matrix = np.hstack([instruments.matrix, np.zeros((m, motors)), biases])
        bias, decay = (MAX_BIAS * biases.T @ instruments.ranges) ** 2 / 3.0, np.exp(-period / BIAS_TIME_CONSTANT)
        self._decay = np.append(np.ones(motors), np.full(len(bias), decay))  # factors in a period
        self._drift = np.append((OFFSET_DRIFT * limits[:motors]) ** 2 * period, (1.0 - decay**2) * bias)
        self._initial_variance = np.append((OFFSET_DEVIATION * limits[:motors]) ** 2, bias)
        self._allocate()

    def _allocate(self) -> None:
        """Create the arrays, for zero arms."""
        m, s = self._matrix.shape
        self.states = np.zeros((0, s))
        self.covariance, self._transition, self._noise = (np.zeros((0, s, s)) for _ in range(3))
        self._ages, self._gain = np.zeros(0, dtype=np.int64), np.zeros((0, s, m))
        self._prepared = np.zeros(0, dtype=bool)  # flags of arms with a prediction for this control period

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes; arguments as in `Controller.reset`.

        Raises:
            ValueError: with a fixed gain, for sensors from which the state is not observable.
        """
        for name in ("states", "covariance", "_transition", "_noise", "_ages", "_gain", "_prepared"):
            setattr(self, name, pad_rows(getattr(self, name), count))
        self._prediction.reset(arms, count)
        self._ages[arms], self.states[arms], self._prepared[arms] = 0, 0.0, False
        if self._fixed:
            covariance = self._stationary(*self._system(*self._rest(episode.goal))[:2], slice(None))
            self._gain[arms] = measurement_update(covariance, self._matrix, self._variances)[0]

    def linear(self, goal: Array) -> dict[str, Array]:
        """Return the linear filter with a fixed gain about motor angles (n,) rad at rest.

        For deviations x from `rest` and u from `holding`: x = A x + B u predicts a period, and x = x + L (y - C x)
        corrects the prediction by measurements y relative to C rest.

        Returns:
            A (2 d, 2 d), B (2 d, n), C (m, 2 d), L (2 d, m), and `rest` (2 d,), `holding` (n,) N m.

        Raises:
            ValueError: for a filter with delay, constant torques or biases, and sensors that do not observe the state.
        """
        if self._disturbed or self._biased or self.delay:
            raise value_error("lqg", "a filter with a delay, disturbed or biased", "one without, for a linear filter")
        rest, holding = self._rest(goal[None])
        transition, noise, _ = self._system(rest, holding)
        covariance = self._stationary(transition, noise, slice(None))
        gain = measurement_update(covariance, self._matrix, self._variances)[0][0]
        inputs = self._jacobians(rest, holding)[0][0, :, self._size : self._size + len(goal)]
        return {"A": transition[0], "B": inputs, "C": self._matrix, "L": gain, "rest": rest[0], "holding": holding[0]}

    def _rest(self, postures: Array) -> tuple[Array, Array]:
        """Return the equilibrium states (r, 2 d) at motor angles (r, n) rad, and the holding torques (r, n), N m."""
        model = self._plant.model
        return rest_state(model, postures), np.array([holding_torques(model, each) for each in postures])

    def _system(self, states: Array, torques: Array) -> tuple[Array, Array, BoolArray]:
        """Return state matrix and noise covariance (r, s, s) of the augmented state, and flags (r,) of success."""
        jacobians, valid = self._jacobians(states, torques)
        size, count, s = self._size, len(states), self._matrix.shape[1]
        transition, noise, inputs = np.zeros((count, s, s)), np.zeros((count, s, s)), jacobians[..., size:]
        transition[:, :size, :size] = jacobians[..., :size]
        transition[:, :size, self._offsets] = inputs[..., : self._offsets.stop - size]
        noise[:, :size, :size] = (inputs * self._forces) @ inputs.mT
        each = np.arange(size, s)
        transition[:, each, each], noise[:, each, each] = self._decay, self._drift
        return transition, noise, valid

    def _stationary(self, transition: Array, noise: Array, part: slice) -> Array:
        """Return the stationary covariance, before a measurement, of a part of the augmented state."""
        result = stationary_covariance(
            transition[:, part, part], noise[:, part, part], self._matrix[:, part], self._variances
        )
        if not np.isfinite(result).all():
            raise value_error("sensors", self.sensors, "sensors from which the state is observable")
        return result

    def estimate(self, readings: Readings, applied: Array, active: BoolArray) -> Estimate:
        """Return the estimate of this control period; arguments as in `Controller.act`.

        Raises:
            ValueError: for sensors from which the state is not observable.
        """
        now = self._instruments.read(readings)
        new, running = (np.flatnonzero(active & flags) for flags in (self._ages == 0, self._ages > 0))
        if len(new):
            self._begin(new, now[new])
        if len(running):
            self.prepare(applied, active)
            self._correct(running, now[running])
        self._ages += active
        self._prepared &= ~active
        states, arms = self.states[:, : self._size].copy(), np.flatnonzero(active)
        delays, offset = np.full(len(states), self.delay), self._offset(np.arange(len(states)))
        states[arms] = self._prediction(arms, states[arms], delays[arms], offset[arms])
        return Estimate(states, delays, {}, offset)

    def prepare(self, applied: Array, active: BoolArray) -> None:
        """Predict the states of the active arms (b,) before their measurements; see `Controller`."""
        arms = np.flatnonzero(active & (self._ages > 0) & ~self._prepared)
        if len(arms):
            self._prediction.record(arms, applied[arms])
            self._predict(arms)
            self._prepared[arms] = True

    def _begin(self, arms: IntArray, now: Array) -> None:
        """Initialise the states of the arms (r,) by the angles in their first measurements (r, m)."""
        angles, core, model = self._instruments.posture, slice(0, self._size), self._plant.model
        self.states[arms, core], holding = self._rest(now[:, angles])
        self._transition[arms], self._noise[arms], _ = self._system(self.states[arms, core], holding)
        rotations = model.at_rest(np.eye(model.n_joints))
        covariance, each = np.zeros_like(self._noise[arms]), np.arange(self._size, len(self._noise[0]))
        covariance[:, core, core] = self._stationary(self._transition[arms], self._noise[arms], core)
        covariance[:, core, core] += (rotations.T * self._variances[angles]) @ rotations
        covariance[:, each, each] = self._initial_variance
        self.covariance[arms] = covariance

    def _predict(self, arms: IntArray) -> None:
        """Predict the states of arms (r,) over the previous period."""
        states, torques = self.states[arms, : self._size], self._prediction.past[arms, self.delay] + self._offset(arms)
        if not self._fixed:
            due = self._ages[arms] % RELINEARISATION_INTERVAL == 0
            if due.any():
                transition, noise, valid = self._system(states[due], torques[due])
                updated = arms[due][valid]
                self._transition[updated], self._noise[updated] = transition[valid], noise[valid]
            self.covariance[arms] = time_update(self.covariance[arms], self._transition[arms], self._noise[arms])
        self.states[arms, : self._size] = self._models.step(("filter", len(self._ages)), arms, states, torques)
        self.states[arms, self._size :] *= self._decay

    def _offset(self, arms: IntArray) -> Array:
        """Return the estimated constant torques (r, n) on the motors of arms (r,), N m."""
        return self.states[arms, self._offsets] if self._disturbed else np.zeros((len(arms), len(self._limits)))

    def _correct(self, arms: IntArray, now: Array) -> None:
        """Correct the states of arms (r,) by their measurements (r, m)."""
        error = now - row_dots(self._matrix, self.states[arms][:, None])
        gain = self._gain[arms]
        if not self._fixed:
            gain, self.covariance[arms] = measurement_update(self.covariance[arms], self._matrix, self._variances)
        self.states[arms] += row_dots(gain, error[:, None])
