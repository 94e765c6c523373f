"""Operations of an environment in a control period, for b arms: readings, observations, limits, actions, truncation.

A kernel replaces several NumPy calls of about a microsecond each, which for one arm took as long as the simulation. d
is the number of coordinates and n of joints; rows, outputs and drives as in `layout`. The energy turnover (J) is the
largest of kinetic + elastic energy, |work| and |dissipation| since the reset: the scale of the energy residual.
"""

import math

from flexman_gym.kernels.arguments import period_of
from flexman_gym.kernels.compile import inner, kernel
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
from flexman_gym.kernels.outputs import energy_residuals, update_energy_turnover


@kernel
def sparse_product(rows, start, source, value, out):
    """Set out (b, m) to rows (b, s) times a sparse matrix, whose column j has value[e] in row source[e].

    Entries e of column j are those with start[j] <= e < start[j + 1].
    """
    for b in range(len(rows)):
        for j in range(len(start) - 1):
            total = 0.0
            for e in range(start[j], start[j + 1]):
                total = fma(value[e], rows[b, source[e]], total)
            out[b, j] = total


@kernel
def fill_views(rows, outputs, energies, turnover, targets, readings, motion, vectors, scalars):
    """Compute the quantities of an `envs.view.View` of b arms.

    Args:
        rows: (b, 2 d + 2) states (2 d), each followed by work and dissipation, J (the energy ledger).
        outputs: (b, OUTPUTS) output rows.
        energies: (b,) total energy at the reset, J.
        turnover: (b,) energy turnover, J, see `update_energy_turnover`.
        targets: (b, 3) target positions, base frame, m.
        readings: arguments start, source and value of `sparse_product`, which computes sensor readings from rows.
        motion: (b, m) set to the readings, followed by the tip velocity (m/s).
        vectors: (b, 6) set to target - tip (m) and the deflection rate (m/s).
        scalars: (5, b) set to the lengths of these two vectors (m, m/s), elastic energy, energy residual and energy
            turnover (J).
    """
    sparse_product(rows, readings[0], readings[1], readings[2], motion)
    last = motion.shape[1] - 3
    for b in range(len(rows)):
        for j in range(3):
            motion[b, last + j] = outputs[b, TIP_VELOCITY_COLUMN + j]
            vectors[b, j] = targets[b, j] - outputs[b, TIP_COLUMN + j]
            vectors[b, 3 + j] = outputs[b, DEFLECTION_RATE_COLUMN + j]
        for i in range(2):
            x, y, z = vectors[b, 3 * i], vectors[b, 3 * i + 1], vectors[b, 3 * i + 2]
            scalars[i, b] = math.sqrt(x * x + y * y + z * z)
        scalars[2, b], scalars[4, b] = outputs[b, LINK_ENERGY] + outputs[b, JOINT_ENERGY], turnover[b]
    energy_residuals(rows, outputs, energies, scalars[3])


@kernel
def full_observation(motion, angles, velocity, goal_angles, vectors, lengths, offset, out):
    """Set out (b, 9 n + 9) to the observation of the full state.

    Args:
        motion: (b, m) readings; the first 8 n are the first entries of the observation.
        angles: (b, n) motor angles, rad.
        velocity: (b, 3) tip velocity, m/s, the last entries of the observation.
        goal_angles: (b, n) goal of the motor angles, rad; the entries after the readings are goal_angles - angles.
        vectors: (b, 3) target - tip, m; the next entries are this vector, and this vector divided by length + offset.
        lengths: (b,) lengths of the vectors, m.
        offset: length added in the divisor, m.
        out: observation, overwritten.
    """
    n = goal_angles.shape[1]
    end = 9 * n
    for b in range(len(out)):
        for j in range(8 * n):
            out[b, j] = motion[b, j]
        for j in range(n):
            out[b, 8 * n + j] = goal_angles[b, j] - angles[b, j]
        scale = lengths[b] + offset
        for j in range(3):
            out[b, end + j], out[b, end + 3 + j] = vectors[b, j], vectors[b, j] / scale
            out[b, end + 6 + j] = velocity[b, j]


@kernel
def flag_violations(motion, limits, observations, bound, status, flags):
    """Set the flags of arms whose simulation has failed, or whose motion or observation exceeds a limit or is NaN.

    Args:
        motion: (b, m) readings and tip velocity of `fill_views`.
        limits: (m,) largest allowed magnitudes of the entries of `motion`, in their units.
        observations: (b, s) observations.
        bound: (s,) largest allowed magnitudes of the observations.
        status: (b,) status of the simulations.
        flags: (b,) overwritten.

    Returns:
        The number of flagged arms.
    """
    count = 0
    for b in range(len(flags)):
        flags[b] = status[b] != OK
        for j in range(len(limits)):
            if not abs(motion[b, j]) <= limits[j]:
                flags[b] = True
        for j in range(len(bound)):
            if not abs(observations[b, j]) <= bound[j]:
                flags[b] = True
        count += flags[b]
    return count


@kernel
def all_within(values, bound):
    """Return True if all magnitudes of the values (m,) are at most the bound; NaN exceeds the bound."""
    for value in values:
        if not abs(value) <= bound:
            return False
    return True


@kernel
def apply_actions(actions, arriving, limits, active, drive, requested, efforts):
    """Set the torques of the drive, and record the actions of active arms and their mean squares.

    Args:
        actions: (b, n) actions of the agent, as fractions of the torque limits.
        arriving: (b, n) actions that take effect in this period, after delays and other effects, as fractions of the
            torque limits.
        limits: (b, n) torque limits, N m.
        active: (b,) flags of the arms whose episode continues.
        drive: (b, n + 6) inputs: n motor torques (N m), set to arriving * limits; tip force (3, N) and base
            acceleration (3, m/s^2), unchanged.
        requested: (b, n) set to the actions of active arms.
        efforts: (b,) set to the mean square of the actions of active arms.
    """
    n = actions.shape[1]
    for b in range(len(actions)):
        for j in range(n):
            drive[b, j] = arriving[b, j] * limits[b, j]
        if active[b]:
            total = 0.0
            for j in range(n):
                requested[b, j] = actions[b, j]
                total += actions[b, j] * actions[b, j]
            efforts[b] = total / n


@kernel
def close_period(rows, outputs, status, drive, periods, last_drive, turnover):
    """Increase the period count and store the drive of arms with status OK; update the energy turnover of all arms.

    Args:
        rows: (b, 2 d + 2) states, each followed by work and dissipation (J), at the end of the period.
        outputs: (b, OUTPUTS) output rows at the end of the period.
        status: (b,) status of the arms in this period.
        drive: (b, n + 6) inputs in this period: n motor torques (N m), tip force (3, N), base acceleration (3, m/s^2).
        periods: (b,) numbers of periods since the reset, increased by one.
        last_drive: (b, n + 6) inputs in the last successful period, overwritten.
        turnover: (b,) energy turnover, J, see `update_energy_turnover`.
    """
    for b in range(len(status)):
        if status[b] == OK:
            periods[b] += 1.0
            copy(drive[b], last_drive[b])
    update_energy_turnover(rows, outputs, turnover)


@kernel
def count_episode_periods(periods, active, horizon, truncated):
    """Increase the period count of the episodes of active arms, and set the flags of truncated episodes.

    Args:
        periods: (b,) numbers of control periods in the episodes, increased by one for active arms.
        active: (b,) flags of the arms whose episode continues.
        horizon: number of periods after which an episode is truncated.
        truncated: (b,) flags, overwritten.

    Returns:
        The number of truncated episodes.
    """
    count = 0
    for b in range(len(periods)):
        periods[b] += active[b]
        truncated[b] = periods[b] >= horizon
        count += truncated[b]
    return count


BELLS, DISTANCE, EXPONENTIAL = 0, 1, 2  # kinds of rewards
REWARD_TERMS = 3  # largest number of terms of a kind


@kernel
def reward_terms(kind, parameters, errors, vibrations, efforts, velocities, out):
    """Set out (REWARD_TERMS, b) to the terms of a reward of b arms; see `Slew` for the formulas.

    Args:
        kind: BELLS; DISTANCE, which sets the first term only; or EXPONENTIAL.
        parameters: BELLS: squared widths of the three curves, m^2, and squared vibration scale, m^2/s^2. DISTANCE:
            squared distance of a reward near 1, m^2, the logarithm of the range, and the look-ahead time, s.
            EXPONENTIAL: three weights and three lengths, m.
        errors: (b,) tip errors, m.
        vibrations: (b,) magnitudes of the deflection rate, m/s; used by BELLS.
        efforts: (b,) mean squares of the actions; used by BELLS.
        velocities: (b, 3) tip velocities, m/s; used by DISTANCE.
        out: overwritten.
    """
    p = parameters
    for b in range(len(errors)):
        square = errors[b] * errors[b]
        if kind == DISTANCE:
            x, y, z = p[2] * velocities[b, 0], p[2] * velocities[b, 1], p[2] * velocities[b, 2]
            out[0, b] = 1.0 - math.log1p((square + (x * x + y * y + z * z)) / p[0]) / p[1]
        elif kind == EXPONENTIAL:
            for j in range(3):
                out[j, b] = p[j] * math.exp(-errors[b] / p[3 + j])
        else:
            near = p[0] / (p[0] + square) + p[1] / (p[1] + square) + p[2] / (p[2] + square)
            out[0, b] = 0.7 / 3.0 * near
            out[1, b] = 0.2 * p[3] / (p[3] + vibrations[b] * vibrations[b])
            out[2, b] = 0.1 * (1.0 - efforts[b])


NOT_DONE, FAILED = -1, 0  # results of a compiled control period


@inner
def start_period(table):
    """Apply the action of a `Period`, and return True; return False for an action beyond -1 to 1, with no effect.

    The table (fields, 3) holds the addresses of a `Period`.
    """
    p = period_of(table)
    if not all_within(p.action[0], 1.0):
        return False
    copy(p.action[0], p.command[0])
    apply_actions(p.command, p.command, p.torque_limits, p.active, p.drive, p.requested, p.efforts)
    return True


@inner
def finish_period(table, rows, outputs, status):
    """Compute view, observations, flags and reward of a `Period` after the motion of its arm.

    Args:
        table: (fields, 3) addresses of the `Period`.
        rows: (1, 2 d + 2) state (2 d), then work and dissipation, J.
        outputs: (1, OUTPUTS).
        status: (1,).

    Returns:
        FAILED, without a new observation and reward; otherwise the number of control periods of the episode.
    """
    p = period_of(table)
    close_period(rows, outputs, status, p.drive, p.periods, p.last_drive, p.turnover)
    matrix = p.reading_start, p.reading_source, p.reading_value
    fill_views(rows, outputs, p.start_energy, p.turnover, p.target, matrix, p.motion, p.vectors, p.scalars)
    full_observation(
        p.motion, p.motor_angles, p.tip_velocity, p.goal_angles, p.target_error, p.tip_error, p.nearness_offset[0],
        p.readings,
    )  # fmt: skip
    p.ages[0] += 1
    if flag_violations(p.motion, p.limits, p.readings, p.bound, status, p.violated) > 0:
        return FAILED
    for j in range(len(p.bound)):
        p.observations[0, j] = p.readings[0, j]
    kind, errors = p.reward[0], p.tip_error
    reward_terms(kind, p.reward_parameters, errors, p.tip_vibration, p.efforts, p.tip_velocity, p.reward_terms)
    return p.ages[0]


@kernel
def fourier_series(series, phases, out):
    """Set out (r, p, s) to Fourier series at phases (r, p), rad.

    The coefficients `series` (r, s, 2 h + 1) are the mean, then the coefficients of cosine and sine of each of h
    harmonics.
    """
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
