"""Controller with an input shaper for its command."""

from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array, BoolArray, IntArray, Vector, pad_rows
from flexman_gym.common.checks import non_negative, sequence, value_error, vector, whole_number
from flexman_gym.control.controller import Controller, EpisodeInfo, Readings, checked_controller
from flexman_gym.control.input_shaping.shapers import (
    DEFAULT_TOLERANCE,
    Shaper,
    convolve_shapers,
    design_shaper,
    excited_modes,
    sample_shaper,
)
from flexman_gym.control.lqr import LQR
from flexman_gym.control.references.trajectories import TIMING_LAWS
from flexman_gym.model.model import Model, check_model
from flexman_gym.model.statics import rest_state, rest_tips

MAX_MODES = 2
REST_PERIODS = 40  # control periods at the goal at the end of a path, so that splines through it end at rest
ANGLE_QUANTITIES, RATE_QUANTITIES = ("angle_errors", "angle_command"), ("goal_rates", "rate_command")
TIP_QUANTITIES, TIP_RATE_QUANTITIES = ("target_error", "tip_command"), ("tip_velocity_command",)
SHIFTED_QUANTITIES = (*ANGLE_QUANTITIES, *RATE_QUANTITIES, *TIP_QUANTITIES, *TIP_RATE_QUANTITIES)
REFUSED_QUANTITIES = (
    "target_nearness",
    "fine_angle_errors",
    "fine_target_error",
    "preview",
)  # readings without a shaped form


class InputShapedController:
    """Controller whose goal command is convolved with the impulses of an input shaper, to avoid residual vibration.

    The command is a step from start to goal, a minimum-jerk motion, or the path of a moving goal. The inner controller
    gets the shaped command as `EpisodeInfo.reference` and in its readings of the goal: angle_errors, goal_rates,
    angle_command, rate_command, target_error, tip_command, tip_velocity_command. An LQR is designed for the goal of
    the reset and reads a state shifted by the same amount. A TrackingLQR requires a duration, since no arm follows a
    step.

    Shaping prevents vibration due to the command, not due to disturbances. The modes are those with held motors; a soft
    controller whose motors yield has other modes.

    Args:
        inner: any Controller.
        model: for modes and tip positions.
        shaper: name in `SHAPERS`.
        modes: number of lowest modes, 1 or 2; or one or two pairs of frequency (Hz) and damping ratio.
        places: path parameters from 0 to 1 over whose modes the mean is taken.
        duration: of the minimum-jerk motion before shaping, s; 0 for a step.
        tolerance: residual vibration tolerated by EI shapers, as a fraction.
    """

    state_fields = ("_now", "inner")

    def __init__(
        self,
        inner: Controller,
        model: Model,
        shaper: str = "zvd",
        modes: int | Array | list[tuple[float, float]] = 1,
        places: Vector = (1.0,),
        duration: float = 0.0,
        tolerance: float = DEFAULT_TOLERANCE,
    ) -> None:
        self.inner, self.model = checked_controller("InputShapedController.inner", inner), check_model(model)
        self.sensors = inner.sensors
        self._own = _parse_modes(modes) if isinstance(modes, list | tuple | np.ndarray) else None
        self._count = (
            whole_number("InputShapedController.modes", modes, 1, MAX_MODES) if self._own is None else len(self._own)
        )
        self.places, self.duration = (
            vector("InputShapedController.places", places),
            non_negative("InputShapedController.duration", duration, "s"),
        )
        if not all(0.0 <= place <= 1.0 for place in self.places):
            raise value_error("InputShapedController.places", places, "numbers from 0 to 1")
        for frequency, ratio in [(1.0, 0.0)] if self._own is None else self._own.tolist():
            design_shaper(shaper, frequency, ratio, tolerance)  # checks the arguments
        self.shaper, self.tolerance = shaper, tolerance
        self._commands: list[_Command] = []
        self._now = np.zeros(0, dtype=np.int64)

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Compute the shaped commands of the arms (r,), and start new episodes of the inner controller."""
        self._now = pad_rows(self._now, count)
        self._now[arms] = 0
        for row, arm in enumerate(arms.tolist()):
            start, goal = episode.start[row], episode.goal[row]
            path = None if episode.reference is None else episode.reference[row]
            command = self._command(start, goal, episode.period, path)
            self._commands += [command] * (arm + 1 - len(self._commands))
            self._commands[arm] = command
            self.inner.reset(np.array([arm]), EpisodeInfo(start[None], goal[None], episode.period, command.path), count)

    def act(self, readings: Readings, applied: Array, active: BoolArray) -> NDArray[Any]:
        """Return the actions (b, n) of the inner controller for the shaped command.

        Args:
            readings: as in `Controller.act`.
            applied: as in `Controller.act`.
            active: as in `Controller.act`.

        Returns:
            Actions (b, n).

        Raises:
            ValueError: for a reading of the goal that cannot be shaped.
        """
        shaped = dict(readings)
        for name, values in readings.items():
            if name in REFUSED_QUANTITIES:
                raise value_error(
                    "InputShapedController.inner",
                    f"a controller that reads {name}",
                    f"one that reads none of {REFUSED_QUANTITIES}",
                )
            if name in SHIFTED_QUANTITIES or (name == "state" and type(self.inner) is LQR):
                places = zip(self._commands, self._now.tolist(), strict=True)
                shaped[name] = values + np.array(
                    [command.move(name)[min(now, command.last)] for command, now in places]
                )
        self._now += active
        return self.inner.act(shaped, applied, active)

    def combined(self, postures: Array) -> Shaper:
        """Return the shaper of all shaped modes, averaged over postures (p, n) rad."""
        modes = self._own
        if modes is None:
            found = [excited_modes(self.model, posture)[: self._count, :2] for posture in postures]
            modes = np.mean([each[: min(map(len, found))] for each in found], axis=0)
        if not len(modes):
            raise value_error("InputShapedController.modes", self._count, "modes of a flexible arm: this arm has none")
        return reduce(
            convolve_shapers,
            [design_shaper(self.shaper, each, ratio, self.tolerance) for each, ratio in modes.tolist()],
        )

    def _command(self, start: Array, goal: Array, period: float, path: Array | None) -> "_Command":
        """Return the shaped command of one arm."""
        if path is None:
            count = int(np.ceil(self.duration / period)) + 1
            times = period * np.arange(count, dtype=np.float64)
            fractions = TIMING_LAWS["minimum-jerk"].at(times / self.duration)[0] if self.duration else np.ones(count)
            plain, before = start + fractions[:, None] * (goal - start), start
            postures = start + np.array(self.places)[:, None] * (goal - start)
        else:
            plain, before = path, path[0]
            postures = path[np.rint(np.array(self.places) * (len(path) - 1)).astype(int)]
        fractions = sample_shaper(self.combined(postures), period)
        if path is None:
            plain = np.vstack([plain, np.repeat(goal[None], len(fractions) + REST_PERIODS, axis=0)])
        rates = np.diff(plain, axis=0, prepend=plain[:1]) / period
        true = np.broadcast_to(goal, plain.shape) if path is None else path
        true_rates = np.zeros_like(rates) if path is None else rates
        return _Command(
            self.model,
            period,
            before + _convolve(fractions, plain - before),
            _convolve(fractions, rates),
            true,
            true_rates,
        )


class _Command:
    """Shaped command (K, n) of one arm, and the differences of readings between it and the true goal (K, n)."""

    def __init__(
        self, model: Model, period: float, angles: Array, rates: Array, true: Array, true_rates: Array
    ) -> None:
        self.angles, self.last = angles, len(angles) - 1
        self._model, self._period, self._true = model, period, true
        moves = dict.fromkeys(ANGLE_QUANTITIES, angles - true) | dict.fromkeys(RATE_QUANTITIES, rates - true_rates)
        self._moves: dict[str, Array] = moves

    def path(self) -> Array:
        """Return the shaped command of one arm as `EpisodeInfo.reference`."""
        return self.angles[None]

    def move(self, name: str) -> Array:
        """Return the offset (K, size) of a reading; those of states and tips are computed on first use."""
        if name == "state" and name not in self._moves:
            self._moves[name] = rest_state(self._model, self._true[:1]) - rest_state(self._model, self.angles)
        elif name not in self._moves:
            tips = rest_tips(self._model, self.angles) - rest_tips(self._model, self._true)
            rates = np.diff(tips, axis=0, prepend=tips[:1]) / self._period
            self._moves |= dict.fromkeys(TIP_QUANTITIES, tips) | dict.fromkeys(TIP_RATE_QUANTITIES, rates)
        return self._moves[name]


def _convolve(fractions: Array, values: Array) -> Array:
    """Return values (K, n), zero before, convolved with the fractions (m,) of a sampled shaper."""
    result = np.zeros_like(values)
    for delay, part in enumerate(fractions[: len(values)]):
        result[delay:] += part * values[: len(values) - delay]
    return result


def _parse_modes(value: object) -> Array:
    """Return given modes (k, 2) as frequencies (Hz) and damping ratios."""
    pairs = sequence("InputShapedController.modes", value, "pairs of frequency (Hz) and damping ratio")
    if not 1 <= len(pairs) <= MAX_MODES:
        raise value_error(
            "InputShapedController.modes", value, f"1 to {MAX_MODES} pairs of frequency (Hz) and damping ratio"
        )
    return np.array([vector(f"InputShapedController.modes[{i}]", pair, 2) for i, pair in enumerate(pairs)])
