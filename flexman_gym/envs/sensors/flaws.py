"""Flaws of an instrument: fractions of its measurement range, or amounts with units as in a data sheet."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import non_negative, set_fields, whole_number
from flexman_gym.common.errors import value_error
from flexman_gym.common.units import UNITS, find_unit

MIN_QUANTISATION = 1e-12  # fraction of the range; smallest quantisation step
MAX_PERIODS = 1000  # control periods; largest delay, and longest time between two samples
AMOUNTS = ("noise", "quantisation", "bias")  # flaws that may have a unit
AMOUNT = re.compile(r"^\s*([0-9.]+(?:[eE][-+]?[0-9]+)?)\s+(\S.*?)\s*$")
COUNTS = ("counts", "counts/turn", "counts/rev", "cpr")  # of an encoder in a turn
STRAIN_UNITS = ("1", "m/m")  # of strains


@dataclass(frozen=True, eq=False)
class Flaws:
    """Flaws of an instrument.

    Noise, bias and quantisation are fractions of the measurement range of each quantity, or texts with a unit as in a
    data sheet, such as "0.2 mrad", "2 microstrain", "0.01 m/s^2" or, for the quantisation of an encoder, "4096 counts"
    in a turn of its shaft, for motor angles that of the motor in front of the gear. An amount with a unit concerns the
    measured quantities with this unit.

    Attributes:
        noise: standard deviation of the normal noise on each sample; truncated at 4 standard deviations.
        bias: largest magnitude of the bias; the bias is drawn uniformly once per episode.
        quantisation: quantisation step.
        delay: control periods until a sample arrives; before the first arrival the first sample is read.
        every: control periods between two samples.
        dropped: probability of losing a sample, in whose place the previous sample is read.
    """

    noise: float | str = 0.0
    bias: float | str = 0.0
    quantisation: float | str = 0.0
    delay: int = 0
    every: int = 1
    dropped: float = 0.0

    def __post_init__(self) -> None:
        for name in ("noise", "bias", "quantisation", "dropped"):
            value: Any = getattr(self, name)
            if isinstance(value, str) and name != "dropped":
                _amount(name, value)
                continue
            part = non_negative(f"sensors.{name}", value)
            if part > 1.0:
                raise value_error(f"sensors.{name}", part, "a fraction from 0 to 1")
            set_fields(self, **{name: part})
        if not isinstance(self.quantisation, str) and 0.0 < self.quantisation < MIN_QUANTISATION:
            raise value_error(
                "sensors.quantisation", self.quantisation, f"0, or a fraction from {MIN_QUANTISATION:g} to 1"
            )
        set_fields(self, delay=whole_number("sensors.delay", self.delay, 0, MAX_PERIODS))
        set_fields(self, every=whole_number("sensors.every", self.every, 1, MAX_PERIODS))
        if self.dropped >= 1.0:
            raise value_error("sensors.dropped", self.dropped, "a probability from 0 to below 1")

    def fraction(self, name: str, units: Sequence[str], ranges: Array, turns: Any = 1.0) -> Any:
        """Return noise, bias or quantisation as fractions of measurement ranges: a number, or an array (size,).

        Args:
            name: "noise", "bias" or "quantisation".
            units: (size,) units of the measured quantities.
            ranges: (size,) ends of their ranges, in these units.
            turns: (size,) turns of the shaft of the encoder per turn of a measured angle.
        """
        value: Any = getattr(self, name)
        if not isinstance(value, str):
            return value
        size, unit = _amount(name, value)
        same = [each == unit or (unit in STRAIN_UNITS and each in STRAIN_UNITS) for each in units]
        if _in_counts(name, value):
            size = size / turns
        return np.where(same, size / ranges, 0.0)

    def check_units(self, units: Sequence[str]) -> None:
        """Raise ValueError for an amount whose unit none of the measured quantities, with these units, has."""
        for name in ("noise", "bias", "quantisation"):
            if isinstance(value := getattr(self, name), str) and not np.any(
                self.fraction(name, units, np.ones(len(units)))
            ):
                known = ", ".join("strain" if each in STRAIN_UNITS else each for each in dict.fromkeys(units))
                raise value_error(f"sensors.{name}", value, f"a fraction, or an amount in units of {known}")


FLAWS = tuple(each.name for each in fields(Flaws))
"""Names of the flaws of a sensor, see `Flaws`."""


def _in_counts(name: str, value: str) -> bool:
    """Return True for a quantisation in counts of an encoder."""
    found = AMOUNT.match(value)
    return name == "quantisation" and found is not None and found[2] in COUNTS


def _amount(name: str, value: str) -> tuple[float, str]:
    """Return an amount in SI units, and its unit."""
    found = AMOUNT.match(value)
    allowed = 'a fraction, or a number > 0 with a unit such as "0.2 mrad"'
    if name == "quantisation":
        allowed += ' or "4096 counts"'
    if not found or not 0.0 < float(found[1]) < math.inf:
        raise value_error(f"sensors.{name}", value, allowed)
    if _in_counts(name, value):
        return 2.0 * math.pi / float(found[1]), "rad"
    unit = find_unit(found[2])
    if unit is None:
        raise value_error(f"sensors.{name}", value, allowed)
    return float(found[1]) * UNITS[unit][1], UNITS[unit][0]
