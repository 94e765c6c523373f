"""Write files with keys of earlier versions in the present form: python scripts/convert.py runs/first own.yaml"""

import argparse
import hashlib
import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from flexman_gym.common.files import read_data, write_data, write_file
from flexman_gym.common.run_folder import BEST, NEWEST, SETTINGS, read_npz, write_npz
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.envs.vector_env import FlexManVectorEnv
from flexman_gym.evaluation.policy_files import METADATA
from flexman_gym.simulation.physical_parameters import UNCERTAIN
from flexman_gym.toolbox.league.certificate_file import CERTIFICATE
from flexman_gym.toolbox.league.rows import CELLS, ROWS

FILES = (SETTINGS, NEWEST, BEST, METADATA, CERTIFICATE, ROWS, CELLS)  # files of a folder that are converted
# Old key or name -> present one, by the place where it is stored.
ENVIRONMENT_KEYS = {"hold": "action_repeat", "tell": "info_keys"}
BASE_KEYS = {"law": "timing", "timing_law": "timing"}
TIMINGS = {"minimum-jerk": "quintic"}
PARAMETER_KEYS = {"link_stiffness": "link_stiffness_factor"}
RANGE_KEYS = {name: key for key, name in UNCERTAIN.items() if key != name} | PARAMETER_KEYS
METHODS = {f"{name}_sweeps": name for name in ("gauss_2", "gauss_3", "midpoint_2", "midpoint_3")}
SETTINGS_KEYS = {"judge_every": "eval_every", "rounds_kept": "iterations_kept", "value_first": "value_warmup"}
CERTIFICATE_KEYS = {"trials": "rows", "name": "scenario", "machine": "computer"}
COLUMNS = {"entrant": "agent", "venue": "scenario", "room": "part"}  # heads of CSV files
RUN_KEYS = {"judge": "evaluation"}  # of the state of a training run
STATE_FIELDS = {
    "_ages": "ages", "viscous_friction": "rotor_damping",
    "_apart": "_perturbations_reduced", "_following": "_paths", "_given_up": "_fallback_active", "_known": "_latest",
    "_looked": "_updated", "_own_coordinates": "_adapted_coordinates", "_own_torques": "_adapted_torques",
    "_pushed": "_filtering", "_residuals": "_detector", "_soft": "_compliance", "_tight": "_holding",
    "ahead": "clock_offset", "begun": "start_time", "lasting": "duration", "numbers": "theta", "pace": "time_scaling",
    "plan": "episode_parameters",
    "quickening": "pace_rate", "shape": "shaping", "wanted": "action", "way": "displacement",
}  # fmt: skip
ADDED_SETTINGS = {"base_in_use": None, "value_warmup": 0}  # settings that were added, with their effect before
REMOVED_SETTINGS = ("engine",)  # settings of runs of RLlib
ADDED_CONSTANTS = frozenset(  # constants of an arm that were added; a state without them has those of its environment
    ("coulomb_rate", "knee_share", "knee_twist", "ripple_torque", "static_excess", "stribeck_rate")
)
TRACKING_BASES = ("lqr-tracking", "lqg", "adaptive-lqr", "privileged-lqr")  # base controllers that track slews
FORMER_TIMING = "quintic"  # timing of these base controllers in run folders and policies that name none
FORMER_METHOD = "midpoint_3"  # method of environments in run folders and policies that name none


def present_text(text: str) -> str:
    """Replace old names of integration methods in a text, such as the name of a scenario."""
    return re.sub(rf"\b({'|'.join(METHODS)})\b", lambda match: METHODS[match[0]], text)


def rename(data: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """Return a mapping with present keys; raise ValueError for a value under both keys."""
    for old in names.keys() & data.keys():
        if names[old] in data:
            raise ValueError(f"{old}: the mapping also has {names[old]}; delete one of them")
    return {names.get(key, key): value for key, value in data.items()}


def present_base(data: Any, stored: bool = False) -> Any:
    """Return a base controller with present keys of its arguments and of its uncertain parameters.

    Args:
        data: name or mapping.
        stored: True for a base in a run folder or a policy, which without a timing had FORMER_TIMING.
    """
    if stored and data in TRACKING_BASES:
        data = {"kind": data}
    if not isinstance(data, dict):
        return data
    result = rename(data, BASE_KEYS)
    if "timing" in result:
        result["timing"] = TIMINGS.get(result["timing"], result["timing"])
    elif stored and result.get("kind") in TRACKING_BASES:
        result["timing"] = FORMER_TIMING
    if isinstance(result.get("unknown"), dict):
        result["unknown"] = rename(result["unknown"], RANGE_KEYS)
    return result


def present_environment(data: Any, stored: bool = False) -> Any:
    """Return the mapping of an environment with present keys.

    Args:
        data: the mapping.
        stored: True for an environment in a run folder or a policy, which without a method had FORMER_METHOD and
            whose base without a timing had FORMER_TIMING; a file of the user without them has the defaults. With
            fidelity="auto" the method is chosen.
    """
    if not isinstance(data, dict):
        return data
    result = rename(data, ENVIRONMENT_KEYS)
    if "base" in result:
        result["base"] = present_base(result["base"], stored)
    if stored and result.get("fidelity", "default") == "default":
        result.setdefault("method", FORMER_METHOD)
    if isinstance(result.get("method"), str):
        result["method"] = present_text(result["method"])
    return result


def present_settings(data: Mapping[str, Any], stored: bool = False) -> dict[str, Any]:
    """Return the settings of a training with present keys; `stored` as in `present_environment`."""
    added = ADDED_SETTINGS if stored else {}
    result = {**rename(data, SETTINGS_KEYS)}
    result = {key: value for key, value in result.items() if key not in REMOVED_SETTINGS}
    result |= {key: value for key, value in added.items() if key not in result}
    if isinstance(result.get("hyperparameters"), dict):
        result["hyperparameters"] = rename(result["hyperparameters"], SETTINGS_KEYS)
        if "teacher" in result["hyperparameters"]:
            result["hyperparameters"]["teacher"] = present_base(result["hyperparameters"]["teacher"], stored)
    if "environment" in result:
        result["environment"] = present_environment(result["environment"], stored)
    if "base_in_use" in result:
        result["base_in_use"] = present_base(result["base_in_use"], stored)
    return result


def json_hash(data: object) -> str:
    """Return the SHA-256 of JSON-compatible data, as in the metadata of a policy."""
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()


def present_policy(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the metadata of an exported policy with present keys and new hashes, after a check of the old hashes."""
    before = {"environment_hash": data["environment"], "settings_hash": data["recipe"]["settings"]}
    for key, value in before.items():
        if data[key] != json_hash(value):
            raise ValueError(f"{key}: the file was changed after its export")
    environment = present_environment(data["environment"], stored=True)
    settings = present_settings(data["recipe"]["settings"], stored=True)
    return {
        **data,
        "recipe": {**data["recipe"], "settings": settings},
        "environment": environment,
        "environment_hash": json_hash(environment),
        "settings_hash": json_hash(settings),
    }


def present_certificate(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return a certificate with present keys and names of methods."""
    result = rename(data, CERTIFICATE_KEYS)
    rows = [rename(row, CERTIFICATE_KEYS) for row in result["rows"]]
    result["rows"] = [{**row, "scenario": present_text(row["scenario"])} for row in rows]
    result["fails"] = [present_text(each) for each in result["fails"]]
    return result


def present_state(data: Mapping[str, Any], environment: Configuration) -> dict[str, Any]:
    """Return the state of an environment with present fields; constants that it lacks are those of the environment."""
    if "single_action_space" in data:
        env: FlexManEnv | FlexManVectorEnv = FlexManVectorEnv(len(data["_randoms"]), **environment.keywords())
    else:
        env = FlexManEnv(**environment.keywords())
    env.reset(seed=0)
    present = env.get_state()
    if "acting" in data:  # the history and the observations were stored with the measurements
        episodes, rest = dict(data["episodes"]), {name: each for name, each in data.items() if name != "acting"}
        sight = dict(episodes.pop("sight"))
        agent = {
            "_history": sight.pop("_history"),
            "observations": sight.pop("seen"),
            "_ages": episodes.get("_ages", episodes.get("ages")),
        }
        agent["command"] = 0.0 * present["agent"]["command"]
        data = rest | {"episodes": episodes | {"measurements": sight}, "agent": data["acting"] | agent}
    result: dict[str, Any] = _matched(data, present)
    return result


def _matched(data: Any, present: Any) -> Any:
    """Return a state with the names of fields, and the added constants, of a present state."""
    if isinstance(data, dict) and isinstance(present, dict) and "bit_generator" not in data:
        names = {name: name if name in present else STATE_FIELDS.get(name, name) for name in data}
        names |= {old: new for old, new in PARAMETER_KEYS.items() if old in data and new in present}
        added = {name: each for name, each in present.items() if name in ADDED_CONSTANTS}
        return added | {names[name]: _matched(each, present.get(names[name])) for name, each in data.items()}
    if isinstance(data, list) and isinstance(present, list) and len(data) == len(present):
        return [_matched(*both) for both in zip(data, present, strict=True)]
    return data


def present_run(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arrays of a training run with present keys of its settings and of the state of its environment."""
    result = rename(data, RUN_KEYS)
    result["settings"] = present_settings(result["settings"], stored=True)
    if isinstance(result.get("training"), dict):
        environment = Configuration.from_plain(result["settings"]["environment"])
        state = present_state(result["training"]["environment"], environment)
        result["training"] = {**result["training"], "environment": state}
    return result


def present_tree(data: Mapping[str, Any], stored: bool) -> dict[str, Any]:
    """Return the content of a JSON or YAML file, whose kind follows from its keys, with present keys."""
    if {"recipe", "environment_hash"} <= data.keys():
        return present_policy(data)
    if "fails" in data and "arrays_hash" in data:
        return present_certificate(data)
    if {"algo", "environment", "hyperparameters", *SETTINGS_KEYS} & data.keys():
        return present_settings(data, stored)
    result: dict[str, Any] = present_environment(data)
    return result


def present_csv(text: str) -> str:
    """Return the text of a CSV file with present heads and names of methods; all other characters stay."""
    lines = text.splitlines(keepends=True)
    head = next((i for i, line in enumerate(lines) if not line.startswith("#")), 0)
    for old, new in COLUMNS.items() if lines else ():
        lines[head] = re.sub(rf"(?<![^,]){old}(?![^,\r\n])", new, lines[head])
    return present_text("".join(lines))


def convert(path: Path, environment: str = "") -> bool:
    """Write a file in its present form; return True if it changed.

    Args:
        path: a .csv, .npz, .json, .yaml or .yml file. Comments of a YAML file that changes are lost.
        environment: id or file of the environment of a state from `get_state`.
    """
    if path.suffix == ".csv":
        text = path.read_bytes().decode()
        present = present_csv(text)
        if present != text:
            write_file(path, present)
        return present != text
    if path.suffix == ".npz":
        data = read_npz(path)
        if "settings" not in data and not environment:
            raise ValueError("give --env, the environment of this state")
        new = present_run(data) if "settings" in data else present_state(data, Configuration.find(environment))
        changed = _outline(new) != _outline(data)
        if changed:
            write_npz(path, new)
        return changed
    tree = json.loads(path.read_bytes()) if path.suffix == ".json" else read_data(path)
    new = present_tree(tree, path.name == SETTINGS)
    if new != tree:
        write_data(path, new)
    return bool(new != tree)


def _outline(data: Any) -> Any:
    """Return nested data with a placeholder for each array, for a comparison of keys and names."""
    if isinstance(data, dict):
        return {key: _outline(value) for key, value in data.items()}
    if isinstance(data, list):
        return [_outline(value) for value in data]
    return None if hasattr(data, "shape") else data


def main() -> int:
    """Convert the files of the arguments; return 1 if one of them cannot be converted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "paths", nargs="+", type=Path, metavar="PATH",
        help="folder of a training run, a policy or a league, or a .csv, .npz, .json or .yaml file",
    )  # fmt: skip
    parser.add_argument("--env", default="", help="id or file of the environment of a state from get_state")
    options, status = parser.parse_args(), 0
    for path in options.paths:
        for file in [path / name for name in FILES if (path / name).is_file()] if path.is_dir() else [path]:
            try:
                print(f"{file}: {'converted' if convert(file, options.env) else 'unchanged'}")
            except (ValueError, KeyError, TypeError, OSError) as error:
                print(f"{file}: {type(error).__name__}: {error}", file=sys.stderr)
                status = 1
    return status


if __name__ == "__main__":
    sys.exit(main())
