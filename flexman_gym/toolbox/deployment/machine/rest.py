"""Rest of an arm after a stop: speeds below which motors and tip are at rest, and the wait for it."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.metrics import BAND
from flexman_gym.model.dynamics import mass_matrix
from flexman_gym.model.model import Model
from flexman_gym.toolbox.deployment.machine.clock import Clock
from flexman_gym.toolbox.deployment.machine.machine import READ_INTERVAL, Machine

REST_SLEWS, MAX_SLEWS = 0.25, 6.0  # slew times; shortest time at rest, and longest wait for it
SILENT_STOP = 10  # multiple of `silence` after which a machine does not answer
REST = ("rest_seconds", "motor_rate", "tip_rest_seconds", "tip_speed")  # entries of the result of `RestWait`
DEVIATIONS = 6.0  # standard deviations of the noise of a speed, which is a magnitude


def noise_level(speeds: Array) -> float:
    """Return the level that measured speeds (k,) of an arm at rest do not exceed; nan for unknown speeds."""
    return float(speeds.mean() + DEVIATIONS * speeds.std())


def slew_seconds(model: Model, torque_limit: Array) -> float:
    """Return the time of the quickest slew by 1 rad of each motor of the rigid arm, with the slowest motor, s.

    The motors move one at a time, from rest to rest under their torque limits, in the posture at zero angles.
    """
    rigid = model.at_rest(np.eye(model.n_joints))[:, : model.n_dof]
    inertias = np.diag(rigid @ mass_matrix(model, np.zeros(2 * model.n_dof)) @ rigid.T)
    return float(2.0 * np.sqrt(inertias / torque_limit).max())


class RestSpeeds:
    """Speeds at which the tip moves by its band in the shortest time at rest: an arm below them is at rest.

    Args:
        model: model of the arm.
        torque_limit: (n,) torque limits, N m.

    Attributes:
        slew: time of a slew by 1 rad, s, see `slew_seconds`.
        tip: speed of the tip, m/s.
        motors: rate of a motor that moves the outstretched rigid arm at this speed, rad/s.
    """

    def __init__(self, model: Model, torque_limit: Array) -> None:
        reach = float(model.constants.length.sum())
        self.slew = slew_seconds(model, torque_limit)
        self.motors = BAND / (REST_SLEWS * self.slew)
        self.tip = reach * self.motors


class RestWait:
    """Wait for the rest of an arm after its stop.

    Args:
        speeds: speeds at rest.
        noise: largest rate of a motor (rad/s) and speed of the tip (m/s) in the readings of the braked arm; nan for a
            speed that is not measured.
        silence: control periods without readings after which an arm is stopped.
    """

    def __init__(self, speeds: RestSpeeds, noise: tuple[float, float], silence: int) -> None:
        self._speeds, self._silence = speeds, silence
        self._limits = np.array([speeds.motors, speeds.tip]) + np.nan_to_num(noise)
        self._known = np.isfinite(noise)

    def __call__(
        self, machine: Machine, clock: Clock, measure: Callable[[Mapping[str, Any]], tuple[float, float]]
    ) -> dict[str, float | None]:
        """Return the times from now to rest, s, and the last speeds; None for what is not known or not reached.

        Args:
            machine: machine that was ordered to stop.
            clock: clock of the machine.
            measure: function of readings that returns the largest motor rate (rad/s) and the speed of the tip (m/s).

        Returns:
            "rest_seconds" and "motor_rate" of the motors, "tip_rest_seconds" and "tip_speed".
        """
        begin = heard = clock.now()
        moved, rested, last = np.full(2, begin), ~self._known, np.full(2, np.nan)
        shortest, longest = REST_SLEWS * self._speeds.slew, MAX_SLEWS * self._speeds.slew
        silent = SILENT_STOP * self._silence * machine.period
        while not rested.all() and clock.now() < min(begin + longest + shortest, heard + silent):
            clock.wait(clock.now() + READ_INTERVAL)
            if (readings := machine.read()) is None:
                continue
            heard, last = clock.now(), np.array(measure(readings))
            moved[~(last <= self._limits)] = heard
            rested = (heard - moved >= shortest) | ~self._known
        times = [float(each - begin) if done else None for each, done in zip(moved, rested & self._known, strict=True)]
        speeds = [float(each) if np.isfinite(each) else None for each in last]
        return dict(zip(REST, (times[0], speeds[0], times[1], speeds[1]), strict=True))
