"""Operations of a control period on the arrays of many arms: readings, observations, limits, torques, ages, paths.

Each takes one call in place of several of NumPy's, which cost a microsecond each: of one arm as much as its motion.
"""

import math

from flexman_gym.kernels.compile import kernel
from flexman_gym.kernels.lanes import fma
from flexman_gym.kernels.layout import (
    DEFLECTION_RATE_COLUMN,
    JOINT_ENERGY,
    LINK_ENERGY,
    OK,
    TIP_COLUMN,
    TIP_VELOCITY_COLUMN,
)
from flexman_gym.kernels.linalg import copy
from flexman_gym.kernels.outputs import energy_residuals, update_energy_scale


@kernel
def sparse_product(rows, start, source, value, out):
    """Linear readings: out[b, j] = sum of value[e] rows[b, source[e]] over start[j] <= e < start[j + 1]."""
    for b in range(len(rows)):
        for j in range(len(start) - 1):
            total = 0.0
            for e in range(start[j], start[j + 1]):
                total = fma(value[e], rows[b, source[e]], total)
            out[b, j] = total


@kernel
def fill_views(rows, outputs, energies, turned, targets, readings, motion, vectors, numbers):
    """What a `View` has of b arms, from rows (b, 2 d + 2), outputs (b, OUTPUTS), energies at the start and what is
    turned over (b,), and targets (b, 3).

    motion (b, m) = the linear readings, as `sparse_product` takes them, and the velocity of the tip; vectors (b, 2,
    3) =
    target - tip and the deflection rate; numbers (5, b) = the lengths of both, the elastic energy, the residual of the
    energy and what is turned over.
    """
    sparse_product(rows, readings[0], readings[1], readings[2], motion)
    last = motion.shape[1] - 3
    for b in range(len(rows)):
        for j in range(3):
            motion[b, last + j] = outputs[b, TIP_VELOCITY_COLUMN + j]
            vectors[b, 0, j] = targets[b, j] - outputs[b, TIP_COLUMN + j]
            vectors[b, 1, j] = outputs[b, DEFLECTION_RATE_COLUMN + j]
        for i in range(2):
            x, y, z = vectors[b, i, 0], vectors[b, i, 1], vectors[b, i, 2]
            numbers[i, b] = math.sqrt(x * x + y * y + z * z)
        numbers[2, b], numbers[4, b] = outputs[b, LINK_ENERGY] + outputs[b, JOINT_ENERGY], turned[b]
    energy_residuals(rows, outputs, energies, numbers[3])


@kernel
def full_observation(motion, angles, velocity, goal_angles, vectors, numbers, near, out):
    """out (b, 9 n + 9) = the first 8 n of motion (b, m), goal_angles - angles of the motors (b, n), vectors (b, 3) and
    the same divided by their lengths (b,) + near, and the velocity (b, 3) of the tip."""
    n = goal_angles.shape[1]
    end = 9 * n
    for b in range(len(out)):
        for j in range(8 * n):
            out[b, j] = motion[b, j]
        for j in range(n):
            out[b, 8 * n + j] = goal_angles[b, j] - angles[b, j]
        scale = numbers[b] + near
        for j in range(3):
            out[b, end + j], out[b, end + 3 + j] = vectors[b, j], vectors[b, j] / scale
            out[b, end + 6 + j] = velocity[b, j]


@kernel
def flag_violations(motion, limits, observations, bound, status, flags):
    """flags (b,) = whether an arm has a status that is not OK, or a magnitude of its motion (b, m) beyond its limit
    (m,), or of its observations (b, s) beyond its bound (s,), as what is no number is; returns how many have."""
    many = 0
    for b in range(len(flags)):
        flags[b] = status[b] != OK
        for j in range(len(limits)):
            if not abs(motion[b, j]) <= limits[j]:
                flags[b] = True
        for j in range(len(bound)):
            if not abs(observations[b, j]) <= bound[j]:
                flags[b] = True
        many += flags[b]
    return many


@kernel
def all_within(values, bound):
    """Whether all magnitudes of the values (m,) are at most the bound; that of no number is not."""
    for value in values:
        if not abs(value) <= bound:
            return False
    return True


@kernel
def apply_actions(actions, arriving, limits, playing, drive, asked, efforts):
    """The torques in drive (b, n + 6) = arriving actions (b, n) times limits; of arms that are playing (b,), asked =
    actions and efforts (b,) = the means of their squares."""
    n = actions.shape[1]
    for b in range(len(actions)):
        for j in range(n):
            drive[b, j] = arriving[b, j] * limits[b, j]
        if playing[b]:
            total = 0.0
            for j in range(n):
                asked[b, j] = actions[b, j]
                total += actions[b, j] * actions[b, j]
            efforts[b] = total / n


@kernel
def close_period(rows, outputs, status, drive, periods, driven, turned):
    """Counts a control period in periods (b,) and keeps its drive (b, n + 6) for the arms whose status is OK; what all
    have turned over (b,) grows, see `update_energy_scale`."""
    for b in range(len(status)):
        if status[b] == OK:
            periods[b] += 1.0
            copy(drive[b], driven[b])
    update_energy_scale(rows, outputs, turned)


@kernel
def count_episode_periods(ages, playing, longest, over):
    """Ages (b,) of arms that are playing grow by a control period; over (b,) = whether they have reached the longest.

    Returns how many have.
    """
    many = 0
    for b in range(len(ages)):
        ages[b] += playing[b]
        over[b] = ages[b] >= longest
        many += over[b]
    return many


@kernel
def fourier_series(series, phases, out):
    """out (r, p, s) = Fourier series (r, s, 2 h + 1) at phases (r, p): mean, then cosine and sine of each harmonic."""
    for r in range(phases.shape[0]):
        for p in range(phases.shape[1]):
            first, second = math.cos(phases[r, p]), math.sin(phases[r, p])
            for s in range(series.shape[1]):
                cosine, sine = first, second
                value = series[r, s, 0]
                for h in range(1, series.shape[2], 2):
                    value = fma(series[r, s, h], cosine, fma(series[r, s, h + 1], sine, value))
                    cosine, sine = cosine * first - sine * second, sine * first + cosine * second
                out[r, p, s] = value
