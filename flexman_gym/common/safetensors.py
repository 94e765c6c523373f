"""Safetensors: named arrays of float32 and float64 as files."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

from flexman_gym.common.checks import one_of, short_repr, value_error
from flexman_gym.common.files import write_atomically

DTYPES = ("float32", "float64")
MAX_BYTES = 10**6  # bytes; of a whole file


def write_tensors(path: Path, arrays: Mapping[str, NDArray[np.floating]]) -> None:
    """Write arrays to a file, atomically.

    Raises:
        ValueError: for arrays of another type.
        OSError: when the file cannot be written.
    """
    _check_types(arrays)
    content = save({name: np.ascontiguousarray(array) for name, array in arrays.items()})
    write_atomically(path, lambda file: file.write(content))


def read_tensors(content: bytes) -> dict[str, NDArray[np.floating]]:
    """Return the arrays in the content of a file.

    Raises:
        ValueError: one line, for a broken header, for arrays of another type, and for bytes that belong to no array.
    """
    if len(content) > MAX_BYTES:
        raise value_error("file", f"{len(content)} bytes", f"at most {MAX_BYTES}")
    try:
        arrays = load(content)
    except KeyError as error:
        raise value_error("dtype", error.args[0], " or ".join(DTYPES)) from None
    except SafetensorError as error:
        said = short_repr(str(error).removeprefix("Error while deserializing: "))
        raise ValueError(f"file: {said}; give arrays in the format of safetensors") from None
    _check_types(arrays)
    return arrays


def _check_types(arrays: Mapping[str, NDArray[np.generic]]) -> None:
    for name, array in arrays.items():
        one_of(f"{name}.dtype", array.dtype.name, DTYPES)
