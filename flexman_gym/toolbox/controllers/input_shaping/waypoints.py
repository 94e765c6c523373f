"""Waypoints of a motion, with the velocities and accelerations that are known, and the curve through them."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import MAX_ENTRIES
from flexman_gym.common.clock import MIN_SAMPLES, Sampling, step_text
from flexman_gym.common.errors import value_error

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

REST_RATE = 0.05  # fraction of the largest rate; smaller rates at the ends are rest
SAME = 1e-9  # fraction of the largest position; smaller differences are rounding
ROUNDING = 1e-6  # fraction of a step; smaller differences of times are rounding
DERIVATIVES = ("positions", "velocities", "accelerations")


class Waypoints(NamedTuple):
    """Points of a motion of n joints.

    Attributes:
        times: (T,) s.
        values: (3, T, n) positions, velocities and accelerations; NaN where unknown.
        notes: what was filled in, left out or resampled, of one line each.
    """

    times: Array
    values: Array
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, name: str, times: Array, values: Array, point: str = "line") -> "Waypoints":
        """Return points at increasing times, with velocities where any are given.

        A repeated point is left out. Velocities and accelerations that are all zero in a motion are taken as unknown.
        Where the velocity of some points is unknown, it is 0 for the first and the last one, and that of a cubic spline
        through the positions for others.

        Args:
            name: name of the motion, for errors.
            times: (T,) s.
            values: (3, T, n), NaN where unknown.
            point: word for a point, for errors.

        Raises:
            ValueError: for times that do not increase, less than two points, four without velocities, no motion, and a
                motion that starts or ends in motion.
        """
        times, values, notes = _without_repeated(name, times, values, point)
        if len(times) < 2 or not np.ptp(values[0], axis=0).any():
            raise ValueError(f"{name}: a motion at rest is not allowed; give one that moves")
        for order, label in ((1, DERIVATIVES[1]), (2, DERIVATIVES[2])):
            if not np.nan_to_num(values[order]).any() and np.isfinite(values[order]).any() and len(times) > 2:
                values[order] = np.nan
                notes.append(f"{label} are all zero: not used")
        unknown = np.isnan(values[1]).any(axis=1)
        if unknown.all() and len(times) < MIN_SAMPLES:
            raise value_error(f"{name}: points", f"{len(times)} positions", f"{MIN_SAMPLES} or more, or velocities")
        result = cls(times, values)
        result._check_rest(name)
        if unknown.any() and not unknown.all():
            values[1, unknown] = result._spline()(times[unknown], 1)
            for end, row in (("first", 0), ("last", -1)):
                if unknown[row]:
                    values[1, row] = 0.0
                    notes.append(f"velocities of the {end} {point} are missing: taken as 0")
            if inner := int(unknown[1:-1].sum()):
                notes.append(f"velocities of {inner} {point}(s) are missing: those of a cubic spline")
        unknown = np.isnan(values[2]).any(axis=1)
        if unknown.any() and not unknown.all():
            notes.append(f"accelerations of {int(unknown.sum())} {point}(s) are missing: those of the curve")
        return result._replace(notes=tuple(notes))

    def curve(self, orders: tuple[int, ...], times: Array) -> Array:
        """Return positions, velocities and accelerations (orders, T, n) of the curve through the points.

        Between two points it is the polynomial of lowest degree with all positions, velocities and accelerations known
        there: of degree 5 or 3. Without velocities it is a cubic spline that starts and ends at rest.
        """
        from scipy.interpolate import BPoly

        if np.isnan(self.values[1]).any():
            return np.array([self._spline()(times, order) for order in orders])
        known = np.isfinite(self.values[2]).all(axis=1)
        points = [list(self.values[: 3 if full else 2, i]) for i, full in enumerate(known.tolist())]
        polynomials = BPoly.from_derivatives(self.times, points)
        return np.array([polynomials(times, order) for order in orders])

    def sampled(self, orders: tuple[int, ...], rate: float | None) -> tuple[float, Array, tuple[str, ...]]:
        """Return the period (s), derivatives (orders, T, n) at equal steps, and notes.

        Without a rate (Hz), points in equal steps are returned as they are; others are sampled at their median step.
        After the last point the motion rests there.
        """
        found, span = Sampling.of(self.times, ROUNDING), float(self.times[-1] - self.times[0])
        if found.is_equal and (not rate or abs(found.period * rate - 1.0) < ROUNDING):
            values = self.values[list(orders)]
            line = f"times rounded to {step_text(found.rounding)} are read as equal steps of {step_text(found.period)}"
            notes = (*self.notes, line) if found.rounding else self.notes
            return found.period, np.where(np.isnan(values), self.curve(orders, self.times), values), notes
        period = 1.0 / rate if rate else float(f"{np.median(np.diff(self.times)):.12g}")
        if span / period >= MAX_ENTRIES:
            raise value_error("rate", f"{1.0 / period:.6g} Hz", f"at most {MAX_ENTRIES / span:.6g} Hz (--rate)")
        times = self.times[0] + period * np.arange(int(np.ceil(span / period - ROUNDING)) + 1)
        values = self.curve(orders, np.minimum(times, self.times[-1]))
        late = times > self.times[-1] + ROUNDING * period
        values[:, late] *= (np.array(orders) == 0)[:, None, None]
        return period, values, (*self.notes, self._resampling(times, period))

    def _resampling(self, times: Array, period: float) -> str:
        """Return the remark about sampling at other times (s)."""
        steps = np.diff(self.times)
        first, second = (bool(np.isfinite(each).any()) for each in self.values[1:])
        curve = f"their velocities{' and accelerations' * second}" if first else "a cubic spline of their positions"
        curve += ", their accelerations left out" * (second and not first)
        span = f"steps of {step_text(steps.min())} to {step_text(steps.max())}"
        line = f"{len(self.times)} points in {span} are sampled at steps of {step_text(period)} by {curve}"
        if times[-1] > self.times[-1] + ROUNDING * period:
            line += f", to {times[-1]:.6g} s in place of {self.times[-1]:.6g} s"
        return line

    def _spline(self) -> "CubicSpline":
        """Return the cubic spline through the positions that starts and ends at rest."""
        from scipy.interpolate import CubicSpline

        return CubicSpline(self.times, self.values[0], bc_type="clamped")

    def _check_rest(self, name: str) -> None:
        """Raise a ValueError for a motion that starts or ends in motion.

        An unknown velocity at an end is that of the differences of the positions, or of their extrapolation; beside a
        known velocity it is that of a constant acceleration, which need not be small if it is less than half of it.
        """
        rates = np.diff(self.values[0], axis=0) / np.diff(self.times)[:, None]
        limit = REST_RATE * max(np.abs(rates).max(), np.nan_to_num(np.abs(self.values[1])).max())
        for place, step in (("start", 1), ("end", -1)):
            (end, near), most = self.values[1, ::step][:2], limit
            outer, inner = rates[::step][[0, min(1, len(rates) - 1)]]
            if np.isfinite(end).all():
                speed = np.abs(end).max()
            elif np.isfinite(near).all():
                speed, most = np.abs(2.0 * outer - near).max(), max(limit, 0.5 * np.abs(near).max())
            else:
                first, second = np.diff(self.times)[::step][[0, min(1, len(rates) - 1)]]
                ends = outer + (outer - inner) * first / (first + second)
                speed = np.minimum(np.abs(outer), np.abs(ends)).max()
            if speed > most:
                allowed = "a motion that starts and ends at rest; otherwise its ends set the vibration"
                raise value_error(f"{name}: the speed at the {place}", f"{speed:.3g} rad/s or m/s", allowed)


def _without_repeated(name: str, times: Array, values: Array, point: str) -> tuple[Array, Array, list[str]]:
    """Return times, values and notes without points that repeat the time and the positions of the one before."""
    times, values, notes = times.copy(), values.copy(), list[str]()
    for i in np.flatnonzero(np.diff(times) <= 0.0)[::-1].tolist():
        same = np.abs(values[0, i + 1] - values[0, i]) <= SAME * max(float(np.abs(values[0]).max()), SAME)
        if times[i + 1] < times[i] or not same.all():
            given = f"{times[i + 1]:g} after {times[i]:g} s"
            raise value_error(f"{name}: time", given, "increasing times")
        values[:, i] = np.where(np.isnan(values[:, i]), values[:, i + 1], values[:, i])
        times, values = np.delete(times, i + 1), np.delete(values, i + 1, axis=1)
        notes.append(f"{point} {i + 2} repeats the one before: left out")
    return times, values, notes
