"""Faults of a simulated machine: readings that are wrong, and packets that are late, too many or too few."""

from collections.abc import Callable

import numpy as np

from flexman_gym.common.arrays import Array

Readings = dict[str, Array]

LATE = 2.5  # control periods by which the fault "late" delays readings
LOSSY = 5  # packets of which the fault "lossy" loses all but one, in both directions
JUMP = 50.0  # control periods by which the fault "clock jumps" advances the clock
TORQUE = 2000.0  # torque limits; reading of the fault "torque"
BIAS = 0.25  # rad; change of the readings in the fault "bias"
CLOCK_RATE = 2.0  # rate of the clock in the fault "clock drifts"


def _not_a_number(now: Readings, _: Readings, __: Array) -> None:
    now["motor_angles"][0] = np.nan


def _freeze(now: Readings, first: Readings, _: Array) -> None:
    now.update({name: values.copy() for name, values in first.items()})


def _freeze_encoders(now: Readings, first: Readings, _: Array) -> None:
    now.update({name: first[name].copy() for name in now if name.startswith("motor")})


def _freeze_joint(now: Readings, first: Readings, _: Array) -> None:
    for name, values in now.items():
        if name.startswith("motor"):
            values[-1] = first[name][-1]


def _flip_rates(now: Readings, _: Readings, __: Array) -> None:
    now["motor_rates"] *= -1.0


def _shift(now: Readings, _: Readings, __: Array) -> None:
    now["motor_angles"] += BIAS


def _degrees(now: Readings, _: Readings, __: Array) -> None:
    for name, values in now.items():
        if name.startswith("motor"):
            np.rad2deg(values, out=values)


def _swap(now: Readings, _: Readings, __: Array) -> None:
    for name, values in now.items():
        if name.startswith("motor"):
            values[:] = values[::-1].copy()


def _torque(now: Readings, _: Readings, limits: Array) -> None:
    now["torques"][0] = TORQUE * limits[0]


# name -> function that changes readings now, given those at the time of the fault and the torque limits (n,), N m
VALUE_FAULTS: dict[str, Callable[[Readings, Readings, Array], None]] = {
    "nan": _not_a_number,
    "frozen": _freeze,
    "frozen encoders": _freeze_encoders,
    "frozen joint": _freeze_joint,
    "rates reversed": _flip_rates,
    "bias": _shift,
    "degrees": _degrees,
    "joints swapped": _swap,
    "torque": _torque,
}
# faults of the packets, see `server.MachineServer`
PACKET_FAULTS = (
    "kill", "silent", "replay", "late", "fast", "slow", "lossy", "clock stands", "clock jumps", "clock drifts",
)  # fmt: skip
FAULTS = (*PACKET_FAULTS, *VALUE_FAULTS)
