"""Optimised slews: single shooting for the shortest settling time, tables of torques, and their replay."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from flexman_gym.common.arrays import Array, IntArray, Vector, pad_rows, row_dots
from flexman_gym.common.checks import MAX_VALUE_LENGTH, short_path, value_error
from flexman_gym.common.files import READ_ERRORS, open_arrays
from flexman_gym.control.controller import EpisodeInfo
from flexman_gym.control.lqr import LQR, TORQUE_SHARE
from flexman_gym.control.references.trajectories import plan_slew
from flexman_gym.kernels.layout import OK, TIP
from flexman_gym.model.model import Model
from flexman_gym.model.statics import holding_torques, rest_state, rest_tips
from flexman_gym.simulation.batch import Batch

KNOT_SPACING = 0.1  # s; between knots of the torques
TAIL_TIME = 0.2  # s; duration of the torques after the arrival
SETTLING_TIME = 1.0  # s; duration of control by the LQR after the optimised torques
MIN_KNOTS = 4  # number of knots
FIRST_FACTOR = 0.8  # of the duration of a minimum-jerk slew; first trial
SHORTER_FACTOR = 0.88  # of the duration, after a success
LONGER_FACTOR = 1.12  # of the duration, after a failure
DURATION_TOLERANCE = 0.012  # relative; ends the search
MAX_DURATIONS = 40  # trial durations
MAX_STEPS = 60  # Gauss-Newton steps for one duration
MAX_JACOBIANS = 12  # Jacobians for one duration
INNER_BAND = 0.6  # fraction of the band; smaller errors have no weight
SETTLED_BAND = 0.995  # fraction of the band within which the tip has settled
DAMPING_FACTORS = np.array([0.1, 1.0, 10.0, 100.0])  # tried in each step
MIN_DAMPING = 1e-6
MAX_DAMPING = 1e3
INITIAL_DAMPING = 1e-2
MAX_COST_RATIO = 0.9  # of a successful step
BROYDEN_UPDATES = 5  # successful steps with one Jacobian
TORQUE_STEP = 0.005  # fraction of the torque limits; perturbation for the Jacobian
RATE_BOUND = 0.97  # fraction of the largest rate, above which rates are penalised
MAX_RATE = 0.99  # fraction of the largest rate
RATE_WEIGHT = 50.0  # bands per excess over RATE_BOUND
FAILURE_ERROR = 1e3  # bands; error of an arm whose simulation failed
COST_DIFFERENCE_STEP = 1e-4  # fraction of the torque limits
TINY = 1e-12  # m
ROUNDING = 1e-9  # fraction of the torque limits


class _SlewTorques(NamedTuple):
    """Torques over T control periods; afterwards an LQR acts at the goal.

    Attributes:
        knots: (K, n) at equal intervals from start to end, N m.
        periods: T.
        arrival: control periods after which the tip stays within the band.
    """

    knots: Array
    periods: int
    arrival: int


def _interpolate_torques(knots: Array, periods: int) -> Array:
    """Return the torques (..., T, n) in the middles of control periods, linear between knots (..., K, n)."""
    places = (np.arange(periods) + 0.5) / periods * (knots.shape[-2] - 1)
    lower = np.minimum(places.astype(int), knots.shape[-2] - 2)
    part = (places - lower)[:, None]
    result: Array = knots[..., lower, :] * (1.0 - part) + knots[..., lower + 1, :] * part
    return result


def broyden_update(jacobian: Array, move: Array, change: Array) -> Array:
    """Return the Jacobian (m, ...) after Broyden's rank-one update.

    Args:
        jacobian: (m, ...) before.
        move: (m,) step.
        change: (...) caused by the step.

    Returns:
        Jacobian (m, ...) that maps the step to the change.
    """
    missed = change - np.tensordot(move, jacobian, 1)
    result: Array = jacobian + np.multiply.outer(move / (move @ move), missed)
    return result


class SingleShooting:
    """Time-optimal slew of one arm between two equilibria, by single shooting.

    The torques at all knots are perturbed side by side in a Batch. Damped Gauss-Newton steps within the torque limits
    bring the tip into the band from an arrival time on, with Broyden's updates of the Jacobian (Mathematics of
    Computation 19, 1965, 577). The arrival time is reduced, starting from the last solution, until no solution is
    found.

    Args:
        regulator: LQR at the end; its model, limits and period are those of the arm.
        arms: function that returns a Batch with a given number of these arms.
        band: m around the target within which the tip counts as settled.
        rate: rad/s, largest motor rate.
        start: (n,) initial motor angles, rad.
        goal: (n,) final motor angles, rad.
    """

    def __init__(
        self, regulator: LQR, arms: Callable[[int], Batch], band: float, rate: float, start: Array, goal: Array
    ) -> None:
        self._max_rate = rate
        self._regulator, self._make_batch, self._band, self._ends = regulator, arms, band, (start, goal)
        self._batches: dict[int, Batch] = {}
        model = regulator.model
        self._start, self._rest = rest_state(model, start), rest_state(model, goal)
        self._holding_torques = np.array([holding_torques(model, posture) for posture in (start, goal)])
        self._gain, self._target = regulator.gain(goal), rest_tips(model, goal[None])[0]
        self._tail, self._stay = (round(time / regulator.period) for time in (TAIL_TIME, SETTLING_TIME))

    def search(self) -> _SlewTorques | None:
        """Return the fastest slew found; None if none settles."""
        torques = plan_slew(
            self._regulator.model, *self._ends, self._regulator.limits, TORQUE_SHARE, self._regulator.period
        )
        solution, best, part = (
            _SlewTorques(torques.torques, len(torques.torques), len(torques.torques)),
            None,
            SHORTER_FACTOR,
        )
        arrival = max(1, round(FIRST_FACTOR * solution.periods))
        for _ in range(MAX_DURATIONS):
            found = self._solve(self._rescale(solution, arrival), arrival)
            if found is not None:
                solution = best = found
                arrival = min(round(part * best.arrival), best.arrival - 1)
            elif best is None:
                arrival = int(np.ceil(LONGER_FACTOR * arrival))
            else:
                gap = best.arrival - arrival
                if gap <= max(1.0, DURATION_TOLERANCE * best.arrival):
                    break
                arrival, part = best.arrival - gap // 2, 0.5 + 0.5 * part
            if arrival < 1:
                break
        return best

    def errors(self, knots: Array, periods: int) -> Array:
        """Return the errors (r, T + W, 3 + n) at the ends of control periods for knots (r, K, n).

        These are the position error (3,) of the tip, m, and the motor rates as fractions of the largest.
        """
        limits, n = self._regulator.limits, len(self._regulator.limits)
        batch, rates = self._batch(len(knots)), self._regulator.model.n_dof + self._regulator.model.motor_columns
        result = np.empty((len(knots), periods + self._stay, 3 + n))
        drives = np.zeros((len(knots), periods, n + 6))
        drives[..., :n] = np.clip(_interpolate_torques(knots, periods) / limits, -1.0, 1.0) * limits
        states, read = batch.roll(drives)
        result[:, :periods, :3], result[:, :periods, 3:] = (
            read[..., TIP] - self._target,
            states[..., rates] / self._max_rate,
        )
        drive = np.zeros((len(knots), n + 6))
        for period in range(periods, periods + self._stay):
            torques = self._holding_torques[1] - row_dots(self._gain, (batch.state - self._rest)[:, None])
            drive[:, :n] = np.clip(torques / limits, -1.0, 1.0) * limits
            batch.step(drive)
            result[:, period, :3] = batch.outputs[:, TIP] - self._target
            result[:, period, 3:] = batch.state[:, rates] / self._max_rate
        result[batch.status != OK] = FAILURE_ERROR * self._band
        return result

    def _batch(self, count: int) -> Batch:
        if count not in self._batches:
            self._batches[count] = self._make_batch(count)
        self._batches[count].reset(np.arange(count), np.tile(self._start, (count, 1)))
        return self._batches[count]

    def _rescale(self, solution: _SlewTorques, arrival: int) -> Array:
        """Return the knots (K, n) of a slew with another arrival time.

        The inertial part of the torques scales with the square of the speed.
        """
        periods, limits, speed = arrival + self._tail, self._regulator.limits, solution.arrival / arrival
        times = np.linspace(0.0, periods, max(MIN_KNOTS, round(periods * self._regulator.period / KNOT_SPACING) + 1))
        own = np.linspace(0.0, solution.periods, len(solution.knots))
        torques = np.array([np.interp(speed * times, own, column) for column in solution.knots.T]).T
        holding = self._holding_torques[0] + np.minimum(times / arrival, 1.0)[:, None] * (
            self._holding_torques[1] - self._holding_torques[0]
        )
        return np.clip(holding + (torques - holding) * speed**2, -limits, limits)

    def _solve(self, knots: Array, arrival: int) -> _SlewTorques | None:
        """Return the slew whose tip stays within the band from the arrival on; None if the iteration fails."""
        periods, damping, reused, counted = arrival + self._tail, INITIAL_DAMPING, 0, 1
        errors, jacobian = self._jacobian(knots, periods)
        for _ in range(MAX_STEPS):
            outside = np.flatnonzero(np.linalg.norm(errors[:, :3], axis=1) > SETTLED_BAND * self._band)
            if outside.max(initial=-1) < arrival - 1 and np.abs(errors[:, 3:]).max() <= MAX_RATE:
                return _SlewTorques(knots, periods, int(outside.max(initial=-1)) + 2)
            tried = self._steps(knots, errors, jacobian, arrival, damping * DAMPING_FACTORS)
            candidate_errors = self.errors(tried, periods)
            costs = np.square(self._residuals(np.concatenate([candidate_errors, errors[None]]), arrival)).sum(axis=1)
            best = int(np.argmin(costs[:-1]))
            better = costs[best] < MAX_COST_RATIO * costs[-1]
            if better:
                move = ((tried[best] - knots) / self._regulator.limits).ravel()
                jacobian = broyden_update(jacobian, move, candidate_errors[best] - errors)
                knots, errors, reused = tried[best], candidate_errors[best], reused + 1
                damping = float(np.clip(damping * DAMPING_FACTORS[best], MIN_DAMPING, MAX_DAMPING))
            elif reused == 0:
                damping *= MAX_DAMPING
            if reused and (reused == BROYDEN_UPDATES or not better):
                errors, jacobian = self._jacobian(knots, periods)
                reused, counted = 0, counted + 1
            if damping > MAX_DAMPING**2 or counted > MAX_JACOBIANS:
                break
        return None

    def _jacobian(self, knots: Array, periods: int) -> tuple[Array, Array]:
        """Return the `errors` of knots and their Jacobian (K n, T + W, 3 + n), per fraction of the limits."""
        nudges = TORQUE_STEP * self._regulator.limits * np.eye(knots.size).reshape(-1, *knots.shape)
        errors = self.errors(np.concatenate([knots[None], knots + nudges]), periods)
        return errors[0], (errors[1:] - errors[0]) / TORQUE_STEP

    def _residuals(self, errors: Array, arrival: int) -> Array:
        """Return the residuals (r, ...) of `errors` (r, T + W, 3 + n), in bands.

        These are the distances beyond the inner band from the arrival on, in every second period, and rates near the
        limit.
        """
        late_errors, rates = errors[:, arrival - 1 :: 2, :3], errors[..., 3:]
        distances = np.linalg.norm(late_errors, axis=2, keepdims=True)
        candidate_errors = (
            late_errors * np.maximum(0.0, 1.0 - INNER_BAND * self._band / np.maximum(distances, TINY)) / self._band
        )
        fast = RATE_WEIGHT * (rates - np.clip(rates, -RATE_BOUND, RATE_BOUND))
        return np.concatenate([candidate_errors.reshape(len(errors), -1), fast.reshape(len(errors), -1)], axis=1)

    def _steps(self, knots: Array, errors: Array, jacobian: Array, arrival: int, dampings: Array) -> Array:
        """Return the knots (r, K, n) after a Gauss-Newton step with each damping (r,), within the torque limits."""
        from scipy.optimize import lsq_linear

        limits = self._regulator.limits
        both = self._residuals(
            np.concatenate([errors[None], errors + COST_DIFFERENCE_STEP * jacobian]), arrival
        ).reshape(len(jacobian) + 1, -1)
        slope = (both[1:] - both[0]) / COST_DIFFERENCE_STEP
        # in the eigenvectors of J J^T, so that each damping requires a small problem only
        squares, axes = np.linalg.eigh(slope @ slope.T)
        target, place = axes.T @ (slope @ both[0]), (knots / limits).ravel()
        bounds = -1.0 - ROUNDING - place, 1.0 + ROUNDING - place
        result = []
        for damping in dampings:
            scale = np.sqrt(np.maximum(squares, 0.0) + damping)
            step = lsq_linear(scale[:, None] * axes.T, -target / scale, bounds, method="bvls").x
            result.append(np.clip(knots + limits * step.reshape(knots.shape), -limits, limits))
        return np.array(result)


SHIPPED_TABLE = Path(__file__).parent / "tables" / "FlexRRR-v0.npz"  # seeds 9000 to 9099
POSTURE_TOLERANCE = 1e-9  # rad; between equal postures
ARM_TOLERANCE = 1e-9  # relative; between the numbers of one arm
COMMAND = "flexman optimise ENVIRONMENT --seeds FIRST COUNT --out FILE"
ENTRIES = ("about", "arm", "seeds", "ends", "periods", "times", "counts", "knots")


@dataclass
class SlewTable:
    """Optimised slews of one arm.

    Attributes:
        about: origin of the table: environment, method, model, command and so on, as texts, numbers and lists.
        arm: numbers that identify the arm, see `arm_fingerprint`.
        found: seed of an episode -> its start and goal (2, n) rad, its torques (knots, periods, arrival), and the
            settling time (s) of its replay in the environment; infinite if it did not settle.
    """

    about: Mapping[str, Any]
    arm: Array
    found: dict[int, tuple[Array, _SlewTorques, float]] = field(default_factory=dict)

    def torques(self, start: Array, goal: Array) -> Array:
        """Return the torques (T, n) of the slew between two postures (n,) rad, N m.

        Args:
            start: (n,) initial motor angles, rad.
            goal: (n,) final motor angles, rad.

        Returns:
            Torques (T, n), N m.

        Raises:
            ValueError: if the table has no such slew.
        """
        for ends, slew, _ in self.found.values():
            if ends.shape == (2, len(start)) and np.abs(ends - [start, goal]).max() <= POSTURE_TOLERANCE:
                return _interpolate_torques(slew.knots, slew.periods)
        allowed = f"start and goal of a slew in the table, or compute one: {COMMAND}"
        raise value_error("episode", [start.tolist(), goal.tolist()], allowed)

    def settling_time(self, seed: int) -> float:
        """Return the settling time (s) of the optimised slew of an episode.

        Args:
            seed: of the episode.

        Returns:
            Settling time, s.

        Raises:
            ValueError: if the table has no such episode.
        """
        if seed not in self.found:
            raise value_error("seed", seed, f"a seed in the table, or compute one: {COMMAND}")
        return self.found[seed][2]

    def check_arm(self, arm: Array) -> None:
        """Check that the table belongs to an arm.

        Args:
            arm: numbers from `arm_fingerprint`.

        Raises:
            ValueError: for another arm.
        """
        if arm.shape != self.arm.shape or not np.allclose(arm, self.arm, rtol=ARM_TOLERANCE, atol=0.0):
            about = self.about.get("environment")
            raise value_error(
                "table", about, f"a table of this arm, with its torque limits and control period: {COMMAND}"
            )

    def save(self, path: Path) -> None:
        """Write the table atomically."""
        rows = [self.found[seed] for seed in sorted(self.found)]
        partial = path.with_name(f"{path.name}.part")
        with partial.open("wb") as file:
            np.savez_compressed(
                file,
                about=np.array(json.dumps(dict(self.about))),
                arm=self.arm,
                seeds=np.array(sorted(self.found), dtype=np.int64),
                ends=np.array([ends for ends, _, _ in rows]),
                periods=np.array([(slew.periods, slew.arrival) for _, slew, _ in rows], dtype=np.int64),
                times=np.array([time for _, _, time in rows]),
                counts=np.array([len(slew.knots) for _, slew, _ in rows], dtype=np.int64),
                knots=np.concatenate([slew.knots for _, slew, _ in rows]) if rows else np.zeros((0, 1)),
            )
        partial.replace(path)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a table; no code in it is executed.

        Args:
            path: of the file.

        Returns:
            The table.

        Raises:
            FileNotFoundError: if there is no file.
            ValueError: for any other file.
        """
        try:
            with open_arrays(path, packed=True) as data:
                about, arm, seeds, ends, periods, times, counts, knots = (data[name] for name in ENTRIES)
            parts = np.split(knots, np.cumsum(counts))[:-1]
            rows = zip(seeds, ends, parts, periods, times, strict=True)
            slews = {
                int(seed): (both, _SlewTorques(part, *map(int, ages)), float(time))
                for seed, both, part, ages, time in rows
            }
            return cls(json.loads(str(about)), arm, slews)
        except FileNotFoundError:
            raise
        except READ_ERRORS as error:
            message = " ".join(str(error).split())[:MAX_VALUE_LENGTH] or type(error).__name__
            raise ValueError(
                f"{short_path(path)}: not a table of slews, as computed by {COMMAND} ({message})"
            ) from None


def arm_fingerprint(model: Model, limits: Array, period: float) -> Array:
    """Return numbers that identify an arm, whatever its discretisation.

    These are lengths, joint stiffnesses, rotor inertias, payload, gravity, torque limits and the control period.
    """
    constants = model.constants
    mass = np.atleast_1d(constants.payload_mass).ravel()
    parts = constants.length, constants.joint_stiffness, constants.rotor_inertia, mass, constants.gravity, limits
    return np.concatenate([*parts, [period]])


class OptimisedController(LQR):
    """Replay of the optimised torques of a slew, followed by an LQR about the goal.

    The episodes must be known in advance. No feedback controller can be expected to settle as fast.

    Args:
        table: slews of this arm.
        model: see `LQR`.
        torque_limit: see `LQR`.
        period: see `LQR`.

    Raises:
        ValueError: for arguments out of range and for a table of another arm; in `reset` for an episode missing in the
            table.
    """

    state_fields = ("_now",)

    def __init__(self, table: SlewTable, model: Model, torque_limit: float | Vector, period: float) -> None:
        super().__init__(model, torque_limit, period)
        table.check_arm(arm_fingerprint(self.model, self.limits, self.period))
        self._table, self._slews, self._now = table, list[Array](), np.zeros(0, dtype=np.int64)

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Look up the slews of the arms (r,)."""
        if episode.path is not None:
            raise value_error("episode", "a moving goal", "a fixed goal: slews are optimised for fixed goals only")
        found = [self._table.torques(*ends) for ends in zip(episode.start, episode.goal, strict=True)]
        super().reset(arms, episode, count)
        self._now = pad_rows(self._now, len(self._holding_torques))
        self._slews += [np.zeros((0, len(self.limits)))] * (len(self._holding_torques) - len(self._slews))
        for arm, torques in zip(arms.tolist(), found, strict=True):
            self._slews[arm], self._now[arm] = torques, 0

    def torques(self, states: Array) -> Array:
        """Return the torques (b, n) for states (b, 2 d), N m, and advance by a control period."""
        result = super().torques(states)
        for arm, now in enumerate(self._now.tolist()):
            if now < len(self._slews[arm]):
                result[arm] = self._slews[arm][now]
        self._now += 1
        return result
