"""Snapshot: the state of an object as arrays and JSON-compatible data, and its restoration.

An object lists the attributes of its state in `state_fields`. Arrays, random generators, dicts, lists, tuples,
numbers, strings, booleans and None are supported as well.
"""

from typing import Any

import numpy as np

from flexman_gym.common.errors import key_error, value_error

GENERATOR = "bit_generator"  # key of the state of a random generator


def get_state(value: Any) -> Any:
    """Return a copy of the state of a value, as dicts and lists of arrays, numbers, strings, booleans and None."""
    if isinstance(value, np.ndarray):
        return value.copy()
    if isinstance(value, np.random.Generator):
        return _generator_state(value)
    if isinstance(value, dict):
        return {name: get_state(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [get_state(each) for each in value]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return {name: get_state(getattr(value, name)) for name in _state_fields(value)}


def set_state(field: str, old: Any, data: Any) -> Any:
    """Restore the state of a value.

    Args:
        field: field, for errors.
        old: present value.
        data: state from `get_state`, to be restored.

    Returns:
        `old` itself if the state was written in place, else a new value.

    Raises:
        ValueError: if the data do not fit the value, with a one-line message. Parts restored before the error stay
            restored.
    """
    if isinstance(old, np.ndarray):
        if not isinstance(data, np.ndarray) or data.shape != old.shape or data.dtype != old.dtype:
            raise value_error(field, _kind_name(data), f"an array {old.shape} of {old.dtype}")
        old[...] = data
        return old
    if isinstance(data, dict) and GENERATOR in data:
        return _generator(field, data)
    if isinstance(old, dict):
        _check_kind(field, data, dict, "a mapping")
        new = {name: set_state(f"{field}.{name}", old.get(name), each) for name, each in data.items()}
        return old if new.keys() == old.keys() and all(new[name] is old[name] for name in new) else new
    if isinstance(old, list | tuple):  # arrays in a tuple are written in place
        _check_kind(field, data, list, "a list")
        if len(data) != len(old):
            raise value_error(field, f"{len(data)} entries", f"{len(old)} entries")
        new_list = [set_state(f"{field}[{i}]", *both) for i, both in enumerate(zip(old, data, strict=True))]
        return old if all(one is other for one, other in zip(new_list, old, strict=True)) else new_list
    if old is None or isinstance(old, bool | int | float | str | np.random.Generator):
        return get_state(data)
    names = _state_fields(old)
    _check_kind(field, data, dict, "a mapping")
    if set(data) != set(names):
        raise key_error(field, sorted(map(str, data)), f"a mapping with {', '.join(sorted(names)) or 'nothing'}")
    for name in names:
        before = getattr(old, name)
        after = set_state(f"{field}.{name}", before, data[name])
        if after is not before:
            _set_field(f"{field}.{name}", old, name, after)
    return old


def _set_field(field: str, owner: Any, name: str, value: Any) -> None:
    """Set an attribute; a property without a setter refuses new entries, since its arrays are written in place."""
    try:
        setattr(owner, name, value)
    except AttributeError:
        raise value_error(field, _kind_name(value), "one with the entries of get_state") from None


def _state_fields(value: Any) -> tuple[str, ...]:
    """Return the names of the attributes that form the state of an object."""
    return getattr(value, "state_fields", ())


def _generator_state(random: np.random.Generator) -> dict[str, Any]:
    """Return the state of a random generator, including the seed for the generators that it spawns."""
    seed: Any = random.bit_generator.seed_seq
    entropy = [int(each) for each in seed.entropy] if np.ndim(seed.entropy) else int(seed.entropy)
    key = [int(each) for each in seed.spawn_key]
    return {**random.bit_generator.state, "entropy": entropy, "spawn_key": key}


def _generator(field: str, data: dict[str, Any]) -> np.random.Generator:
    """Return the random generator of a state."""
    try:
        bits = np.random.PCG64(np.random.SeedSequence(data["entropy"], spawn_key=data["spawn_key"]))
        state: Any = {name: each for name, each in data.items() if name not in ("entropy", "spawn_key")}
        bits.state = state
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"{field}: this is no state of a random generator ({reason}); give one of get_state") from None
    return np.random.Generator(bits)


def _check_kind(field: str, data: Any, kind: type, words: str) -> None:
    if not isinstance(data, kind):
        raise value_error(field, _kind_name(data), words)


def _kind_name(data: Any) -> str | None:
    if data is None:
        return None
    return f"array {data.shape} of {data.dtype}" if isinstance(data, np.ndarray) else type(data).__name__
