"""Tables of named entries, which are imported at their first use, and plug-ins that add names to them."""

import json
import os
import re
import sys
import warnings
from collections.abc import Callable, ItemsView, Iterator, Mapping, ValuesView
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, Generic, TypeVar

from flexman_gym.common.checks import one_of, text
from flexman_gym.common.errors import short_path, value_error

Entry = TypeVar("Entry")
TABLES = {
    "controller": "flexman_gym.agent.base_controllers:BASES",
    "action-mode": "flexman_gym.agent.action_modes:ACTIONS",
    "task": "flexman_gym.envs.tasks:TASKS",
    "sensor": "flexman_gym.envs.sensors:SENSORS",
    "effect": "flexman_gym.envs.effects:SIGNALS",
    "metric": "flexman_gym.evaluation.metrics:METRICS",
    "method": "flexman_gym.simulation.methods:METHODS",
}
"""Kind of an entry -> its table."""
GROUP = "flexman_gym.plugins"  # entry points of plug-ins, named KIND.NAME
REGISTERED = "FLEXMAN_REGISTERED"  # environment variable with the names registered so far, for processes started later
NAME = re.compile(r"[A-Za-z][\w-]*")
PLACE = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*")


def load_entry(place: str) -> Any:
    """Import and return an object.

    Args:
        place: module and name of the object, "module:name".
    """
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


def register(kind: str, name: str, place: str) -> None:
    """Add a name to a table: it is then known to `gym.make`, files, `fm.evaluate`, the command line and the league.

    Processes that are started later know the name as well. An entry point of the group "flexman_gym.plugins" named
    "controller.mine", with the same place, does the same for an installed package without a call.

    Args:
        kind: "controller" (a `ControllerEntry`, or a function of a `Plant` and keyword arguments that returns a
            Controller), "action-mode", "task" (class with the members of `Task`), "sensor" (function that returns a
            Sensor), "effect" (class with the members of `Effect`), "metric" (a `Metric`) or "method" (a `Method`).
        name: name of the entry; letters, digits, "_" and "-".
        place: module and name of the entry, "module:name", which is imported at its first use.

    Raises:
        ValueError: for an unknown kind, another form of name or place, and for a name that is registered already.
    """
    one_of("kind", kind, TABLES)
    if not NAME.fullmatch(text("name", name)):
        raise value_error("name", name, "letters, digits, _ and -, such as my-controller")
    if not PLACE.fullmatch(text("place", place)):
        raise value_error("place", place, "module:name, such as my_package.my_module:make")
    if name in load_entry(TABLES[kind]):
        raise value_error("name", name, f"a new name: this {kind} is registered already")
    names = _registered()
    names.setdefault(kind, {})[name] = place
    os.environ[REGISTERED] = json.dumps(names)


def register_file(kind: str, path: str | Path) -> str:
    """Register the function `make` of a Python file under the name of the file, and return this name.

    The folder of the file is added to the module search path, as by `python FILE`; the file runs at its first use.

    Args:
        kind: kind of the entry, see `register`.
        path: the file, such as "my_controller.py".

    Raises:
        FileNotFoundError: for a file that does not exist.
        ValueError: for a file whose name is no name of a module, and for a name of the library.
    """
    file = Path(path).resolve()
    if not file.is_file():
        raise FileNotFoundError(f"{short_path(path)}: there is no such file")
    place = f"{file.stem}:make"
    if _registered().get(kind, {}).get(file.stem) != place:
        register(kind, file.stem, place)
    if str(file.parent) not in sys.path:
        sys.path.insert(0, str(file.parent))
    return file.stem


def _registered() -> dict[str, dict[str, str]]:
    """Return the places of the names that were registered in this process or in one that started it, by kind."""
    names: dict[str, dict[str, str]] = json.loads(os.environ.get(REGISTERED, "{}"))
    return names


@cache
def plugins() -> dict[str, dict[str, str]]:
    """Return the places of the names of installed plug-ins, by kind; a wrong entry point is named in a UserWarning."""
    from importlib.metadata import entry_points

    found: dict[str, dict[str, str]] = {}
    for point in entry_points(group=GROUP):
        kind, _, name = point.name.partition(".")
        if kind not in TABLES or not NAME.fullmatch(name) or not PLACE.fullmatch(point.value):
            owner = point.dist.name if point.dist else "a package"
            form = f"KIND.NAME = module:name with one of {', '.join(TABLES)}"
            message = f"plug-in of {owner}: {point.name} = {point.value} is left out; give {form}"
            warnings.warn(message, UserWarning, stacklevel=2)
            continue
        found.setdefault(kind, {}).setdefault(name, point.value)
    return found


class Registry(Mapping[str, Entry], Generic[Entry]):
    """Table of entries by name, of which each is imported at its first use.

    The names are known without an import, so that a program loads only the entries that it uses. Names of plug-ins are
    looked up when a name is not found; they never replace a name of the library.

    Args:
        kind: kind of the entries, a key of TABLES.
        entries: name -> entry, or its module and name, "module:name".
        adapt: function that makes an entry of the object of a plug-in, given its name.
    """

    def __init__(self, kind: str, entries: Mapping[str, Any], adapt: Callable[[str, Any], Entry] | None = None) -> None:
        self._kind, self._own, self._adapt = kind, dict(entries), adapt
        self._loaded: dict[str, Entry] = {}

    def _place(self, name: Any) -> Any:
        """Return the entry of a name, or its place; None for an unknown name."""
        if name in self._own:
            return self._own[name]
        registered = _registered().get(self._kind, {})
        return registered[name] if name in registered else plugins().get(self._kind, {}).get(name)

    def __getitem__(self, name: str) -> Entry:
        if name not in self._loaded:
            place = self._place(name)
            if place is None:
                raise KeyError(name)
            if not isinstance(place, str):
                entry: Entry = place
                return entry
            self._loaded[name] = load_entry(place) if name in self._own else self._plugin(name, place)
        return self._loaded[name]

    def _plugin(self, name: str, place: str) -> Entry:
        """Return the entry of a plug-in."""
        try:
            found = load_entry(place)
        except Exception as error:  # of a module of somebody else
            reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
            raise ValueError(f"{self._kind} {name}: {place} of a plug-in cannot be imported ({reason})") from error
        entry: Entry = self._adapt(name, found) if self._adapt else found
        return entry

    def file(self, name: str) -> Path | None:
        """Return the file with the entry of a plug-in; None for a name of the library or an unknown name."""
        place = None if name in self._own else self._place(name)
        return Path(str(import_module(place.partition(":")[0]).__file__)) if place else None

    def __contains__(self, name: object) -> bool:
        return self._place(name) is not None

    def __iter__(self) -> Iterator[str]:
        known = plugins().get(self._kind, {}) if plugins.cache_info().currsize else {}  # not read for a list alone
        return iter(dict.fromkeys([*self._own, *_registered().get(self._kind, {}), *known]))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def items(self) -> ItemsView[str, Entry]:
        """Return all names and entries; a plug-in that cannot be imported is left out with a UserWarning."""
        return self._all().items()

    def values(self) -> ValuesView[Entry]:
        """Return all entries, as `items`."""
        return self._all().values()

    def _all(self) -> dict[str, Entry]:
        found: dict[str, Entry] = {}
        plugins()
        for name in self:
            try:
                found[name] = self[name]
            except ValueError as error:
                warnings.warn(str(error), UserWarning, stacklevel=3)
        return found
