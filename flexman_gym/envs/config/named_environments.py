"""Named environments and their conditions."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn

from flexman_gym.common import files
from flexman_gym.common.checks import one_of, value_error
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
NAMED_ENVIRONMENTS: dict[str, NamedEnvironment] = {
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
DEFAULT_ID = "FlexRRR-v0"


NOMINAL = "nominal"  # the condition without changes
CONDITION_FOLDER = Path(__file__).parents[1] / "conditions"  # arm/condition.yaml: changes of settings
CONDITIONS = (NOMINAL, *sorted({path.stem for path in CONDITION_FOLDER.glob("*/*.yaml")}))


def condition_settings(id: str, condition: object) -> dict[str, Any]:
    """Return the settings of a named environment under one of its conditions; {} for the nominal one.

    Raises:
        ValueError: for another condition, and for an environment without conditions.
    """
    named = NAMED_ENVIRONMENTS[one_of("id", id, NAMED_ENVIRONMENTS)]
    if not named.conditions:
        known = [each for each, named in NAMED_ENVIRONMENTS.items() if named.conditions]
        raise value_error("condition", f"{id}/{condition}", f"one for {', '.join(known)}")
    folder = CONDITION_FOLDER / named.conditions
    own = sorted(path.stem for path in folder.glob("*.yaml"))
    if one_of("condition", condition, (NOMINAL, *own)) == NOMINAL:
        return {}
    changes = files.read_data(folder / f"{condition}.yaml")
    return {name: _merged(named.plain(name), change) for name, change in changes.items()}


def refuse_condition(name: str, condition: str, **settings: Any) -> NoReturn:
    """Refuse an id with a condition behind it, which `rollout` and the commands take and Gymnasium does not.

    Raises:
        ValueError: one line with the keyword of `gym.make` and `gym.make_vec` in its place.
    """
    raise value_error("id", f"{name}/{condition}", f'gym.make("{name}", condition="{condition}")')


def _merged(old: object, change: object) -> object:
    """Return a value with a change.

    Mappings are merged; of a list of mappings each takes its own entry of a list of numbers.
    """
    if isinstance(old, dict) and isinstance(change, dict):
        return {**old, **{name: _merged(old.get(name, {}), each) for name, each in change.items()}}
    if isinstance(old, list) and isinstance(change, dict):
        return [
            {**entry, **{name: each[i] if isinstance(each, list) else each for name, each in change.items()}}
            for i, entry in enumerate(old)
        ]
    return change
