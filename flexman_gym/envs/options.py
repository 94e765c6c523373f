"""Options: what a reset is given beside its seed, for all arms or for each of them."""

import numbers
from collections.abc import Mapping
from typing import Any

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import one_of, refusal, sequence, vector
from flexman_gym.envs.places import TIPS
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.parameters import PARAMETERS


def given_options(
    options: Mapping[str, Any] | None, plan: Mapping[str, Array], size: tuple[int, int]
) -> dict[str, Any]:
    """The options with a leading axis for the arms; `size` is (b, n), how many arms and joints there are."""
    names = [*plan, *(name for name, posture in TIPS.items() if posture in plan), "parameters"]
    if options is not None and not isinstance(options, dict):
        raise refusal("options", options, f"a dict with {', '.join(names[:-1])} or {names[-1]}")
    given: dict[str, Any] = {}
    for name, value in (options or {}).items():
        field = f"options[{name!r}]"
        if one_of("options", name, names) == "parameters":
            given[name] = _parameters(field, value, size)
        else:
            if TIPS.get(name) in given or name in [TIPS.get(other) for other in given]:
                raise refusal(field, value, "either a posture or a place of the tip")
            shape = (3,) if name in TIPS else plan[name].shape[1:]
            given[name] = _each(field, value, shape, size[0], "m" if name in TIPS else "rad" * (shape == size[1:]))
    return given


def check_parameters(options: object, batch: Batch) -> None:
    """Refuses parameters that a batch could not take, before a reset has changed anything."""
    if isinstance(options, dict) and "parameters" in options:
        field, arms, model = "options['parameters']", len(batch.rows), batch.model
        for name, values in _parameters(field, options["parameters"], (arms, model.n_joints)).items():
            PARAMETERS[name].checked(f"{field}[{name!r}]", values, model, arms)


def _each(field: str, value: object, shape: tuple[int, ...], arms: int, unit: str) -> Array:
    """Numbers (b, ...) of all arms from those of one, shape (...), or of each."""
    if len(shape) != 1:
        return _numbers(field, value, (arms, *shape))
    entries = sequence(field, value, "numbers")
    if not entries or not isinstance(entries[0], list | tuple | np.ndarray):
        return np.tile(vector(field, value, shape[0], unit), (arms, 1))
    if len(entries) != arms:
        allowed = f"{shape[0]} numbers ({unit}), or a list of {arms} such lists, one for each arm"
        raise refusal(field, value, allowed)
    return np.array([vector(f"{field}[{i}]", entry, shape[0], unit) for i, entry in enumerate(entries)])


def _parameters(field: str, value: object, size: tuple[int, int]) -> dict[str, Array]:
    if not isinstance(value, dict):
        raise refusal(field, value, f"a dict with some of {', '.join(PARAMETERS)}")
    given = {}
    for name, values in value.items():
        shape = PARAMETERS[one_of(field, name, PARAMETERS)].shape(size[1])
        given[name] = _numbers(f"{field}[{name!r}]", values, (size[0], *shape))
    return given


def _numbers(field: str, value: object, shape: tuple[int, ...]) -> Array:
    """Numbers of that shape, or of one arm, which all then have."""
    allowed = f"numbers of the shape {shape}, or {shape[1:]}"
    try:
        listed = value if isinstance(value, numbers.Real | np.ndarray) else sequence(field, value)  # not too long
        values = np.broadcast_to(np.asarray(listed), shape)
    except Exception:  # another shape, lists of different length, an object of somebody's own
        raise refusal(field, value, allowed) from None
    if values.dtype.kind not in "fiu":
        raise refusal(field, value, allowed)
    return values
