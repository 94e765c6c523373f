"""Joints: rigid or flexible revolute joints, and their geared motors."""

import math
from dataclasses import dataclass

from flexman_gym.common.arrays import Vector
from flexman_gym.common.checks import (
    MAX_SIZE,
    UNIT_TOLERANCE,
    finite,
    flag,
    instance,
    physical,
    sequence,
    set_fields,
    vector,
)
from flexman_gym.common.errors import value_error
from flexman_gym.scene.input_checks import check_keywords, warn_unusual_units

LARGEST_RANGE = 8.0 * math.pi  # rad; largest range of the angle of a joint with stops


@check_keywords
@dataclass(frozen=True)
class Motor:
    """Motor with a gear that drives a joint.

    All values except the gear ratio and the efficiency refer to the motor shaft, on the input side of the gear.

    Attributes:
        gear_ratio: turns of the motor shaft per turn of the joint, 1; 1 without a gear.
        torque_constant: torque at the motor shaft per current, N m/A.
        rotor_inertia: moment of inertia of the rotor and the parts fixed to the motor shaft, kg m^2; may be 0.
        current_limit: largest current, A; None if unknown. With a resistance it limits the current at standstill; a
            turning shaft draws less by its back-EMF, or more while it brakes.
        speed_limit: largest speed of the motor shaft, rad/s; None if unknown.
        efficiency: output torque of the gear / ideal output torque, 1; greater than 0 and at most 1.
        encoder_resolution: angle of the motor shaft per count of the encoder, rad; None without an encoder.
        torque_ripple: amplitude of the torque ripple, N m. It is added to the motor torque as torque_ripple *
            sin(ripple_cycles * angle + ripple_phase) at the angle of the motor shaft, whatever the current: cogging and
            offsets of the current sensors (Holtz and Springob 1996, IEEE Trans. Ind. Electron. 43, 309).
        ripple_cycles: cycles of the torque ripple per turn of the motor shaft, 1; None without torque ripple. An
            amplitude of 0 with cycles can be varied, see `simulation.physical_parameters`.
        ripple_phase: rad.
        resistance: resistance of the winding, ohm, for a motor whose input is a voltage U (V); None for a motor whose
            current is controlled, so that its torque does not depend on its speed. At the speed w (rad/s) of the shaft
            the current is (U - back_emf_constant * w) / resistance; the inductance of the winding is neglected. The
            input torque of the joint is then the torque at standstill, `torque_per_volt` * U, and the back-EMF is a
            damper, `back_emf_damping`. Source: Krause et al. (2013), Analysis of Electric Machinery, section 2.3.
        back_emf_constant: V s/rad; None for the number of torque_constant, which it equals in an ideal motor.
        voltage_limit: largest voltage, V; None if unknown.

    Raises:
        ValueError: for a number outside 1e-30 to 1e30, for an efficiency outside its range, for a torque ripple without
            cycles, and for a back-EMF constant or a voltage limit without a resistance.

    Examples:
        >>> motor = fm.Motor(gear_ratio=100, torque_constant=0.05, rotor_inertia=2e-6, current_limit=1.5)
        >>> joint = fm.Joint((0, 0, 1), stiffness=30.0, motor=motor)
        >>> round(joint.rotor_inertia, 3), joint.torque_limit
        (0.02, 7.5)
    """

    gear_ratio: float
    torque_constant: float
    rotor_inertia: float
    current_limit: float | None = None
    speed_limit: float | None = None
    efficiency: float = 1.0
    encoder_resolution: float | None = None
    torque_ripple: float = 0.0
    ripple_cycles: float | None = None
    ripple_phase: float = 0.0
    resistance: float | None = None
    back_emf_constant: float | None = None
    voltage_limit: float | None = None

    def __post_init__(self) -> None:
        set_fields(
            self,
            gear_ratio=physical("Motor.gear_ratio", self.gear_ratio, "turns of the motor per turn of the joint"),
            torque_constant=physical("Motor.torque_constant", self.torque_constant, "N m/A"),
            rotor_inertia=physical("Motor.rotor_inertia", self.rotor_inertia, "kg m^2", zero=True),
            efficiency=physical("Motor.efficiency", self.efficiency),
            torque_ripple=physical("Motor.torque_ripple", self.torque_ripple, "N m", zero=True),
            ripple_phase=finite("Motor.ripple_phase", self.ripple_phase, "rad"),
        )
        optional = {"current_limit": "A", "speed_limit": "rad/s", "encoder_resolution": "rad", "ripple_cycles": "1",
                    "resistance": "ohm", "back_emf_constant": "V s/rad", "voltage_limit": "V"}  # fmt: skip
        for name, unit in optional.items():
            value = getattr(self, name)
            if value is not None:
                set_fields(self, **{name: physical(f"Motor.{name}", value, unit)})
        if self.efficiency > 1.0:
            raise value_error("Motor.efficiency", self.efficiency, "a number > 0 and <= 1")
        if self.torque_ripple > 0.0 and self.ripple_cycles is None:
            raise value_error("Motor.torque_ripple", self.torque_ripple, "0 without ripple_cycles")
        for name in ("back_emf_constant", "voltage_limit"):
            if self.resistance is None and getattr(self, name) is not None:
                raise value_error(f"Motor.{name}", getattr(self, name), "None without a resistance (ohm)")
        warn_unusual_units("Motor", vars(self))

    @property
    def reflected_inertia(self) -> float:
        """Rotor inertia reflected to the joint: gear_ratio^2 * rotor_inertia, kg m^2."""
        return self.gear_ratio**2 * self.rotor_inertia

    @property
    def torque_per_ampere(self) -> float:
        """Joint torque per current: gear_ratio * torque_constant * efficiency, N m/A."""
        return self.gear_ratio * self.torque_constant * self.efficiency

    @property
    def torque_per_volt(self) -> float | None:
        """Joint torque at standstill per voltage: torque_per_ampere / resistance, N m/V; None without a resistance."""
        return None if self.resistance is None else self.torque_per_ampere / self.resistance

    @property
    def back_emf_damping(self) -> float:
        """Damping at the joint by the back-EMF: torque_per_volt * back_emf_constant * gear_ratio, N m s/rad, or 0."""
        constant = self.torque_constant if self.back_emf_constant is None else self.back_emf_constant
        return (self.torque_per_volt or 0.0) * constant * self.gear_ratio

    @property
    def joint_torque_limit(self) -> float | None:
        """Largest torque at the joint, N m: the lower one of current limit and `stall_torque`; None without both."""
        by_current = None if self.current_limit is None else self.torque_per_ampere * self.current_limit
        return min((each for each in (by_current, self.stall_torque) if each is not None), default=None)

    @property
    def stall_torque(self) -> float | None:
        """Joint torque at standstill at the voltage limit, N m; None without a resistance or a voltage limit."""
        if self.torque_per_volt is None or self.voltage_limit is None:
            return None
        return self.torque_per_volt * self.voltage_limit

    @property
    def joint_speed_limit(self) -> float | None:
        """Largest speed of the joint, rad/s; None without a speed limit."""
        return None if self.speed_limit is None else self.speed_limit / self.gear_ratio

    @property
    def joint_resolution(self) -> float | None:
        """Joint angle per count of the encoder, rad; None without an encoder."""
        return None if self.encoder_resolution is None else self.encoder_resolution / self.gear_ratio


@check_keywords
@dataclass(frozen=True)
class Joint:
    """Revolute joint: rotor and link, rigidly connected or by a spring and a damper (Eq. (23), see `model.beam`).

    A passive joint has no motor: its spring and damper connect the link to the frame that carries the joint.

    Attributes:
        axis: unit vector (3,) in the tip frame of the previous link, or in the base frame for the first joint. Its
            length must be 1 within 1e-9; it is not normalised.
        rotor_inertia: moment of inertia of the rotor about the joint axis, reflected to the joint, kg m^2. It must be
            positive for a flexible joint, because the angle of the rotor is then a coordinate of its own.
        stiffness: stiffness of the spring between rotor and link, N m/rad; None for a rigid joint.
        damping: coefficient of the damper parallel to this spring, N m s/rad; 0 for a rigid joint.
        viscous_friction: coefficient of viscous friction between the rotor and the frame that carries the joint, N m
            s/rad.
        coulomb_friction: Coulomb friction torque between the rotor and the frame that carries the joint, N m. At the
            rotor rate r (rad/s) the friction torque is coulomb_friction * tanh(r / coulomb_rate), against the motion.
        coulomb_rate: rotor rate at which the friction torque is 76 % (tanh 1) of coulomb_friction, rad/s.
        static_friction: static friction (break-away torque), N m; None for that of coulomb_friction. The friction
            torque is then multiplied by 1 + (static_friction / coulomb_friction - 1) / (1 + (r / stribeck_rate)^2). A
            motor at rest under a smaller torque creeps, by less than coulomb_rate under half of it. The largest
            friction torque is within 5 % of static_friction for a stribeck_rate of at least 10 coulomb_rate.
        stribeck_rate: rotor rate at which half of this excess is left, rad/s.
        backlash: total gap between motor and link, measured at the joint, rad; None for a spring without gap. The
            spring acts beyond half the gap on either side; the damper also acts within the gap. A backlash of 0 is a
            spring without gap whose backlash can be varied, see `simulation.physical_parameters`.
        stiffness_pieces: pieces of the spring below its full stiffness, as (torque, fraction), ...: up to the torque, N
            m, ascending, the stiffness is a fraction > 0 and <= 1 of `stiffness`, which acts beyond the last.
        knee_width: twist on either side of an end of the gap or of a piece, over which the stiffness changes linearly,
            rad.
        torque_limit: largest motor torque at the joint, N m; None if unknown. Environments scale actions by this limit;
            `simulate` does not apply it.
        passive: True for a joint without motor and rotor; the spring is then relaxed at a joint angle of zero, and
            stiffness=None is a joint without a spring. Its friction acts between link and carrying frame.
        motor: Motor with its gear, or None. Its `reflected_inertia` replaces rotor_inertia, its `joint_torque_limit`
            torque_limit and its `joint_speed_limit` speed_limit; leave out all three.
        speed_limit: largest speed of the joint, rad/s; None if unknown. Planned motions keep it; the simulation does
            not enforce it.
        angle_range: least and largest joint angle, rad; None for a joint that turns without stops. Episodes start and
            end within the range, and start around its middle; the simulation has no stops.

    Raises:
        ValueError: for a value outside its range, for a damper without a spring, for a spring without a rotor inertia,
            and for a rotor inertia, torque limit or speed limit in contradiction to the motor.

    Examples:
        >>> fm.Joint((0, 0, 1), rotor_inertia=0.01, stiffness=30.0).axis
        (0.0, 0.0, 1.0)
    """

    axis: Vector
    rotor_inertia: float = 0.0
    stiffness: float | None = None
    damping: float = 0.0
    viscous_friction: float = 0.0
    coulomb_friction: float = 0.0
    coulomb_rate: float = 0.01
    torque_limit: float | None = None
    motor: Motor | None = None
    static_friction: float | None = None
    stribeck_rate: float = 0.05
    backlash: float | None = None
    stiffness_pieces: tuple[tuple[float, float], ...] = ()
    knee_width: float = 1e-4
    passive: bool = False
    speed_limit: float | None = None
    angle_range: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        self._check_passive()
        if self.motor is not None:
            self._set_from_motor(instance("Joint.motor", self.motor, Motor, "a Motor or None"))
        set_fields(
            self,
            axis=_unit_vector("Joint.axis", self.axis),
            rotor_inertia=physical("Joint.rotor_inertia", self.rotor_inertia, "kg m^2", zero=True),
            damping=physical("Joint.damping", self.damping, "N m s/rad", zero=True),
            viscous_friction=physical("Joint.viscous_friction", self.viscous_friction, "N m s/rad", zero=True),
            coulomb_friction=physical("Joint.coulomb_friction", self.coulomb_friction, "N m", zero=True),
            coulomb_rate=physical("Joint.coulomb_rate", self.coulomb_rate, "rad/s"),
            stribeck_rate=physical("Joint.stribeck_rate", self.stribeck_rate, "rad/s"),
            knee_width=physical("Joint.knee_width", self.knee_width, "rad"),
            stiffness_pieces=_stiffness_pieces(self.stiffness_pieces),
        )
        self._check_static_friction()
        if self.torque_limit is not None:
            set_fields(self, torque_limit=physical("Joint.torque_limit", self.torque_limit, "N m"))
        if self.speed_limit is not None:
            set_fields(self, speed_limit=physical("Joint.speed_limit", self.speed_limit, "rad/s"))
        if self.angle_range is not None:
            set_fields(self, angle_range=_angle_range(self.angle_range))
        if self.stiffness is not None:
            set_fields(self, stiffness=physical("Joint.stiffness", self.stiffness, "N m/rad; None for a rigid joint"))
            if self.rotor_inertia == 0.0 and not self.passive:
                allowed = (
                    "a number > 0 (kg m^2): the rotor of a joint with stiffness has mass; at the joint, the inertia of "
                    "the rotor of the motor times the square of the gear ratio"
                )
                raise value_error("Joint.rotor_inertia", self.rotor_inertia, allowed)
        elif self.damping > 0.0 and not self.passive:
            raise value_error(
                "Joint.damping", self.damping, "0 with stiffness None: the damper is parallel to the spring"
            )
        if self.backlash is not None:
            set_fields(self, backlash=physical("Joint.backlash", self.backlash, "rad", zero=True))
        if self.has_knees and self.stiffness is None:
            name = "stiffness_pieces" if self.stiffness_pieces else "backlash"
            raise value_error(
                f"Joint.{name}", getattr(self, name), "none with stiffness None: it belongs to the spring"
            )
        warn_unusual_units("Joint", vars(self))

    def _check_passive(self) -> None:
        """Check that a passive joint has no motor, rotor, limits, backlash and stiffness pieces."""
        if flag("Joint.passive", self.passive):
            names = (
                "motor",
                "rotor_inertia",
                "torque_limit",
                "backlash",
                "stiffness_pieces",
                "speed_limit",
                "angle_range",
            )
            for name in names:
                if getattr(self, name) not in (None, 0.0, ()):
                    raise value_error(f"Joint.{name}", getattr(self, name), "none for a passive joint")

    def _check_static_friction(self) -> None:
        """Convert static_friction to a float and check that it is at least the Coulomb friction of the joint."""
        if self.static_friction is not None:
            set_fields(self, static_friction=physical("Joint.static_friction", self.static_friction, "N m", zero=True))
            if self.coulomb_friction == 0.0 or self.static_friction < self.coulomb_friction:
                allowed = f"a torque (N m) of at least coulomb_friction, {self.coulomb_friction:g}, which must be > 0"
                raise value_error("Joint.static_friction", self.static_friction, allowed)

    def _set_from_motor(self, motor: Motor) -> None:
        """Set rotor inertia and limits from the motor; values equal to those of the motor are accepted."""
        inertia, limit, speed = motor.reflected_inertia, motor.joint_torque_limit, motor.joint_speed_limit
        if self.rotor_inertia not in (0.0, inertia):
            allowed = f"none together with a motor, whose rotor inertia at the joint is {inertia:.6g} (kg m^2)"
            raise value_error("Joint.rotor_inertia", self.rotor_inertia, allowed)
        if self.torque_limit not in (None, limit) and limit is not None:
            allowed = f"none together with a motor with a limit, which sets {limit:.6g} (N m)"
            raise value_error("Joint.torque_limit", self.torque_limit, allowed)
        if self.speed_limit not in (None, speed) and speed is not None:
            allowed = f"none together with a motor with a speed limit, which sets {speed:.6g} (rad/s)"
            raise value_error("Joint.speed_limit", self.speed_limit, allowed)
        set_fields(
            self,
            rotor_inertia=inertia,
            torque_limit=self.torque_limit if limit is None else limit,
            speed_limit=self.speed_limit if speed is None else speed,
        )

    @property
    def rotor_damping(self) -> float:
        """Viscous friction and the damping of the back-EMF, or of the damper of a passive joint, N m s/rad."""
        if self.passive:
            return self.viscous_friction + self.damping
        return self.viscous_friction + (0.0 if self.motor is None else self.motor.back_emf_damping)

    @property
    def static_excess(self) -> float:
        """Static friction / Coulomb friction - 1, dimensionless; 0 without static friction."""
        return 0.0 if self.static_friction is None else self.static_friction / self.coulomb_friction - 1.0

    @property
    def has_knees(self) -> bool:
        """True if the torque-twist curve of the spring has knees: a backlash, which may be 0, or stiffness pieces."""
        return self.backlash is not None or bool(self.stiffness_pieces)

    @property
    def soft_stiffness(self) -> float:
        """Stiffness at small torques / stiffness, dimensionless; that beyond the gap."""
        return self.stiffness_pieces[0][1] if self.stiffness_pieces else 1.0

    @property
    def ripple_torque(self) -> float:
        """Amplitude of the torque ripple at the joint, N m."""
        return 0.0 if self.motor is None else self.motor.torque_ripple * self.motor.gear_ratio * self.motor.efficiency

    @property
    def ripple_cycles(self) -> float:
        """Cycles of the torque ripple per turn of the motor at the joint, after the gear; 0 without torque ripple."""
        return 0.0 if self.motor is None else (self.motor.ripple_cycles or 0.0) * self.motor.gear_ratio

    @property
    def ripple_phase(self) -> float:
        """Phase of the torque ripple, rad."""
        return 0.0 if self.motor is None else self.motor.ripple_phase


def _angle_range(value: object) -> tuple[float, float]:
    """Return a range of joint angles, rad; ValueError if its ends are not ascending or more than four turns apart."""
    low, high = vector("Joint.angle_range", value, 2, "rad")
    if not 0.0 < high - low <= LARGEST_RANGE:
        allowed = f"two ascending angles (rad), at most {LARGEST_RANGE:.4g} apart; None for a joint without stops"
        raise value_error("Joint.angle_range", value, allowed)
    return low, high


def _stiffness_pieces(value: object) -> tuple[tuple[float, float], ...]:
    """Return stiffness pieces as floats, after checking that torques ascend and fractions are > 0 and <= 1."""
    pieces, last = [], 0.0
    for i, piece in enumerate(sequence("Joint.stiffness_pieces", value, "pairs (torque, fraction)")):
        name = f"Joint.stiffness_pieces[{i}]"
        torque, fraction = vector(name, piece, 2)
        if not (last < torque <= MAX_SIZE and 1e-6 <= fraction <= 1.0):
            raise value_error(name, piece, f"(torque, fraction) with a torque > {last:g} (N m), a fraction 1e-6 to 1")
        pieces.append((torque, fraction))
        last = torque
    return tuple(pieces)


def _unit_vector(name: str, value: object) -> tuple[float, ...]:
    """Return a (3,) vector of length 1 within 1e-9 as a tuple of floats, without normalising it."""
    entries = vector(name, value, 3)
    length = math.hypot(*entries)
    if not abs(length - 1.0) <= UNIT_TOLERANCE:
        raise value_error(name, value, f"a vector of length 1 (the length of this one is {length:.12g})")
    return entries
