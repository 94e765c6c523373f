"""Snapshot: the state of an object as arrays and plain data, and its restoration."""

import warnings
from typing import Any

import numpy as np

from flexman_gym.common.checks import value_error

FORMER_FIELDS = {
    "_apart": "_perturbations_reduced", "_following": "_paths", "_given_up": "_fallback_active", "_known": "_latest",
    "_looked": "_updated", "_own_coordinates": "_adapted_coordinates", "_own_torques": "_adapted_torques",
    "_pushed": "_filtering", "_residuals": "_detector", "_soft": "_compliance", "_tight": "_holding",
    "ahead": "clock_offset", "begun": "start_time", "lasting": "duration", "pace": "time_scaling",
    "quickening": "pace_rate", "shape": "shaping", "wanted": "action", "way": "displacement",
}  # fmt: skip
"""State field of release 0.2 -> present field: snapshots of older releases are read under their present names."""
GENERATOR = "bit_generator"  # the key by which the state of a random generator is known


def get_state(value: Any) -> Any:
    """Gives a copy of a value of the kinds above: dicts and lists of arrays, numbers, texts, booleans and None."""
    if isinstance(value, np.ndarray):
        return value.copy()
    if isinstance(value, np.random.Generator):
        return _of_generator(value)
    if isinstance(value, dict):
        return {name: get_state(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [get_state(each) for each in value]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return {name: get_state(getattr(value, name)) for name in _state_fields(value)}


def set_state(field: str, old: Any, data: Any) -> Any:
    """Gives what was taken back to a value made alike; returns the value, `old` itself where it could be written into.

    Raises:
        ValueError: one line, where the data does not fit; what was written before stays written.
    """
    if isinstance(old, np.ndarray):
        if not isinstance(data, np.ndarray) or data.shape != old.shape or data.dtype != old.dtype:
            raise value_error(field, _sort(data), f"an array {old.shape} of {old.dtype}")
        old[...] = data
        return old
    if isinstance(data, dict) and GENERATOR in data:
        return _generator(field, data)
    if isinstance(old, dict):
        _check_kind(field, data, dict, "a mapping")
        new = {name: set_state(f"{field}.{name}", old.get(name), each) for name, each in data.items()}
        return old if new.keys() == old.keys() and all(new[name] is old[name] for name in new) else new
    if isinstance(old, list | tuple):  # arrays of a tuple are written into
        _check_kind(field, data, list, "a list")
        if len(data) != len(old):
            raise value_error(field, f"{len(data)} entries", f"{len(old)} entries")
        fresh = [set_state(f"{field}[{i}]", *both) for i, both in enumerate(zip(old, data, strict=True))]
        return old if all(one is other for one, other in zip(fresh, old, strict=True)) else fresh
    if old is None or isinstance(old, bool | int | float | str | np.random.Generator):
        return get_state(data)
    names = _state_fields(old)
    _check_kind(field, data, dict, "a mapping")
    if set(data) != set(names):
        data = {FORMER_FIELDS.get(name, name): each for name, each in data.items()}
    if set(data) != set(names):
        raise value_error(field, sorted(map(str, data)), f"a mapping with {', '.join(sorted(names)) or 'nothing'}")
    for name in names:
        before = getattr(old, name)
        after = set_state(f"{field}.{name}", before, data[name])
        if after is not before:
            setattr(old, name, after)
    return old


def _state_fields(value: Any) -> tuple[str, ...]:
    """Return the names of the attributes that make up the state of an object; () for an object without state."""
    if hasattr(value, "kept") and not hasattr(value, "state_fields"):
        said = f"{type(value).__name__}.kept is deprecated; name it state_fields"
        warnings.warn(said, DeprecationWarning, stacklevel=3)
        return tuple(value.kept)
    return tuple(getattr(value, "state_fields", ()))


def split_arrays(data: Any, arrays: dict[str, np.ndarray], path: str = "") -> Any:
    """Gives the data without its arrays, which go into `arrays`; names of theirs take their place."""
    if isinstance(data, np.ndarray):
        arrays[path] = data
        return {"array": path}
    if isinstance(data, dict):
        return {name: split_arrays(each, arrays, f"{path}/{name}") for name, each in data.items()}
    if isinstance(data, list):
        return [split_arrays(each, arrays, f"{path}/{i}") for i, each in enumerate(data)]
    return data


def join_arrays(data: Any, arrays: Any) -> Any:
    """Gives the data with its arrays again; raises KeyError for one that is not there."""
    if isinstance(data, dict):
        if data.keys() == {"array"}:
            return arrays[data["array"]]
        return {name: join_arrays(each, arrays) for name, each in data.items()}
    return [join_arrays(each, arrays) for each in data] if isinstance(data, list) else data


def _of_generator(random: np.random.Generator) -> dict[str, Any]:
    """The state of a generator and the seed from which streams of its own are made."""
    seed: Any = random.bit_generator.seed_seq
    entropy = [int(each) for each in seed.entropy] if np.ndim(seed.entropy) else int(seed.entropy)
    key = [int(each) for each in seed.spawn_key]
    return {**random.bit_generator.state, "entropy": entropy, "spawn_key": key}


def _generator(field: str, data: dict[str, Any]) -> np.random.Generator:
    try:
        made = np.random.PCG64(np.random.SeedSequence(data["entropy"], spawn_key=data["spawn_key"]))
        state: Any = {name: each for name, each in data.items() if name not in ("entropy", "spawn_key")}
        made.state = state
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        said = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"{field}: this is not the state of a generator ({said}); give one that was taken") from None
    return np.random.Generator(made)


def _check_kind(field: str, data: Any, kind: type, words: str) -> None:
    if not isinstance(data, kind):
        raise value_error(field, _sort(data), words)


def _sort(data: Any) -> str | None:
    if data is None:
        return None
    return f"array {data.shape} of {data.dtype}" if isinstance(data, np.ndarray) else type(data).__name__
