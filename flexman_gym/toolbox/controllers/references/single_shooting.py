"""Single shooting: torques of the slew with the shortest settling time, between knots, by Gauss-Newton steps."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, row_dots
from flexman_gym.envs.limits import Limits
from flexman_gym.kernels.layout import OK, TIP
from flexman_gym.model.linearization import LinearMeasurements
from flexman_gym.model.statics import holding_torques, rest_state, rest_tips
from flexman_gym.simulation.batch import Batch
from flexman_gym.toolbox.controllers.arm_scales import SlewBounds
from flexman_gym.toolbox.controllers.lqr import FEEDFORWARD_FRACTION, LQR
from flexman_gym.toolbox.controllers.references.trajectories import plan_slew

# Times of an arm whose slews last 3 s, as those of FlexRRR-v0; others in proportion
KNOT_SPACING = 0.1  # s; time between two knots of the torques
TAIL_TIME = 0.2  # s; duration of the torques after the arrival of the tip
SETTLING_TIME = 1.0  # s; duration of control by the LQR after the optimised torques
MIN_KNOTS = 4  # smallest number of knots
FIRST_FACTOR = 0.8  # dimensionless; first trial duration, relative to a minimum-jerk slew
SHORTER_FACTOR = 0.88  # dimensionless; next trial duration after a success, relative to the last
LONGER_FACTOR = 1.12  # dimensionless; next trial duration after a failure, relative to the last
LATE_FACTOR = 1.08  # dimensionless; first trial duration / predicted one; with 1, a third of the slews need more trials
LATER_FACTOR = 1.08  # dimensionless; next trial duration after a failure of a predicted slew, relative to the last
DURATION_TOLERANCE = 0.012  # dimensionless; relative difference of failed and successful duration that ends the search
MAX_STRETCH = 3.0  # dimensionless; longest trial duration / the first
MAX_DURATIONS = 40  # largest number of trial durations
MAX_STEPS = 60  # largest number of Gauss-Newton steps for one duration
MAX_JACOBIANS = 12  # largest number of Jacobians for one duration
SHORTENED_FACTOR = 0.98  # dimensionless; next trial duration with the Jacobian of a solution, relative to the last
SLEW_FACTOR = 0.73  # first trial duration / duration of a quintic slew; shortest ones are 0.6 to 0.77
FEW_JACOBIANS = 2  # the same for a predicted slew: a longer duration needs fewer Jacobians than a second attempt
INNER_BAND = 0.6  # fraction of the band; smaller errors have no weight
SETTLED_BAND = 0.995  # fraction of the band within which the tip counts as settled
DAMPING_FACTORS = np.array([0.1, 1.0, 10.0, 100.0])  # dimensionless; changes of the damping that are tried in each step
MIN_DAMPING = 1e-6  # dimensionless; least damping of the Gauss-Newton matrix
MAX_DAMPING = 1e3  # dimensionless; largest damping
INITIAL_DAMPING = 1e-2  # 1
MAX_COST_RATIO = 0.9  # dimensionless; largest ratio of the costs after and before a successful step
BROYDEN_UPDATES = 5  # number of successful steps with one Jacobian
TORQUE_STEP = 0.005  # fraction of the torque limits; perturbation for the Jacobian
SHARE_BOUND = 0.97  # fraction of their limits above which motor rates and deflections are penalised
MAX_SHARE = 0.99  # fraction of their limits that motor rates and deflections of a solution may reach
SHARE_WEIGHT = 50.0  # bands; penalty of a motor rate or deflection that exceeds SHARE_BOUND by its limit
FAILURE_ERROR = 1e3  # bands; error of an arm whose simulation failed
COST_DIFFERENCE_STEP = 1e-4  # fraction of the torque limits; perturbation for the Jacobian of the residuals
MIN_DISTANCE = 1e-12  # m; avoids division by zero
BOUND_MARGIN = 1e-9  # fraction of the torque limits; keeps bounds apart that rounding would exchange


class SlewTorques(NamedTuple):
    """Torques of a slew over T control periods; afterwards an LQR acts at the goal.

    Attributes:
        knots: (K, n) torques at equal intervals from start to end, N m.
        periods: T, number of control periods.
        arrival: number of control periods after which the tip stays within the band.
    """

    knots: Array
    periods: int
    arrival: int


def interpolate_torques(knots: Array, periods: int) -> Array:
    """Return the torques (..., T, n) in the middles of control periods, linear between knots (..., K, n)."""
    positions = (np.arange(periods) + 0.5) / periods * (knots.shape[-2] - 1)
    lower = np.minimum(positions.astype(int), knots.shape[-2] - 2)
    part = (positions - lower)[:, None]
    result: Array = knots[..., lower, :] * (1.0 - part) + knots[..., lower + 1, :] * part
    return result


def simulate_torques(batch: Batch, state: Array, torques: Array) -> Array:
    """Return the states (T + 1, 2 d) of the arm of a Batch of one, from a state (2 d,) under torques (T, n), N m."""
    drives = np.zeros((1, len(torques), torques.shape[1] + 6))  # motor torques, tip force, base acceleration
    drives[0, :, : torques.shape[1]] = torques
    batch.reset(np.zeros(1, dtype=np.int64), state[None])
    return np.vstack([state, batch.roll(drives)[0][0]])


def _broyden_update(jacobian: Array, step: Array, change: Array) -> Array:
    """Return the Jacobian (m, ...) after Broyden's rank-one update (Mathematics of Computation 19, 1965, 577).

    Args:
        jacobian: (m, ...) Jacobian before the step, a row for each variable.
        step: (m,) change of the variables.
        change: (...) change of the function by the step.
    """
    error = change - np.tensordot(step, jacobian, 1)
    result: Array = jacobian + np.multiply.outer(step / (step @ step), error)
    return result


class SingleShooting:
    """Time-optimal slew of one arm from an equilibrium or a motion to an equilibrium, by single shooting.

    Torques with one perturbed knot each are simulated together in a Batch. Damped Gauss-Newton steps within the torque
    limits bring the tip into the band from an arrival time on, with Broyden's updates of the Jacobian, and keep motor
    rates and deflections of links within their limits. The arrival time is reduced, starting from the last solution,
    until no solution is found.

    Args:
        regulator: LQR about the goal, with the model, torque limits and control period of the arm.
        make_batch: function that returns a Batch with a given number of these arms.
        band: distance from the target within which the tip counts as settled, m.
        max_rate: largest motor rate, rad/s; the largest deflection of a link is that of `envs.limits.Limits`.
        ends: (n,) initial motor angles at rest, rad, or (2 d,) initial state; (n,) final motor angles, rad.
        budget: largest number of Jacobians of all durations; None for no limit.
        slowness: duration of a slew of the arm, relative to that of the arm of FlexRRR-v0, by which times are scaled.

    Attributes:
        jacobians: number of Jacobians computed.
    """

    def __init__(
        self,
        regulator: LQR,
        make_batch: Callable[[int], Batch],
        band: float,
        max_rate: float,
        ends: tuple[Array, Array],
        budget: int | None = None,
        slowness: float = 1.0,
    ) -> None:
        self._max_rate, self.budget, self.jacobians = max_rate, budget, 0
        model, (start, goal) = regulator.model, ends
        self._driven = np.flatnonzero(model.constants.passive == 0)
        self._measurements = LinearMeasurements(model)
        self._max_deflections = Limits.deflection * np.repeat(model.constants.length, 2)
        moving = len(start) == 2 * model.n_dof
        posture = (1 - model.constants.passive) * start[model.motor_columns] if moving else start
        self._regulator, self._make_batch, self._band, self._ends = regulator, make_batch, band, (posture, goal)
        self._batches: dict[int, Batch] = {}
        self._start, self._rest = start if moving else rest_state(model, start), rest_state(model, goal)
        self._holding_torques = np.array([holding_torques(model, each) for each in (posture, goal)])
        self._gain, self._target = regulator.gain(goal), rest_tips(model, goal[None])[0]
        scale = slowness / regulator.period
        self._tail, self._settling = round(scale * TAIL_TIME), round(scale * SETTLING_TIME)
        self._spacing = slowness * KNOT_SPACING
        self._jacobian_known: Array | None = None  # of the last solution

    def search(self) -> SlewTorques | None:
        """Return the fastest slew found, from a planned slew; None if no slew settles."""
        quintic = self._quintic()
        return self.improve(quintic, max(1, round(FIRST_FACTOR * quintic.arrival)))

    def _quintic(self) -> SlewTorques:
        """Return the torques of a planned slew between the ends."""
        bounds = SlewBounds(self._regulator.limits, FEEDFORWARD_FRACTION)
        torques = plan_slew(self._regulator.model, *self._ends, bounds, self._regulator.period).torques
        return SlewTorques(torques, len(torques), len(torques))

    def first(self, predicted: SlewTorques) -> SlewTorques | None:
        """Return the first slew found that settles, from predicted torques and a planned slew in turn; None if none.

        The first trial is later than predicted by about the error of the prediction, since no slew arrives before the
        shortest time. Each further trial from the same torques is longer. The slew found is then shortened as long as
        steps with its own Jacobian settle.
        """
        trials, found = [(predicted, LATE_FACTOR * predicted.arrival)], None
        for attempt in range(MAX_DURATIONS):
            solution, time = trials.pop(0)
            arrival = max(1, round(time))
            found = self._solve(self.rescale(solution, arrival), arrival, FEW_JACOBIANS)
            if found is not None or self._exhausted():
                break
            trials.append((solution, LATER_FACTOR * time))
            if attempt == 0:  # most predictions settle, and a slew takes time to plan
                quintic = self._quintic()
                trials.insert(0, (quintic, SLEW_FACTOR * quintic.arrival))
        return found and self._shortened(found)

    def _shortened(self, found: SlewTorques) -> SlewTorques:
        """Return the last of ever shorter slews that settle after steps with the last Jacobian, without a new one."""
        while self._jacobian_known is not None:
            arrival = min(round(SHORTENED_FACTOR * found.arrival), found.arrival - 1)
            periods, rows = arrival + self._tail, self._jacobian_known.shape[1]
            before = np.round(np.arange(periods) * (rows - self._settling) / periods).astype(int)
            after = np.arange(rows - self._settling, rows)
            jacobian = self._jacobian_known[:, np.concatenate([before, after])]
            shorter = self._solve(self.rescale(found, arrival, len(found.knots)), arrival, 0, jacobian)
            if shorter is None:
                break
            found = shorter
        return found

    def improve(self, solution: SlewTorques, arrival: int, factor: float = SHORTER_FACTOR) -> SlewTorques | None:
        """Return the fastest slew found from a first guess; None if no slew settles.

        Args:
            solution: first guess, which need not settle.
            arrival: first trial of the arrival time, control periods.
            factor: next trial after a success, relative to the arrival found.
        """
        best, longest = None, MAX_STRETCH * arrival
        for _ in range(MAX_DURATIONS):
            found = self._solve(self.rescale(solution, arrival), arrival)
            if found is not None:
                solution = best = found
                arrival = min(round(factor * best.arrival), best.arrival - 1)
            elif best is None:
                arrival = int(np.ceil(LONGER_FACTOR * arrival))
            else:
                gap = best.arrival - arrival
                if gap <= max(1.0, DURATION_TOLERANCE * best.arrival):
                    break
                arrival, factor = best.arrival - gap // 2, 0.5 + 0.5 * factor
            if arrival < 1 or arrival > longest or self._exhausted():
                break
        return best

    def _exhausted(self) -> bool:
        return self.budget is not None and self.jacobians >= self.budget

    def errors(self, knots: Array, periods: int) -> Array:
        """Return the errors (r, T + W, 3 + q) at the ends of control periods for knots (r, K, n).

        W control periods under the LQR follow the T periods of the slew. An error consists of the position error (3,)
        of the tip, m, and q fractions of limits, see `_shares`.
        """
        limits, batch = self._regulator.limits, self._batch(len(knots))
        n, settling = len(limits), self._settling
        drives = np.zeros((len(knots), periods, n + 6))  # motor torques, tip force, base acceleration
        drives[..., :n] = np.clip(interpolate_torques(knots, periods) / limits, -1.0, 1.0) * limits
        states, outputs = batch.roll(drives)
        states, tips = (np.pad(each, ((0, 0), (0, settling), (0, 0))) for each in (states, outputs[..., TIP]))
        drive = np.zeros((len(knots), n + 6))
        for period in range(periods, periods + settling):
            torques = self._holding_torques[1] - row_dots(self._gain, (batch.state - self._rest)[:, None])
            torques = self._regulator.compensated(torques, batch.state)
            drive[:, :n] = np.clip(torques / limits, -1.0, 1.0) * limits
            batch.step(drive)
            states[:, period], tips[:, period] = batch.state, batch.outputs[:, TIP]
        result: Array = np.concatenate([tips - self._target, self._shares(states)], axis=2)
        result[batch.status != OK] = FAILURE_ERROR * self._band
        return result

    def _shares(self, states: Array) -> Array:
        """Return the rates of the m motors and the deflections of the n links of states (r, T, 2 d), (r, T, m + 2 n).

        They are fractions of the largest motor rate and of the largest deflection.
        """
        measured = self._measurements.measure(states.reshape(-1, states.shape[2]))
        rates = measured["motor_rates"][:, self._driven] / self._max_rate
        shares = np.hstack([rates, measured["link_deflections"] / self._max_deflections])
        return shares.reshape(*states.shape[:2], -1)

    def _batch(self, count: int) -> Batch:
        if count not in self._batches:
            self._batches[count] = self._make_batch(count)
        self._batches[count].reset(np.arange(count), np.tile(self._start, (count, 1)))
        return self._batches[count]

    def rescale(self, solution: SlewTorques, arrival: int, count: int | None = None) -> Array:
        """Return K knots (K, n) of a slew, rescaled to an arrival time (control periods); K by KNOT_SPACING if None.

        The inertial part of the torques scales with the square of the speed.
        """
        periods, limits, speed = arrival + self._tail, self._regulator.limits, solution.arrival / arrival
        usual = max(MIN_KNOTS, round(periods * self._regulator.period / self._spacing) + 1)
        times = np.linspace(0.0, periods, usual if count is None else count)
        knot_times = np.linspace(0.0, solution.periods, len(solution.knots))
        torques = np.array([np.interp(speed * times, knot_times, column) for column in solution.knots.T]).T
        holding = self._holding_torques[0] + np.minimum(times / arrival, 1.0)[:, None] * (
            self._holding_torques[1] - self._holding_torques[0]
        )
        return np.clip(holding + (torques - holding) * speed**2, -limits, limits)

    def _solve(
        self, knots: Array, arrival: int, most: int = MAX_JACOBIANS, jacobian: Array | None = None
    ) -> SlewTorques | None:
        """Return the slew whose tip stays within the band from the arrival on; None if the iteration fails.

        Args:
            knots: (K, n) first torques, N m.
            arrival: arrival time, control periods.
            most: largest number of Jacobians.
            jacobian: first Jacobian; None to compute it.
        """
        periods, damping, updates, jacobians = arrival + self._tail, INITIAL_DAMPING, 0, 0
        errors = self.errors(knots[None], periods)[0]
        for _ in range(MAX_STEPS):
            outside = np.flatnonzero(np.linalg.norm(errors[:, :3], axis=1) > SETTLED_BAND * self._band)
            if outside.max(initial=-1) < arrival - 1 and np.abs(errors[:, 3:]).max() <= MAX_SHARE:
                self._jacobian_known = jacobian
                return SlewTorques(knots, periods, int(outside.max(initial=-1)) + 2)
            if jacobian is None:
                if jacobians >= most or self._exhausted():
                    break
                errors, jacobian = self._jacobian(knots, periods)
                updates, jacobians = 0, jacobians + 1
            tried = self._steps(knots, errors, jacobian, arrival, damping * DAMPING_FACTORS)
            candidate_errors = self.errors(tried, periods)
            costs = np.square(self._residuals(np.concatenate([candidate_errors, errors[None]]), arrival)).sum(axis=1)
            best = int(np.argmin(costs[:-1]))
            better = costs[best] < MAX_COST_RATIO * costs[-1]
            if better:
                step = self._fractions(tried[best] - knots)
                jacobian = _broyden_update(jacobian, step, candidate_errors[best] - errors)
                knots, errors, updates = tried[best], candidate_errors[best], updates + 1
                damping = float(np.clip(damping * DAMPING_FACTORS[best], MIN_DAMPING, MAX_DAMPING))
            elif updates == 0:
                damping *= MAX_DAMPING
            if updates and (updates == BROYDEN_UPDATES or not better):
                jacobian = None
            if damping > MAX_DAMPING**2:
                break
        return None

    def _jacobian(self, knots: Array, periods: int) -> tuple[Array, Array]:
        """Return the errors of knots (K, n) and their Jacobian (K m, T + W, 3 + q), per fraction of the limits."""
        self.jacobians += 1
        steps = self._torques(TORQUE_STEP * np.eye(self._fractions(knots).size), knots)
        errors = self.errors(np.concatenate([knots[None], knots + steps]), periods)
        return errors[0], (errors[1:] - errors[0]) / TORQUE_STEP

    def _residuals(self, errors: Array, arrival: int) -> Array:
        """Return the residuals (r, ...) of errors (r, T + W, 3 + q), in bands.

        The residuals are the tip errors beyond the inner band in every second period from the arrival on, and the
        motor rates and deflections above SHARE_BOUND.
        """
        late_errors, shares = errors[:, arrival - 1 :: 2, :3], errors[..., 3:]
        distances = np.linalg.norm(late_errors, axis=2, keepdims=True)
        candidate_errors = (
            late_errors
            * np.maximum(0.0, 1.0 - INNER_BAND * self._band / np.maximum(distances, MIN_DISTANCE))
            / self._band
        )
        excess = SHARE_WEIGHT * (shares - np.clip(shares, -SHARE_BOUND, SHARE_BOUND))
        return np.concatenate([candidate_errors.reshape(len(errors), -1), excess.reshape(len(errors), -1)], axis=1)

    def _steps(self, knots: Array, errors: Array, jacobian: Array, arrival: int, dampings: Array) -> Array:
        """Return the knots (r, K, n) after a Gauss-Newton step with each damping (r,), within the torque limits."""
        from scipy.optimize import lsq_linear

        limits = self._regulator.limits
        residuals = self._residuals(
            np.concatenate([errors[None], errors + COST_DIFFERENCE_STEP * jacobian]), arrival
        ).reshape(len(jacobian) + 1, -1)
        slopes = (residuals[1:] - residuals[0]) / COST_DIFFERENCE_STEP
        # in the eigenvectors of J J^T, so that each damping requires a small problem only
        squares, axes = np.linalg.eigh(slopes @ slopes.T)
        target, current = axes.T @ (slopes @ residuals[0]), self._fractions(knots)
        bounds = -1.0 - BOUND_MARGIN - current, 1.0 + BOUND_MARGIN - current
        result = []
        for damping in dampings:
            scale = np.sqrt(np.maximum(squares, 0.0) + damping)
            step = lsq_linear(scale[:, None] * axes.T, -target / scale, bounds, method="bvls").x
            result.append(np.clip(knots + self._torques(step[None], knots)[0], -limits, limits))
        return np.array(result)

    def _fractions(self, knots: Array) -> Array:
        """Return the torques (K m,) of the m motors at knots (K, n), fractions of the limits."""
        result: Array = (knots[:, self._driven] / self._regulator.limits[self._driven]).ravel()
        return result

    def _torques(self, fractions: Array, knots: Array) -> Array:
        """Return torques (r, K, n), N m, at knots like (K, n), for fractions (r, K m) of the limits of the m motors."""
        result = np.zeros((len(fractions), *knots.shape))
        result[..., self._driven] = self._regulator.limits[self._driven] * fractions.reshape(
            len(result), len(knots), -1
        )
        return result
