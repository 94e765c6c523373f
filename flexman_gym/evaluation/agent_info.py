"""Information on an agent: description, required information, training time, and the seeds used for training."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexman_gym.agent.base_controllers import BASES
from flexman_gym.common.errors import short_path, value_error
from flexman_gym.common.run_folder import SETTINGS, read_settings
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.sensors import plain_sensors
from flexman_gym.evaluation.agent_spec import SIMPLE_AGENTS
from flexman_gym.evaluation.agents import is_baseline
from flexman_gym.evaluation.policy_files import policy_folder, read_policy
from flexman_gym.evaluation.rollouts import SELECTION_SEEDS, training_seed
from flexman_gym.evaluation.trained_agents import training_folder

# information not available on hardware; "its episodes": start, goal and parameters of the episodes before they begin
ORACLE_INFORMATION = ("true state", "true parameters", "its episodes")
INFORMATION = {  # information that is given -> entries of `information` of an agent, of which one is enough
    "true state and parameters": ("true parameters", "its episodes"),
    "true state": ("true state",),
    "model, ranges of the parameters": ("structure of the model",),
    "nominal model or data sheets": ("model", "data sheets"),
    "measurements only": (),
}
NO_TUNING = "none"  # tuning of an agent without a controller
TRUE_SENSORS = ("full", "fine", "state")  # sensors that read the true state
# columns of the training time, s, in learning curves: CPU time, and elapsed time for runs of earlier versions
CPU_COLUMN, TIME_COLUMN = "time/cpu_seconds", "time/time_elapsed"


@dataclass(frozen=True)
class _AgentInfo:
    """Description of an agent.

    Attributes:
        description: kind of the agent, such as the algorithm of its training.
        tuning: method and duration of the tuning or training.
        information: required information in addition to motor angles and rates.
    """

    description: str
    tuning: str
    information: tuple[str, ...]

    @property
    def realisable(self) -> bool:
        """True if the agent uses measurable signals only, without ORACLE_INFORMATION, and so could act on hardware."""
        return not set(self.information) & set(ORACLE_INFORMATION)

    @property
    def needs(self) -> str:
        """Required information as text."""
        return ", ".join(self.information) or ("nothing" if self.tuning == NO_TUNING else "its motors")

    @property
    def kind(self) -> str:
        """Kind of the required information, a key of INFORMATION."""
        return information_kind(self.information)


def describe_agent(agent: str) -> _AgentInfo:
    """Return the description of an agent given by its name or its folder.

    Args:
        agent: name of an agent, or folder of a training run or a policy.

    Raises:
        FileNotFoundError: for a folder without a training run or policy.
    """
    if agent in BASES:
        return _AgentInfo(BASES[agent].description, BASES[agent].tuning, BASES[agent].information)
    if agent in SIMPLE_AGENTS:
        return _AgentInfo(SIMPLE_AGENTS[agent], NO_TUNING, ())
    settings, seconds = _settings(agent), training_seconds(agent)
    environment = Configuration.from_plain(settings.get("environment"))
    base = settings.get("base_in_use") or environment.base  # a base in use replaces the base of the training
    kind = base.get("kind") if isinstance(base, dict) else base
    described = f"a policy trained by {str(settings.get('algo', 'a recipe')).upper()}"
    described += f", with the base controller {kind}" if kind else ""
    trained = "for a time missing in its curves" if seconds is None else f"for {seconds / 60.0:.3g} minutes of CPU time"
    return _AgentInfo(described, trained, policy_information(environment, base))


def policy_information(environment: Configuration, base: object = None) -> tuple[str, ...]:
    """Return the information that a policy needs, from its sensors and its base controller.

    Args:
        environment: environment of the training.
        base: base controller in place of that of the environment; None to keep it.
    """
    base = base or environment.base
    kind = base.get("kind") if isinstance(base, dict) else base
    sensors = {each["kind"] if isinstance(each, dict) else each for each in plain_sensors(environment.sensors)}
    needed = ["training", *(["true state"] if sensors & set(TRUE_SENSORS) else [])]
    of_base = BASES[kind].information if isinstance(kind, str) else ()
    return tuple(dict.fromkeys([*needed, *of_base]))


def information_kind(needed: Iterable[str]) -> str:
    """Return the key of INFORMATION for the information that an agent needs."""
    found = set(needed)
    return next(name for name, entries in INFORMATION.items() if found & set(entries) or not entries)


def training_seconds(agent: str) -> float | None:
    """Return the CPU time of the training, s, of a policy or a run; None for a run without learning curves."""
    if folder := policy_folder(agent):
        return float(read_policy(folder).metadata["training_seconds"])
    from flexman_gym.common.tables import read_csv_rows

    result = None
    for path in () if is_baseline(agent) else sorted(Path(agent).glob("progress*.csv")):
        names, *rows = [*read_csv_rows(path)] or [[]]
        head = CPU_COLUMN if CPU_COLUMN in names else TIME_COLUMN
        column = names.index(head) if head in names else len(names)
        try:
            times = [float(row[column]) for row in rows if row[column:] and row[column]]
        except ValueError:
            raise ValueError(f"{short_path(path)}: {head} is not a number in each row") from None
        result = (result or 0.0) + max(times, default=0.0)
    return result


def check_seeds_unseen(agent: str, seeds: Sequence[int]) -> None:
    """Raise ValueError if the training or selection of a policy used one of the given seeds, by its stored settings."""
    if is_baseline(agent):
        return
    settings = _settings(agent)
    try:
        first, arms = training_seed(int(settings["seed"])), int(settings["envs"])
        selected = bool(settings["eval_every"])
    except (KeyError, TypeError, ValueError):
        raise value_error("agent", agent, f"a run whose {SETTINGS} have seed, envs and eval_every") from None
    used = {*range(first, first + arms), *(SELECTION_SEEDS if selected else ())} & set(seeds)
    if used:
        allowed = f"a policy neither trained nor selected on the seed {min(used)}, a test seed"
        raise value_error("agent", agent, allowed)


def _settings(agent: str) -> dict[str, Any]:
    if folder := policy_folder(agent):
        metadata = read_policy(folder).metadata
        return {**metadata["recipe"]["settings"], "environment": metadata["environment"]}
    return read_settings(training_folder(agent))
