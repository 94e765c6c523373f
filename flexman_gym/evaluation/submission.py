"""Submission: what an entrant needs to know, and what the folder of a run tells of how it was trained."""

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flexman_gym.checks import refusal
from flexman_gym.control.bases import BASES
from flexman_gym.envs.description import Description
from flexman_gym.envs.sensors import plain_sensors
from flexman_gym.evaluation.entrants import BASELINES
from flexman_gym.evaluation.folder import SETTINGS, existing
from flexman_gym.evaluation.seeds import SELECTION, training_seed

TRUTHS = ("true state", "true parameters", "its episodes")  # what nobody can be told of a real arm
TRUE_SENSORS = ("full", "fine", "state")
SECONDS = "time/time_elapsed"  # the column of Stable-Baselines3


def needs(entrant: str) -> tuple[str, ...]:
    """Says what an entrant needs to know, beside what its motors measure.

    Raises:
        FileNotFoundError, ValueError: one line, for a folder that holds no run.
    """
    if entrant in BASELINES:
        return BASES[entrant].knows if entrant in BASES else ()
    sensors = plain_sensors(Description.from_dict(_settings(entrant).get("environment")).setup().sensors)
    kinds = {each["kind"] if isinstance(each, dict) else each for each in sensors}
    return ("training", "true state") if kinds & set(TRUE_SENSORS) else ("training",)


def is_buildable(entrant: str) -> bool:
    """Says whether an entrant could act on a real arm: nobody tells it the truth."""
    return not set(needs(entrant)) & set(TRUTHS)


def training_seconds(entrant: str) -> float | None:
    """Gives the time (s) that a run has taken as its curves tell, None where there are none."""
    result = None
    for path in () if entrant in BASELINES else sorted(Path(entrant).glob("progress*.csv")):
        with path.open(newline="", encoding="utf-8") as file:
            times = [float(row[SECONDS]) for row in csv.DictReader(file) if row.get(SECONDS)]
        result = (result or 0.0) + max(times, default=0.0)
    return result


def check_seeds(entrant: str, seeds: Sequence[int]) -> None:
    """Refuses a run that has seen the episodes of some seeds, as far as its settings tell.

    Raises:
        FileNotFoundError, ValueError: one line.
    """
    if entrant in BASELINES:
        return
    settings = _settings(entrant)
    try:
        first, arms = training_seed(int(settings["seed"])), int(settings["envs"])
        chosen = bool(settings["judge_every"])
    except (KeyError, TypeError, ValueError):
        raise refusal("entrant", entrant, f"a run whose {SETTINGS} say seed, envs and judge_every") from None
    seen = {*range(first, first + arms), *(SELECTION if chosen else ())} & set(seeds)
    if seen:
        allowed = f"a policy that was neither trained nor chosen on the seed {min(seen)}, which is one of the test"
        raise refusal("entrant", entrant, allowed)


def _settings(entrant: str) -> dict[str, Any]:
    result = json.loads(existing(Path(entrant) / SETTINGS).read_text(encoding="utf-8"))
    return result if isinstance(result, dict) else {}
