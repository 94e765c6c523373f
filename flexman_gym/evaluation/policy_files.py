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
from flexman_gym.common.checks import mapping, one_of
from flexman_gym.common.errors import key_error, short_repr, value_error
from flexman_gym.common.files import existing_file, reading, regular_file, write_atomically
from flexman_gym.common.run_folder import check_keys, check_method

FOLDER = Path(__file__).parents[1] / "policies"
METADATA, ARRAYS, CERTIFICATE = "policy.json", "policy.safetensors", "certificate.json"
POLICIES = tuple(sorted(path.parent.name for path in FOLDER.glob(f"*/{METADATA}")))
FORMAT = "flexman_gym policy 1"
DTYPES = ("float32", "float64")  # allowed types of arrays
MAX_BYTES = 10**6  # bytes; largest size of a file
KEYS = (
    "format", "words", "licence", "commit", "versions", "recipe", "training_seconds", "environment",
    "environment_hash", "settings_hash", "observation", "league", "arrays_hash",
)  # fmt: skip
STATISTICS, CHECKS = ("statistics.mean", "statistics.var"), ("check.observations", "check.actions")
REQUIRED_KEYS = (("arrays_hash", str), ("fails", list), ("rows", list))  # keys of a certificate and their types
CERTIFICATE_KEYS = (*(name for name, _ in REQUIRED_KEYS), "computer")
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
        metadata = _parse_metadata(_read_bytes(path))
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


def read_certificate(folder: Path) -> dict[str, Any] | None:
    """Return the certificate (robustness report) in the folder of a policy; None if missing, or of different arrays.

    Args:
        folder: folder of the policy.

    Raises:
        ValueError: for a damaged file, and for a file without the keys `arrays_hash` (hash of the network), `fails`
            (names of failed scenarios) and `rows` (metrics of each scenario).
    """
    path = folder / CERTIFICATE
    if not path.is_file():
        return None
    with reading(path, "is no certificate", (ValueError,)):
        result = _parse_json(_read_bytes(path))
        if isinstance(result, dict):
            mapping("certificate", result, CERTIFICATE_KEYS)
        if not isinstance(result, dict) or not all(isinstance(result.get(name), kind) for name, kind in REQUIRED_KEYS):
            raise ValueError(f"give a mapping with {', '.join(name for name, _ in REQUIRED_KEYS)}")
        if not all(isinstance(row, dict) and isinstance(row.get("scenario"), str) for row in result["rows"]):
            raise ValueError("give rows that are mappings with a scenario")
    return result if result["arrays_hash"] == _parse_json(_read_bytes(folder / METADATA)).get("arrays_hash") else None


def describe_policy(name: str) -> str:
    """Return the description of a shipped policy, its results, and the limits that it exceeds in its certificate."""
    metadata, certificate = _parse_json(_read_bytes(FOLDER / name / METADATA)), read_certificate(FOLDER / name)
    text, row = f"{metadata['words']} ", metadata["league"]
    if row:
        text += f"{row['environment']}: {row['settled']:.0%} settle, median {row['settling_time']:.2f} s, "
        text += f"vibration {millimetres(row['vibration'])}. "
    if certificate is None:
        return text + "It has no certificate."
    exceeded = [
        f"{change}{': ' * bool(reasons)}{reasons.partition(', ')[0]}" for change, reasons in exceeded_limits(name)
    ]
    return text + (
        f"Beyond its limits: {'; '.join(exceeded)}." if exceeded else "Within all limits of its certificate."
    )


def exceeded_limits(name: str) -> list[tuple[str, str]]:
    """Return the changes of the environment that exceed limits in the certificate of a shipped policy.

    Args:
        name: name of the policy.

    Returns:
        Changes that are given to the controller, such as "delay=3" or "@mujoco", with the values beyond a limit and the
        limits ("" without them); [] without a certificate.
    """
    certificate = read_certificate(FOLDER / name) or {"fails": [], "rows": []}
    reasons = {row["scenario"]: str(row["fails"]) for row in certificate["rows"][::-1] if row.get("fails")}
    changes = []
    for fail in certificate["fails"]:
        scenario, _, seeds = fail.partition(" on seeds ")
        change = change_name(scenario)
        changes.append((f"{change}, seeds {seeds}" if seeds else change, reasons.get(scenario, "")))
    return changes


def change_name(scenario: str) -> str:
    """Return the change in the name of a scenario, such as "delay=3" or "@mujoco", without "+given"."""
    where, at, plant = scenario.partition("@")
    return at + plant or where.rpartition("/")[2].removesuffix("+given")


def millimetres(length: float) -> str:
    """Return a length, m, in mm with its unit; "below 0.01 mm" for small ones."""
    if length < 1e-5:
        return "below 0.01 mm"
    return f"{1e3 * length:.0f} mm" if length >= 0.1 else f"{1e3 * length:.2g} mm"


def _read_bytes(path: Path) -> bytes:
    return regular_file(path, MAX_BYTES).read_bytes()


def _parse_metadata(content: bytes) -> dict[str, Any]:
    """Return the metadata of a policy after a check of keys, format, and hashes of environment and settings."""
    metadata = _parse_json(content)
    if not isinstance(metadata, dict) or set(metadata) != set(KEYS):
        raise key_error("keys", sorted(metadata) if isinstance(metadata, dict) else metadata, ", ".join(KEYS))
    if metadata["format"] != FORMAT:
        raise value_error("format", metadata["format"], FORMAT)
    for name, data in (("environment", metadata["environment"]), ("settings", metadata["recipe"]["settings"])):
        if _json_hash(data) != metadata[f"{name}_hash"]:
            raise value_error(name, "data with another hash", f"the {name} of the export")
    check_keys(metadata["recipe"]["settings"])
    check_method(metadata["environment"])
    return metadata


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


def _parse_json(text: bytes) -> Any:
    """Return the data of a JSON text.

    Raises:
        ValueError: for a syntax error, a repeated key, NaN and infinity, with a one-line message.
    """
    try:
        return json.loads(text.decode("utf-8"), object_pairs_hook=_unique_keys, parse_constant=_refuse_constant)
    except RecursionError:
        raise ValueError("mappings are nested too deeply") from None


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
