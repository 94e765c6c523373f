"""Joint: a revolute joint, rigid or with a spring and a damper, and the motor that drives it."""

from dataclasses import dataclass

from flexman_gym.arrays import Vector
from flexman_gym.checks import instance, physical, refusal, store, unit_vector
from flexman_gym.scene.guesses import answer_guesses
from flexman_gym.scene.motor import Motor
from flexman_gym.scene.slips import warn_of_slips


@answer_guesses
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
        store(
            self,
            axis=unit_vector("Joint.axis", self.axis),
            rotor_inertia=physical("Joint.rotor_inertia", self.rotor_inertia, "kg m^2", zero=True),
            damping=physical("Joint.damping", self.damping, "N m s/rad", zero=True),
            viscous_friction=physical("Joint.viscous_friction", self.viscous_friction, "N m s/rad", zero=True),
            coulomb_friction=physical("Joint.coulomb_friction", self.coulomb_friction, "N m", zero=True),
            coulomb_rate=physical("Joint.coulomb_rate", self.coulomb_rate, "rad/s"),
        )
        if self.torque_limit is not None:
            store(self, torque_limit=physical("Joint.torque_limit", self.torque_limit, "N m"))
        if self.stiffness is not None:
            store(self, stiffness=physical("Joint.stiffness", self.stiffness, "N m/rad; None for a rigid joint"))
            if self.rotor_inertia == 0.0:
                allowed = "a number > 0 (kg m^2): the rotor of a joint with stiffness has mass"
                raise refusal("Joint.rotor_inertia", self.rotor_inertia, allowed)
        elif self.damping > 0.0:
            raise refusal("Joint.damping", self.damping, "0 with stiffness None: the damper is parallel to the spring")
        warn_of_slips("Joint", vars(self))

    def _take_from_motor(self, motor: Motor) -> None:
        """Takes rotor inertia and torque limit from the motor; a copy of a joint gives them once more."""
        inertia, limit = motor.reflected_inertia, motor.joint_torque_limit
        if self.rotor_inertia not in (0.0, inertia):
            allowed = f"nothing beside a motor, whose rotor gives the joint {inertia:.6g} (kg m^2)"
            raise refusal("Joint.rotor_inertia", self.rotor_inertia, allowed)
        if self.torque_limit not in (None, limit) and limit is not None:
            allowed = f"nothing beside a motor with a current limit, which gives {limit:.6g} (N m)"
            raise refusal("Joint.torque_limit", self.torque_limit, allowed)
        store(self, rotor_inertia=inertia, torque_limit=self.torque_limit if limit is None else limit)

    @property
    def speed_limit(self) -> float | None:
        """The most speed that its motor gives the joint, rad/s; None where it is unknown."""
        return None if self.motor is None else self.motor.joint_speed_limit
