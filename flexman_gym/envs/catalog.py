"""Catalog: the named environments, an entry each."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from flexman_gym.envs.limits import Limits
from flexman_gym.envs.tasks import Hold, Slew, Task, Track
from flexman_gym.scene.arm import Arm, Payload
from flexman_gym.scene.catalog import one_joint, paper_rrr, vertical_2r

Gains = dict[str, tuple[float, ...]]


@dataclass(frozen=True)
class Named:
    """What a named environment is made of where `gym.make` is not told otherwise.

    Attributes:
        arm: makes the arm; its joints say the torque limits.
        pd: gains of the PD controller that was tuned for it: stiffness (N m/rad) and damping (N m s/rad), one for each
            joint.
        task, sensors, limits: see `Setup`.
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


def flex_rrr() -> Arm:
    """The paper's arm with heavier rotors and modal damping: 1 kg m^2 could not be damped by a motor at 50 Hz."""
    return paper_rrr(rotor_inertia=10.0, torque_limit=400.0, modal_damping_ratio=0.005)


def flex_rrr_gravity() -> Arm:
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


# Gains: the best by mean reward of 8 episodes among 200 drawn at random and 60 around the best of those, damping
# held below 950 N m s/rad: the sampled motor is unstable from 2 rotor inertia / period = 1000 on.
RRR_PD: Gains = {"stiffness": (497.0, 325.0, 328.0), "damping": (950.0, 950.0, 103.0)}
# Gains of these: `python scripts/tune.py ID`.
PLANAR_PD: Gains = {"stiffness": (18.7, 13.9), "damping": (4.52, 3.0)}
# The least RMS tip error of 8 episodes among those drawn at random whose sampled loop is well within the unit circle.
RRR_TRACK_PD: Gains = {"stiffness": (9000.0, 5810.0, 21.4), "damping": (616.0, 950.0, 306.0)}
PLANAR_TRACK_PD: Gains = {"stiffness": (59.6, 2.77), "damping": (19.0, 3.44)}
GRAVITY_PD: Gains = {"stiffness": (8730.0, 10100.0, 1810.0), "damping": (8210.0, 9480.0, 1730.0)}
RRR = Named(flex_rrr, RRR_PD, conditions="rrr")
PLANAR = Named(
    vertical_2r,
    PLANAR_PD,
    task=Slew(reward="distance"),
    limits=Limits(rate=20.0, twist=0.5, deflection_rate=20.0, tip_speed=20.0),
    control_period=0.01,
    longest_step=0.0025,
    conditions="planar",
)
NAMED: dict[str, Named] = {
    "FlexRRR-v0": RRR,
    "FlexRRR-Track-v0": replace(RRR, pd=RRR_TRACK_PD, task=Track(preview=(0.2, 0.5, 1.0)), horizon=20.0),
    "FlexRRR-Hold-v0": replace(RRR, task=Hold()),
    "FlexRRR-Gravity-v0": replace(
        RRR,
        arm=flex_rrr_gravity,
        pd=GRAVITY_PD,
        task=Slew(start=0.6, slew=0.6, reward="distance"),
        control_period=0.01,
        conditions="gravity",
    ),
    "FlexPlanar-v0": PLANAR,
    "FlexPlanar-Track-v0": replace(PLANAR, pd=PLANAR_TRACK_PD, task=Track(preview=(0.05, 0.1, 0.2))),
    "FlexPlanar-Hold-v0": replace(PLANAR, task=Hold(impulse=(0.02, 0.1), load=(0.0, 0.5), sway=(0.0, 1.0), gap=1.0)),
    "FlexOne-v0": Named(
        one_joint,
        {"stiffness": (1.27,), "damping": (0.514,)},
        task=Slew(start=1.0, slew=1.5, reward="distance"),
        limits=Limits(rate=20.0, twist=0.5, deflection_rate=20.0, tip_speed=20.0),
        longest_step=0.00125,
    ),
}
DEFAULT = "FlexRRR-v0"
