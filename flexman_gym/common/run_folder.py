"""Run folder: settings, arrays with plain data, and a lock."""

import fcntl
import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.common.checks import short_path
from flexman_gym.common.files import READ_ERRORS, existing_file, open_arrays, regular_file, write_atomically

SETTINGS, NEWEST, BEST, LOCK = "settings.json", "newest.npz", "best.npz", "lock"
TEXT = "data.json"  # the name of the plain data among the arrays of a file


def write_npz(path: Path, data: dict[str, Any]) -> None:
    """Writes dicts and lists of arrays and plain data, as arrays and JSON in one file (npz); see `write_atomically`."""
    arrays: dict[str, np.ndarray] = {}
    text = json.dumps(_split_arrays(data, arrays)).encode()
    named: dict[str, Any] = {TEXT: np.frombuffer(text, dtype=np.uint8), **arrays}  # paths begin with a slash
    write_atomically(path, lambda file: np.savez(file, allow_pickle=False, **named))


def read_npz(path: Path) -> Any:
    """Reads such a file; nothing in it is run.

    Raises:
        FileNotFoundError: when there is none.
        ValueError: one line, for a file that is something else, broken, or larger than it looks.
    """
    try:
        with open_arrays(existing_file(path)) as result:
            text = result[TEXT].tobytes().decode("utf-8")
            return _join_arrays(json.loads(text), result)
    except FileNotFoundError:
        raise
    except READ_ERRORS as error:
        said = " ".join(str(error).split())[:120] or type(error).__name__
        raise ValueError(f"{short_path(path)}: this is not what a training run has written ({said})") from None


def _split_arrays(data: Any, arrays: dict[str, np.ndarray], path: str = "") -> Any:
    if isinstance(data, np.ndarray):
        arrays[path] = data
        return {"array": path}
    if isinstance(data, dict):
        return {name: _split_arrays(each, arrays, f"{path}/{name}") for name, each in data.items()}
    if isinstance(data, list):
        return [_split_arrays(each, arrays, f"{path}/{i}") for i, each in enumerate(data)]
    return data


def _join_arrays(data: Any, arrays: Any) -> Any:
    if isinstance(data, dict):
        if data.keys() == {"array"}:
            return arrays[data["array"]]
        return {name: _join_arrays(each, arrays) for name, each in data.items()}
    return [_join_arrays(each, arrays) for each in data] if isinstance(data, list) else data


def read_settings_text(folder: Path) -> str:
    """Return the text of the settings of a training run.

    Raises:
        FileNotFoundError, ValueError: one line, where there are none, and for a file of more than 1 MB.
    """
    path = existing_file(folder / SETTINGS)
    try:
        return regular_file(path).read_bytes().decode("utf-8", errors="replace")
    except ValueError as error:
        raise ValueError(f"{short_path(path)}: {error}") from None


def read_settings(folder: Path) -> dict[str, Any]:
    """Return the settings of a training run, unchecked.

    Raises:
        FileNotFoundError, ValueError: one line, for a file that is no mapping in JSON.
    """
    text, place = read_settings_text(folder), short_path(folder / SETTINGS)
    try:
        result = json.loads(text)
    except (ValueError, RecursionError):
        result = None
    if not isinstance(result, dict):
        raise ValueError(f"{place}: this is no mapping in JSON; give the settings of a training run")
    return result


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Holds a folder for this process alone; the lock ends with the process, however that ends.

    Raises:
        ValueError: one line, when another process trains in the folder, and where the lock is a link.
        OSError: when nothing can be written there.
    """
    path = folder / LOCK
    if path.is_symlink():
        raise ValueError(f"folder: {folder} is not allowed; give one whose file {LOCK} is not a link")
    with os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666), "r+", encoding="utf-8") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ValueError(f"folder: {folder} is not allowed; process {_holder(file)} trains in it") from None
        holder = _holder(file)
        if holder:
            print(f"Process {holder}, which trained in {folder}, is gone: this one takes over.", file=sys.stderr)
        file.seek(0)
        file.truncate()
        file.write(str(os.getpid()))
        file.flush()
        try:
            yield
        finally:
            file.truncate(0)


def _holder(file: Any) -> str:
    """The process whose number is in a lock, "" for none."""
    file.seek(0)
    return str(file.read(20)).strip()
