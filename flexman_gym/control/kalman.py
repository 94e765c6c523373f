"""Kalman: an observer that filters noisy readings of arms, with the simulator as its predictor."""

from collections.abc import Sequence

import numpy as np

from flexman_gym.arrays import Array, Flags, IntArray, grown, row_dots
from flexman_gym.checks import non_negative, refusal
from flexman_gym.control.bases import Plant
from flexman_gym.control.controller import Episode, Readings
from flexman_gym.control.instruments import make_instruments
from flexman_gym.control.observer import Estimate
from flexman_gym.control.riccati import corrected, predicted, stationary
from flexman_gym.control.slopes import Slopes
from flexman_gym.model.statics import holding_torques, rest_states
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.readings import INSTRUMENTS

TORQUE = 0.02  # of the torque limits, deviation of torques that nobody knows of, new in each period
OFFSET, DRIFT = 0.1, 0.05  # of the torque limits, deviation of a constant torque at first; and what a second adds to it
BIAS, LASTING = 0.005, 30.0  # of a range, up to which a reading is off; s, for which it keeps that
EVERY = 5  # control periods between two looks at the slopes of the motion


class KalmanFilter:
    """Extended Kalman filter: the simulator predicts the state, readings correct it by their errors.

    How exact an estimate is, a covariance, follows the slopes of the simulated motion; that of an arm at its start is
    the one to which a long rest would lead. Unknown torques on the motors are the noise of the process. Beside the
    state it may estimate constants: torques on the motors, which a law then takes away (integral action), and the
    biases of readings (Anderson and Moore, Optimal Filtering, 1979, chapters 3, 8 and 9).

    An arm is at rest at its start, where its encoders say. Of a delay that is not known the middle is taken.

    Args:
        plant: the arm, the delay of torques, and how exact instruments are.
        sensors: names in `simulation.readings.INSTRUMENTS`, "motor_encoders" among them.
        noise: deviation of the unknown torques, a part of the torque limits.
        disturbed: whether constant torques on the motors are estimated.
        biased: whether each reading may be off by a constant of up to 0.5 % of its range.
        fixed: whether the gain is the stationary one at the goal throughout an episode, which takes less time and suits
            arms that stay near.

    Attributes:
        states: (b, s) state, constant torques (N m) and biases as they are estimated at the last readings.
        covariance: (b, s, s) of their errors; it stays that of the start where the gain is fixed.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    kept = ("states", "covariance", "_transition", "_noise", "_past", "_ages")

    def __init__(
        self,
        plant: Plant,
        sensors: Sequence[str] = tuple(INSTRUMENTS),
        noise: float = TORQUE,
        disturbed: bool = False,
        biased: bool = False,
        fixed: bool = False,
    ) -> None:
        self.sensors, self._plant, self._fixed = tuple(sensors), plant, fixed
        self._instruments = read = make_instruments(plant, sensors)
        n, limits = plant.model.n_joints, np.array(plant.torque_limit)
        self._size, self._limits = 2 * plant.model.n_dof, limits
        self._variances, self._torque_variances = read.deviations**2, (non_negative("noise", noise) * limits) ** 2
        offsets, biases = disturbed * n, biased * len(read.ranges)
        self._matrix = np.hstack([read.matrix, np.zeros((len(read.matrix), offsets)), np.eye(len(read.matrix), biases)])
        self._offsets = slice(self._size, self._size + offsets)
        kept, bias = np.exp(-plant.period / LASTING), (BIAS * read.ranges[:biases]) ** 2 / 3.0
        self._keeping = np.concatenate([np.ones(offsets), np.full(biases, kept)])
        self._spread = np.concatenate([(OFFSET * limits[:offsets]) ** 2, bias])  # of the constants at the start
        drift = (DRIFT * limits[:offsets]) ** 2 * plant.period
        self._drift = np.concatenate([drift, (1.0 - kept**2) * bias])  # of a period
        self.delay, self._slopes = (sum(plant.delay) + 1) // 2, Slopes(plant)
        self._allocate()

    def _allocate(self) -> None:
        """Makes the memory of no arm."""
        s, m = self._matrix.shape[1], len(self._matrix)
        self.states, self._past = np.zeros((0, s)), np.zeros((0, self.delay + 1, len(self._limits)))
        self.covariance, self._transition, self._noise = (np.zeros((0, s, s)) for _ in range(3))
        self._ages, self._gain = np.zeros(0, dtype=np.int64), np.zeros((0, s, m))
        self._ahead: Batch | None = None

    def reset(self, arms: IntArray, episode: Episode) -> None:
        """Starts new episodes of the arms (r,)."""
        count = int(arms.max(initial=-1)) + 1
        if count > len(self._ages):
            for name in (*self.kept, "_gain"):
                setattr(self, name, grown(getattr(self, name), count))
            self._ahead = Batch(self._plant.model, *self._plant.moved, self._plant.period, arms=count)
        self._ages[arms] = 0
        self.states[arms] = self._past[arms] = 0.0
        if self._fixed:
            transition, noise = self._system(*self._rest(episode.goal))
            covariance = self._settled(transition, noise, self._matrix)
            self._gain[arms] = corrected(covariance, self._matrix, self._variances)[0]

    def _rest(self, postures: Array) -> tuple[Array, Array]:
        """States (r, 2 d) at rest at postures (r, n) rad, and the torques (r, n) N m that hold them."""
        model = self._plant.model
        return rest_states(model, postures), np.array([holding_torques(model, each) for each in postures])

    def _system(self, states: Array, torques: Array) -> tuple[Array, Array]:
        """Transition and noise (r, s, s) of a period, of all that is estimated; NaN where an arm does not go on."""
        slopes, good = self._slopes(states, torques)
        size, s = self._size, self._matrix.shape[1]
        transition, noise, inputs = np.zeros((len(states), s, s)), np.zeros((len(states), s, s)), slopes[..., size:]
        transition[:, :size, :size], transition[:, :size, self._offsets] = slopes[..., :size], inputs[
            ..., : self._offsets.stop - size
        ]
        noise[:, :size, :size] = (inputs * self._torque_variances) @ inputs.mT
        each = np.arange(size, s)
        transition[:, each, each], noise[:, each, each] = self._keeping, self._drift
        transition[~good] = np.nan
        return transition, noise

    def _settled(self, transition: Array, noise: Array, matrix: Array) -> Array:
        """The stationary covariance before readings.

        Raises:
            ValueError: for instruments that do not tell the state.
        """
        result = stationary(transition, noise, matrix, self._variances)
        if not np.isfinite(result).all():
            raise refusal("sensors", self.sensors, "ones that tell where the arm is")
        return result

    def estimate(self, readings: Readings, applied: Array, playing: Flags) -> Estimate:
        """Gives what is known now; see `Observer`."""
        now = self._instruments.read(readings)
        fresh, later = (np.flatnonzero(playing & flags) for flags in (self._ages == 0, self._ages > 0))
        if len(fresh):
            self._begin(fresh, now[fresh])
        if len(later):
            self._past[later, 1:] = self._past[later, :-1]
            self._past[later, 0] = applied[later] * self._limits
            self._follow(later)
            self._correct(later, now[later])
        self._ages += playing
        ahead, arms = self.states[:, : self._size].copy(), np.flatnonzero(playing)
        for late in range(self.delay - 1, -1, -1):
            ahead[arms] = self._moved(arms, ahead[arms], self._past[arms, late])
        disturbance = np.zeros_like(applied)
        disturbance[:, : self._offsets.stop - self._size] = self.states[:, self._offsets]
        return Estimate(ahead, np.full(len(ahead), self.delay), {}, disturbance)

    def _begin(self, arms: IntArray, now: Array) -> None:
        """Begins with the first readings (r, m) of arms (r,)."""
        places, size, model = self._instruments.places["motor_angles"], self._size, self._plant.model
        self.states[arms, :size], held = self._rest(now[:, places])
        transition, noise = self._system(self.states[arms, :size], held)
        covariance = np.zeros_like(transition)
        core = slice(0, size)
        covariance[:, core, core] = self._settled(transition[:, core, core], noise[:, core, core], self._matrix[:, core])
        turn = np.eye(size)[: model.n_joints]
        turn[np.arange(model.n_joints), model.motor_columns] = 1.0
        covariance[:, core, core] += (turn.T * self._variances[places]) @ turn
        each = np.arange(size, covariance.shape[1])
        covariance[:, each, each] = self._spread
        self.covariance[arms], self._transition[arms], self._noise[arms] = covariance, transition, noise

    def _follow(self, arms: IntArray) -> None:
        """Moves arms (r,) on through the period that is over."""
        acted = self._past[arms, self.delay]
        if not self._fixed:
            due = arms[self._ages[arms] % EVERY == 0]
            if len(due):
                torques = self._past[due, self.delay] + self._offset(due)
                transition, noise = self._system(self.states[due, : self._size], torques)
                good = np.isfinite(transition).all(axis=(1, 2))
                self._transition[due[good]], self._noise[due[good]] = transition[good], noise[good]
            self.covariance[arms] = predicted(self.covariance[arms], self._transition[arms], self._noise[arms])
        self.states[arms, : self._size] = self._moved(arms, self.states[arms, : self._size], acted)
        self.states[arms, self._size :] *= self._keeping

    def _offset(self, arms: IntArray) -> Array:
        """Constant torques on the motors of arms (r,), as they are estimated."""
        return self.states[arms, self._offsets] if self._offsets.stop > self._size else np.zeros(len(self._limits))

    def _moved(self, arms: IntArray, states: Array, torques: Array) -> Array:
        """States (r, 2 d) of arms (r,) a period after some, under torques (r, n) N m that are asked for."""
        assert self._ahead is not None
        count, n = len(self._ahead.rows), len(self._limits)
        drive, moving = np.zeros((count, n + 6)), np.zeros(count, dtype=bool)
        drive[arms, :n], moving[arms] = torques + self._offset(arms), True
        self._ahead.place(arms, states)
        self._ahead.step(drive, moving)
        return self._ahead.state[arms]

    def _correct(self, arms: IntArray, now: Array) -> None:
        """Takes the readings (r, m) of arms (r,) into account."""
        error = now - row_dots(self._matrix, self.states[arms][:, None])
        if self._fixed:
            gain = self._gain[arms]
        else:
            gain, self.covariance[arms] = corrected(self.covariance[arms], self._matrix, self._variances)
        self.states[arms] += row_dots(gain, error[:, None])
