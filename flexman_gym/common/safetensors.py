"""Safetensors: reading and writing of named arrays, without execution of code."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.checks import one_of, value_error
from flexman_gym.common.run_folder import write_atomically

DTYPES: dict[str, np.dtype[Any]] = {"F32": np.dtype("<f4"), "F64": np.dtype("<f8")}
FIELDS = ("dtype", "shape", "data_offsets")
HEAD, ALIGNED, MAX_BYTES = 8, 8, 10**6  # bytes: of the length of the header, and of a whole file at most


def write_tensors(path: Path, arrays: Mapping[str, NDArray[np.floating]]) -> None:
    """Writes arrays of float32 and float64: the length of a header, the header as JSON, and the numbers.

    Raises:
        ValueError: for arrays of another type.
        OSError: when the file cannot be written.
    """
    header: dict[str, Any] = {}
    numbers, end = [], 0
    for name in sorted(arrays, key=lambda each: (-arrays[each].dtype.itemsize, each)):  # each begins on its size
        kind = next((key for key, known in DTYPES.items() if known == arrays[name].dtype), "")
        if not kind:
            raise value_error(name, str(arrays[name].dtype), f"an array of {' or '.join(DTYPES)}")
        numbers.append(arrays[name].astype(DTYPES[kind]).tobytes())
        header[name] = {"dtype": kind, "shape": list(arrays[name].shape), "data_offsets": [end, end + len(numbers[-1])]}
        end += len(numbers[-1])
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % ALIGNED)
    write_atomically(path, lambda file: file.write(b"".join([len(text).to_bytes(HEAD, "little"), text, *numbers])))


def read_tensors(content: bytes) -> dict[str, NDArray[np.floating]]:
    """Gives the arrays of such a file.

    Raises:
        ValueError: one line, for a header that is no such mapping, and for numbers that it does not account for, each
            once and to the last byte.
    """
    if not HEAD < len(content) <= MAX_BYTES:
        raise value_error("file", f"{len(content)} bytes", f"at most {MAX_BYTES}, and a header")
    start = HEAD + int.from_bytes(content[:HEAD], "little")
    if start > len(content):
        raise value_error("header", f"{start - HEAD} bytes", f"at most the {len(content) - HEAD} that follow")
    header = parse_json(content[HEAD:start])
    if not isinstance(header, dict):
        raise value_error("header", type(header).__name__, "a mapping of arrays")
    result, places = {}, []
    for name, entry in header.items():
        kind, shape, (first, last) = _entry(name, entry)
        size = math.prod(shape) * kind.itemsize
        if not 0 <= first <= last <= len(content) - start or last - first != size:
            raise value_error(f"{name}.data_offsets", [first, last], f"{size} of the {len(content) - start} bytes")
        places.append((first, last))
        result[name] = np.frombuffer(content[start + first : start + last], kind).reshape(shape)
    ends = [0, *(last for _, last in sorted(places))]
    if [first for first, _ in sorted(places)] != ends[:-1] or ends[-1] != len(content) - start:
        raise value_error("data_offsets", sorted(places), "places side by side, from the first byte to the last")
    return result


def parse_json(text: bytes) -> Any:
    """Gives what a text in JSON says: no key twice, and no number that JSON does not know.

    Raises:
        ValueError: one line, for anything else.
    """
    try:
        return json.loads(text.decode("utf-8"), object_pairs_hook=_once, parse_constant=_no_number)
    except RecursionError:
        raise ValueError("its mappings lie too deep in each other") from None


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) < len(pairs):
        raise ValueError("a key stands there twice")
    return result


def _no_number(text: str) -> Any:
    raise ValueError(f"{text} is no number of JSON")


def _entry(name: str, entry: Any) -> tuple[np.dtype[Any], list[int], list[int]]:
    """Type, shape and place of an array."""
    if not isinstance(entry, dict) or set(entry) != set(FIELDS):
        raise value_error(name, entry, f"a mapping with {', '.join(FIELDS)}")
    kind = DTYPES[one_of(f"{name}.dtype", entry["dtype"], DTYPES)]
    for field, count in (("shape", None), ("data_offsets", 2)):
        value = entry[field]
        whole = isinstance(value, list) and all(type(each) is int and 0 <= each <= MAX_BYTES for each in value)
        if not whole or count not in (None, len(value)):
            raise value_error(f"{name}.{field}", value, f"{count or 'a list of'} whole numbers from 0 to {MAX_BYTES}")
    return kind, entry["shape"], entry["data_offsets"]
