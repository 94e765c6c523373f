"""Configuration of an environment: an id and checked settings."""

import os
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn, Self

from flexman_gym.common import files
from flexman_gym.common.checks import mapping, one_of, positive, sequence, text, vector
from flexman_gym.common.errors import key_error, keyword_error, nearest, unknown_name, value_error
from flexman_gym.common.formatting import text_fields
from flexman_gym.common.registry import load_entry
from flexman_gym.envs.config.arm_settings import arm_torque_limits, derived_settings
from flexman_gym.envs.config.named_environments import (
    DEFAULT_ID,
    NAMED_ENVIRONMENTS,
    Gains,
    condition_names,
    condition_settings,
)
from flexman_gym.envs.config.randomisation import Randomisation
from flexman_gym.envs.config.settings import AUTO_SETTINGS, SETTINGS, EnvironmentSettings
from flexman_gym.envs.foundation import check_foundation
from flexman_gym.envs.limits import Limits
from flexman_gym.envs.registration import NOMINAL
from flexman_gym.envs.tasks import Slew, with_named_reward
from flexman_gym.model.state_space import first_order_lag
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.input_checks import warn_unusual_units
from flexman_gym.scene.serialization import SUFFIXES, URDF, find_arm, to_plain
from flexman_gym.simulation.integrator import default_step

NESTED_SETTINGS = ("arm", "task", "limits", "foundation")  # settings with fields, such as arm.payload.mass
DERIVED = ("control_period", "horizon", "limits", "slew_time")  # settings that follow from an arm of the user
MAX_PERIODS = 10**9  # control periods; longest episode
HINTS = {foreign: hint for setting in SETTINGS.values() for foreign, hint in setting.foreign.items()}
SET_HELP = "setting of the environment (flexman list settings), or a part of one: arm.payload.mass=0.5"


class Configuration(EnvironmentSettings):
    """Configuration of an environment: an id and settings, checked at construction.

    A missing setting has the value of the named environment, or its default. Settings may be objects or JSON-compatible
    data (strings, numbers, booleans, lists, mappings); a file contains JSON-compatible data only. The setting
    "condition" names a condition of the environment, which supplies values for missing settings.

    Args:
        id: id of a named environment.
        settings: name -> value, as in `gym.make`.
        folder: folder to which the path of a file with an arm is relative.
    """

    id: str
    derived: dict[str, Any]  # settings that follow from the arm
    _given: dict[str, Any]

    def __init__(self, id: str = DEFAULT_ID, settings: Mapping[str, Any] | None = None, folder: Path = Path()) -> None:
        named, given = NAMED_ENVIRONMENTS[one_of("id", id, NAMED_ENVIRONMENTS)], dict(settings or {})
        if given.pop("condition", NOMINAL) != NOMINAL:
            given = _with_condition(id, settings["condition"], given, folder)  # type: ignore[index]
        given = with_named_reward(_checked_mapping(given), named.task)
        _refuse_unknown(given)
        if isinstance(given.get("limits"), str):
            known = [name for name, each in NAMED_ENVIRONMENTS.items() if each.study]
            if given["limits"] != "study" or id not in known:
                allowed = f"Limits, a mapping of its arguments, or 'study' for {', '.join(known)}"
                raise value_error("limits", given["limits"], allowed)
            given["limits"] = dict(named.study)
        arm = given.get("arm")
        if (isinstance(arm, str) and arm.endswith((*SUFFIXES, URDF))) or (isinstance(arm, dict) and "urdf" in arm):
            given["arm"] = to_plain(find_arm(arm, folder))
        vars(self).update(id=id, _given=given, derived={})
        for name, setting in SETTINGS.items():
            value = given.get(name, setting.default)
            vars(self)[name] = setting.check(getattr(named, name) if value is None and setting.named else value)
        self._check_joints()
        vars(self).update(derived=self._derive_settings())
        vars(self).update(self.derived)
        self._check_together()

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(f"{name}: a configuration is immutable; make another one with replace")

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Configuration):
            return NotImplemented
        one, two = (_lists(each.to_plain(strict=False)) for each in (self, other))
        return bool(one == two)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"Configuration({self.id!r}, {self._given!r})"

    def __str__(self) -> str:
        """Return the id, the arm in one line, and each setting that has a value."""
        shown = ((name, getattr(self, name)) for name in SETTINGS if name != "arm")
        lines = text_fields(
            [("id", self.id), ("arm", str(self.arm).partition("\n")[0])]
            + [each for each in shown if each[1] not in (None, ())]
        )
        return "\n".join(lines)

    def _check_joints(self) -> None:
        """Check what passive joints exclude, and store the torque limits."""
        passive = [joint.passive for joint in self.arm.joints]
        if all(passive) and not getattr(self.foundation, "names", ()):
            raise value_error("arm.joints", "passive joints", "a joint with a motor, or the setting foundation")
        if any(passive):
            because = f": joint {passive.index(True) + 1} of the arm is passive"
            if self.task.moves:
                raise value_error("task", self.task, f"a task whose goal rests{because}")
            if self.safety:
                raise value_error("safety", self.safety, f"False{because}")
            if isinstance(self.actions, str | dict) and self.actions != "torque":  # an object is the user's own
                raise value_error("actions", self.actions, f"'torque'{because}")
        check_foundation(self, any(passive))
        vars(self)["torque_limit"] = arm_torque_limits(self.arm, self.torque_limit)

    def _derive_settings(self) -> dict[str, Any]:
        """Return the missing settings that follow from an arm of the user."""
        missing = [name for name in DERIVED if self._given.get(name) is None]
        if not missing or not self.has_own_arm or vars(self)["settings"] == "named":
            return {}
        found = derived_settings(self.arm, self.torque_limit, self.slew_span)
        return {name: found[name] for name in missing}

    @property
    def slew_span(self) -> tuple[float, float]:
        """Largest initial motor angle and largest change of a motor angle of the slews of the task, rad."""
        task: Any = self.task
        return float(getattr(task, "start", Slew.start)), float(getattr(task, "slew", Slew.slew))

    @property
    def has_own_arm(self) -> bool:
        """True for an arm whose links or joints differ from those of the named environment."""
        arm, named = self.arm, NAMED_ENVIRONMENTS[self.id].arm
        return arm.links != named.links or arm.joints != named.joints

    def _check_together(self) -> None:
        """Check the settings whose allowed values depend on other settings, and store the gains."""
        if not 0.5 <= self.horizon / self.control_period <= MAX_PERIODS:
            allowed = f"1 to {MAX_PERIODS} control periods of {self.control_period} s"
            raise value_error("horizon", self.horizon, allowed)
        warn_unusual_units("", {"horizon": self.horizon})
        self.limits.check_joints(self.arm.n_joints)
        if self.base == "pd":
            vars(self)["gains"] = self.pd_gains
        if self.fidelity == "default":
            if self.tolerance is not None:
                raise value_error("tolerance", self.tolerance, 'None without fidelity="auto"')
            if isinstance(self.modes, str):
                one_of("modes", self.modes, ("assembled",))
            return
        for name in AUTO_SETTINGS:
            if getattr(self, name) != SETTINGS[name].default:
                raise value_error(name, getattr(self, name), 'nothing: fidelity="auto" chooses it')
        positive("tolerance", self.tolerance, 'm, for fidelity="auto"')

    @classmethod
    def from_keywords(cls, keywords: Mapping[str, Any], others: Collection[str] = ()) -> "Configuration":
        """Return the configuration for keyword arguments of `gym.make` and `gym.make_vec`.

        Args:
            keywords: settings; "name", the id of a named environment; and "configuration", a Configuration in which the
                settings replace settings of the same names.
            others: names of keyword arguments of the environment that are no settings, for the error message.
        """
        given = dict(keywords)
        original = given.pop("configuration", None)
        if original is not None and not isinstance(original, Configuration):
            raise value_error("configuration", original, "a Configuration")
        id = one_of("name", given.pop("name", original.id if original else DEFAULT_ID), NAMED_ENVIRONMENTS)
        _refuse_unknown(given, others)
        if original is None:
            return cls(id, given)
        if original.id != id:
            raise value_error("configuration", original.id, f"one of {id}")
        return original.replace(**given)

    @classmethod
    def from_plain(cls, data: object, folder: Path = Path()) -> Self:
        """Return the configuration of a mapping with "id" and settings.

        Args:
            data: the mapping.
            folder: folder to which the path of a file with an arm is relative.
        """
        settings = _checked_mapping(data)
        return cls(settings.pop("id", DEFAULT_ID), settings, folder)

    @classmethod
    def load(cls, path: str | Path, changes: Sequence[str] = ()) -> Self:
        """Read a .json, .yaml or .yml file: a mapping with "id" and settings.

        Args:
            path: path of the file.
            changes: changes "name=value" of settings, see `changed`.

        Raises:
            FileNotFoundError: if the file does not exist.
            ValueError: for a setting that is not allowed, with a one-line message: file, field, value and the allowed
                values.
        """
        with files.naming(path):
            return cls._from_changes(files.read_data(Path(path)), changes, Path(path).parent)

    @classmethod
    def find(cls, name: "str | Configuration", changes: Sequence[str] = ()) -> "Configuration":
        """Return the configuration of a named environment, with or without a condition, or of a file.

        Args:
            name: an id, an id and a condition such as "FlexRRR-v0/unknown", the path of a file, or a Configuration.
            changes: changes "name=value" of settings, see `changed`.

        Raises:
            ValueError: for a name that is not an id.
            FileNotFoundError: for a path without a file.
        """
        if isinstance(name, Configuration):
            return name.changed(changes) if changes else name
        id, slash, condition = text("environment", name).partition("/")
        if id in NAMED_ENVIRONMENTS and (slash or name in NAMED_ENVIRONMENTS):
            settings = condition_settings(id, condition) if slash else {}
            return cls._from_changes({"id": id, **settings}, changes)
        if not os.path.exists(name):  # unlike Path.exists it accepts any string
            near = [f"{each}/{own}" for each in NAMED_ENVIRONMENTS for own in condition_names(each)] if slash else ()
            raise unknown_name("environment", name, sorted(NAMED_ENVIRONMENTS), "the path of a file", near)
        return cls.load(name, changes)

    @classmethod
    def of_file(cls, arm: object, changes: Sequence[str] = ()) -> Self | None:
        """Return the configuration of the file of an environment; None for an arm in any other form.

        Args:
            arm: as the setting `arm`, or the path of a file of an environment, which has the key "id".
            changes: changes "name=value" of settings, see `changed`.
        """
        if not (isinstance(arm, str | Path) and str(arm).endswith(SUFFIXES)):
            return None
        with files.naming(arm):
            data = files.read_data(Path(arm))
            if "id" not in data:
                return None
            if data.keys() >= {*DERIVED}:  # a stored environment: nothing is left to derive but the gains of a PD
                data.pop("settings", None)
            return cls._from_changes(data, changes, Path(arm).parent)

    @property
    def given(self) -> dict[str, Any]:
        """Copy of the settings given to the constructor; a condition is replaced by the settings it changes."""
        return dict(self._given)

    def keywords(self) -> dict[str, Any]:
        """Return keyword arguments of `gym.make` and `gym.make_vec`, whose settings are not checked a second time."""
        return {"configuration": self}

    def replace(self, **changes: Any) -> "Configuration":
        """Return a configuration with changed settings; without changes the same object."""
        _refuse_unknown(changes, ())
        return type(self)(self.id, {**self._given, **changes}) if changes else self

    def without(self, names: Collection[str]) -> "Configuration":
        """Return a configuration in which the settings of these names have their defaults."""
        kept = {name: value for name, value in self._given.items() if name not in names}
        return self if len(kept) == len(self._given) else type(self)(self.id, kept)

    def to_plain(self, strict: bool = True) -> dict[str, Any]:
        """Return JSON-compatible data of the environment, for `from_plain` on any computer and in later releases.

        The mapping contains the data of the arm in place of a name or a file, the gains of base="pd", and the method,
        whose default may change with a release.

        Args:
            strict: True to raise ValueError for an object without JSON-compatible data; False to return the object
                itself.

        Raises:
            ValueError: for a task, sensor, controller or function defined by the user, which a file cannot contain.
        """
        plain = {name: self._plain(name, value, strict) for name, value in self._given.items()}
        if self.base == "pd":
            plain["gains"] = {name: list(numbers) for name, numbers in self.gains.items()}
        if self.fidelity == "default":
            plain.setdefault("method", self._plain("method", self.method, strict))
        if self.has_own_arm:  # without them another release may derive other ones
            form = {"limits": Limits.to_plain}
            plain |= {name: form.get(name, float)(value) for name, value in self.derived.items()}
            plain["settings"] = "named"
        return {"id": self.id, **plain, "arm": to_plain(self.arm)}

    def _plain(self, name: str, value: Any, strict: bool) -> Any:
        """Return the JSON-compatible data of the given value of a setting."""
        if _is_plain(value):
            return value
        stored, form = getattr(self, name), SETTINGS[name].plain
        try:
            if form is None and not _is_plain(stored):
                raise value_error(name, stored, "an object with a name; a file cannot hold an object of the user")
            return form(stored) if form and stored is not None else stored
        except ValueError:
            if strict:
                raise
            return value

    def save(self, path: str | Path) -> None:
        """Write the configuration to a .json, .yaml or .yml file, from which `load` makes an equal configuration.

        The commands accept such a file: `flexman train --env FILE`.

        Args:
            path: path of the file.

        Raises:
            ValueError: for a path with a different suffix, and for an object without JSON-compatible data.
        """
        files.write_data(Path(path), _lists(self.to_plain()))

    def changed(self, changes: Sequence[str], **settings: Any) -> "Configuration":
        """Return a configuration with changes "name=value", after settings that replace those of the same names.

        Values have the syntax of YAML. A name with dots, such as "arm.payload.mass=0.5", changes one field of the arm,
        the task, the limits or a mapping.
        """
        given = {"id": self.id, **self._given, **settings}
        return self._from_changes(given, changes) if changes else self.replace(**settings)

    @classmethod
    def _from_changes(cls, data: object, changes: Sequence[str], folder: Path = Path()) -> Self:
        """Return the configuration of a mapping with changes "name=value", checked after the last change."""
        data = _checked_mapping(data)
        for change in sequence("--set", changes, "texts"):
            name, equals, written = text("--set", change).partition("=")
            if not equals or not all(part.isidentifier() for part in name.split(".")):
                raise value_error("--set", change, "name=value, such as control_period=0.01 or arm.payload.mass=0.5")
            try:
                value = files.parse_yaml(written)
            except (ValueError, RecursionError):
                raise value_error(
                    "--set", change, "a value that is a number, a text, [a, list] or {a: mapping}"
                ) from None
            first, *rest = name.split(".")
            if name == "condition":  # its settings replace earlier ones of the same names
                data |= _of_condition(data["id"], value, data, folder)[0]
                continue
            if rest and first in NESTED_SETTINGS:
                named, form = NAMED_ENVIRONMENTS[one_of("id", data["id"], NAMED_ENVIRONMENTS)], SETTINGS[first]
                given = find_arm(data["arm"], folder) if first == "arm" and first in data else data.get(first)
                assert form.plain is not None
                data[first] = form.plain(form.check(given)) if first in data else named.plain(first)
            _set_entry(data, [first, *rest], value)
        return cls.from_plain(data, folder)

    @property
    def disturbances(self) -> Randomisation | None:
        """Randomisation of the environment together with that of its task; the environment's ranges take precedence."""
        of_task, given = dict(getattr(self.task, "disturbances", {})), self.randomisation
        if not of_task:
            return given
        return Randomisation(**of_task | (given.given if given else {}))

    @property
    def rotates(self) -> bool:
        """True for an arm whose base rotates."""
        return self.foundation is not None and bool(self.foundation.rotates)

    @property
    def randomised_ranges(self) -> dict[str, Any]:
        """Ranges of the setting randomisation by name."""
        return dict(self.randomisation.given) if self.randomisation else {}

    @property
    def max_delay(self) -> int:
        """Largest delay of the commanded torques, control periods."""
        delay = self.disturbances.delay if self.disturbances else None
        return int(delay[1]) if delay else 0

    @property
    def integration_step(self) -> float:
        """Setting step, s; for None the `default_step` of the control period."""
        if self.step is not None:
            return self.step
        return default_step(self.control_period, NAMED_ENVIRONMENTS[self.id].longest_step)

    @property
    def lag(self) -> tuple[float, float] | None:
        """Result of `first_order_lag` for one control period; None without drive_bandwidth."""
        return None if self.drive_bandwidth is None else first_order_lag(self.control_period, self.drive_bandwidth)

    @property
    def max_periods(self) -> int:
        """Control periods after which an episode is truncated."""
        return max(1, round(self.horizon / self.control_period))

    @property
    def has_named_motors(self) -> bool:
        """True for an arm with the links and motors of the named environment; payload and friction may differ."""
        return _tuned_parts(self.arm) == _tuned_parts(NAMED_ENVIRONMENTS[self.id].arm)

    @property
    def pd_gains(self) -> Gains:
        """PD gains by name: the setting gains, by default those of the named environment, or designed for another arm.

        An own arm, whose links or motors differ from the named environment, has the gains of `pd_design.design_pd`.

        Raises:
            ValueError: without the setting, for such an arm if no gains have stability margins at the control period.
        """
        named, gains = NAMED_ENVIRONMENTS[self.id], self.gains
        if gains is None and not any(self.torque_limit):  # passive joints only: the agent commands the foundation
            return dict.fromkeys(("stiffness", "damping"), (0.0,) * self.arm.n_joints)
        if gains is None and not self.has_named_motors:
            if self._given.get("settings") == "named":
                allowed = f"those of this arm, which flexman optimise gains finds: {self.id} has other links or motors"
                raise value_error("gains", None, allowed)
            designed: Gains = load_entry("flexman_gym.toolbox.controllers.pd_design:design_pd")(self)
            return designed
        if gains is None:
            return dict(named.pd)
        gains = mapping("gains", gains, ("stiffness", "damping"))
        if len(gains) < 2:
            raise value_error("gains", gains, "a mapping with stiffness (N m/rad) and damping (N m s/rad)")
        return {name: vector(f"gains.{name}", each, self.arm.n_joints) for name, each in gains.items()}


_LINES = (f"        {name}: {each.help}" + f" ({each.unit})" * bool(each.unit) for name, each in SETTINGS.items())
Configuration.__doc__ = "\n".join([f"{Configuration.__doc__}\n    Attributes:", *_LINES])


def _with_condition(id: str, condition: object, given: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return settings with those of a condition, which the given ones replace, but for an arm of the user."""
    found, own = _of_condition(id, condition, given, folder)
    return {**found, **given} | ({"arm": found["arm"]} if own else {})


def _of_condition(id: str, condition: object, given: dict[str, Any], folder: Path) -> tuple[dict[str, Any], bool]:
    """Return the settings of a condition, and True if they are relative to the properties of an arm of the user."""
    if given.get("arm") is not None:
        arm, named = find_arm(given["arm"], folder), NAMED_ENVIRONMENTS[one_of("id", id, NAMED_ENVIRONMENTS)].arm
        if (arm.links, arm.joints) != (named.links, named.joints):
            from flexman_gym.envs.config.conditions import condition_for_arm

            return condition_for_arm(id, condition, arm, given.get("torque_limit")), True
    return condition_settings(id, condition), False


def _checked_mapping(data: object) -> dict[str, Any]:
    """Return a copy of a mapping with "id" and settings, after a check of the types of its keys."""
    if not isinstance(data, dict):
        raise value_error("environment", data, "a mapping with id and settings")
    for name, value in data.items():
        if text("a key of environment", name) == "name":
            raise value_error(name, value, "it as id")
    return dict(data)


def _refuse_unknown(settings: Mapping[str, Any], others: Collection[str] | None = None) -> None:
    """Raise an error for an unknown setting, with the name of that setting in this library, or a similar name.

    Args:
        settings: names and values.
        others: further keyword arguments, if the settings are keyword arguments; the error is then a KeywordError.
    """
    known = {*SETTINGS, "condition", *(others or ())}
    for name, value in settings.items():
        if name not in known:
            near = nearest(name, sorted(known))
            near = f"the nearest is {near}; all: " if near else ""
            allowed = HINTS.get(name, f"a setting: {near}{' '.join(sorted(SETTINGS))}")
            raise key_error(name, value, allowed) if others is None else keyword_error(name, value, allowed, name)


def _is_plain(value: object) -> bool:
    """Return True for JSON-compatible data: strings, numbers, booleans, None, and lists and mappings of these."""
    if isinstance(value, dict):
        return all(map(_is_plain, value.values()))
    if isinstance(value, list | tuple):
        return all(map(_is_plain, value))
    return value is None or isinstance(value, bool | int | float | str)


def _lists(value: Any) -> Any:
    """Return tuples as lists, at every level."""
    if isinstance(value, dict):
        return {name: _lists(each) for name, each in value.items()}
    return [_lists(each) for each in value] if isinstance(value, list | tuple) else value


def _set_entry(data: dict[str, Any], path: list[str], value: object) -> None:
    """Write a value into nested mappings; a value on the path that is no mapping is replaced by a mapping."""
    for part in path[:-1]:
        inner = data.get(part)
        data[part] = data = dict(inner) if isinstance(inner, dict) else {}
    data[path[-1]] = value


def _tuned_parts(arm: Arm) -> tuple[object, ...]:
    """Return the properties of an arm on which controllers that are tuned for it depend."""
    return arm.links, [(joint.axis, joint.rotor_inertia, joint.stiffness) for joint in arm.joints]
