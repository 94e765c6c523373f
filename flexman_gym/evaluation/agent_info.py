"""Information on an agent: description, required information, training time, and seeds seen in training."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flexman_gym.common.checks import short_path, value_error
from flexman_gym.common.renamed import RUN_SETTINGS, rename_keys
from flexman_gym.common.run_folder import SETTINGS, read_settings
from flexman_gym.common.time_series import read_csv_rows
from flexman_gym.control.base_controllers import BASES
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.sensors import plain_sensors
from flexman_gym.evaluation.agent import BASELINES, LAWLESS_AGENTS
from flexman_gym.evaluation.policy_files import policy_folder, read_policy
from flexman_gym.evaluation.rollout import SELECTION_SEEDS, training_seed

ORACLE_INFORMATION = ("true state", "true parameters", "its episodes")  # not available for a real arm
TRUE_SENSORS = ("full", "fine", "state")
TIME_COLUMN = "time/time_elapsed"  # the column of Stable-Baselines3


def describe_agent(agent: str) -> tuple[str, str]:
    """Return the description of an agent, and how it was tuned or trained.

    Raises:
        FileNotFoundError, ValueError: one line, for a folder that holds no run.
    """
    if agent in BASES:
        return BASES[agent].description, BASES[agent].tuning
    if agent in LAWLESS_AGENTS:
        return LAWLESS_AGENTS[agent], "none"
    settings, seconds = _settings(agent), training_seconds(agent)
    base = settings.get("base_in_use") or (settings.get("environment") or {}).get("base")
    what = f"a policy that {str(settings.get('algo', 'a recipe')).upper()} has trained"
    trained = "for a time that its curves do not tell" if seconds is None else f"for {seconds / 60.0:.3g} minutes"
    return what + (f", beside the base {base if isinstance(base, str) else base['kind']}" if base else ""), trained


def required_information(agent: str) -> tuple[str, ...]:
    """Return the information that an agent needs beside the measurements of its motors.

    Raises:
        FileNotFoundError, ValueError: one line, for a folder that holds no run.
    """
    if agent in BASELINES:
        return BASES[agent].information if agent in BASES else ()
    settings = _settings(agent)
    setup = Configuration.from_plain(settings.get("environment"))
    kinds = {each["kind"] if isinstance(each, dict) else each for each in plain_sensors(setup.sensors)}
    beside = settings.get("base_in_use") or setup.base  # a base in use takes the place of the one it learned with
    base = beside.get("kind") if isinstance(beside, dict) else beside
    known = ["training", *(["true state"] if kinds & set(TRUE_SENSORS) else [])]
    return tuple(dict.fromkeys([*known, *(BASES[base].information if isinstance(base, str) else ())]))


def is_realisable(agent: str) -> bool:
    """Return whether an agent could act on a real arm: it needs no ORACLE_INFORMATION."""
    return not set(required_information(agent)) & set(ORACLE_INFORMATION)


def training_seconds(agent: str) -> float | None:
    """Return the training time (s) of a policy or of the curves of a run, None without curves."""
    if folder := policy_folder(agent):
        return float(read_policy(folder).about["training_seconds"])
    result = None
    for path in () if agent in BASELINES else sorted(Path(agent).glob("progress*.csv")):
        names, *rows = [*read_csv_rows(path)] or [[]]
        at = names.index(TIME_COLUMN) if TIME_COLUMN in names else len(names)
        try:
            times = [float(row[at]) for row in rows if row[at:] and row[at]]
        except ValueError:
            raise ValueError(f"{short_path(path)}: {TIME_COLUMN} is not a number in each row") from None
        result = (result or 0.0) + max(times, default=0.0)
    return result


def check_seeds_unseen(agent: str, seeds: Sequence[int]) -> None:
    """Check that a run was not trained or selected on the episodes of some seeds, according to its settings.

    Raises:
        FileNotFoundError, ValueError: one line.
    """
    if agent in BASELINES:
        return
    settings = _settings(agent)
    try:
        first, arms = training_seed(int(settings["seed"])), int(settings["envs"])
        chosen = bool(settings["eval_every"])
    except (KeyError, TypeError, ValueError):
        raise value_error("entrant", agent, f"a run whose {SETTINGS} say seed, envs and eval_every") from None
    seen = {*range(first, first + arms), *(SELECTION_SEEDS if chosen else ())} & set(seeds)
    if seen:
        allowed = f"a policy that was neither trained nor chosen on the seed {min(seen)}, which is one of the test"
        raise value_error("entrant", agent, allowed)


def _settings(agent: str) -> dict[str, Any]:
    if folder := policy_folder(agent):
        about = read_policy(folder).about
        settings = rename_keys(about["recipe"]["settings"], RUN_SETTINGS, warn=False)
        return {**settings, "environment": about["environment"]}
    return read_settings(Path(agent))
