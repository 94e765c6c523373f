"""Run folder of a training: settings, states as arrays and JSON-compatible data, and a lock."""

import fcntl
import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.common.errors import key_error, value_error
from flexman_gym.common.files import existing_file, naming, open_arrays, reading, regular_file, write_atomically

SETTINGS, NEWEST, BEST, LOCK = "settings.json", "newest.npz", "best.npz", "lock"
RESULT, BASE = "result.json", "base"  # file that names the result of a run; the base controller in place of the policy
NO_SETTINGS = "has no settings of a training run"  # predicate of a damaged file of settings
KEYS = (  # settings of a training run, and the versions of packages with which it was trained
    "algo", "environment", "steps", "seed", "envs", "hyperparameters", "schedules", "normalise_reward", "eval_every",
    "value_warmup", "base_in_use", "training_horizon", "arms", "versions", "earlier_versions",
)  # fmt: skip
PLAIN_DATA = "data.json"  # name of the JSON-compatible data among the arrays of a file


def policy_file(folder: Path) -> Path:
    """Return the file of the best policy of a run, or of the newest if no best policy exists.

    Raises:
        FileNotFoundError: if the folder has neither.
        ValueError: for a run whose result is its base controller.
    """
    if has_base_as_result(folder):
        keeps = f"flexman train --resume --keep-worse --folder {folder} keeps the policy"
        raise value_error("run", str(folder), f"a run whose result is a policy, not its base controller; {keeps}")
    return folder / BEST if (folder / BEST).is_file() else existing_file(folder / NEWEST)


def write_npz(path: Path, data: dict[str, Any]) -> None:
    """Write nested dicts and lists of arrays and JSON-compatible data atomically to one npz file."""
    arrays: dict[str, np.ndarray] = {}
    text = json.dumps(_split_arrays(data, arrays)).encode()
    named: dict[str, Any] = {
        PLAIN_DATA: np.frombuffer(text, dtype=np.uint8),
        **arrays,
    }  # array names begin with "/"
    write_atomically(path, lambda file: np.savez(file, allow_pickle=False, **named))


def read_npz(path: Path) -> Any:
    """Read nested data from a file of `write_npz` without running any code in it.

    Args:
        path: path of the file.

    Raises:
        FileNotFoundError: if the file does not exist.
        ValueError: for a damaged file, another kind of file, or arrays larger than the file, with a one-line message.
    """
    with reading(path, "is no file of a training run"), open_arrays(existing_file(path)) as result:
        text = result[PLAIN_DATA].tobytes().decode("utf-8")
        return _join_arrays(json.loads(text), result)


def _split_arrays(data: Any, arrays: dict[str, np.ndarray], path: str = "") -> Any:
    """Move the arrays of nested data into `arrays` by path; return the data with references in their place."""
    if isinstance(data, np.ndarray):
        arrays[path] = data
        return {"array": path}
    if isinstance(data, dict):
        return {name: _split_arrays(each, arrays, f"{path}/{name}") for name, each in data.items()}
    if isinstance(data, list):
        return [_split_arrays(each, arrays, f"{path}/{i}") for i, each in enumerate(data)]
    return data


def _join_arrays(data: Any, arrays: Any) -> Any:
    """Return nested data with its references replaced by arrays; raise KeyError for a missing array."""
    if isinstance(data, dict):
        if data.keys() == {"array"}:
            return arrays[data["array"]]
        return {name: _join_arrays(each, arrays) for name, each in data.items()}
    return [_join_arrays(each, arrays) for each in data] if isinstance(data, list) else data


def read_settings(folder: Path) -> dict[str, Any]:
    """Read the settings of a training run; only their keys are checked.

    Args:
        folder: folder of the run.

    Raises:
        FileNotFoundError: if there are no settings.
        ValueError: for a file of more than 1 MB or without a JSON mapping, and for an unknown key, with a one-line
            message.
    """
    path = existing_file(folder / SETTINGS)
    with naming(path):
        text = regular_file(path).read_bytes().decode("utf-8", errors="replace")
        try:
            result = json.loads(text)
        except (ValueError, RecursionError):
            result = None
        if not isinstance(result, dict):
            raise ValueError("this is no mapping in JSON; give the settings of a training run")
        check_keys(result)
    return result


def has_base_as_result(folder: Path) -> bool:
    """Return True for a run whose policy settles less often than its base controller, see `flexman_agents.guard`."""
    path = folder / RESULT
    if not path.is_file():
        return False
    with reading(path, "names no result of a training run"):
        return bool(json.loads(regular_file(path).read_bytes())["result"] == BASE)


def check_keys(settings: dict[str, Any]) -> None:
    """Raise an error for an unknown key of the stored settings of a run, and for an environment without its method."""
    for name in settings:
        if name not in KEYS:
            raise key_error(name, settings[name], f"one of {', '.join(KEYS)}")
    check_method(settings.get("environment"))


def check_method(environment: object) -> None:
    """Raise an error for a stored environment without its method, since the default method may change.

    With fidelity="auto" no method is stored, since `choose_model` chooses it.
    """
    fixed = isinstance(environment, dict) and environment.get("fidelity", "default") == "default"
    if fixed and environment.get("method") is None:  # type: ignore[attr-defined]
        raise key_error("environment.method", None, "the integration method of the training")


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Lock a folder for this process; the lock ends with the process, even if the process is killed.

    Args:
        folder: the folder.

    Raises:
        ValueError: if another process trains in the folder, or if the lock file is a link, with a one-line message.
        OSError: if the folder is not writable.
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
            print(
                f"Process {holder}, which trained in {folder}, has ended; this process takes over the folder.",
                file=sys.stderr,
            )
        file.seek(0)
        file.truncate()
        file.write(str(os.getpid()))
        file.flush()
        try:
            yield
        finally:
            file.truncate(0)


def _holder(file: Any) -> str:
    """Return the process id in a lock file; "" for an empty file."""
    file.seek(0)
    return str(file.read(20)).strip()
