"""Information on an agent: description, required information, training time, and seeds seen in training."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flexman_gym.common.checks import short_path, value_error
from flexman_gym.common.run_folder import SETTINGS, read_settings
from flexman_gym.common.time_series import read_csv_lines
from flexman_gym.control.base_controllers import BASES
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.sensors import plain_sensors
from flexman_gym.evaluation.agent import BASELINES
from flexman_gym.evaluation.policy_files import policy_folder, read_policy
from flexman_gym.evaluation.rollout import SELECTION_SEEDS, training_seed

ORACLE_INFORMATION = ("true state", "true parameters", "its episodes")  # what nobody can be told of a real arm
TRUE_SENSORS = ("full", "fine", "state")
TIME_COLUMN = "time/time_elapsed"  # the column of Stable-Baselines3
PLAIN = "none: usual weights for every arm"
DESCRIPTIONS = {  # what baselines are, and how they are tuned
    "zero": ("no torque at all", "none"),
    "random": ("random torques", "none"),
    "pd": ("a PD of the motors, with gains for each arm, task and delay",
           "by `flexman tune`, about half a minute of computing time an environment, on the seeds 0 to 7"),
    "pd-shaped": ("the PD behind an input shaper (ZVD) for the lowest mode of the nominal arm", "that of the PD"),
    "lqr": ("a linear-quadratic regulator about the goal", PLAIN),
    "lqr-tracking": ("a linear-quadratic regulator that tracks a smooth slew, or a path", PLAIN),
    "lqg": ("a Kalman filter of the nominal arm, which reads what a laboratory measures, and `lqr-tracking`", PLAIN),
    "mpc": ("model predictive control within the torque limits", PLAIN),
    "adaptive-lqr": ("eleven simulated arms beside the real one, fitted to what a laboratory measures, and "
                     "`lqr-tracking` for the arm that they find; the PD where they explain nothing", PLAIN),
    "privileged-lqr": ("`lqr-tracking` that is told true state and true parameters: the yardstick", PLAIN),
    "optimised": ("the quickest slew that a search has found for each episode, replayed",
                  "by `flexman optimise` on the episodes of the test themselves: a bound, no competitor"),
}  # fmt: skip


def describe_agent(entrant: str) -> tuple[str, str]:
    """Says what an entrant is, and how it was tuned or trained.

    Raises:
        FileNotFoundError, ValueError: one line, for a folder that holds no run, and for a baseline without words.
    """
    if entrant in BASELINES:
        if entrant not in DESCRIPTIONS:
            raise value_error("entrant", entrant, f"one that ABOUT describes: {', '.join(DESCRIPTIONS)}")
        return DESCRIPTIONS[entrant]
    settings, seconds = _settings(entrant), training_seconds(entrant)
    base = settings.get("base_in_use") or (settings.get("environment") or {}).get("base")
    what = f"a policy that {str(settings.get('algo', 'a recipe')).upper()} has trained"
    trained = "for a time that its curves do not tell" if seconds is None else f"for {seconds / 60.0:.3g} minutes"
    return what + (f", beside the base {base if isinstance(base, str) else base['kind']}" if base else ""), trained


def required_information(entrant: str) -> tuple[str, ...]:
    """Says what an entrant needs to know, beside what its motors measure.

    Raises:
        FileNotFoundError, ValueError: one line, for a folder that holds no run.
    """
    if entrant in BASELINES:
        return BASES[entrant].knows if entrant in BASES else ()
    settings = _settings(entrant)
    setup = Configuration.from_plain(settings.get("environment"))
    kinds = {each["kind"] if isinstance(each, dict) else each for each in plain_sensors(setup.sensors)}
    beside = settings.get("base_in_use") or setup.base  # a base in use takes the place of the one it learned with
    base = beside.get("kind") if isinstance(beside, dict) else beside
    known = ["training", *(["true state"] if kinds & set(TRUE_SENSORS) else [])]
    return tuple(dict.fromkeys([*known, *(BASES[base].knows if isinstance(base, str) else ())]))


def is_realisable(entrant: str) -> bool:
    """Says whether an entrant could act on a real arm: nobody tells it the truth."""
    return not set(required_information(entrant)) & set(ORACLE_INFORMATION)


def training_seconds(entrant: str) -> float | None:
    """Gives the time (s) that a run has taken as its curves tell, None where there are none."""
    if folder := policy_folder(entrant):
        return float(read_policy(folder).about["training_seconds"])
    result = None
    for path in () if entrant in BASELINES else sorted(Path(entrant).glob("progress*.csv")):
        names, *rows = [*read_csv_lines(path)] or [[]]
        at = names.index(TIME_COLUMN) if TIME_COLUMN in names else len(names)
        try:
            times = [float(row[at]) for row in rows if row[at:] and row[at]]
        except ValueError:
            raise ValueError(f"{short_path(path)}: {TIME_COLUMN} is not a number in each row") from None
        result = (result or 0.0) + max(times, default=0.0)
    return result


def check_unseen(entrant: str, seeds: Sequence[int]) -> None:
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
        raise value_error("entrant", entrant, f"a run whose {SETTINGS} say seed, envs and judge_every") from None
    seen = {*range(first, first + arms), *(SELECTION_SEEDS if chosen else ())} & set(seeds)
    if seen:
        allowed = f"a policy that was neither trained nor chosen on the seed {min(seen)}, which is one of the test"
        raise value_error("entrant", entrant, allowed)


def _settings(entrant: str) -> dict[str, Any]:
    if folder := policy_folder(entrant):
        about = read_policy(folder).about
        return {**about["recipe"]["settings"], "environment": about["environment"]}
    return read_settings(Path(entrant))
