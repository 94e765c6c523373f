"""Output-error estimator: joint estimation of states, uncertain parameters, start angles, biases and delay."""

from collections.abc import Mapping, Sequence

import numpy as np

from flexman_gym.agent.controller import EpisodeInfo, Plant, Readings
from flexman_gym.common.arrays import Array, BoolArray, IntArray, pad_rows, row_dots
from flexman_gym.model.linearization import LINEAR_SENSORS
from flexman_gym.model.statics import rest_state
from flexman_gym.toolbox.controllers.internal_model import DelayCompensation, DiscreteJacobians
from flexman_gym.toolbox.controllers.observers.innovations import (
    PROCESS_NOISE,
    SMALL_PROCESS_NOISE,
    ChangeDetector,
    InnovationGains,
)
from flexman_gym.toolbox.controllers.observers.measurement_history import MeasurementHistory
from flexman_gym.toolbox.controllers.observers.observer import (
    MAX_BIAS,
    Estimate,
    MeasurementModel,
    UncertainStates,
    default_sensors,
)
from flexman_gym.toolbox.controllers.observers.perturbed_models import (
    PerturbedModels,
    Prior,
    Resimulation,
    UncertainParameters,
    covariance_factors,
    solve_scaled,
    standard_deviations,
    uncertain_ranges,
)

RESIMULATION_TIMES = (6, 12, 20, 30, 45, 65, 90, 130, 200, 300)  # time units since the start of an episode
DELAY_COST = 60.0  # dimensionless; cost above that of the best consistent fit beyond which a delay is excluded
MAX_COST = 1e100  # dimensionless; cost of a diverged fit
UPDATE_INTERVAL = 5  # time units between two updates of the models to the estimate
MIN_BIAS = 1e-5  # fraction of the range; smallest assumed limit of a bias
START_ANGLE_DEVIATION = 1e-4  # rad; prior standard deviation of start angles given by `EpisodeInfo`
MAX_STATE = 1e4  # largest magnitude of an entry of the state of a model that has not diverged; modes reach hundreds
MAX_PERTURBATION = 0.5  # rad; difference of motor angles beyond which perturbations are reduced
SENSITIVE_PERTURBATION = 0.02  # rad; difference beyond which innovations correct the states: the motion is unstable
DETECTION_START = 25  # time units from the start of an episode to the start of change detection
BOUNDED_START = 45  # time units from the start after which entries at a bound move the others; linear by then
CONSISTENT_MISFIT = 3.0  # dimensionless; mean square below which the estimated model explains the measurements
START_ANGLE_BOUND = 10.0  # prior standard deviations; bound of the estimate of a start angle


class Estimator:
    """Output-error observer: a parameter vector theta and the delay are fitted to all measurements of the episode.

    The model has no process noise: the motion follows from theta and the applied torques. Perturbed models, one for
    each entry of theta that affects the motion, are simulated together with the estimated model and yield the
    sensitivities of a recursive least-squares fit. At certain periods the whole episode is simulated again from the
    start with Levenberg-Marquardt steps, which removes linearisation errors (Ljung, System Identification, 2nd ed.,
    1999, chapters 7 and 10). These fits are made for each delay that is not yet excluded, and the delay with the least
    cost is the estimate. Lost samples have no weight.

    If the model does not explain the measurements of an arm, the estimation is repeated from the start of the episode
    with process noise: the states are corrected by innovations, and the sensitivities of the corrected states to theta
    replace those of the simulated ones (Friedland, IEEE Transactions on Automatic Control 14, 1969, 359). If the
    measurements are still not explained, the arm has changed, and the estimation starts anew from the present state.

    Args:
        plant: plant model with uncertain parameters and the noise of the instruments.
        sensors: as in `KalmanFilter`.
        unknown: name -> (low, high), see `UncertainParameters`; None for the uncertain parameters of the plant, and for
            its joint stiffness and friction.
        biased: True to estimate biases of the measurements, up to 0.5 % of their ranges where the plant names none;
            None for the biases of the plant. The start angles are then those of `EpisodeInfo`, since biased encoders do
            not determine them.
        relinearised: False to keep the linearisation of a re-simulation until the next one, so that the covariance is
            that of the errors. Updates of the models to the estimate excite vibrations that the arm does not have, and
            their sensitivities to stiffness count as information.
        unit: control periods in a time unit, see `ArmScales.unit`.

    Attributes:
        theta: (b, p) parameter vectors: uncertain parameters, start angles relative to their initial guess
            (rad), biases, relative gain errors of the strain gauges.
        delays: (b,) estimated delays, control periods.
    """

    _arrays = (
        "theta", "delays", "_origin", "_states", "_information", "_change", "_ages", "_steps", "_perturbations_reduced",
        "_filtering", "_likely", "_error_sensitivity",
    )  # fmt: skip
    state_fields = (*_arrays, "_history", "_innovations", "_prediction", "_detector")

    def __init__(
        self,
        plant: Plant,
        sensors: Sequence[str] | None = None,
        unknown: Mapping[str, tuple[float, float]] | None = None,
        biased: bool | None = None,
        relinearised: bool = True,
        unit: int = 1,
    ) -> None:
        sensors = default_sensors(plant, tuple(LINEAR_SENSORS)) if sensors is None else sensors
        self.sensors, self._plant, self._relinearised = tuple(sensors), plant, relinearised
        self._given, self._unit = (plant, self.sensors, unknown, biased), unit
        self._resimulated = unit * np.array(RESIMULATION_TIMES)  # control periods
        instruments = self._instruments = MeasurementModel(plant, self.sensors)
        ranges = uncertain_ranges(plant) if unknown is None else unknown
        uncertain = self.uncertain = UncertainParameters(plant.model, ranges)
        biased = bool(instruments.biases.any()) if biased is None else biased
        gauges = np.flatnonzero(instruments.gain_errors)
        self._models = PerturbedModels(plant, uncertain, instruments.matrix, biased, gauges)
        self._innovations = InnovationGains(DiscreteJacobians(plant), instruments, plant.tip_force)
        self._encoders = None if biased else instruments.posture
        starts = instruments.deviations[instruments.posture]
        if biased:
            starts = np.full(len(starts), START_ANGLE_DEVIATION)
        told = instruments.biases if instruments.biases.any() else MAX_BIAS * instruments.ranges
        errors = np.concatenate(
            [np.maximum(told, MIN_BIAS * instruments.ranges)] * biased + [instruments.gain_errors[gauges]]
        )
        self._prior = Prior(
            np.concatenate([uncertain.mean, np.zeros(self._models.size - len(uncertain.mean))]),
            np.concatenate([uncertain.deviation, starts, errors / np.sqrt(3.0)]),
            np.concatenate([uncertain.low, -START_ANGLE_BOUND * starts, -2.0 * errors]),
            np.concatenate([uncertain.high, START_ANGLE_BOUND * starts, 2.0 * errors]),
        )
        # the first angles define the start, so that they have no weight
        self._history = MeasurementHistory(instruments, plant, int(self._resimulated[-1]) + 1, self._encoders)
        self._allocate()

    def _allocate(self) -> None:
        """Create the arrays, for zero arms."""
        (m, size), p, models = self._models.matrix.shape, self._models.size, 1 + self._models.dynamic
        n, late = self._plant.model.n_joints, self._plant.delay[1]
        self.theta, self._change = np.zeros((0, p)), np.zeros((0, p))
        self._origin, self._states = np.zeros((0, size)), np.zeros((0, models, size))
        self.delays, self._ages = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        self._information = np.zeros((0, p, p))
        self._given_angles, self._prediction = np.zeros((0, n)), DelayCompensation(self._plant)
        self._detector = ChangeDetector(m)
        # of the corrected states to biases and gain errors, which do not affect the simulated motion
        self._error_sensitivity = np.zeros((0, size, p - self._models.dynamic))
        self._likely = np.ones((0, 1 + late - self._plant.delay[0]), dtype=bool)  # delays that are not excluded
        self._steps, self._simulated_theta = np.zeros((0, models - 1)), np.zeros((0, p + models - 1))
        self._perturbations_reduced, self._filtering = np.zeros(0, dtype=bool), np.zeros(0, dtype=bool)

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes; arguments as in `Controller.reset`."""
        if count > len(self._ages):
            for name in (*self._arrays, "_given_angles", "_simulated_theta"):
                setattr(self, name, pad_rows(getattr(self, name), count))
            self._history.allocate(count)
            self._innovations.allocate(count)
        self._ages[arms], self._given_angles[arms], self._filtering[arms] = 0, episode.start, False
        self.theta[arms], self._change[arms] = self._prior.mean, 0.0
        self._information[arms] = self._prior.information
        self._simulated_theta[arms] = np.nan
        self._history.reset(arms)
        self._detector.reset(arms, count)
        self._prediction.reset(arms, count)

    def estimate(self, readings: Readings, applied: Array, active: BoolArray) -> Estimate:
        """Return the estimate of this control period; see `Observer`."""
        now = self._instruments.read(readings)
        new, running = (np.flatnonzero(active & flags) for flags in (self._ages == 0, self._ages > 0))
        if len(new):
            self._begin(new, now[new])
        if len(running):
            before = self._states[running, 0]
            self._advance(running, applied[running])
            motion = self._states[running, 0] - before
            lost = self._history.store(running, self._ages[running], now[running], motion)
            resimulated = (
                (self._ages[running, None] == self._resimulated).any(axis=1)  # np.isin takes ten times as long
                & ~self._perturbations_reduced[running]
                & ~self._filtering[running]
            )
            for age in np.unique(self._ages[running[resimulated]]).tolist():
                self._refit(running[resimulated & (self._ages[running] == age)], age)
            self._update_fit(running[~resimulated], now[running[~resimulated]], lost[~resimulated])
            late = self._ages[running] > self._unit * DETECTION_START
            self._answer_changes(running[self._detector.detect(running) & late])
        self._ages += active
        return self._state_at_effect(np.flatnonzero(active))

    @property
    def inconsistent(self) -> BoolArray:
        """Flags (b,) of arms whose measurements no model explains, even after a restart for a detected change."""
        return self._detector.inconsistent & ((self._ages > self._unit * DETECTION_START) | self._filtering)

    @property
    def consistent(self) -> BoolArray:
        """Flags (b,) of arms whose measurements are explained by the estimated model."""
        result: BoolArray = (self._detector.misfit < CONSISTENT_MISFIT) & ~self.inconsistent
        return result

    @property
    def estimates(self) -> dict[str, Array]:
        """Parameters NAME, (b, ...), their standard deviations NAME_deviation, `delay` and `misfit`."""
        values = self._models.parameters(self._prior.clip(self.theta + self._change))
        spread = self._models.uncertain.deviations(standard_deviations(self._information))
        return values | spread | {"delay": self.delays.astype(float), "misfit": self._detector.misfit}

    def consistent_copy(self) -> "Estimator":
        """Return a new estimator with the same arguments but `relinearised`, whose confidence region is consistent."""
        return Estimator(*self._given, relinearised=False, unit=self._unit)

    def confidence_region(self, arms: IntArray, deviations: float) -> UncertainStates:
        """Return the estimates of arms (r,), with deviations of each uncertain parameter, and the likely delays.

        The entries of a parameter (of all joints) deviate together, and the parameters after it by their covariance: by
        columns of the Cholesky factor of the covariance of theta.

        Args:
            arms: (r,) indices.
            deviations: number of standard deviations.
        """
        theta, names = self._prior.clip(self.theta + self._change)[arms], np.array(self.uncertain.names)
        factors, late = covariance_factors(self._information[arms]), self._likely.shape[1] > 1
        parts = [np.zeros_like(theta)]
        for name in dict.fromkeys(self.uncertain.names):
            sign = deviations if name == "payload_mass" else -deviations  # a heavier payload, less stiffness
            parts.append(sign * factors[:, :, np.flatnonzero(names == name)].sum(axis=2))
        changes = np.stack(parts + [parts[0]] * (2 * late), axis=1)
        changes = self._prior.clip(theta[:, None] + changes) - theta[:, None]
        jacobian = self._state_jacobian(arms)
        states = self._current_states(arms)[:, None] + row_dots(jacobian[:, None], changes[:, :, None])
        delays = np.repeat(self.delays[arms, None], changes.shape[1], axis=1)
        if late:
            likely, least = self._likely[arms], self._plant.delay[0]
            delays[:, -2] = least + likely.argmax(axis=1)
            delays[:, -1] = least + likely.shape[1] - 1 - likely[:, ::-1].argmax(axis=1)
        values = self._models.parameters((theta[:, None] + changes).reshape(-1, theta.shape[1]))
        parameters = {name: each.reshape(*changes.shape[:2], *each.shape[1:]) for name, each in values.items()}
        return UncertainStates(states, parameters, delays, len(parts) - 1)

    def _begin(self, arms: IntArray, now: Array) -> None:
        """Start the fits of arms (r,) with their first measurements (r, m)."""
        angles = self._given_angles[arms] if self._encoders is None else now[:, self._encoders]
        self._origin[arms] = rest_state(self._plant.model, angles)
        self._history.begin(arms, now)
        self._likely[arms] = True
        self.delays[arms] = (sum(self._plant.delay) + 1) // 2
        self._states[arms] = self._models.initial_states(self._origin[arms], self.theta[arms])
        self._steps[arms], self._perturbations_reduced[arms] = self._models.steps, False
        self._error_sensitivity[arms] = 0.0
        if self._plant.tip_force:
            self._filtering[arms] = self._start_filter(arms)

    def _answer_changes(self, arms: IntArray) -> None:
        """Repeat the estimation of arms (r,) whose measurements are not explained, or start it anew."""
        known = ~self._filtering[arms] & ~self._perturbations_reduced[arms]
        known &= self._ages[arms] < len(self._history)  # the start and all measurements since
        if known.any():
            self._filter_history(arms[known])
        if not known.all():
            self._restart_after_change(arms[~known])

    def _filter_history(self, arms: IntArray) -> None:
        """Repeat the estimation of arms (r,) from the start of their episodes, with corrections by innovations."""
        ages, past, history = self._ages[arms], self._prediction.past[arms], self._history
        self.theta[arms] = self._prior.clip(self.theta[arms] + self._change[arms])
        self.theta[arms, self._models.dynamic :], self._change[arms] = 0.0, 0.0
        self._information[arms] = self._prior.information
        self._states[arms] = self._models.initial_states(self._origin[arms], self.theta[arms])
        self._steps[arms], self._perturbations_reduced[arms] = self._models.steps, True
        self._filtering[arms] = self._start_filter(arms)
        self._innovations.covariance[arms] = 0.0  # apart from the start angles, which are entries of theta
        for period in range(int(ages.max()) + 1):
            now = arms[ages >= period]
            if period:
                self._prediction.past[now] = history.recent_torques(now, period)
                self._set_parameters(now)
                self._simulate_period(now)
            self._ages[now] = period
            unused = history.lost[now, period] | (history.weights[period] == 0.0)
            self._update_fit(now, history.readings[now, period], unused)
        self._prediction.past[arms] = past
        self._detector.reset(arms, len(self._ages))

    def _restart_after_change(self, arms: IntArray) -> None:
        """Restart the fit of arms (r,) with a detected change, such as a new payload or an external force."""
        count, states = len(self.uncertain.names), self._current_states(arms)
        self.theta[arms] = self._prior.clip(self.theta[arms] + self._change[arms])
        self.theta[arms, count : self._models.dynamic], self._change[arms] = 0.0, 0.0
        self._states[arms], self._steps[arms] = states[:, None], self._models.steps
        self._information[arms] = self._prior.information
        self._ages[arms], self._perturbations_reduced[arms] = 1, True  # True: no resimulation, without known start
        self._detector.reset(arms, len(self._ages))
        self._filtering[arms] = self._start_filter(arms, sudden=True)

    def _start_filter(
        self, arms: IntArray, noise: tuple[float, float] = PROCESS_NOISE, sudden: bool = False
    ) -> BoolArray:
        """Start the correction of arms (r,) by innovations; return flags (r,) of arms with a stationary covariance."""
        torques = self._prediction.past[arms, self.delays[arms]]
        self._error_sensitivity[arms] = 0.0
        return self._innovations.begin(arms, self._current_states(arms), torques, noise, sudden)

    def _reduce_perturbations(self, arms: IntArray) -> None:
        """Reduce the perturbations of arms (r,) whose perturbed models are far from the estimated model.

        If the motion is unstable without control, perturbations grow, and with them the assumed information. The states
        are then corrected by innovations.
        """
        states, motors = self._states[arms], self._plant.model.motor_columns
        spread = np.abs(states[:, 1:, motors] - states[:, :1, motors]).max(axis=2)
        uncorrected = ~self._filtering[arms] & ~self._perturbations_reduced[arms]
        sensitive = arms[uncorrected & (spread.max(axis=1) > SENSITIVE_PERTURBATION)]
        if len(sensitive):
            self._filtering[sensitive] = self._start_filter(sensitive, SMALL_PROCESS_NOISE)
            self._innovations.covariance[sensitive] = 0.0  # without process noise so far
        spread /= MAX_PERTURBATION
        large = spread > 1.0
        if large.any():
            factor = np.where(large, 1.0 / np.maximum(spread, 1.0), 1.0)
            self._states[arms, 1:] = states[:, :1] + factor[..., None] * (states[:, 1:] - states[:, :1])
            self._steps[arms] *= factor
            self._perturbations_reduced[arms] |= large.any(axis=1)

    def _set_parameters(self, arms: IntArray) -> None:
        """Set the parameters of the simulated models of arms (r,) to changed estimates."""
        current = np.hstack([self.theta[arms], self._steps[arms]])
        stale = (current != self._simulated_theta[arms]).any(axis=1)
        if stale.any():
            arms = arms[stale]
            theta = self.theta[arms]
            perturbed = self._models.perturb(theta, self._steps[arms]).reshape(-1, theta.shape[1])
            self._models.models(*self._batch_key).vary(self._rows(arms).ravel(), **self._models.parameters(perturbed))
            self._prediction.set_parameters(arms, self._models.parameters(theta))
            self._simulated_theta[arms] = current[stale]

    @property
    def _batch_key(self) -> tuple[str, int]:
        """Purpose and size of the batch with the models of all arms."""
        return "models", self._states.shape[0] * self._states.shape[1]

    def _rows(self, arms: IntArray) -> IntArray:
        """Return the rows (r, 1 + s) of the models of arms (r,) in the batch."""
        return arms[:, None] * self._states.shape[1] + np.arange(self._states.shape[1])

    def _advance(self, arms: IntArray, actions: Array) -> None:
        """Advance the models of arms (r,) by a period, after commanded torques (r, n), fractions of the limits."""
        self._set_parameters(arms)
        self._prediction.record(arms, actions)
        self._history.store_torques(arms, self._ages[arms], self._prediction.past[arms, 0])
        self._simulate_period(arms)

    def _simulate_period(self, arms: IntArray) -> None:
        """Simulate a control period of all models of arms (r,) under the torques of their delays."""
        rows, torques = self._rows(arms), self._prediction.past[arms, self.delays[arms]]
        states = self._states[arms].reshape(rows.size, -1)
        ends = self._models.models.step(self._batch_key, rows.ravel(), states, torques.repeat(rows.shape[1], axis=0))
        self._states[arms] = ends.reshape(*rows.shape, -1)
        lost = arms[~(np.abs(self._states[arms]) < MAX_STATE).all(axis=(1, 2))]
        self._states[lost], self._detector.misfit[lost] = self._origin[lost][:, None], MAX_STATE

    def _update_fit(self, arms: IntArray, now: Array, lost: BoolArray) -> None:
        """Update the recursive least-squares fits of arms (r,) with measurements (r, m), without lost ones (r, m)."""
        jacobian = self._models.measurement_jacobian(self._states[arms], self._steps[arms], self.theta[arms])
        filtered, errors = self._filtering[arms], slice(self._models.dynamic, None)
        if filtered.any():
            corrected = arms[filtered]
            sensitivity = self._innovations.propagate(corrected, self._error_sensitivity[corrected])
            self._error_sensitivity[corrected] = sensitivity
            jacobian[filtered, :, errors] += self._instruments.matrix @ sensitivity
        error = now - self._models.read(self._states[arms, 0], self.theta[arms])
        error -= row_dots(jacobian, self._change[arms][:, None])
        precision = np.repeat(self._history.weights[-1:], len(arms), axis=0)
        if filtered.any():
            precision[filtered] = 1.0 / self._innovations.variances(arms[filtered])
        precision *= ~lost
        weighted = (jacobian * precision[..., None]).transpose(0, 2, 1)
        self._information[arms] += weighted @ jacobian
        gradient = row_dots(weighted, error[:, None])
        self._change[arms] += solve_scaled(self._information[arms], gradient)
        self._detector.update(arms, error * np.sqrt(precision))
        if filtered.any():
            self._correct(arms[filtered], now[filtered], lost[filtered], jacobian[filtered, :, errors])
        due = arms[self._ages[arms] % (self._unit * UPDATE_INTERVAL) == 0]
        if len(due):
            self._apply_change(due)

    def _correct(self, arms: IntArray, now: Array, lost: BoolArray, jacobian: Array) -> None:
        """Correct each model of arms (r,) by its innovation.

        Args:
            arms: (r,) indices.
            now: (r, m) measurements.
            lost: (r, m) flags of lost measurements, which correct nothing.
            jacobian: (r, m, e) Jacobian of the measurements with respect to biases and gain errors.
        """
        states, theta = self._states[arms], self._models.perturb(self.theta[arms], self._steps[arms])
        error = now[:, None] - self._models.read(
            states.reshape(-1, states.shape[2]), theta.reshape(-1, theta.shape[2])
        ).reshape(*states.shape[:2], -1)
        error *= ~lost[:, None]
        gain = self._innovations.gains(arms, states[:, 0], self._prediction.past[arms, self.delays[arms]])
        self._states[arms] = states + row_dots(gain[:, None], error[:, :, None])
        self._error_sensitivity[arms] -= gain @ (jacobian * ~lost[..., None])

    def _apply_change(self, arms: IntArray) -> None:
        """Add the change of theta estimated since the last update to theta and to the states of arms (r,)."""
        if not self._relinearised:  # changed only for arms that are not simulated again
            last = self._filtering[arms] | self._perturbations_reduced[arms] | (self._ages[arms] >= len(self._history))
            self._reduce_perturbations(arms[~last])
            arms = arms[last]
        before = self.theta[arms]
        change, late = self._change[arms], self._ages[arms] > self._unit * BOUNDED_START
        change[late] = self._prior.constrain(before[late], change[late], self._information[arms[late]])
        self.theta[arms] = self._prior.clip(before + change)
        self._states[arms] += row_dots(self._state_jacobian(arms), (self.theta[arms] - before)[:, None])[:, None]
        self._change[arms] = 0.0
        self._reduce_perturbations(arms)

    def _refit(self, arms: IntArray, age: int) -> None:
        """Fit theta of arms (r,) to all measurements of their first `age` control periods."""
        self.theta[arms] = self._prior.clip(self.theta[arms] + self._change[arms])
        theta, simulation = self._fit_delays(arms, age)
        valid = np.isfinite(simulation.cost) & (np.abs(simulation.states) < MAX_STATE).all(axis=(1, 2))
        if not valid.all():  # arms with diverged simulations continue with the recursive fit
            other = arms[~valid]
            self._update_fit(other, self._history.readings[other, age], self._history.lost[other, age])
        arms, theta, simulation = arms[valid], theta[valid], simulation.select(valid)
        self.theta[arms] = theta
        self._states[arms], self._steps[arms] = simulation.states, self._models.steps
        self._information[arms] = simulation.information + self._prior.information
        if age <= 2 * self._unit * DETECTION_START:
            self._detector.reset(arms, len(self._ages))  # innovations so far include linearisation errors
        self._detector.misfit[arms] = simulation.cost / self._history.count(arms, age)
        self._change[arms], _ = simulation.step(self.theta[arms], self._prior)
        self._apply_change(arms)

    def _fit_delays(self, arms: IntArray, age: int) -> tuple[Array, Resimulation]:
        """Fit theta of arms (r,) for each likely delay, and store the delay with the least cost.

        Returns:
            Fitted parameter vectors (r, p) and the simulation of the arms with these parameters and delays.
        """
        least, likely = self._plant.delay[0], self._likely[arms].T
        delays, each = np.nonzero(likely)  # one fit for each pair of a delay and an arm
        rows = arms[each]
        data = self._history.data(rows, age, least + delays)
        theta, simulation = self._models.fit(self._origin[rows], self.theta[rows], self._prior, data)
        costs, fits = np.full(likely.shape, np.inf), np.zeros(likely.shape, dtype=np.int64)
        costs[likely] = np.nan_to_num(simulation.cost + self._prior.cost(theta), nan=np.inf)
        costs[likely], fits[likely] = np.minimum(costs[likely], MAX_COST), np.arange(len(rows))
        best = costs.argmin(axis=0)
        self.delays[arms] = least + best
        least_cost, count = costs.min(axis=0), self._history.weights[: age + 1].size
        self._likely[arms] = (
            likely & ((costs <= least_cost + DELAY_COST) | (least_cost > CONSISTENT_MISFIT * count))
        ).T
        chosen = fits[best, np.arange(len(arms))]
        return theta[chosen], simulation.select(chosen)

    def _current_states(self, arms: IntArray) -> Array:
        """Return the estimated states (r, 2 d) of arms (r,) at the last measurement."""
        result: Array = self._states[arms, 0]
        return result + row_dots(self._state_jacobian(arms), self._change[arms][:, None])

    def _state_jacobian(self, arms: IntArray) -> Array:
        """Return the Jacobian (r, 2 d, p) of the states of arms (r,) with respect to theta."""
        simulated = self._models.jacobian(self._states[arms], self._steps[arms])
        return np.concatenate([simulated, self._error_sensitivity[arms]], axis=2)

    def _state_at_effect(self, arms: IntArray) -> Estimate:
        """Return the estimate; states of the active arms (r,) are predicted to when torques commanded now act."""
        states = self._states[:, 0].copy()
        states[arms] = self._current_states(arms)
        theta = self._prior.clip(self.theta + self._change)
        self._set_parameters(arms)
        states[arms] = self._prediction(arms, states[arms], self.delays[arms])
        return Estimate(states, self.delays, self._models.parameters(theta))
