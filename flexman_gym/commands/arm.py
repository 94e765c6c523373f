"""Describe an arm of one's own: its settings, and what cannot work.

FILE is an arm file (.yaml, .json), a file of an environment, a URDF, or the name of an arm of the catalog. With --try,
controllers without training play 20 episodes each, and one of them is recommended.
"""

import argparse
import sys
from contextlib import suppress
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, TextIO

from flexman_gym.commands import CommandLine, add_options, output_file
from flexman_gym.common.errors import value_error
from flexman_gym.common.formatting import WIDTH, json_text

if TYPE_CHECKING:
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.toolbox.league.arm_trial import Trial

HEADS = f"{'controller':<13}{'payload, stiffness':<19}{'settled':>9}{'s':>6}{'CPU s':>7}  {'failures':<14}needs"


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    parser.add_argument(
        "arm", metavar="FILE", help="arm file, environment file, URDF, or name of an arm of the catalog"
    )
    add_options(
        parser, "--env", "--set", "--json", env={"help": "environment in which the arm moves (default: FlexRRR-v0)"}
    )
    parser.add_argument("--try", dest="play", action="store_true", help="play 20 episodes of each controller")
    parser.add_argument(
        "--save", type=output_file, metavar="FILE", help="write the environment, with its gains, as .yaml or .json"
    )


def _run(options: argparse.Namespace) -> int:
    """Print the description, the table of controllers, and the recommended one, or all as JSON; return 0."""
    from flexman_gym.envs.config.arm_description import describe
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.envs.config.named_environments import DEFAULT_ID

    own = Configuration.of_file(options.arm, options.set)
    if own and options.env:
        raise value_error("--env", options.env, f"none: {options.arm} is the file of an environment")
    own = own or Configuration.find(options.env or DEFAULT_ID).changed(options.set, arm=options.arm)
    found = describe(own.arm, own)
    table = sys.stderr if options.json else sys.stdout
    print(found, file=table)
    trials, (chosen, reason) = _play(found.configuration, table) if options.play else ([], (None, ""))
    if options.json:
        facts = {"environment": found.configuration.to_plain(), "facts": found.facts._asdict()}
        choice = {"recommended": chosen and chosen.agent, "reason": reason}
        played = {"trials": [each._asdict() for each in trials], **choice} if options.play else {}
        print(json_text({**facts, "warnings": found.warnings, **played}))
    if options.save:
        _save(found.configuration, chosen, options.save, table)
    return 0


def _play(environment: "Configuration", table: TextIO) -> "tuple[list[Trial], tuple[Trial | None, str]]":
    """Print a row for each controller as it comes; return all results, and the recommended one with the reason."""
    from flexman_gym.toolbox.league.arm_trial import choose, try_agents

    print(f"\n{HEADS}", file=table, flush=True)
    trials = []
    for trial in try_agents(environment):
        trials.append(trial)
        print(_row(trial), file=table, flush=True)
    chosen, reason = choose(trials)
    print(f"\nrecommended: {chosen.agent if chosen else 'none'}: {reason}", file=table)
    return trials, (chosen, reason)


def _row(trial: "Trial") -> str:
    """Return the row of a controller, of at most 100 characters; a longer refusal is continued below."""
    from flexman_gym.agent.base_controllers import BASES

    if trial.refusal:
        head = f"{trial.agent:<13}{trial.knows:<19}"
        return fill(f"refused: {trial.refusal}", WIDTH, initial_indent=head, subsequent_indent=" " * len(head))
    time = "-" if trial.settling_time == float("inf") else f"{trial.settling_time:.3g}"
    causes = ", ".join(f"{count} {name}" for name, count in trial.failures.items()) or "none"
    needs = ", ".join(BASES[trial.agent].information) or "motor encoders"
    settled = f"{trial.settled:.0%} of {trial.episodes}"
    return f"{trial.agent:<13}{trial.knows:<19}{settled:>9}{time:>6}{trial.seconds:>7.1f}  {causes:<13} {needs}"


def _save(environment: "Configuration", chosen: "Trial | None", path: Path, table: TextIO) -> None:
    """Write the environment with its PD gains and, after a trial, the recommended controller as base."""
    if chosen is not None:
        environment = environment.replace(base=chosen.agent)
    with suppress(ValueError):  # the description says why an arm has no gains
        environment = environment.replace(gains=environment.pd_gains)
    environment.save(path)
    print(f"{path}: flexman evaluate {environment.base or 'pd'} --env {path}", file=table)
    print(f"{path}: flexman train ppo_on_pd_minute --arm {path}", file=table)


EXAMPLES = (
    "flexman arm planar_2r --set torque_limit=20  # of the catalog",
    "flexman arm planar_2r --set torque_limit=20 --save own.yaml",
    "flexman arm own.yaml --try  # which controller?",
    "flexman arm own.yaml --json | python3 -m json.tool",
)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)
