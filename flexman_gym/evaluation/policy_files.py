"""Policy files: an exported policy as safetensors and JSON, checked by hashes and stored actions."""

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

from flexman_gym.agent.network import Network, policy_parameters
from flexman_gym.common.checks import one_of
from flexman_gym.common.errors import key_error, short_repr, value_error
from flexman_gym.common.files import existing_file, reading, regular_file, write_atomically
from flexman_gym.common.run_folder import check_keys, check_method

FOLDER = Path(__file__).parents[1] / "policies"
METADATA, ARRAYS = "policy.json", "policy.safetensors"
POLICIES = tuple(sorted(path.parent.name for path in FOLDER.glob(f"*/{METADATA}")))
FORMAT = "flexman_gym policy 1"
DTYPES = ("float32", "float64")  # allowed types of arrays
MAX_BYTES = 10**6  # bytes; largest size of a file
KEYS = (
    "format", "words", "licence", "commit", "versions", "recipe", "training_seconds", "environment",
    "environment_hash", "settings_hash", "observation", "league", "arrays_hash",
)  # fmt: skip
STATISTICS, CHECKS = ("statistics.mean", "statistics.var"), ("check.observations", "check.actions")
CHECK_ROWS = 64  # number of observations stored with their actions as a check of the network
CHECK_TOLERANCE = 1e-9  # dimensionless; largest difference of an action from the stored action


class _ExportedPolicy(NamedTuple):
    """Exported policy: metadata with the entries KEYS, and network."""

    metadata: dict[str, Any]
    network: Network


def policy_folder(name: str) -> Path | None:
    """Return the folder of a shipped policy by its name, or of an exported policy by its path; None for other texts."""
    if name in POLICIES:
        return FOLDER / name
    return Path(name) if os.path.isfile(Path(name) / METADATA) else None


def read_policy(folder: Path) -> _ExportedPolicy:
    """Return metadata and network of an exported policy without executing code of its files.

    Args:
        folder: folder of the policy.

    Raises:
        FileNotFoundError: if a file is missing.
        ValueError: for a file that is too large or damaged, for wrong hashes of arrays, environment or settings, and
            for a network whose actions differ from the stored actions.
    """
    path, wrong = existing_file(folder / METADATA), "is no exported policy"
    with reading(path, wrong):
        metadata = read_json(path)
        _check_metadata(metadata)
    path = existing_file(folder / ARRAYS)
    with reading(path, wrong):
        content = _read_bytes(path)
        if hashlib.sha256(content).hexdigest() != metadata["arrays_hash"]:
            raise value_error("arrays_hash", metadata["arrays_hash"], "that of the arrays: one of them was changed")
        return _ExportedPolicy(metadata, _check_network(metadata, _read_tensors(content)))


def write_policy(folder: Path, metadata: Mapping[str, Any], arrays: dict[str, NDArray[np.floating]]) -> None:
    """Write a policy with its format and hashes, and read it as a check.

    Args:
        folder: folder of the policy; it is created if it does not exist.
        metadata: metadata with the entries KEYS, except format and hashes.
        arrays: layers and normalisation of the network, and observations and actions as a check, by name.

    Raises:
        OSError: if the folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    _check_dtypes(arrays)
    content = save({name: np.ascontiguousarray(array) for name, array in arrays.items()})
    write_atomically(folder / ARRAYS, lambda file: file.write(content))
    computed = {
        "format": FORMAT,
        "environment_hash": _json_hash(metadata["environment"]),
        "settings_hash": _json_hash(metadata["recipe"]["settings"]),
        "arrays_hash": hashlib.sha256(content).hexdigest(),
    }
    complete = {name: computed.get(name, metadata.get(name)) for name in KEYS}
    write_atomically(folder / METADATA, lambda file: file.write((json.dumps(complete, indent=1) + "\n").encode()))
    read_policy(folder)


def _json_hash(data: object) -> str:
    """Return the SHA-256 of JSON-compatible data, independent of the order of keys."""
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()


def read_json(path: Path) -> Any:
    """Return the data of a JSON file.

    Raises:
        ValueError: for more than MAX_BYTES, a syntax error, a repeated key, NaN and infinity, with a one-line message.
    """
    text = _read_bytes(path)
    try:
        return json.loads(text.decode("utf-8"), object_pairs_hook=_unique_keys, parse_constant=_refuse_constant)
    except RecursionError:
        raise ValueError("mappings are nested too deeply") from None


def _read_bytes(path: Path) -> bytes:
    return regular_file(path, MAX_BYTES).read_bytes()


def _check_metadata(metadata: Any) -> None:
    """Check keys, format, and hashes of environment and settings of the metadata of a policy."""
    if not isinstance(metadata, dict) or set(metadata) != set(KEYS):
        raise key_error("keys", sorted(metadata) if isinstance(metadata, dict) else metadata, ", ".join(KEYS))
    if metadata["format"] != FORMAT:
        raise value_error("format", metadata["format"], FORMAT)
    for name, data in (("environment", metadata["environment"]), ("settings", metadata["recipe"]["settings"])):
        if _json_hash(data) != metadata[f"{name}_hash"]:
            raise value_error(name, "data with another hash", f"the {name} of the export")
    check_keys(metadata["recipe"]["settings"])
    check_method(metadata["environment"])


def _check_network(metadata: dict[str, Any], arrays: dict[str, NDArray[np.floating]]) -> Network:
    """Return the network with the given arrays after a comparison of its actions with the stored actions."""
    settings = metadata["recipe"]["settings"]
    algo, activation = settings["algo"], settings["hyperparameters"].get("activation")
    layers = policy_parameters(algo, arrays)
    if unknown := arrays.keys() ^ {*layers, *STATISTICS, *CHECKS}:
        raise value_error("arrays", sorted(unknown), f"layers of {algo}, {', '.join((*STATISTICS, *CHECKS))}")
    moments = {name.partition(".")[2]: arrays[name] for name in STATISTICS}
    network = Network(algo, activation, layers, moments)
    observations, actions = (arrays[name] for name in CHECKS)
    if observations.shape != (CHECK_ROWS, network.size) or actions.shape != (CHECK_ROWS, network.joints):
        allowed = f"arrays {(CHECK_ROWS, network.size)} and {(CHECK_ROWS, network.joints)}"
        raise value_error("check", f"arrays {observations.shape} and {actions.shape}", allowed)
    difference = np.abs(network(observations) - actions).max()
    if not difference <= CHECK_TOLERANCE:
        given = f"actions that differ by {difference:.2g} from the stored ones"
        raise value_error("check", given, f"a network whose actions differ by at most {CHECK_TOLERANCE}")
    return network


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) < len(pairs):
        raise ValueError("a key is repeated")
    return result


def _refuse_constant(text: str) -> Any:
    raise ValueError(f"{text} is no JSON number")


def _read_tensors(content: bytes) -> dict[str, NDArray[np.floating]]:
    """Return the arrays in the content of a file in the format of safetensors.

    Raises:
        ValueError: for a damaged header, arrays of a type not in DTYPES, and bytes that belong to no array, with a
            one-line message.
    """
    if len(content) > MAX_BYTES:
        raise value_error("file", f"{len(content)} bytes", f"at most {MAX_BYTES}")
    try:
        arrays = load(content)
    except KeyError as error:
        raise value_error("dtype", error.args[0], " or ".join(DTYPES)) from None
    except SafetensorError as error:
        reason = short_repr(str(error).removeprefix("Error while deserializing: "))
        raise ValueError(f"file: {reason}; give arrays in the format of safetensors") from None
    _check_dtypes(arrays)
    return arrays


def _check_dtypes(arrays: Mapping[str, NDArray[np.generic]]) -> None:
    for name, array in arrays.items():
        one_of(f"{name}.dtype", array.dtype.name, DTYPES)
