"""Named environments: default settings of each environment id."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from flexman_gym.envs.limits import Limits
from flexman_gym.envs.tasks import Hold, Slew, Task, Track, plain_task
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.catalog import one_joint, paper_rrr, quanser_2dsfl, vertical_2r
from flexman_gym.scene.rigid_body import Payload
from flexman_gym.scene.serialization import to_plain

Gains = dict[str, tuple[float, ...]]


@dataclass(frozen=True)
class NamedEnvironment:
    """What a named environment is made of where `gym.make` is not told otherwise.

    Attributes:
        arm: makes the arm; its joints say the torque limits.
        pd: gains of the PD controller that was tuned for it: stiffness (N m/rad) and damping (N m s/rad), one for each
            joint.
        task: see `Configuration`.
        sensors: see `Configuration`.
        limits: see `Configuration`.
        control_period: s.
        horizon: s, after which an episode is truncated.
        conditions: the folder of its environment files under conditions; "" for none.
        longest_step: s, of the default method; the energy alarm stays silent at it under random torques.
    """

    arm: Callable[[], Arm]
    pd: Gains
    task: Task = field(default_factory=Slew)
    sensors: Any = "full"
    limits: Limits = field(default_factory=Limits)
    control_period: float = 0.02
    horizon: float = 10.0
    longest_step: float = 0.02 / 3.0
    conditions: str = ""

    def value(self, name: str) -> Any:
        """Return the value of a setting."""
        return self.arm() if name == "arm" else getattr(self, name)

    def plain(self, name: str) -> Any:
        """Return the plain form of arm, task or limits; {} for another setting."""
        forms = {"arm": to_plain, "task": plain_task, "limits": asdict}
        return forms[name](self.value(name)) if name in forms else {}


def flex_rrr() -> Arm:
    """The paper's arm with heavier rotors and modal damping: 1 kg m^2 could not be damped by a motor at 50 Hz."""
    return paper_rrr(rotor_inertia=10.0, torque_limit=400.0, modal_damping_ratio=0.005)


def _flex_rrr_gravity() -> Arm:
    """The paper's arm on the earth with 10 kg at its tip: stiffer joints and motors that hold it outstretched.

    Outstretched with 20 kg, joints 2 and 3 carry 4.0 and 1.1 kN m.
    """
    arm = paper_rrr(joint_stiffness=6e4, payload=Payload(10.0), gravity=(0.0, 0.0, -9.81), modal_damping_ratio=0.005)
    motors = ((100.0, 2500.0), (100.0, 7000.0), (40.0, 2000.0))  # kg m^2 and N m
    joints = [
        replace(joint, rotor_inertia=rotor, torque_limit=limit)
        for joint, (rotor, limit) in zip(arm.joints, motors, strict=True)
    ]
    return replace(arm, joints=joints)


# Gains: `flexman tune ID`. All have a gain margin of 2 and a phase margin of 30 degrees in the sampled loop.
RRR_PD: Gains = {"stiffness": (148.0, 144.0, 522.0), "damping": (472.0, 487.0, 366.0)}
RRR_TRACK_PD: Gains = {"stiffness": (11.4, 9870.0, 4.15), "damping": (487.0, 443.0, 331.0)}
RRR_HOLD_PD: Gains = {"stiffness": (85.1, 7700.0, 244.0), "damping": (488.0, 294.0, 318.0)}
GRAVITY_PD: Gains = {"stiffness": (6160.0, 6840.0, 8660.0), "damping": (5690.0, 6470.0, 637.0)}
PLANAR_PD: Gains = {"stiffness": (39.0, 5.56), "damping": (9.35, 1.33)}
PLANAR_TRACK_PD: Gains = {"stiffness": (300.0, 13.9), "damping": (9.91, 1.39)}
PLANAR_HOLD_PD: Gains = {"stiffness": (63.0, 26.1), "damping": (9.83, 3.96)}
ONE_PD: Gains = {"stiffness": (1.13,), "damping": (0.487,)}
QUANSER_PD: Gains = {"stiffness": (15.7, 9.38), "damping": (0.353, 0.267)}
RRR = NamedEnvironment(flex_rrr, RRR_PD, conditions="rrr")
PLANAR = NamedEnvironment(
    vertical_2r,
    PLANAR_PD,
    task=Slew(reward="distance"),
    limits=Limits(rate=20.0, twist=0.5, deflection_rate=20.0, tip_speed=20.0),
    control_period=0.01,
    longest_step=0.0025,
    conditions="planar",
)
NAMED: dict[str, NamedEnvironment] = {
    "FlexRRR-v0": RRR,
    "FlexRRR-Track-v0": replace(RRR, pd=RRR_TRACK_PD, task=Track(preview=(0.2, 0.5, 1.0)), horizon=20.0),
    "FlexRRR-Hold-v0": replace(RRR, pd=RRR_HOLD_PD, task=Hold()),
    "FlexRRR-Gravity-v0": replace(
        RRR,
        arm=_flex_rrr_gravity,
        pd=GRAVITY_PD,
        task=Slew(start=0.6, slew=0.6, reward="distance"),
        control_period=0.01,
        conditions="gravity",
    ),
    "FlexPlanar-v0": PLANAR,
    "FlexPlanar-Track-v0": replace(PLANAR, pd=PLANAR_TRACK_PD, task=Track(preview=(0.05, 0.1, 0.2))),
    "FlexPlanar-Hold-v0": replace(
        PLANAR, pd=PLANAR_HOLD_PD, task=Hold(impulse=(0.02, 0.1), load=(0.0, 0.5), sway=(0.0, 1.0), gap=1.0)
    ),
    "FlexOne-v0": NamedEnvironment(
        one_joint,
        ONE_PD,
        task=Slew(start=1.0, slew=1.5, reward="distance"),
        limits=Limits(rate=20.0, twist=0.5, deflection_rate=20.0, tip_speed=20.0),
        longest_step=0.00125,
    ),
    "FlexQuanser-v0": NamedEnvironment(
        quanser_2dsfl,
        QUANSER_PD,
        task=Slew(start=0.5, slew=0.5, reward="distance"),
        sensors=({"kind": "motor_encoders", "quantisation": 1e-5}, "strain", "command"),
        limits=Limits(angle=1.6, rate=10.0, deflection_rate=10.0, tip_speed=10.0),
        control_period=0.01,
        longest_step=0.01 / 3.0,
    ),
}
"""Named environments: id -> values of settings that are not given."""
DEFAULT = "FlexRRR-v0"
