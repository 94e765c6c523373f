"""Description: settings of an environment as plain data, read from a file, a command line or a run."""

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, NoReturn, Self

from flexman_gym.common import files
from flexman_gym.common.checks import one_of, sequence, short_path, text, value_error
from flexman_gym.envs.config.named_environments import DEFAULT, NAMED
from flexman_gym.envs.config.randomisation import Randomisation
from flexman_gym.envs.config.setup import Setup, setup_of
from flexman_gym.envs.limits import Limits, find_limits
from flexman_gym.envs.sensors import plain_sensors
from flexman_gym.envs.tasks import TASKS, find_task
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.serialization import find_arm, to_plain

WHOLE = ("arm", "task", "limits")  # what a named environment has before a change leads into it
NOMINAL = "nominal"  # the condition without changes
CONDITION_FOLDER = (
    Path(__file__).parents[1] / "conditions"
)  # a folder for each arm, with a file of changes for each condition
CONDITIONS = (NOMINAL, *sorted({path.stem for path in CONDITION_FOLDER.glob("*/*.yaml")}))


@dataclass(frozen=True)
class Description:
    """An environment as plain data: texts, numbers, booleans, lists and mappings.

    Attributes:
        id: of a named environment.
        settings: keyword arguments of `gym.make`, plain. An arm is the name of a function of the catalog, a mapping
            with its name at "catalog" and its arguments, the path of a file with an arm or a scene, or a mapping as in
            a scene file. A task is its name, or a mapping with its name at "kind" and its arguments; limits and
            randomisation are mappings. Settings beside a "condition" go before what it changes.
        folder: against which paths of files are meant.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    id: str = DEFAULT
    settings: Mapping[str, Any] | None = None
    folder: Path = Path()

    def __post_init__(self) -> None:
        one_of("id", self.id, NAMED)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Reads a .json, .yaml or .yml file: a mapping with "id" and settings.

        Raises:
            FileNotFoundError: when there is none.
            ValueError: one line with file, field, value and what is allowed.
        """
        try:
            return cls.from_dict(files.read_data(Path(path)), Path(path).parent)
        except ValueError as error:
            raise ValueError(f"{short_path(path)}: {error}") from None

    @classmethod
    def find(cls, name: str) -> Self:
        """Gives a named environment, one under a condition such as "FlexRRR-v0/unknown", or that of a file.

        Raises:
            FileNotFoundError, ValueError: one line, also where it is neither.
        """
        if text("environment", name) in NAMED:
            return cls(name)
        named, slash, condition = name.partition("/")
        if slash and named in NAMED:
            return cls.under(named, condition)
        if not os.path.exists(name):  # whatever the name is
            allowed = f"one, or one of {', '.join(sorted(NAMED))}"
            raise FileNotFoundError(f"{short_path(name)}: there is no such file; give {allowed}")
        return cls.load(name)

    @classmethod
    def under(cls, name: str, condition: str) -> Self:
        """Gives a named environment under one of the CONDITIONS, whose files say what they change.

        Raises:
            ValueError: for another condition, and for an environment without conditions.
        """
        folder = NAMED[one_of("id", name, NAMED)].conditions
        if not folder:
            known = [each for each, named in NAMED.items() if named.conditions]
            raise value_error("condition", f"{name}/{condition}", f"one for {', '.join(known)}")
        own = [path.stem for path in (CONDITION_FOLDER / folder).glob("*.yaml")]
        if one_of("condition", condition, (NOMINAL, *sorted(own))) == NOMINAL:
            return cls(name)
        changes, named = files.read_data(CONDITION_FOLDER / folder / f"{condition}.yaml"), cls(name)
        settings = {
            key: _merged(_plain(key, named._value(key, {"id": name})) if key in WHOLE else {}, change)
            for key, change in changes.items()
        }
        return cls.from_dict({"id": name, **settings})

    @classmethod
    def from_dict(cls, data: object, folder: Path = Path()) -> Self:
        """The description in a mapping with "id" and settings, every one of which is checked."""
        if not isinstance(data, dict):
            raise value_error("environment", data, "a mapping with id and settings")
        for name in data:
            text("a key of environment", name)
        if "name" in data:
            raise value_error("name", data["name"], "it as id")
        settings = {name: value for name, value in data.items() if name != "id"}
        result = cls(data.get("id", DEFAULT), settings, folder)
        result.setup()
        return result

    def whole_settings(self) -> dict[str, Any]:
        """A copy of the settings, with those of a condition that they name in its place."""
        settings = dict(self.settings or {})
        condition = settings.pop("condition", NOMINAL)
        if condition == NOMINAL:
            return settings
        return {**self.under(self.id, condition).whole_settings(), **settings}

    def setup(self) -> Setup:
        """The setup that it describes."""
        return setup_of({"name": self.id, **self.keywords()})

    def keywords(self) -> dict[str, Any]:
        """Keyword arguments of `gym.make` and `gym.make_vec`."""
        makers = {
            "arm": lambda value: find_arm(value, self.folder),
            "task": find_task,
            "limits": find_limits,
            "modes": _tuples, "elements": _tuples,
        }  # fmt: skip
        settings = self.whole_settings()
        return {name: makers[name](value) if name in makers else value for name, value in settings.items()}

    def whole(self) -> dict[str, Any]:
        """The mapping from which `from_dict` gives the same environment anywhere and later.

        It has the whole arm in place of a file, and the gains of base="pd".
        """
        settings, setup = self.whole_settings(), self.setup()
        if setup.base == "pd":
            settings["gains"] = _plain("gains", setup.gains)
        return {"id": self.id, **settings, "arm": to_plain(setup.arm)}

    def save(self, path: str | Path) -> None:
        """Write the whole environment to a .json, .yaml or .yml file, from which `load` gives an equal one.

        The commands take such a file: `flexman train --env FILE`.

        Raises:
            ValueError: for another suffix, and for an object of one's own, which no file can hold.
        """
        files.write_data(Path(path), _lists(described(self.setup())))

    def changed(self, changes: Sequence[str]) -> Self:
        """The same with changes "name=value", values as in a file; names with dots lead into mappings and the arm.

        What they lead into and do not name stays what it is, or what the named environment has.

        Raises:
            ValueError: one line with the change and what is allowed.
        """
        data: dict[str, Any] = {"id": self.id, **self.whole_settings()}
        for change in sequence("--set", changes, "texts"):
            path, equals, written = text("--set", change).partition("=")
            if not equals or not all(part.isidentifier() for part in path.split(".")):
                raise value_error("--set", change, "name=value, such as control_period=0.01 or arm.payload.mass=0.5")
            try:
                value = files.parse_yaml(written)
            except (ValueError, RecursionError):
                raise value_error(
                    "--set", change, "a value that is a number, a text, [a, list] or {a: mapping}"
                ) from None
            if path == "condition":  # which goes before what was said of the same settings
                data |= self.under(data["id"], value).whole_settings()
                continue
            first, *rest = path.split(".")
            if rest and first in WHOLE:
                data[first] = _plain(first, self._value(first, data))
            _put(data, path.split("."), value)
        return type(self).from_dict(data, self.folder)

    def _value(self, name: str, data: Mapping[str, Any]) -> Any:
        """The arm, task or limits of a mapping that may not be whole yet."""
        named = NAMED[one_of("id", data["id"], NAMED)]
        if name not in data:
            return named.arm() if name == "arm" else getattr(named, name)
        return Description(data["id"], {name: data[name]}, self.folder).keywords()[name]


def find_setup(settings: Mapping[str, Any], others: Collection[str] = ()) -> Setup:
    """The setup of keyword arguments of `gym.make`, of which "condition" names changes; `others` see `setup_of`."""
    given = dict(settings)
    if "condition" in given:
        named = Description(given.get("name", DEFAULT), {"condition": given.pop("condition")})
        given = named.keywords() | given
    return setup_of(given, ("condition", *others))


def refuse_condition(name: str, condition: str, **settings: Any) -> NoReturn:
    """Refuse an id with a condition behind it, which `rollout` and the commands take and Gymnasium does not.

    Raises:
        ValueError: one line with the keyword of `gym.make` and `gym.make_vec` in its place.
    """
    raise value_error("id", f"{name}/{condition}", f'gym.make("{name}", condition="{condition}")')


def described(setup: Setup) -> dict[str, Any]:
    """The mapping of a setup that was made with objects.

    Raises:
        ValueError: for a task, sensors or a controller of one's own, which no file can hold.
    """
    data: dict[str, Any] = {"id": setup.name}
    for each in fields(Setup):
        value = getattr(setup, each.name)
        if each.name != "name" and value != each.default:
            data[each.name] = _plain(each.name, value)
    return data


def _tuples(value: object) -> object:
    """Lists as tuples, all the way down."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _lists(value: Any) -> Any:
    """Tuples as lists, all the way down."""
    if isinstance(value, dict):
        return {name: _lists(each) for name, each in value.items()}
    return [_lists(each) for each in value] if isinstance(value, list | tuple) else value


def _merged(old: object, change: object) -> object:
    """A value with a change: mappings merge; of a list of mappings each takes its own of the numbers in a list."""
    if isinstance(old, dict) and isinstance(change, dict):
        return {**old, **{name: _merged(old.get(name, {}), each) for name, each in change.items()}}
    if isinstance(old, list) and isinstance(change, dict):
        return [
            {**entry, **{name: each[i] if isinstance(each, list) else each for name, each in change.items()}}
            for i, entry in enumerate(old)
        ]
    return change


def _put(data: dict[str, Any], path: list[str], value: object) -> None:
    """Writes a value into a mapping of mappings; what is nothing yet becomes a mapping."""
    for part in path[:-1]:
        inner = data.get(part)
        data[part] = data = dict(inner) if isinstance(inner, dict) else {}
    data[path[-1]] = value


def _plain(name: str, value: Any) -> Any:
    """A setting as plain data."""
    if isinstance(value, Arm):
        return to_plain(value)
    if isinstance(value, Limits):
        return asdict(value)
    if isinstance(value, Randomisation):
        return {name: getattr(value, name) for name in value.given}
    if name == "task" and type(value) in TASKS.values():
        kind = next(key for key, each in TASKS.items() if each is type(value))
        return {"kind": kind, **asdict(value)}
    if name == "sensors":
        return plain_sensors(value)
    if name in ("base", "actions", "reward") and isinstance(value, dict):
        return dict(value)
    if name == "gains" and value is not None:
        return {each: list(numbers) for each, numbers in value.items()}
    if value is None or isinstance(value, bool | int | float | str | tuple | list):
        return value
    raise value_error(name, value, "something with a name: an object of one's own cannot be kept in a file")
