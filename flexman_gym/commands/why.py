"""Diagnose why the tip does not settle, and suggest a remedy.

The causes are ringing, limit cycle, offset, transient, noise and failure; each with its share of the tip error after
arrival.
"""

import argparse
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from flexman_gym.commands import CommandLine, add_options, load_agent, name_unused

if TYPE_CHECKING:
    from flexman_gym.toolbox.diagnosis.diagnosis import Diagnosis

DEFAULT_EPISODES = 20


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    names = "agent", "--episodes", "--seed", "--env", "--set", "--trust"
    agent = {
        "nargs": "+",
        "help": "name or folder of an agent, or file of a saved episode, such as a log of flexman drive",
    }
    add_options(parser, *names, agent=agent, episodes={"default": DEFAULT_EPISODES})


def _run(options: argparse.Namespace) -> int:
    """Print the share of each cause and the remedy for the largest one, for each agent and log; return 0."""
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.evaluation.agents import common_environment
    from flexman_gym.simulation.episode import Episode
    from flexman_gym.toolbox.diagnosis.diagnosis import REMEDIES, TRAINING_REMEDIES, diagnose, diagnose_log

    if options.episodes < 1:
        options.parser.error(f"--episodes: {options.episodes} is not allowed; give a whole number > 0")
    for name in (logs := [each for each in options.agent if each.endswith(".npz")]):
        print("\n".join(_diagnosis_lines(name, [diagnose_log(Episode.load(name))], REMEDIES)))
    agents = {name: load_agent(name, options.trust) for name in options.agent if name not in logs}
    if not agents:
        return 0
    named = Configuration.find(options.env) if options.env else None
    environment = common_environment(list(agents.values()), named, options.set)
    name_unused(options.env, named, environment, agents.values())
    seeds = range(options.seed, options.seed + options.episodes)
    for name, each in agents.items():
        remedies = REMEDIES if each.law is None else TRAINING_REMEDIES
        title = f"{name} on {options.env or environment.id}"
        print("\n".join(_diagnosis_lines(title, diagnose(each, environment, seeds), remedies)))
    return 0


def _diagnosis_lines(title: str, results: "Sequence[Diagnosis]", remedies: Mapping[str, str]) -> list[str]:
    """Return the report on the diagnoses of some episodes, as lines."""
    import numpy as np

    failures = Counter(each.failure for each in results if each.failure)
    rms = 1e3 * np.array([each.rms for each in results if not each.failure] or [np.nan])
    shares = {cause: float(np.mean([each.shares[cause] for each in results])) for cause in remedies}
    largest = Counter(each.cause for each in results)
    error = f"RMS error after arrival {np.median(rms):.3g} mm (to {rms.max():.3g})"
    failed = f"{failures.total()} failed ({', '.join(failures)})"
    about = [failed] * bool(failures) + [error] * (failures.total() < len(results))
    lines = [f"{title}: {len(results)} episodes, {', '.join(about)}"]
    for cause, share in sorted(shares.items(), key=lambda entry: -entry[1]):
        lines.append(
            f"  {cause:<12}{share:>6.1%}, the largest share of {largest[cause]} "
            f"episodes{_dominant_tone(results, cause)}"
        )
    worst = max(shares, key=lambda cause: shares[cause])
    remedy = "none needed, the error is small" if all(each.negligible for each in results) else remedies[worst]
    return [*lines, f"  remedy: {remedy}"]


def _dominant_tone(results: "Sequence[Diagnosis]", cause: str) -> str:
    """Return the mode with the largest share of a cause and the median frequency of its tones; "" without tones."""
    import numpy as np

    from flexman_gym.toolbox.diagnosis.diagnosis import OFFSET, TRANSIENT

    tones = [tone for each in results for tone in each.tones if tone[2] == cause]
    weights: Counter[str] = Counter()
    for _, share, _, name in tones:
        weights[name] += share  # type: ignore[assignment]
    if not tones or cause in (OFFSET, TRANSIENT):
        return ""
    name = max(weights, key=lambda each: weights[each])
    middle = float(np.median([frequency for frequency, _, _, each in tones if each == name]))
    return f": {name}{', ' if name else ''}at {middle:.3g} Hz"


EXAMPLES = ("flexman why pd lqr --env FlexOne-v0 --episodes 5",)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)
