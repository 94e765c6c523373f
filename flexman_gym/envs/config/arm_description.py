"""Description of an arm as a plant: modes, holding torques, slews, and the settings with which it can be controlled."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexman_gym.envs.config.arm_settings import (
    PERIODS_PER_ROTOR,
    PERIODS_PER_SLEW,
    PERIODS_PER_VIBRATION,
    ArmFacts,
    arm_facts,
    motor_speeds,
    wanted_period,
)
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import DEFAULT_ID
from flexman_gym.metrics import BAND

MUCH = 1.5  # ratio of a control period to the period that the arm needs, beyond which it is said
LIGHT_ROTOR = 1e-4  # rotor inertia / inertia about the joint, below which a gear ratio seems to be forgotten
HEAVY = 0.9  # holding torque / torque limit, beyond which it is said


@dataclass(frozen=True)
class ArmDescription:
    """Description of an arm in an environment; its text has a line for each property.

    Attributes:
        configuration: configuration of the environment, with the settings that follow from the arm.
        facts: properties from which they follow.
        lines: text, line by line.
        warnings: what cannot work or works badly, with the number that would do.
    """

    configuration: Configuration
    facts: ArmFacts
    lines: tuple[str, ...]
    warnings: tuple[str, ...]

    def __str__(self) -> str:
        return "\n".join([*self.lines, *(f"! {each}" for each in self.warnings)])


def describe(arm: Any, environment: str | Configuration = DEFAULT_ID, **settings: Any) -> ArmDescription:
    """Describe an arm: frequencies, holding torques, slews, settings that follow from them, and what cannot work.

    Args:
        arm: as the setting `arm` of an environment: an Arm, a name, or the path of a file. A file of an environment is
            described with its settings.
        environment: environment in which it moves, unless the file names it.
        **settings: further settings of the environment, such as control_period (s).

    Raises:
        ValueError: for an arm that cannot hold its weight, with joint, posture, and the number that would do.

    Examples:
        >>> print(fm.describe(fm.catalog.planar_2r(), torque_limit=20.0).lines[1])
        frequencies, motors held     2.47, 15.5, 32.9, 43.6 Hz
    """
    of_file = Configuration.of_file(arm)
    configuration = (
        of_file.replace(**settings) if of_file else Configuration.find(environment).replace(arm=arm, **settings)
    )
    facts = arm_facts(configuration.arm, configuration.torque_limit, configuration.slew_span)
    rows = [("arm", _summary(configuration, facts)), *_fact_rows(configuration, facts)]
    gains, warnings = _gains(configuration)
    rows += [*_setting_rows(configuration, facts), ("PD", gains)]
    lines = tuple(f"{name:<28} {value}" for name, value in rows)
    return ArmDescription(configuration, facts, lines, (*_warnings(configuration, facts), *warnings))


def _summary(configuration: Configuration, facts: ArmFacts) -> str:
    """Return joints, reach and masses of an arm."""
    arm = configuration.arm
    elastic = sum(joint.stiffness is not None for joint in arm.joints)
    flexible = sum(link.flexible for link in arm.links)
    payload = arm.payload.mass if arm.payload else 0.0
    return (
        f"{arm.n_joints} joint{'s' * (arm.n_joints > 1)}, elastic: {elastic}; flexible links: {flexible}; "
        f"reach {facts.reach:.3g} m, mass {sum(link.mass for link in arm.links):.3g} kg, payload {payload:.3g} kg"
    )


def _fact_rows(configuration: Configuration, facts: ArmFacts) -> Iterator[tuple[str, str]]:
    """Yield names and values of frequencies, holding torques and slews."""
    place = f", at {np.round(facts.home, 2).tolist()} rad" * any(facts.home)
    for name, values in (("held", facts.held), ("free", facts.free)):
        yield f"frequencies, motors {name}", f"{_numbers(values)} Hz{place}" if values else "none: rigid"
    for i, (share, posture) in enumerate(zip(facts.holding, facts.postures, strict=True)):
        limit = configuration.torque_limit[i]
        if configuration.arm.joints[i].passive:
            yield f"joint {i + 1}", "passive: no motor, its angle follows from the motion"
            continue
        place = f", at {np.round(posture, 2).tolist()} rad" if share > 0.005 else ""
        yield f"joint {i + 1} holds", f"{share:.0%} of its torque limit, {limit:.4g} N m{place}"
    speeds = ", ".join("none" if each is None else f"{each:.3g}" for each in motor_speeds(configuration.arm))
    yield "speed limits of the joints", f"{speeds} rad/s, for planned motions only"
    if any(ranges := configuration.arm.angle_ranges):
        ends = ", ".join("none" if each is None else f"{each[0]:.3g} to {each[1]:.3g}" for each in ranges)
        yield "angle ranges of the joints", f"{ends} rad; episodes start around the middle"
    middle, longest = np.median(facts.durations), facts.durations.max()
    yield "slews", f"median {middle:.3g} s, longest {longest:.3g} s, peak rate {facts.rate:.3g} rad/s"


def _setting_rows(configuration: Configuration, facts: ArmFacts) -> Iterator[tuple[str, str]]:
    """Yield names and values of the settings, and of the band in which the tip has settled."""
    own = " (follows from the arm)"
    for name, unit in (("control_period", "s"), ("horizon", "s"), ("slew_time", "s")):
        yield name, f"{getattr(configuration, name):g} {unit}{own * (name in configuration.derived)}"
    limits = configuration.limits
    values = f"rate {limits.rate:g} rad/s, twist {limits.twist:g} rad, tip speed {limits.tip_speed:g} m/s"
    yield "limits", values + own * ("limits" in configuration.derived)
    yield "band of a settled tip", f"{1e3 * BAND * facts.reach:.3g} mm"


def _numbers(values: Sequence[float]) -> str:
    """Return numbers with three digits."""
    return ", ".join(f"{each:.3g}" for each in values)


def _warnings(configuration: Configuration, facts: ArmFacts) -> Iterator[str]:
    """Yield what cannot work or works badly."""
    for i in np.flatnonzero(facts.holding > HEAVY):
        share, posture = facts.holding[i], np.round(facts.postures[i], 2).tolist()
        needed = share * configuration.torque_limit[i] / HEAVY
        yield f"joint {i + 1} holds {share:.0%} of its torque limit at {posture} rad; {needed:.3g} N m would do"
    yield from _rotor_warnings(configuration, facts)
    yield from _speed_warnings(configuration, facts)
    longest, horizon = float(facts.durations.max()), configuration.horizon
    if longest > 0.5 * horizon:
        yield f"the longest slew needs {longest:.3g} s; the horizon is {horizon:g} s"
    period, wanted = configuration.control_period, wanted_period(facts)
    if period > MUCH * wanted:
        times = {
            "first mode": facts.first_period / PERIODS_PER_VIBRATION,
            "median slew": float(np.median(facts.durations)) / PERIODS_PER_SLEW,
        }
        cause = next((name for name, value in times.items() if value and value <= wanted * 1.001), "fastest rotor")
        count = {"first mode": PERIODS_PER_VIBRATION, "median slew": PERIODS_PER_SLEW}.get(cause, PERIODS_PER_ROTOR)
        yield f"the control period is {1e3 * period:.3g} ms; {count} in the {cause} need {1e3 * wanted:.2g} ms"
    yield from _sensor_warnings(configuration, facts)


def _rotor_warnings(configuration: Configuration, facts: ArmFacts) -> Iterator[str]:
    """Yield the joint whose rotor is lightest relative to its links, if a gear ratio seems to be forgotten."""
    shares = {
        i: joint.rotor_inertia / inertia
        for i, (joint, inertia) in enumerate(zip(configuration.arm.joints, facts.inertia, strict=True), 1)
        if joint.stiffness is not None and not joint.passive
    }
    joint = min(shares, key=lambda each: shares[each], default=0)
    if joint and shares[joint] < LIGHT_ROTOR:
        inertia = configuration.arm.joints[joint - 1].rotor_inertia
        yield (
            f"the rotor of joint {joint} has {inertia:.3g} kg m^2, {shares[joint]:.1g} of the inertia that it moves; "
            "at the joint it is the inertia of the motor's rotor times the square of the gear ratio"
        )


def _speed_warnings(configuration: Configuration, facts: ArmFacts) -> Iterator[str]:
    """Yield the joint whose speed limit slews at the torque limits exceed most."""
    speeds = {i: speed for i, speed in enumerate(motor_speeds(configuration.arm), 1) if speed is not None}
    if speeds and facts.torque_rate > MUCH * min(speeds.values()):
        joint = min(speeds, key=lambda each: speeds[each])
        yield (
            "agents without planned motions, such as pd and policies, exceed the speed limits: slews at the torque "
            f"limits reach {facts.torque_rate:.3g} rad/s, joint {joint} allows {speeds[joint]:.3g} rad/s; limits.rate "
            "ends an episode, and a motor with voltage_limit bounds its speed"
        )


def _sensor_warnings(configuration: Configuration, facts: ArmFacts) -> Iterator[str]:
    """Yield errors of the encoders that move the tip by more than the band of a settled tip."""
    band = BAND * facts.reach
    for i, joint in enumerate(configuration.arm.joints):
        step = joint.motor.joint_resolution if joint.motor else None
        if step and step * facts.reach > band:
            yield f"the encoder of joint {i + 1} resolves {1e3 * step:.2g} mrad, {step * facts.reach / band:.2g} bands"
    errors = configuration.disturbances.ranges.get("sensor_bias", (0.0,)) if configuration.disturbances else (0.0,)
    bias = max(map(abs, errors)) * configuration.limits.angle * facts.reach
    if bias > band:
        yield f"the bias of the encoders moves the tip by up to {bias / band:.2g} bands"


def _gains(configuration: Configuration) -> tuple[str, tuple[str, ...]]:
    """Return the PD gains of an arm, or "none", and the reason."""
    try:
        gains = configuration.pd_gains
    except ValueError as error:
        return "none", (str(error),)
    return f"stiffness {_numbers(gains['stiffness'])} N m/rad, damping {_numbers(gains['damping'])} N m s/rad", ()
