"""Randomisation: ranges from which each episode draws what its arm is like and what disturbs it."""

from dataclasses import dataclass, fields

from flexman_gym.checks import non_negative, positive, refusal, sequence, store, vector, whole_number

Range = tuple[float, float]
FACTORS = ("joint_stiffness", "link_stiffness", "rotor_inertia", "torque_limit")
LONGEST_DELAY = 1000  # control periods
TRUNCATION = 4.0  # standard deviations; noise beyond it is drawn again


@dataclass(frozen=True)
class Randomisation:
    """Ranges (low, high) from which every episode draws anew, uniformly; None switches an effect off.

    Each effect has a random stream of its own, made from the seed of the environment, so that one that is switched on
    changes neither the draws of the others nor start and goal. What an episode drew does not depend on those before it.

    Attributes:
        payload_mass: kg, with which the payload's inertia grows.
        joint_stiffness, rotor_inertia, torque_limit: factors > 0 on the nominal values, one for each joint.
        link_stiffness: factor > 0 on the elastic moduli, one for each link.
        joint_damping: N m s/rad, one for each joint.
        sensor_noise: standard deviation as a part of each observation's bound; normal noise on each entry of each
            observation, within 4 standard deviations (a number beyond is drawn again). The bounds of the observation
            space grow by 4 times the largest standard deviation; whether an arm leaves its limits is decided without
            noise.
        delay: whole control periods by which torques come late; before the first there is none.
        initial_vibration: m, deflection of the tip of each flexible link at the start, in a random direction across the
            beam and in the shape that a force on that tip gives it; the arm is released from there. Directions into
            which the model of a link cannot bend are left out.
        tip_impulse: N s, impulses of random directions, each a force on the tip that is constant during one control
            period, at random times.
        impulse_gap: mean time between two impulses, s; at least a control period.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    payload_mass: Range | None = None
    joint_stiffness: Range | None = None
    link_stiffness: Range | None = None
    rotor_inertia: Range | None = None
    joint_damping: Range | None = None
    torque_limit: Range | None = None
    sensor_noise: Range | None = None
    delay: tuple[int, int] | None = None
    initial_vibration: Range | None = None
    tip_impulse: Range | None = None
    impulse_gap: float = 2.0

    def __post_init__(self) -> None:
        for name in EFFECTS:
            if (value := getattr(self, name)) is not None:
                store(self, **{name: _range(name, value)})
        store(self, impulse_gap=positive("Randomisation.impulse_gap", self.impulse_gap, "s"))

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects that are on."""
        return tuple(name for name in EFFECTS if getattr(self, name) is not None)


EFFECTS = tuple(each.name for each in fields(Randomisation) if each.name != "impulse_gap")


def _range(name: str, value: object) -> tuple[float, float]:
    field = f"Randomisation.{name}"
    low, high = entries = vector(field, value, 2)
    for each in entries:
        (positive if name in FACTORS else non_negative)(field, each)
    if name == "delay":
        low, high = (whole_number(field, each, 0, LONGEST_DELAY) for each in sequence(field, value))
    if low > high:
        raise refusal(field, value, "a range (low, high) with low <= high, or None")
    return low, high
