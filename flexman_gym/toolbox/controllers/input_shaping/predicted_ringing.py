"""Ringing of an arm predicted from its model, for input shaping without a record."""

from collections.abc import Sequence

import numpy as np

from flexman_gym.common.arrays import Vector
from flexman_gym.common.checks import non_negative
from flexman_gym.model.model import Model
from flexman_gym.simulation.physical_parameters import varied_model
from flexman_gym.toolbox.controllers.excited_modes import excited_modes
from flexman_gym.toolbox.identification.ring_down import MAX_DAMPING
from flexman_gym.toolbox.identification.ringing import DAMPING_DEVIATION, FREQUENCY_DEVIATION, Ringing

TINY_DAMPING = 1e-6  # damping ratio added to that of an arm, which may be undamped


def predicted_ringing(
    model: Model,
    posture: Vector,
    payloads: Sequence[float] | None = None,
    residual: float = 0.05,
    servo: float | None = None,
) -> Ringing:
    """Return the one or two modes of an arm at the end of a motion, with deviations that cover a range of payloads.

    A second mode belongs to them if it moves the tip by more than the allowed residual of the first one.

    Args:
        model: model of the arm.
        posture: (n,) motor angles at the end, rad.
        payloads: lowest and highest payload, kg; None for that of the model.
        residual: allowed residual vibration / vibration without a shaper.
        servo: bandwidth of position servos that hold the motors, Hz; None for motors that do not move.

    Raises:
        ValueError: for a negative payload, and for an arm without a vibration that its motors excite.
    """
    low, high = payloads or 2 * [float(model.constants.payload_mass[0])]
    found = []
    for mass in (0.5 * (low + high), low, high):
        loaded = varied_model(model, payload_mass=non_negative("payload_mass", mass, "kg"))
        modes = excited_modes(loaded, posture, servo=servo)
        found.append(modes[modes[:, 1] < MAX_DAMPING][:2])
    count = min(map(len, found))
    if count == 2 and found[0][1, 2] < residual * found[0][0, 2]:
        count = 1
    if not count:
        raise ValueError("the motors excite no vibration; there is nothing to shape")
    values = np.array([each[:count, :2] for each in found])
    values[..., 1] += TINY_DAMPING
    values[..., 0] *= np.sqrt(1.0 - values[..., 1] ** 2)
    ranges = np.hypot(np.ptp(values, axis=0) / (2.0 * values[0]), [FREQUENCY_DEVIATION, DAMPING_DEVIATION])
    frequencies, damping = values[0].T
    return Ringing(frequencies, damping, posture, deviation=ranges[:, 0], damping_deviation=ranges[:, 1])
