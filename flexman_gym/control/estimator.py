"""Estimator: an observer that fits what is unknown of an arm to all that was read, by simulating the arm beside it."""

from collections.abc import Mapping, Sequence

import numpy as np

from flexman_gym.arrays import Array, Flags, IntArray, grown, row_dots
from flexman_gym.control.bases import Plant
from flexman_gym.control.controller import Episode, Readings
from flexman_gym.control.innovations import Innovations
from flexman_gym.control.instruments import make_instruments
from flexman_gym.control.observer import Estimate
from flexman_gym.control.slopes import Slopes
from flexman_gym.control.trials import Prior, Sweep, Trials, solved, step
from flexman_gym.control.unknowns import make_unknowns
from flexman_gym.model.statics import rest_states
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.readings import INSTRUMENTS

REPLAYS = (6, 12, 20, 30, 45, 65, 90, 130, 200, 300)  # control periods after which all is simulated again
DELAYS_UNTIL = 20  # at replays so early the delay is looked for
EVERY = 5  # periods after which the trials take over what was estimated
BIAS = 0.005  # of a range, up to which a biased instrument is off
HOMED = 1e-4  # rad, deviation of an angle at the start that is told
LOST = 100.0  # largest entry of a state of a trial that still says something
WINDOW = 0.1  # part of the last misfit in its mean
SPREAD = 0.5  # rad, by which trials may differ before they are drawn together
CHANGED, QUIET = 1.45, 25  # misfit above 1 that tells a change, in deviations of a period; periods without a look
BOUND = 10.0  # deviations, up to which an angle at the start is looked for


class Estimator:
    """Output-error observer: unknown parameters, angles at the start and delay are fitted to all readings so far.

    There is no process noise: what an arm does follows from its parameters, its start and the torques that were
    applied. Beside the arm as it is estimated move others with one unknown changed each. A recursive least-squares fit
    follows them, and now and then all is simulated again from the start with Levenberg-Marquardt steps, which removes
    the error of linearisation (Ljung, System Identification, 2nd ed., 1999, chapters 7 and 10).

    Args:
        plant: the arm, what is unknown of it, and how exact instruments are.
        sensors: names in `simulation.readings.INSTRUMENTS`.
        unknown: name -> (low, high), see `unknowns.make_unknowns`; None takes those of the plant.
        biased: whether each reading may be off by a constant of up to 0.5 % of its range. The angles at the start are
            then taken as they are told, for encoders that are off cannot tell them.

    Attributes:
        numbers: (b, p) what is estimated: unknowns, angles (rad) of the start against `_origin`, biases.
        delays: (b,) control periods.
        misfit: (b,) mean square of the last errors of readings, in deviations; 1 where all is as it was assumed.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    _arrays = (
        "numbers", "delays", "misfit", "_origin", "_states", "_information", "_change", "_ages", "_readings",
        "_torques", "_past", "_steps", "_apart", "_pushed",
    )  # fmt: skip
    kept = (*_arrays, "_innovations", "_beside", "_ahead")

    def __init__(
        self,
        plant: Plant,
        sensors: Sequence[str] = tuple(INSTRUMENTS),
        unknown: Mapping[str, tuple[float, float]] | None = None,
        biased: bool = False,
    ) -> None:
        self.sensors, self._plant = tuple(sensors), plant
        model, n = plant.model, plant.model.n_joints
        read = self._instruments = make_instruments(plant, self.sensors)
        unknowns = self.unknowns = make_unknowns(model, plant.unknown if unknown is None else unknown)
        trials = self._trials = Trials(model, (*plant.moved, plant.period), unknowns, read.matrix, biased)
        self._innovations = Innovations(Slopes(plant), read, plant.push)
        self._encoders = None if biased else read.places["motor_angles"]
        starts = np.full(n, HOMED) if self._encoders is None else read.deviations[self._encoders]
        biases = BIAS * read.ranges if biased else np.zeros(0)
        self._prior = Prior(
            np.concatenate([unknowns.mean, np.zeros(trials.size - len(unknowns.mean))]),
            np.concatenate([unknowns.deviation, starts, biases / np.sqrt(3.0)]),
            np.concatenate([unknowns.low, -BOUND * starts, -2.0 * biases]),
            np.concatenate([unknowns.high, BOUND * starts, 2.0 * biases]),
        )
        self._weights = np.tile(read.deviations**-2.0, (REPLAYS[-1] + 1, 1))
        if self._encoders is not None:
            self._weights[0, self._encoders] = 0.0  # from which the angles at the start come
        self._allocate()

    def _allocate(self) -> None:
        """Makes the memory of no arm."""
        (m, size), p, trials = self._trials.matrix.shape, self._trials.size, 1 + self._trials.moving
        n, late, rows = self._plant.model.n_joints, self._plant.delay[1], len(self._weights)
        self.numbers, self._change = np.zeros((0, p)), np.zeros((0, p))
        self.misfit, self._origin, self._states = np.zeros(0), np.zeros((0, size)), np.zeros((0, trials, size))
        self.delays, self._ages = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        self._information, self._readings = np.zeros((0, p, p)), np.zeros((0, rows, m))
        self._torques, self._past = np.zeros((0, late + rows, n)), np.zeros((0, late + 1, n))
        self._told, self._limits = np.zeros((0, n)), np.array(self._plant.torque_limit)
        self._steps = np.zeros((0, trials - 1))
        self._apart, self._pushed = np.zeros(0, dtype=bool), np.zeros(0, dtype=bool)
        self._beside: Batch | None = None
        self._ahead: Batch | None = None

    def reset(self, arms: IntArray, episode: Episode) -> None:
        """Starts new episodes of the arms (r,)."""
        count = int(arms.max(initial=-1)) + 1
        if count > len(self._ages):
            for name in (*self._arrays, "_told"):
                setattr(self, name, grown(getattr(self, name), count))
            self._innovations.grow(count)
            self._beside, self._ahead = self._trials.batch(count * self._states.shape[1]), self._trials.batch(count)
        self._ages[arms], self._told[arms] = 0, episode.start
        self._torques[arms] = self._past[arms] = 0.0

    def estimate(self, readings: Readings, applied: Array, playing: Flags) -> Estimate:
        """Gives what is known now; see `Observer`."""
        now = self._instruments.read(readings)
        fresh, later = (np.flatnonzero(playing & flags) for flags in (self._ages == 0, self._ages > 0))
        if len(fresh):
            self._begin(fresh, now[fresh])
        if len(later):
            self._advance(later, applied[later] * self._limits)
            kept = later[self._ages[later] < len(self._weights)]
            self._readings[kept, self._ages[kept]] = now[kept]
            again = np.isin(self._ages[later], REPLAYS) & ~self._apart[later] & ~self._pushed[later]
            for age in np.unique(self._ages[later[again]]).tolist():
                self._replay(later[again & (self._ages[later] == age)], age)
            self._recur(later[~again], now[later[~again]])
            much = 1.0 + CHANGED * np.sqrt(2.0 / now.shape[1])
            self._change_over(later[(self.misfit[later] > much) & (self._ages[later] > QUIET)])
        self._ages += playing
        return self._predicted(np.flatnonzero(playing))

    def _begin(self, arms: IntArray, now: Array) -> None:
        """Begins the fits of arms (r,) with their first readings (r, m)."""
        angles = self._told[arms] if self._encoders is None else now[:, self._encoders]
        self._origin[arms] = rest_states(self._plant.model, angles)
        self._readings[arms, 0], self.misfit[arms] = now, 1.0
        self.numbers[arms], self._change[arms] = self._prior.mean, 0.0
        self.delays[arms] = (sum(self._plant.delay) + 1) // 2
        self._states[arms] = self._trials.starts(self._origin[arms], self.numbers[arms])
        self._steps[arms], self._apart[arms] = self._trials.steps, False
        self._information[arms], self._pushed[arms] = np.eye(self._trials.size) / self._prior.deviation**2, False
        self._inform(arms)
        if self._plant.push:
            self._pushed[arms] = self._filtered(arms, sudden=False)

    def _change_over(self, arms: IntArray) -> None:
        """Lets arms (r,) that their fit explains no longer begin anew: a load was picked up, or something pushes."""
        if not len(arms):
            return
        known, states = len(self.unknowns.names), self._present(arms)
        self.numbers[arms] = np.clip(self.numbers[arms] + self._change[arms], self._prior.low, self._prior.high)
        self.numbers[arms, known : self._trials.moving], self._change[arms] = 0.0, 0.0
        self._states[arms], self._steps[arms] = states[:, None], self._trials.steps
        self._information[arms] = np.eye(self._trials.size) / self._prior.deviation**2
        self._ages[arms], self.misfit[arms], self._apart[arms] = 1, 1.0, True  # no start to which a replay goes back
        self._pushed[arms] = self._filtered(arms, sudden=True)
        self._inform(arms)

    def _filtered(self, arms: IntArray, sudden: bool) -> Flags:
        """Begins to correct the states of arms (r,) by their readings; says for which of them it can."""
        torques = self._past[arms, self.delays[arms]]
        return self._innovations.begin(arms, self._present(arms), torques, sudden)

    def _inform(self, arms: IntArray) -> None:
        """Gives the trials of arms (r,) the numbers as they are."""
        numbers, states, motors = self.numbers[arms], self._states[arms], self._plant.model.motor_columns
        spread = np.abs(states[:, 1:, motors] - states[:, :1, motors]).max(axis=2) / SPREAD
        far = spread > 1.0
        if far.any():
            part = np.where(far, 1.0 / np.maximum(spread, 1.0), 1.0)
            self._states[arms, 1:] = states[:, :1] + part[..., None] * (states[:, 1:] - states[:, :1])
            self._steps[arms] *= part
            self._apart[arms] |= far.any(axis=1)
        assert self._beside is not None and self._ahead is not None
        all_numbers = self._trials.changed(numbers, self._steps[arms]).reshape(-1, numbers.shape[1])
        self._beside.vary(self._rows(arms).ravel(), **self._trials.parameters(all_numbers))
        self._ahead.vary(arms, **self._trials.parameters(numbers))

    def _rows(self, arms: IntArray) -> IntArray:
        """The trials (r, 1 + s) of arms (r,)."""
        trials = self._states.shape[1]
        return arms[:, None] * trials + np.arange(trials)

    def _advance(self, arms: IntArray, torques: Array) -> None:
        """Moves the trials of arms (r,) by a period, and keeps the torques (r, n) that were asked for in it."""
        age, late = self._ages[arms], self._plant.delay[1]
        self._past[arms, 1:] = self._past[arms, :-1]
        self._past[arms, 0] = torques
        few = age <= len(self._weights)
        self._torques[arms[few], late + age[few] - 1] = torques[few]
        assert self._beside is not None
        rows = self._rows(arms)
        drive, moving = (
            np.zeros((len(self._beside.rows), len(self._limits) + 6)),
            np.zeros(len(self._beside.rows), bool),
        )
        drive[rows, : len(self._limits)] = self._past[arms, self.delays[arms]][:, None]
        moving[rows] = True
        self._beside.place(rows.ravel(), self._states[arms].reshape(rows.size, -1))
        self._beside.step(drive, None if moving.all() else moving)
        self._states[arms] = self._beside.state[rows]
        lost = arms[~(np.abs(self._states[arms]) < LOST).all(axis=(1, 2))]
        self._states[lost], self.misfit[lost] = self._origin[lost][:, None], LOST

    def _recur(self, arms: IntArray, now: Array) -> None:
        """Takes the readings (r, m) of arms (r,) into their fits."""
        slopes = self._trials.reading_slopes(self._trials.slopes(self._states[arms], self._steps[arms]))
        error = now - self._trials.read(self._states[arms, 0], self.numbers[arms])
        error -= row_dots(slopes, self._change[arms][:, None])
        certain = np.repeat(self._weights[-1:], len(arms), axis=0)
        pushed = self._pushed[arms]
        if pushed.any():
            certain[pushed] = 1.0 / self._innovations.variances(arms[pushed])
        weighted = (slopes * certain[..., None]).transpose(0, 2, 1)
        self._information[arms] += weighted @ slopes
        gradient = row_dots(weighted, error[:, None])
        self._change[arms] += solved(self._information[arms], gradient)
        self.misfit[arms] += WINDOW * ((error**2 * certain).mean(axis=1) - self.misfit[arms])
        if pushed.any():
            self._correct(arms[pushed], now[pushed])
        due = arms[self._ages[arms] % EVERY == 0]
        if len(due):
            self._shift(due)

    def _correct(self, arms: IntArray, now: Array) -> None:
        """Moves all trials of arms (r,) towards what was read (r, m), each by its own error."""
        states, numbers = self._states[arms], self._trials.changed(self.numbers[arms], self._steps[arms])
        error = now[:, None] - self._trials.read(
            states.reshape(-1, states.shape[2]), numbers.reshape(-1, numbers.shape[2])
        ).reshape(*states.shape[:2], -1)
        gain = self._innovations.gains(arms, states[:, 0], self._past[arms, self.delays[arms]])
        self._states[arms] = states + row_dots(gain[:, None], error[:, :, None])

    def _shift(self, arms: IntArray) -> None:
        """Lets the trials of arms (r,) take over what was estimated since they last did."""
        before = self.numbers[arms]
        self.numbers[arms] = np.clip(before + self._change[arms], self._prior.low, self._prior.high)
        moved = (self.numbers[arms] - before)[:, None, : self._trials.moving]
        self._states[arms] += row_dots(self._trials.slopes(self._states[arms], self._steps[arms]), moved)[:, None]
        self._change[arms] = 0.0
        self._inform(arms)

    def _replay(self, arms: IntArray, age: int) -> None:
        """Fits the numbers of arms (r,) to all readings since their start."""
        self.numbers[arms] = np.clip(self.numbers[arms] + self._change[arms], self._prior.low, self._prior.high)
        weights = np.broadcast_to(self._weights[: age + 1], (len(arms), age + 1, self._weights.shape[1]))
        fewest, late = self._plant.delay
        if late > fewest and age <= DELAYS_UNTIL:
            costs = [self._swept(arms, age, delay, weights).cost for delay in range(fewest, late + 1)]
            self.delays[arms] = fewest + np.nan_to_num(np.array(costs), nan=np.inf).argmin(axis=0)
        data = self._arrived(arms, age, self.delays[arms]), self._readings[arms, : age + 1], weights
        numbers, sweep = self._trials.fit(self._origin[arms], self.numbers[arms], self._prior, data)
        well = np.isfinite(sweep.cost) & (np.abs(sweep.states) < LOST).all(axis=(1, 2))
        if not well.all():  # the recursion goes on with them
            self._recur(arms[~well], self._readings[arms[~well], age])
        arms, numbers, sweep = arms[well], numbers[well], sweep.of(well)
        self.numbers[arms] = numbers
        self._states[arms], self._steps[arms] = sweep.states, self._trials.steps
        self._information[arms] = sweep.information + np.eye(self._trials.size) / self._prior.deviation**2
        self.misfit[arms] = sweep.cost / self._weights[: age + 1].size
        self._change[arms], _ = step(sweep, self.numbers[arms], self._prior)
        self._shift(arms)

    def _swept(self, arms: IntArray, age: int, delay: int, weights: Array) -> Sweep:
        """A simulation of arms (r,) from their start, with a delay."""
        torques = self._arrived(arms, age, np.full(len(arms), delay))
        return self._trials.sweep(
            self._origin[arms], self.numbers[arms], torques, self._readings[arms, : age + 1], weights
        )

    def _arrived(self, arms: IntArray, periods: int, delays: IntArray) -> Array:
        """Torques (r, k, n) that acted on arms (r,) in their first k periods."""
        return self._torques[arms[:, None], self._plant.delay[1] + np.arange(periods) - delays[:, None]]

    def _present(self, arms: IntArray) -> Array:
        """States (r, 2 d) of arms (r,) now, as they are estimated."""
        moved = self._change[arms][:, None, : self._trials.moving]
        result: Array = self._states[arms, 0]
        return result + row_dots(self._trials.slopes(self._states[arms], self._steps[arms]), moved)

    def _predicted(self, arms: IntArray) -> Estimate:
        """What is known of all arms when torques that the arms (r,) are asked for now begin to act."""
        states = self._states[:, 0].copy()
        states[arms] = self._present(arms)
        numbers = np.clip(self.numbers + self._change, self._prior.low, self._prior.high)
        assert self._ahead is not None
        drive, moving = np.zeros((len(states), len(self._limits) + 6)), np.zeros(len(states), dtype=bool)
        for period in range(int(self.delays[arms].max(initial=0))):
            lag = self.delays - 1 - period
            moving[:] = False
            moving[arms] = lag[arms] >= 0
            drive[:, : len(self._limits)] = self._past[np.arange(len(states)), np.maximum(lag, 0)]
            if period == 0:
                self._ahead.place(arms, states[arms])
            self._ahead.step(drive, moving)
        if self.delays[arms].any():
            states[arms] = self._ahead.state[arms]
        return Estimate(states, self.delays, self._trials.parameters(numbers))
