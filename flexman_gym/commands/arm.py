"""Describe an arm of one's own: its settings, and what cannot work.

FILE is an arm file (.yaml, .json), a file of an environment, a URDF, or the name of an arm of the catalog. With --try,
controllers without training play 20 episodes each, and one of them is recommended.
"""

import argparse
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from flexman_gym.commands import CommandLine, add_options, output_file
from flexman_gym.common.errors import value_error

if TYPE_CHECKING:
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.toolbox.league.arm_trial import Trial

HEADS = f"{'controller':<14}{'payload, stiffness':<20}{'settled':>10}{'s':>8}{'CPU s':>8}  {'failures':<20}needs"


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    parser.add_argument(
        "arm", metavar="FILE", help="arm file, environment file, URDF, or name of an arm of the catalog"
    )
    add_options(parser, "--env", "--set", env={"help": "environment in which the arm moves (default: FlexRRR-v0)"})
    parser.add_argument("--try", dest="play", action="store_true", help="play 20 episodes of each controller")
    parser.add_argument(
        "--save", type=output_file, metavar="FILE", help="write the environment, with its gains, as .yaml or .json"
    )


def _run(options: argparse.Namespace) -> int:
    """Print the description, the table of controllers, and the recommended one; return 0."""
    from flexman_gym.envs.config.arm_description import describe
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.envs.config.named_environments import DEFAULT_ID

    own = Configuration.of_file(options.arm, options.set)
    if own and options.env:
        raise value_error("--env", options.env, f"none: {options.arm} is the file of an environment")
    own = own or Configuration.find(options.env or DEFAULT_ID).changed(options.set, arm=options.arm)
    found = describe(own.arm, own)
    print(found)
    chosen = _play(found.configuration) if options.play else None
    if options.save:
        _save(found.configuration, chosen, options.save)
    return 0


def _play(environment: "Configuration") -> "Trial | None":
    """Print a row for each controller as it comes; return the recommended one."""
    from flexman_gym.toolbox.league.arm_trial import choose, try_agents

    print(f"\n{HEADS}", flush=True)
    trials = []
    for trial in try_agents(environment):
        trials.append(trial)
        print(_row(trial), flush=True)
    chosen, reason = choose(trials)
    print(f"\nrecommended: {chosen.agent if chosen else 'none'}: {reason}")
    return chosen


def _row(trial: "Trial") -> str:
    """Return the row of a controller."""
    from flexman_gym.agent.base_controllers import BASES

    if trial.refusal:
        return f"{trial.agent:<14}{trial.knows:<20}refused: {trial.refusal}"
    time = "-" if trial.settling_time == float("inf") else f"{trial.settling_time:.3g}"
    causes = ", ".join(f"{count} {name}" for name, count in trial.failures.items()) or "none"
    needs = ", ".join(BASES[trial.agent].information) or "motor encoders"
    settled = f"{trial.settled:.0%} of {trial.episodes}"
    return f"{trial.agent:<14}{trial.knows:<20}{settled:>10}{time:>8}{trial.seconds:>8.1f}  {causes:<20}{needs}"


def _save(environment: "Configuration", chosen: "Trial | None", path: Path) -> None:
    """Write the environment with its PD gains and, after a trial, the recommended controller as base."""
    if chosen is not None:
        environment = environment.replace(base=chosen.agent)
    with suppress(ValueError):  # the description says why an arm has no gains
        environment = environment.replace(gains=environment.pd_gains)
    environment.save(path)
    print(
        f"{path}: flexman evaluate {environment.base or 'pd'} --env {path}; flexman train ppo_on_pd_minute --arm {path}"
    )


COMMAND = CommandLine(_arguments, _run)
