"""Certificate file of an exported policy: reading, changes that exceed limits, and description of a policy by it."""

from pathlib import Path
from typing import Any

from flexman_gym.common.checks import mapping
from flexman_gym.common.files import reading
from flexman_gym.common.formatting import millimetres
from flexman_gym.evaluation.policy_files import FOLDER, METADATA, read_json
from flexman_gym.toolbox.league.scenarios import change_name

CERTIFICATE = "certificate.json"
REQUIRED_KEYS = (("arrays_hash", str), ("fails", list), ("rows", list))  # keys of a certificate and their types
CERTIFICATE_KEYS = (*(name for name, _ in REQUIRED_KEYS), "computer", "left_out")


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
        result = read_json(path)
        if isinstance(result, dict):
            mapping("certificate", result, CERTIFICATE_KEYS)
        if not isinstance(result, dict) or not all(isinstance(result.get(name), kind) for name, kind in REQUIRED_KEYS):
            raise ValueError(f"give a mapping with {', '.join(name for name, _ in REQUIRED_KEYS)}")
        if not all(isinstance(row, dict) and isinstance(row.get("scenario"), str) for row in result["rows"]):
            raise ValueError("give rows that are mappings with a scenario")
    return result if result["arrays_hash"] == read_json(folder / METADATA).get("arrays_hash") else None


def describe_policy(name: str) -> str:
    """Return the description of a shipped policy, its results, and the limits that it exceeds in its certificate."""
    metadata, certificate = read_json(FOLDER / name / METADATA), read_certificate(FOLDER / name)
    text, row = f"{metadata['words']} ", metadata["league"]
    if row:
        results = [f"{row['settled']:.0%} settle"]
        if row["settling_time"] is not None:  # infinite, if most episodes do not settle
            results.append(f"median {row['settling_time']:.2f} s")
        if row["vibration"] is not None:
            results.append(f"vibration {millimetres(row['vibration'])}")
        text += f"{row['environment']}: {', '.join(results)}. "
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
