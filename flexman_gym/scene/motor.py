"""Motor: an electric motor and its gear, in the numbers of a data sheet."""

from dataclasses import dataclass

from flexman_gym.checks import physical, refusal, store
from flexman_gym.scene.guesses import answer_guesses
from flexman_gym.scene.slips import warn_of_slips


@answer_guesses
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
        store(
            self,
            gear_ratio=physical("Motor.gear_ratio", self.gear_ratio, "turns of the motor for one of the joint"),
            torque_constant=physical("Motor.torque_constant", self.torque_constant, "N m/A"),
            rotor_inertia=physical("Motor.rotor_inertia", self.rotor_inertia, "kg m^2", zero=True),
            efficiency=physical("Motor.efficiency", self.efficiency),
        )
        for name, unit in (("current_limit", "A"), ("speed_limit", "rad/s"), ("encoder_resolution", "rad")):
            value = getattr(self, name)
            if value is not None:
                store(self, **{name: physical(f"Motor.{name}", value, unit)})
        if self.efficiency > 1.0:
            raise refusal("Motor.efficiency", self.efficiency, "a number > 0 and <= 1")
        warn_of_slips("Motor", vars(self))

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
