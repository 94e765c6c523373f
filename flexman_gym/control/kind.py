"""Kind: a part that is chosen by its name, or by a mapping with its name and arguments."""

from collections.abc import Collection, Mapping
from typing import Any

from flexman_gym.checks import mapping, one_of, refusal, text


def checked_kind(name: str, value: object, known: Mapping[str, Collection[str]]) -> tuple[str, dict[str, Any]]:
    """Gives name and arguments of a value that is a name, or a mapping with one at "kind" and its arguments.

    Args:
        name: of the field.
        value: what was given.
        known: names, and the arguments that each takes.

    Raises:
        ValueError: for anything else.
    """
    if isinstance(value, str):
        return one_of(name, value, known), {}
    if not isinstance(value, Mapping) or "kind" not in value:
        raise refusal(name, value, "a name, or a mapping with a name at kind and its arguments")
    chosen = one_of(f"{name}.kind", text(f"{name}.kind", value["kind"]), known)
    given = {text(f"a key of {name}", key): each for key, each in value.items() if key != "kind"}
    return chosen, mapping(name, given, known[chosen])
