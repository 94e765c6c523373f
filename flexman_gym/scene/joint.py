"""Revolute joints, rigid or elastic, and the geared motors that drive them."""

import math
from dataclasses import dataclass

from flexman_gym.common.arrays import Vector
from flexman_gym.common.checks import UNIT_TOLERANCE, instance, physical, set_fields, value_error, vector
from flexman_gym.scene.input_checks import check_keywords, warn_unusual_units


@check_keywords
@dataclass(frozen=True)
class Motor:
    """A motor that turns a joint through a gear; its own numbers are those of its shaft, before the gear.

    Attributes:
        gear_ratio: turns of the motor for one turn of the joint; 1 without a gear.
        torque_constant: torque of the motor for each ampere, N m/A.
        rotor_inertia: of the rotor, and of what turns with it before the gear, kg m^2.
        current_limit: A; None where it is unknown.
        speed_limit: of the motor, rad/s; None where it is unknown.
        efficiency: part of the torque that the gear passes on, > 0 and at most 1.
        encoder_resolution: angle of the motor between two counts of its encoder, rad; None without one.

    Raises:
        ValueError: for a number that is not from 1e-30 to 1e30 (the rotor inertia may be 0), and for an efficiency
            outside its range.

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

    def __post_init__(self) -> None:
        set_fields(
            self,
            gear_ratio=physical("Motor.gear_ratio", self.gear_ratio, "turns of the motor for one of the joint"),
            torque_constant=physical("Motor.torque_constant", self.torque_constant, "N m/A"),
            rotor_inertia=physical("Motor.rotor_inertia", self.rotor_inertia, "kg m^2", zero=True),
            efficiency=physical("Motor.efficiency", self.efficiency),
        )
        for name, unit in (("current_limit", "A"), ("speed_limit", "rad/s"), ("encoder_resolution", "rad")):
            value = getattr(self, name)
            if value is not None:
                set_fields(self, **{name: physical(f"Motor.{name}", value, unit)})
        if self.efficiency > 1.0:
            raise value_error("Motor.efficiency", self.efficiency, "a number > 0 and <= 1")
        warn_unusual_units("Motor", vars(self))

    @property
    def reflected_inertia(self) -> float:
        """Inertia of the rotor as the joint feels it, gear_ratio^2 rotor_inertia, kg m^2."""
        return self.gear_ratio**2 * self.rotor_inertia

    @property
    def torque_per_ampere(self) -> float:
        """Torque at the joint for each ampere, gear_ratio torque_constant efficiency, N m/A."""
        return self.gear_ratio * self.torque_constant * self.efficiency

    @property
    def joint_torque_limit(self) -> float | None:
        """The most torque at the joint, N m; None without a current limit."""
        return None if self.current_limit is None else self.torque_per_ampere * self.current_limit

    @property
    def joint_speed_limit(self) -> float | None:
        """The most speed of the joint, rad/s; None without a speed limit."""
        return None if self.speed_limit is None else self.speed_limit / self.gear_ratio

    @property
    def joint_resolution(self) -> float | None:
        """Angle of the joint between two counts of the encoder, rad; None without one."""
        return None if self.encoder_resolution is None else self.encoder_resolution / self.gear_ratio


@check_keywords
@dataclass(frozen=True)
class Joint:
    """A revolute joint: a rotor that turns the link behind it directly, or through a spring and a damper (Eq. 23).

    Attributes:
        axis: (3,) unit vector in the frame of the previous link's tip; for the first joint, in the base frame. It is
            not normalised.
        rotor_inertia: about the axis, on the link's side of any gear, kg m^2.
        stiffness: of the spring between rotor and link, N m/rad; None for a rigid joint.
        damping: of the damper parallel to that spring, N m s/rad.
        viscous_friction: of the rotor in its bearings and gear, N m s/rad; of the link where the joint is rigid.
        coulomb_friction: of the rotor in its bearings and gear, N m. It opposes the rate r of the rotor with the torque
            coulomb_friction tanh(r / coulomb_rate).
        coulomb_rate: rate at which the Coulomb friction has reached three quarters of its full size, rad/s.
        torque_limit: the most that the motor gives, N m; None where it is unknown. Environments scale actions by it; a
            simulation applies any torque that it is given.
        motor: a Motor with its gear; None where the numbers above say what it does. Its `reflected_inertia` becomes the
            rotor_inertia and its `joint_torque_limit` the torque_limit, which are then left out.

    Raises:
        ValueError: for an axis whose length is not 1 within 1e-9, for a number that is negative or not finite, for a
            damper without a spring, for a spring without a rotor (its coordinate would have no mass), and for a rotor
            inertia or a torque limit beside a motor that says another one.

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

    def __post_init__(self) -> None:
        if self.motor is not None:
            self._take_from_motor(instance("Joint.motor", self.motor, Motor, "a Motor or None"))
        set_fields(
            self,
            axis=_unit_vector("Joint.axis", self.axis),
            rotor_inertia=physical("Joint.rotor_inertia", self.rotor_inertia, "kg m^2", zero=True),
            damping=physical("Joint.damping", self.damping, "N m s/rad", zero=True),
            viscous_friction=physical("Joint.viscous_friction", self.viscous_friction, "N m s/rad", zero=True),
            coulomb_friction=physical("Joint.coulomb_friction", self.coulomb_friction, "N m", zero=True),
            coulomb_rate=physical("Joint.coulomb_rate", self.coulomb_rate, "rad/s"),
        )
        if self.torque_limit is not None:
            set_fields(self, torque_limit=physical("Joint.torque_limit", self.torque_limit, "N m"))
        if self.stiffness is not None:
            set_fields(self, stiffness=physical("Joint.stiffness", self.stiffness, "N m/rad; None for a rigid joint"))
            if self.rotor_inertia == 0.0:
                allowed = "a number > 0 (kg m^2): the rotor of a joint with stiffness has mass"
                raise value_error("Joint.rotor_inertia", self.rotor_inertia, allowed)
        elif self.damping > 0.0:
            raise value_error(
                "Joint.damping", self.damping, "0 with stiffness None: the damper is parallel to the spring"
            )
        warn_unusual_units("Joint", vars(self))

    def _take_from_motor(self, motor: Motor) -> None:
        """Takes rotor inertia and torque limit from the motor; a copy of a joint gives them once more."""
        inertia, limit = motor.reflected_inertia, motor.joint_torque_limit
        if self.rotor_inertia not in (0.0, inertia):
            allowed = f"nothing beside a motor, whose rotor gives the joint {inertia:.6g} (kg m^2)"
            raise value_error("Joint.rotor_inertia", self.rotor_inertia, allowed)
        if self.torque_limit not in (None, limit) and limit is not None:
            allowed = f"nothing beside a motor with a current limit, which gives {limit:.6g} (N m)"
            raise value_error("Joint.torque_limit", self.torque_limit, allowed)
        set_fields(self, rotor_inertia=inertia, torque_limit=self.torque_limit if limit is None else limit)

    @property
    def speed_limit(self) -> float | None:
        """The most speed that its motor gives the joint, rad/s; None where it is unknown."""
        return None if self.motor is None else self.motor.joint_speed_limit


def _unit_vector(name: str, value: object) -> tuple[float, ...]:
    """Return a (3,) vector of length 1 within 1e-9 as a tuple of floats; it is not normalised.

    Raises:
        ValueError: for anything else.
    """
    entries = vector(name, value, 3)
    length = math.hypot(*entries)
    if not abs(length - 1.0) <= UNIT_TOLERANCE:
        raise value_error(name, value, f"a vector of length 1 (the length of this one is {length:.12g})")
    return entries
