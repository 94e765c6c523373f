"""Tables of named entries that are imported at their first use."""

from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Any, Generic, TypeVar

Entry = TypeVar("Entry")


def load_entry(place: str) -> Any:
    """Import and return an object.

    Args:
        place: module and name of the object, "module:name".
    """
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


class Registry(Mapping[str, Entry], Generic[Entry]):
    """Table of entries by name, of which each is imported at its first use.

    The names are known without an import, so that a program loads only the entries that it uses.

    Args:
        places: name -> module and name of the entry, "module:name".
    """

    def __init__(self, places: Mapping[str, str]) -> None:
        self._places = dict(places)
        self._loaded: dict[str, Entry] = {}

    def __getitem__(self, name: str) -> Entry:
        if name not in self._loaded:
            self._loaded[name] = load_entry(self._places[name])
        return self._loaded[name]

    def __contains__(self, name: object) -> bool:
        return name in self._places

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)
