"""Optimised slews: single shooting for the shortest settling time, tables of the torques found, and their replay."""

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

KNOT_SPACING, TAIL_TIME, SETTLING_TIME = (
    0.1,
    0.2,
    1.0,
)  # s: between knots, of torques after the tip has arrived, and of the LQR behind them
MIN_KNOTS = 4  # knots
FIRST_FACTOR, SHORTER_FACTOR, LONGER_FACTOR, DURATION_TOLERANCE = (
    0.8,
    0.88,
    1.12,
    0.012,
)  # parts of a duration: tried first, then next, and given up at
MAX_DURATIONS, MAX_STEPS, MAX_JACOBIANS = 40, 60, 12
INNER_BAND, SETTLED_BAND = (
    0.6,
    0.995,
)  # of the band: errors below the first weigh nothing, and below the second it has settled
DAMPING_FACTORS, MIN_DAMPING, MAX_DAMPING, INITIAL_DAMPING = np.array([0.1, 1.0, 10.0, 100.0]), 1e-6, 1e3, 1e-2
MAX_COST_RATIO, BROYDEN_UPDATES = 0.9, 5  # of the cost, in a move that counts; such moves before slopes are taken anew
TORQUE_STEP = 0.005  # of the torque limits, for slopes
RATE_BOUND, MAX_RATE, RATE_WEIGHT = (
    0.97,
    0.99,
    50.0,
)  # parts of the largest rate, and bands for exceeding the first by all of it
FAILURE_ERROR = 1e3  # bands, where an arm that failed counts as being
COST_DIFFERENCE_STEP, TINY, ROUNDING = 1e-4, 1e-12, 1e-9  # a move in parts of the limits, m, and parts of the limits


class SlewTorques(NamedTuple):
    """Torques for T control periods, after which an LQR at the goal acts.

    knots: (K, n) N m, at equal intervals from the beginning to the end. periods: T. arrival: control periods after
    which the tip stays within the band.
    """

    knots: Array
    periods: int
    arrival: int


def interpolate_torques(knots: Array, periods: int) -> Array:
    """Gives torques (..., T, n) of control periods: those in their middles, on lines between knots (..., K, n)."""
    places = (np.arange(periods) + 0.5) / periods * (knots.shape[-2] - 1)
    lower = np.minimum(places.astype(int), knots.shape[-2] - 2)
    part = (places - lower)[:, None]
    result: Array = knots[..., lower, :] * (1.0 - part) + knots[..., lower + 1, :] * part
    return result


def broyden_update(slopes: Array, move: Array, change: Array) -> Array:
    """Gives slopes (m, ...) that map a move (m,) to the change (...) that it made, and moves across it as before."""
    missed = change - np.tensordot(move, slopes, 1)
    result: Array = slopes + np.multiply.outer(move / (move @ move), missed)
    return result


class SingleShooting:
    """A slew of one arm, from rest at motor angles (n,) rad to rest at others, whose torques are searched for.

    Single shooting: all torques at knots are nudged side by side in a Batch, and damped Gauss-Newton steps within the
    torque limits bring the tip into the band from some time on; slopes follow the moves after Broyden (Mathematics of
    Computation 19, 1965, 577). That time is then shortened, from the torques found last, until the steps fail.

    Args:
        regulator: for the end; its model, limits and period are those of the arm.
        arms: makes a Batch of so many such arms.
        band: m around the target, in which the tip has settled.
        rate: rad/s, which no motor may exceed.
        start: (n,) rad, motor angles at the beginning.
        goal: (n,) rad, motor angles at the end.
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

    def search(self) -> SlewTorques | None:
        """Gives the quickest slew found, None where none settles."""
        torques = plan_slew(
            self._regulator.model, *self._ends, self._regulator.limits, TORQUE_SHARE, self._regulator.period
        )
        known, best, part = (
            SlewTorques(torques.torques, len(torques.torques), len(torques.torques)),
            None,
            SHORTER_FACTOR,
        )
        arrival = max(1, round(FIRST_FACTOR * known.periods))
        for _ in range(MAX_DURATIONS):
            found = self._solve(self._rescale(known, arrival), arrival)
            if found is not None:
                known = best = found
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
        """Gives what is to be small (r, T + W, 3 + n) at the ends of control periods, for knots (r, K, n).

        The tip's way from the target, m, and the rates of the motors, parts of the largest.
        """
        limits, n = self._regulator.limits, len(self._regulator.limits)
        batch, rates = self._batch(len(knots)), self._regulator.model.n_dof + self._regulator.model.motor_columns
        result = np.empty((len(knots), periods + self._stay, 3 + n))
        drives = np.zeros((len(knots), periods, n + 6))
        drives[..., :n] = np.clip(interpolate_torques(knots, periods) / limits, -1.0, 1.0) * limits
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

    def _rescale(self, known: SlewTorques, arrival: int) -> Array:
        """Knots (K, n) of a slew that arrives at another time: what moves the arm goes with the square of the speed."""
        periods, limits, speed = arrival + self._tail, self._regulator.limits, known.arrival / arrival
        times = np.linspace(0.0, periods, max(MIN_KNOTS, round(periods * self._regulator.period / KNOT_SPACING) + 1))
        own = np.linspace(0.0, known.periods, len(known.knots))
        torques = np.array([np.interp(speed * times, own, column) for column in known.knots.T]).T
        held = self._holding_torques[0] + np.minimum(times / arrival, 1.0)[:, None] * (
            self._holding_torques[1] - self._holding_torques[0]
        )
        return np.clip(held + (torques - held) * speed**2, -limits, limits)

    def _solve(self, knots: Array, arrival: int) -> SlewTorques | None:
        """Moves knots until the tip is within the band from its arrival on; None where no move helps."""
        periods, damping, reused, counted = arrival + self._tail, INITIAL_DAMPING, 0, 1
        errors, slopes = self._jacobian(knots, periods)
        for _ in range(MAX_STEPS):
            outside = np.flatnonzero(np.linalg.norm(errors[:, :3], axis=1) > SETTLED_BAND * self._band)
            if outside.max(initial=-1) < arrival - 1 and np.abs(errors[:, 3:]).max() <= MAX_RATE:
                return SlewTorques(knots, periods, int(outside.max(initial=-1)) + 2)
            tried = self._steps(knots, errors, slopes, arrival, damping * DAMPING_FACTORS)
            ways = self.errors(tried, periods)
            costs = np.square(self._residuals(np.concatenate([ways, errors[None]]), arrival)).sum(axis=1)
            best = int(np.argmin(costs[:-1]))
            better = costs[best] < MAX_COST_RATIO * costs[-1]
            if better:
                move = ((tried[best] - knots) / self._regulator.limits).ravel()
                slopes = broyden_update(slopes, move, ways[best] - errors)
                knots, errors, reused = tried[best], ways[best], reused + 1
                damping = float(np.clip(damping * DAMPING_FACTORS[best], MIN_DAMPING, MAX_DAMPING))
            elif reused == 0:
                damping *= MAX_DAMPING
            if reused and (reused == BROYDEN_UPDATES or not better):
                errors, slopes = self._jacobian(knots, periods)
                reused, counted = 0, counted + 1
            if damping > MAX_DAMPING**2 or counted > MAX_JACOBIANS:
                break
        return None

    def _jacobian(self, knots: Array, periods: int) -> tuple[Array, Array]:
        """The `errors` of knots, and how they change (K n, T + W, 3 + n) with each knot, in parts of its limit."""
        nudges = TORQUE_STEP * self._regulator.limits * np.eye(knots.size).reshape(-1, *knots.shape)
        errors = self.errors(np.concatenate([knots[None], knots + nudges]), periods)
        return errors[0], (errors[1:] - errors[0]) / TORQUE_STEP

    def _residuals(self, errors: Array, arrival: int) -> Array:
        """What of `errors` (r, T + W, 3 + n) is too large, (r, ...) in bands.

        Ways beyond the inner band from an arrival on, in every other period, and rates that are near the largest.
        """
        late, rates = errors[:, arrival - 1 :: 2, :3], errors[..., 3:]
        distances = np.linalg.norm(late, axis=2, keepdims=True)
        ways = late * np.maximum(0.0, 1.0 - INNER_BAND * self._band / np.maximum(distances, TINY)) / self._band
        fast = RATE_WEIGHT * (rates - np.clip(rates, -RATE_BOUND, RATE_BOUND))
        return np.concatenate([ways.reshape(len(errors), -1), fast.reshape(len(errors), -1)], axis=1)

    def _steps(self, knots: Array, errors: Array, slopes: Array, arrival: int, dampings: Array) -> Array:
        """Knots (r, K, n) after a Gauss-Newton step with each damping (r,), none beyond the torque limits."""
        from scipy.optimize import lsq_linear

        limits = self._regulator.limits
        both = self._residuals(np.concatenate([errors[None], errors + COST_DIFFERENCE_STEP * slopes]), arrival).reshape(
            len(slopes) + 1, -1
        )
        slope = (both[1:] - both[0]) / COST_DIFFERENCE_STEP
        # in the axes of the squares, so that each damping costs a small problem only
        squares, axes = np.linalg.eigh(slope @ slope.T)
        wanted, place = axes.T @ (slope @ both[0]), (knots / limits).ravel()
        bounds = -1.0 - ROUNDING - place, 1.0 + ROUNDING - place
        result = []
        for damping in dampings:
            scale = np.sqrt(np.maximum(squares, 0.0) + damping)
            step = lsq_linear(scale[:, None] * axes.T, -wanted / scale, bounds, method="bvls").x
            result.append(np.clip(knots + limits * step.reshape(knots.shape), -limits, limits))
        return np.array(result)


SHIPPED_TABLE = Path(__file__).parent / "tables" / "FlexRRR-v0.npz"  # seeds 9000 to 9099
POSTURE_TOLERANCE, ARM_TOLERANCE = (
    1e-9,
    1e-9,
)  # rad between postures that are the same, and of the numbers of an arm relative to them
COMMAND = "flexman optimise ENVIRONMENT --seeds FIRST COUNT --out FILE"
ENTRIES = ("about", "arm", "seeds", "ends", "periods", "times", "counts", "knots")


@dataclass
class SlewTable:
    """Optimised slews of one arm.

    Attributes:
        about: what it was made with: environment, method, model, command and so on; texts, numbers and lists.
        arm: numbers by which the arm is known, see `arm_fingerprint`.
        found: seed of an episode -> its start and goal (2, n) rad, the Slew, and the settling time (s) of its replay in
            the environment, infinite where it did not settle.
    """

    about: Mapping[str, Any]
    arm: Array
    found: dict[int, tuple[Array, SlewTorques, float]] = field(default_factory=dict)

    def torques(self, start: Array, goal: Array) -> Array:
        """Gives the torques (T, n) N m of the slew between two postures (n,) rad.

        Raises:
            ValueError: where there is none.
        """
        for ends, slew, _ in self.found.values():
            if ends.shape == (2, len(start)) and np.abs(ends - [start, goal]).max() <= POSTURE_TOLERANCE:
                return interpolate_torques(slew.knots, slew.periods)
        allowed = f"a start and a goal that the table has, or make one: {COMMAND}"
        raise value_error("episode", [start.tolist(), goal.tolist()], allowed)

    def settling_time(self, seed: int) -> float:
        """Gives the settling time (s) of the optimised slew of an episode.

        Raises:
            ValueError: for an episode that the table does not have.
        """
        if seed not in self.found:
            raise value_error("seed", seed, f"one that the table has, or make one: {COMMAND}")
        return self.found[seed][2]

    def check_arm(self, arm: Array) -> None:
        """Refuses a table of another arm.

        Raises:
            ValueError: one line.
        """
        if arm.shape != self.arm.shape or not np.allclose(arm, self.arm, rtol=ARM_TOLERANCE, atol=0.0):
            about = self.about.get("environment")
            raise value_error("table", about, f"one of this arm, with its torque limits and control period: {COMMAND}")

    def save(self, path: Path) -> None:
        """Writes it, whole or not at all."""
        rows = [self.found[seed] for seed in sorted(self.found)]
        beside = path.with_name(f"{path.name}.part")
        with beside.open("wb") as file:
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
        beside.replace(path)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Reads a table; nothing in it is run.

        Raises:
            FileNotFoundError: where there is no such file.
            ValueError: for a file that is none.
        """
        try:
            with open_arrays(path, packed=True) as data:
                about, arm, seeds, ends, periods, times, counts, knots = (data[name] for name in ENTRIES)
            parts = np.split(knots, np.cumsum(counts))[:-1]
            rows = zip(seeds, ends, parts, periods, times, strict=True)
            slews = {
                int(seed): (both, SlewTorques(part, *map(int, ages)), float(time))
                for seed, both, part, ages, time in rows
            }
            return cls(json.loads(str(about)), arm, slews)
        except FileNotFoundError:
            raise
        except READ_ERRORS as error:
            said = " ".join(str(error).split())[:MAX_VALUE_LENGTH] or type(error).__name__
            raise ValueError(f"{short_path(path)}: it is no table of slews, which {COMMAND} makes ({said})") from None


def arm_fingerprint(model: Model, limits: Array, period: float) -> Array:
    """Gives what tells arms apart however finely they are modelled: lengths, springs, rotors, load, weight, motors."""
    constants = model.constants
    mass = np.atleast_1d(constants.payload_mass).ravel()
    parts = constants.length, constants.joint_stiffness, constants.rotor_inertia, mass, constants.gravity, limits
    return np.concatenate([*parts, [period]])


class OptimisedController(LQR):
    """Replays the torques of a slew that a search found, then regulates the whole state about the goal.

    It knows its episodes beforehand, and nothing that acts on what it sees can be expected to be as quick.

    Args:
        table: of slews, of this arm.
        model: see `LQR`.
        torque_limit: see `LQR`.
        period: see `LQR`.

    Raises:
        ValueError: one line with field, value and what is allowed; also for a table of another arm, and in `reset` for
            an episode that the table does not have.
    """

    state_fields = ("_now",)

    def __init__(self, table: SlewTable, model: Model, torque_limit: float | Vector, period: float) -> None:
        super().__init__(model, torque_limit, period)
        table.check_arm(arm_fingerprint(self.model, self.limits, self.period))
        self._table, self._slews, self._now = table, list[Array](), np.zeros(0, dtype=np.int64)

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Looks up the slews of the arms (r,)."""
        if episode.path is not None:
            raise value_error("episode", "a goal that moves", "one that stays, for which slews are optimised")
        found = [self._table.torques(*ends) for ends in zip(episode.start, episode.goal, strict=True)]
        super().reset(arms, episode, count)
        self._now = pad_rows(self._now, len(self._held))
        self._slews += [np.zeros((0, len(self.limits)))] * (len(self._held) - len(self._slews))
        for arm, torques in zip(arms.tolist(), found, strict=True):
            self._slews[arm], self._now[arm] = torques, 0

    def torques(self, states: Array) -> Array:
        """Gives torques (b, n) N m for states (b, 2 d), and moves on by a period."""
        result = super().torques(states)
        for arm, now in enumerate(self._now.tolist()):
            if now < len(self._slews[arm]):
                result[arm] = self._slews[arm][now]
        self._now += 1
        return result
