"""Commands of `flexman`, one file each; the `COMMAND` of a file adds its arguments to a parser and runs it."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from flexman_gym.common.errors import short_path
from flexman_gym.common.files import check_output

if TYPE_CHECKING:
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.evaluation.agent_spec import AgentSpec


class CommandLine(NamedTuple):
    """Command line of one command.

    Attributes:
        arguments: function that adds the arguments to a parser.
        run: function that runs the command with the parsed arguments, and returns the exit status.
    """

    arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]


def add_options(parser: argparse.ArgumentParser, *names: str, **changes: dict[str, Any]) -> None:
    """Add common arguments of commands to a parser.

    Args:
        parser: parser of the command.
        names: "scene", "agent", "--env", "--episodes", "--seed", "--set" or "--trust".
        changes: name of an argument without dashes -> keyword arguments of `add_argument` for this command.
    """
    from flexman_gym.envs.config.configuration import SET_HELP
    from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
    from flexman_gym.evaluation.rollouts import TEST_SEEDS
    from flexman_gym.evaluation.trained_agents import AGENTS

    ids = ", ".join(sorted(NAMED_ENVIRONMENTS))
    environment = f"environment: a file, an id with a condition such as FlexRRR-v0/delay, or {ids}"
    shared: dict[str, dict[str, Any]] = {
        "scene": {"type": Path, "help": "scene, a .json or .yaml file"},
        "agent": {
            "help": f"folder of a run or a policy, a zip of Stable-Baselines3 (with --trust), or {', '.join(AGENTS)}"
        },
        "--env": {"help": f"{environment} (default: that of the agent)"},
        "--episodes": {
            "type": int,
            "metavar": "N",
            "default": len(TEST_SEEDS),
            "help": "number of episodes (default: %(default)s)",
        },
        "--seed": {
            "type": int,
            "default": TEST_SEEDS.start,
            "metavar": "N",
            "help": "seed of the first episode; later episodes have the next seeds (default: %(default)s)",
        },
        "--set": {
            "action": "append",
            "default": [],
            "metavar": "NAME=VALUE",
            "help": SET_HELP,
        },
        "--trust": {"action": "store_true", "help": "load files of Stable-Baselines3; they can run any code"},
    }
    for name in names:
        parser.add_argument(name, **shared[name] | changes.get(name.lstrip("-"), {}))


def numbers(text: str) -> list[float]:
    """Return the numbers of a text "0.1,-0.2"."""
    try:
        return [float(each) for each in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not allowed; give numbers such as 0.1,-0.2") from None


def output_file(text: str) -> Path:
    """Return the path of an output file after checking, before the command begins its work, that it can be written."""
    return _checked_output(text, Path(text))


def output_folder(text: str) -> Path:
    """Return the path of an output folder after checking that a file can be written in it."""
    return _checked_output(text, Path(text) / "file").parent


def _checked_output(text: str, path: Path) -> Path:
    try:
        return check_output(path)
    except OSError as error:
        allowed = f"a path at which a file can be written: {error.strerror}"
        raise argparse.ArgumentTypeError(f"{short_path(text)} is not allowed; give {allowed}") from None


def load_agent(name: str, trust: bool, environment: "Configuration | None" = None) -> "AgentSpec":
    """Return an agent by its name or folder.

    Files of Stable-Baselines3 are read only if trusted, as reading them can run code.

    Args:
        name: name of an agent, folder of a run or a policy, or a zip of Stable-Baselines3.
        trust: True if files of Stable-Baselines3 may be read.
        environment: environment in which the policy of a zip was trained, with the settings of its agent; None for the
            environment of the evaluation.

    Raises:
        FileNotFoundError, ValueError: for a name without an agent, with a one-line message.
    """
    from flexman_gym.evaluation.agents import find_agent

    if trust and name.endswith(".zip"):
        from flexman_agents.sb3 import load_sb3

        return load_sb3(Path(name), environment)
    return find_agent(name)
