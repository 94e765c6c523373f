"""Settings that follow from an arm: times and limits, from its modes, rotors, motors and slews."""

import json
import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.agent.pd import torque_limits
from flexman_gym.common.arrays import Array
from flexman_gym.common.errors import value_error
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.postures import PostureRanges
from flexman_gym.model.dynamics import mass_matrix
from flexman_gym.model.model import Model, build_model
from flexman_gym.model.statics import holding_torques, rest_state
from flexman_gym.model.vibration import modes
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.serialization import find_arm, to_plain

SHOWN = 4  # number of modes
SLEWS, SEED = 12, 1  # number of drawn slews, and their seed
PEAK_ACCELERATION, PEAK_RATE = 10.0 / 3.0**0.5, 1.875  # of a minimum-jerk motion of 1 rad in 1 s, rad/s^2 and rad/s
TORQUE_SHARE, SPEED_SHARE = 0.95, 0.85  # fractions of the limits that a slew uses
PERIODS_PER_VIBRATION, PERIODS_PER_SLEW, PERIODS_PER_ROTOR = 40, 25, 8  # control periods in each of these times
SHORTEST_PERIOD, LONGEST_PERIOD = 0.002, 0.02  # s; range of a derived control period
SLEWS_PER_HORIZON = 4.0  # horizon / longest slew
VIBRATIONS_PER_HORIZON, SHORTEST_HORIZON = 10.0, 5.0  # periods of the first mode; s
ROUNDING = 1e-3  # fraction of the highest frequency with held motors; lower frequencies with free motors are no modes
ANGLE_MARGIN = 0.5  # rad; limit of the angles beyond the ranges of the joints
LIMIT_FACTOR = 3.0  # limits of rates and twists / values of a slew at the torque limits


class ArmFacts(NamedTuple):
    """Properties of an arm from which settings follow.

    Attributes:
        home: (n,) posture in the middle of the angle ranges, rad; zero without ranges.
        held, free: frequencies (k,) of the first modes with motors held and free, Hz, at this posture.
        rotor: highest frequency of a rotor on its spring, Hz; 0 without elastic joints.
        holding: (n,) largest holding torque of each joint / its torque limit, over the ends of the slews.
        postures: (n, n) motor angles of these largest holding torques, rad; a row for each joint.
        durations: (s,) durations of the slews, s: the shortest that the limits of torques and speeds and the first mode
            allow.
        rate: largest motor rate of the slews, rad/s.
        torque_rate: largest motor rate of slews that only the torque limits bound, rad/s.
        torque_share: median over the slews of the largest torque of the acceleration / the torque available to it.
        reach: length of the stretched arm, m.
        inertia: (n,) moment of inertia of the outboard links and the rotor about each joint at `home`, kg m^2.
    """

    home: tuple[float, ...]
    held: tuple[float, ...]
    free: tuple[float, ...]
    rotor: float
    holding: Array
    postures: Array
    durations: Array
    rate: float
    torque_rate: float
    torque_share: float
    reach: float
    inertia: Array

    @property
    def first_period(self) -> float:
        """Period of the first mode with motors held, s; 0 for a rigid arm."""
        return 1.0 / self.held[0] if self.held else 0.0


def arm_facts(arm: Arm, torque_limit: Sequence[float], span: tuple[float, float] = (0.8, 0.8)) -> ArmFacts:
    """Return the properties of an arm from which settings follow.

    Args:
        arm: the arm.
        torque_limit: (n,) N m.
        span: largest initial motor angle and largest change of a motor angle of the slews, rad.

    Raises:
        ValueError: for an arm that cannot hold its weight, with joint, posture, and the torque limit or the stiffness
            that would do.
    """
    return _facts(json.dumps(to_plain(arm)), tuple(map(float, torque_limit)), (float(span[0]), float(span[1])))


@lru_cache(maxsize=64)
def _facts(plain: str, torque_limit: tuple[float, ...], span: tuple[float, float]) -> ArmFacts:
    """Return the facts of an arm given by its JSON text, by which results are stored."""
    arm = find_arm(json.loads(plain))
    model, limits, n = build_model(arm, elements=2), np.array(torque_limit), arm.n_joints
    random = np.random.default_rng(SEED)
    motors = np.array([not joint.passive for joint in arm.joints])
    ranges = PostureRanges.of(arm)
    starts = ranges.draw_starts(random, span[0], (SLEWS,)) * motors
    changes = ranges.draw_changes(random, starts, span[1]) * motors
    ends = np.stack([starts, starts + changes], axis=1)
    torques = np.abs([[holding_torques(model, posture) for posture in pair] for pair in ends])
    shares = np.divide(torques, limits, out=np.zeros_like(torques), where=motors)
    _check_holding(shares, ends, limits)
    largest = shares.reshape(-1, n).argmax(axis=0)
    held = tuple(modes(model, arm.home).frequencies[:SHOWN].tolist())
    found = modes(model, arm.home, motors="free").frequencies.tolist()
    free = tuple(each for each in found if each > ROUNDING * max(held, default=0.0))[:SHOWN]
    by_torque = _torque_durations(model, limits, (starts, changes), torques.max(axis=1))
    speeds = np.array([np.inf if speed is None else speed for speed in motor_speeds(arm)])
    durations = np.maximum(by_torque, (PEAK_RATE * np.abs(changes) / (SPEED_SHARE * speeds)).max(axis=1))
    rates, torque_rates = (_peak_rates(changes, each) for each in (durations, by_torque))
    durations = np.maximum(durations, 1.0 / held[0] if held else 0.0)
    springs = [each.stiffness / each.rotor_inertia for each in arm.joints if each.stiffness and not each.passive]
    rotor = math.sqrt(max(springs, default=0.0)) / (2.0 * math.pi)
    return ArmFacts(
        arm.home,
        held,
        free,
        rotor,
        shares.reshape(-1, n).max(axis=0),
        ends.reshape(-1, n)[largest],
        durations,
        float(rates.max()),
        float(torque_rates.max()),
        float(np.median((by_torque / durations) ** 2)),
        float(model.constants.length.sum()),
        np.diag(slew_inertia(model, np.array(arm.home))).copy(),
    )


def _peak_rates(changes: Array, durations: Array) -> Array:
    """Return the largest motor rates (s,) of slews by changes (s, n), rad, in durations (s,), s; rad/s."""
    rates: Array = PEAK_RATE * np.abs(changes).max(axis=1) / np.where(durations > 0.0, durations, 1.0)
    return rates


def _check_holding(shares: Array, ends: Array, limits: Array) -> None:
    """Raise ValueError if the motors cannot hold the weight at most of the postures (s, 2, n), rad."""
    beyond = shares > 1.0
    for i in np.flatnonzero(beyond.reshape(-1, len(limits)).mean(axis=0) > 0.5):
        k = int(shares[..., i].argmax())
        share, posture = shares[..., i].ravel()[k], ends.reshape(-1, len(limits))[k].round(2).tolist()
        allowed = (
            f"at least {share * limits[i]:.3g} N m: joint {i + 1} holds {share:.0%} of it at motor angles {posture} rad"
        )
        raise value_error(f"arm.joints[{i}].torque_limit", float(limits[i]), allowed)


def _torque_durations(model: Model, limits: Array, slews: tuple[Array, Array], holding: Array) -> Array:
    """Return the durations (s,), s, of minimum-jerk slews at the limits of the torques.

    The inertia is that of motors and links without elastic deformation, in the middle of the slew.
    """
    result = []
    for start, change, weight in zip(*slews, holding, strict=True):
        inertia = slew_inertia(model, start + change / 2.0)
        free = np.maximum(TORQUE_SHARE * limits - weight, (1.0 - TORQUE_SHARE) * limits)
        needed = PEAK_ACCELERATION * np.abs(inertia @ change)
        result.append(np.sqrt((needed[limits > 0.0] / free[limits > 0.0]).max(initial=0.0)))
    return np.array(result)


def slew_inertia(model: Model, posture: Array) -> Array:
    """Return the mass matrix (n, n) of links and motors that turn together, at motor angles (n,) rad."""
    n, columns = model.n_joints, model.motor_columns
    mass = mass_matrix(model, rest_state(model, posture))
    inertia: Array = mass[:n, :n] + np.diag(np.where(columns != np.arange(n), np.diag(mass)[columns], 0.0))
    return inertia


def motor_speeds(arm: Arm) -> list[float | None]:
    """Return the largest speed of each joint, rad/s; None for a joint without a speed limit."""
    return [joint.speed_limit for joint in arm.joints]


def arm_torque_limits(arm: Arm, given: Any = None) -> tuple[float, ...]:
    """Return the torque limits (n,) of the joints of an arm, N m; 0 for passive joints.

    Args:
        arm: the arm.
        given: one number for all motors, a number for each motor, or for each joint, N m; None for the limits of the
            joints.

    Raises:
        ValueError: for numbers that are not allowed, and for a motor without a limit.
    """
    motors = [i for i, joint in enumerate(arm.joints) if not joint.passive]
    several = isinstance(given, list | tuple) or (isinstance(given, np.ndarray) and given.ndim > 0)
    if given is None:
        given = [arm.joints[i].torque_limit for i in motors]
        if None in given:
            allowed = "one number (N m), or one for each joint: the joints of this arm have no torque_limit"
            raise value_error("torque_limit", None, allowed)
    elif several and len(given) == arm.n_joints:
        given = [given[i] for i in motors]
    limits = dict(zip(motors, torque_limits("torque_limit", given, len(motors)) if motors else (), strict=True))
    return tuple(limits.get(i, 0.0) for i in range(arm.n_joints))


def derived_settings(arm: Arm, torque_limit: Sequence[float], span: tuple[float, float]) -> dict[str, Any]:
    """Return control_period, horizon, limits and slew_time of an arm, rounded to 1, 2 or 5 times a power of ten.

    The control period is the longest, from 2 to 20 ms, with 40 periods in the first mode with motors held, 25 in the
    median slew and 8 in the fastest vibration of a rotor on its spring. The horizon is four of the longest slews, and
    at least ten periods of the first mode and 5 s. Limits of rates and twists are three times the largest values of
    slews at the torque limits, without limits of speed. The limit of the angles is 4 rad, or half a radian beyond the
    ranges of the joints. The slew time is the median of the slews.

    Args:
        arm: as in `arm_facts`.
        torque_limit: as in `arm_facts`.
        span: as in `arm_facts`.

    Raises:
        ValueError: see `arm_facts`.
    """
    facts = arm_facts(arm, torque_limit, span)
    longest = SLEWS_PER_HORIZON * float(facts.durations.max())
    horizon = max(longest, VIBRATIONS_PER_HORIZON * facts.first_period, SHORTEST_HORIZON)
    return {
        "control_period": max(SHORTEST_PERIOD, _round_down(min(LONGEST_PERIOD, wanted_period(facts)))),
        "horizon": _round_up(horizon),
        "limits": _derived_limits(arm, torque_limit, facts),
        "slew_time": _round(float(np.median(facts.durations))),
    }


def wanted_period(facts: ArmFacts) -> float:
    """Return the control period that the modes, rotors and slews of an arm need, s."""
    # below the first mode with held motors an arm with free motors swings under gravity
    vibrations = [each for each in facts.free if each >= facts.held[0]] if facts.held else []
    rotor = max(facts.rotor, *vibrations[:1], 0.0)
    return min(
        facts.first_period / PERIODS_PER_VIBRATION or math.inf,
        float(np.median(facts.durations)) / PERIODS_PER_SLEW,
        1.0 / (PERIODS_PER_ROTOR * rotor) if rotor else math.inf,
    )


def _derived_limits(arm: Arm, torque_limit: Sequence[float], facts: ArmFacts) -> Limits:
    """Return limits of the rates, twists, deflection rates and tip speeds of an arm."""
    usual = Limits()
    # agents without planned motions exceed speed limits; an arm without motors has no slews
    rate = LIMIT_FACTOR * facts.torque_rate or usual.rate
    twists = [
        LIMIT_FACTOR * limit / joint.stiffness
        for limit, joint in zip(torque_limit, arm.joints, strict=True)
        if joint.stiffness is not None and not joint.passive
    ]
    bending = usual.deflection * facts.reach * 2.0 * math.pi * (facts.held[0] if facts.held else 0.0)
    tip = facts.reach * rate
    angles = [abs(angle) for bounds in arm.angle_ranges if bounds for angle in bounds]
    return Limits(
        angle=max([usual.angle, *(ANGLE_MARGIN + angle for angle in angles)]),
        rate=_round_up(rate),
        twist=min(usual.twist, _round_up(max(twists))) if twists else usual.twist,
        deflection_rate=_round_up(max(tip, bending)),
        tip_speed=_round_up(max(tip, bending)),
    )


def _round(value: float) -> float:
    """Return the nearest of 1, 2 and 5 times a power of ten to a value, by their ratio."""
    return min((_round_up(value), _round_down(value)), key=lambda each: abs(math.log(each / value)))


def _round_up(value: float) -> float:
    """Return the least of 1, 2 and 5 times a power of ten that is at least a value, to a rounding error."""
    power = math.floor(math.log10(value))
    return next(float(f"{m}e{power}") for m in (1, 2, 5, 10, 20) if float(f"{m}e{power}") >= value * (1.0 - 1e-6))


def _round_down(value: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is at most a value, to a rounding error."""
    power = math.floor(math.log10(value))
    fitting = [float(f"{m}e{power}") for m in (0.5, 1, 2, 5, 10) if float(f"{m}e{power}") <= value * (1.0 + 1e-6)]
    return fitting[-1]
