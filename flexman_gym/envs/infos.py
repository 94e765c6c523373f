"""Forms of the info of an environment: nested, flat, of the end of episodes only, or empty."""

from collections.abc import Callable
from typing import Any

import numpy as np

from flexman_gym.common.arrays import BoolArray
from flexman_gym.common.registry import load_entry
from flexman_gym.kernels import layout

Infos = dict[str, Any]
INFO_MODES = ("always", "at end", "flat", "none")  # values of the argument infos
TEXTS: dict[str, Callable[[str], int]] = {
    "status": layout.STATUS.index,
    "safety_status": lambda text: int(load_entry("flexman_gym.toolbox.safety.safety_filter:STATUS").index(text)),
    "failure": bool,
}
"""Key of a text -> function that returns its number."""


def flat_info(info: Infos) -> Infos:
    """Return an info of one or of several arms whose values are numbers and arrays of numbers.

    An entry of a nested dict has the key "KEY/NAME". "status" is the index of the text in `kernels.layout.STATUS`,
    "safety_status" that in the STATUS of the safety filter, and "failure" is True for a failure. Other texts and
    objects are left out.
    """
    result = {}
    for key, value in info.items():
        if isinstance(value, dict):
            result.update({f"{key}/{name}": each for name, each in flat_info(value).items()})
        elif np.asarray(value).dtype.kind in "biuf":
            result[key] = value
        elif key in TEXTS:
            number = TEXTS[key]
            result[key] = number(value) if isinstance(value, str) else np.array([number(each) for each in value])
    return result


def batched_info(info: Infos) -> Infos:
    """Return the info of a single arm with a leading axis of length 1 on every number and array."""
    return {key: batched_info(value) if isinstance(value, dict) else np.array([value]) for key, value in info.items()}


def with_masks(infos: Infos, mask: BoolArray) -> Infos:
    """Return the infos with a mask under "_KEY" for each key, also in nested dicts."""
    result = {}
    for key, value in infos.items():
        result[key] = with_masks(value, mask) if isinstance(value, dict) else value
        result[f"_{key}"] = mask
    return result


def masked(infos: Infos, mask: BoolArray) -> Infos:
    """Return infos in which the arms outside a mask (b,) have zeros (None for objects)."""
    result: Infos = {}
    for key, value in infos.items():
        if isinstance(value, dict):
            result[key] = masked(value, mask)
        elif not key.startswith("_"):
            result[key] = np.zeros_like(value) if value.dtype != object else np.full_like(value, None)
            result[key][mask] = value[mask]
        result[key if key.startswith("_") else f"_{key}"] = mask.copy()
    return result
