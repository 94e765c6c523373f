"""Infos: what an environment says beside observations, of one arm and of many, with Gymnasium's masks."""

from typing import Any

import numpy as np

from flexman_gym.arrays import Flags

Infos = dict[str, Any]


def arrays(info: Infos) -> Infos:
    """The info of an arm alone, with an axis for the arms in front of every number and array."""
    return {key: arrays(value) if isinstance(value, dict) else np.array([value]) for key, value in info.items()}


def with_masks(infos: Infos, mask: Flags) -> Infos:
    """The infos with a mask for each key, those of dicts inside too."""
    result = {}
    for key, value in infos.items():
        result[key] = with_masks(value, mask) if isinstance(value, dict) else value
        result[f"_{key}"] = mask
    return result


def masked(infos: Infos, mask: Flags) -> Infos:
    """Infos of the arms of a mask alone, zero (None for objects) elsewhere."""
    result: Infos = {}
    for key, value in infos.items():
        if isinstance(value, dict):
            result[key] = masked(value, mask)
        elif not key.startswith("_"):
            result[key] = np.zeros_like(value) if value.dtype != object else np.full_like(value, None)
            result[key][mask] = value[mask]
        result[key if key.startswith("_") else f"_{key}"] = mask.copy()
    return result
