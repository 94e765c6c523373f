"""Named environments and their conditions, each a YAML file."""

from collections import UserDict
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Self

from flexman_gym.common import files
from flexman_gym.common.checks import mapping, one_of
from flexman_gym.common.errors import value_error
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.registration import CONDITION_FOLDER, ENVIRONMENT_FOLDER, IDS, NOMINAL
from flexman_gym.envs.tasks import Slew, Task, find_task, plain_task
from flexman_gym.envs.view import SLEW_TIME
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.serialization import find_arm, to_plain

Gains = dict[str, tuple[float, ...]]


@dataclass(frozen=True)
class _NamedEnvironment:
    """Default settings of a named environment.

    Attributes:
        arm: robot arm whose joints have torque limits.
        pd: gains of the PD controller tuned for the arm by `flexman optimise gains ID`: stiffness (N m/rad) and damping
            (N m s/rad), one for each joint. Its sampled loop has a gain margin of 2 and a phase margin of 30 degrees.
        task: see `Configuration`.
        sensors: see `Configuration`.
        limits: see `Configuration`.
        control_period: time between two commands to the motors, s.
        horizon: time after which an episode is truncated, s.
        slew_time: see `Configuration`.
        longest_step: longest step of the default method, s; random torques then cause no energy alarm.
        conditions: name of the folder with the conditions of the environment; "" for an environment without conditions.
        actions: see `Configuration`.
        foundation: see `Configuration`, as a mapping: its kind is a feature, which is loaded where it is used.
        usual_payload: payload to which those of the conditions refer for an arm of the user, kg.
        study: arguments of `Limits` for the setting limits="study"; {} for an environment without them.
    """

    arm: Arm
    pd: Gains
    task: Task = field(default_factory=Slew)
    sensors: Any = "full"
    limits: Limits = field(default_factory=Limits)
    control_period: float = 0.02
    horizon: float = 10.0
    slew_time: float = SLEW_TIME
    longest_step: float = 0.02 / 3.0
    conditions: str = ""
    actions: Any = "torque"
    foundation: dict[str, Any] | None = None
    usual_payload: float = 1.0
    study: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Return the named environment of a YAML file with the attributes of this class as JSON-compatible data.

        The arm is a name or a mapping as for `Configuration`. In addition, lists at its key "joints" set fields of the
        joints, such as joints: {stiffness: [5e3, 5e3, 2e3]}. The key "extends" names a second environment in the same
        folder, which supplies missing attributes.

        Args:
            path: path of the file.

        Raises:
            ValueError: for data that are not allowed, with a one-line message: file, field, value and the allowed
                values.
        """
        try:
            data = mapping("environment", _read(path), [each.name for each in fields(cls)])
            if not {"arm", "pd"} <= data.keys():
                raise value_error("environment", sorted(data), "a mapping with arm and pd")
            for name, build in {"arm": _arm, "task": find_task, "limits": Limits.find}.items():
                if name in data:
                    data[name] = build(data[name])
            gains = {name: tuple(values) for name, values in data.pop("pd").items()}
            sensors = data.pop("sensors", cls.sensors)
            return cls(pd=gains, sensors=tuple(sensors) if isinstance(sensors, list) else sensors, **data)
        except ValueError as error:
            raise ValueError(f"{path.name}: {error}") from None

    def plain(self, name: str) -> Any:
        """Return the JSON-compatible data of arm, task, limits or foundation; {} for any other setting."""
        if name == "foundation":
            return dict(self.foundation or {})
        forms = {"arm": to_plain, "task": plain_task, "limits": Limits.to_plain}
        return forms[name](getattr(self, name)) if name in forms else {}


def _read(path: Path) -> dict[str, Any]:
    """Return the data of the file of a named environment, merged with the data of the environment it extends."""
    data = files.read_data(path, of_package=True)
    parent = data.pop("extends", None)
    return data if parent is None else _read(path.with_name(f"{parent}.yaml")) | data


def _arm(value: Any) -> Arm:
    """Return the arm of a name or a mapping, whose key "joints" maps fields of the joints to lists of values (n,)."""
    if not isinstance(value, dict) or "joints" not in value:
        return find_arm(value)
    arm = find_arm({name: each for name, each in value.items() if name != "joints"})
    return find_arm(_merged(to_plain(arm), {"joints": value["joints"]}))


def _merged(old: object, change: object) -> object:
    """Return JSON-compatible data with a change.

    Mappings are merged. In a list of mappings, a list of values in the change sets a field of each of the mappings.
    """
    if isinstance(old, dict) and isinstance(change, dict):
        return {**old, **{name: _merged(old.get(name, {}), each) for name, each in change.items()}}
    if isinstance(old, list) and isinstance(change, dict):
        return [
            {**entry, **{name: each[i] if isinstance(each, list) else each for name, each in change.items()}}
            for i, entry in enumerate(old)
        ]
    return change


class _NamedEnvironments(UserDict[str, Any]):
    """Named environments by id, each of which is read at its first use, with the arms that it needs."""

    def __getitem__(self, id: str) -> _NamedEnvironment:
        if self.data[id] is None:
            self.data[id] = _NamedEnvironment.load(ENVIRONMENT_FOLDER / f"{id}.yaml")
        result: _NamedEnvironment = self.data[id]
        return result


NAMED_ENVIRONMENTS = _NamedEnvironments(dict.fromkeys(IDS))
"""Named environments: id -> default settings; each id has a file in ENVIRONMENT_FOLDER."""
DEFAULT_ID = "FlexRRR-v0"  # environment of a configuration without an id


def condition_names(id: str) -> tuple[str, ...]:
    """Return the names of the conditions of a named environment; only "nominal" for one without conditions."""
    folder = NAMED_ENVIRONMENTS[id].conditions
    return NOMINAL, *sorted(path.stem for path in (CONDITION_FOLDER / folder).glob("*.yaml") if folder)


def condition_settings(id: str, condition: object) -> dict[str, Any]:
    """Return the settings changed by a condition of a named environment; {} for the condition "nominal".

    Args:
        id: id of the environment.
        condition: name of the condition.

    Raises:
        ValueError: for an unknown condition, and for an environment without conditions.
    """
    named = NAMED_ENVIRONMENTS[one_of("id", id, NAMED_ENVIRONMENTS)]
    if not named.conditions:
        known = [each for each, named in NAMED_ENVIRONMENTS.items() if named.conditions]
        raise value_error("condition", f"{id}/{condition}", f"one for {', '.join(known)}")
    if one_of("condition", condition, condition_names(id)) == NOMINAL:
        return {}
    changes = files.read_data(CONDITION_FOLDER / named.conditions / f"{condition}.yaml", of_package=True)
    result = {name: _merged(named.plain(name), change) for name, change in changes.items()}
    return result | ({"settings": "named"} if "arm" in result else {})  # it changes the arm, and keeps the rest
