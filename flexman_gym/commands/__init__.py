"""Commands of `flexman`, one file each; the `COMMAND` of a file adds its arguments to a parser and runs it."""

import argparse
import os
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from flexman_gym.common.errors import short_path
from flexman_gym.common.files import check_output

if TYPE_CHECKING:
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.evaluation.agent_spec import AgentSpec
    from flexman_gym.scene.scene import Scene

EXAMPLES = "EXAMPLES"  # heading in a help
SCENES = {"paper_rr": "rr", "paper_fr": "fr", "paper_ff": "ff"}  # name of a scene -> case of `catalog.paper_scene`


class CommandLine(NamedTuple):
    """Command line of one command.

    Attributes:
        arguments: function that adds the arguments to a parser.
        run: function that runs the command with the parsed arguments, and returns the exit status.
        examples: lines for the help of `flexman COMMAND`. They run in an empty folder, in their order.
    """

    arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]
    examples: tuple[str, ...] = ()


class CommandHelp(argparse.RawDescriptionHelpFormatter):
    """Formatter of the help of a command: a usage without the options, a filled description, and its examples."""

    def add_usage(
        self, usage: str | None, actions: Iterable[argparse.Action], groups: Any, prefix: str | None = None
    ) -> None:
        """Add the usage with the required arguments and those without a name; "[options]" stands for the others."""
        shown = [each for each in actions if each.required or not each.option_strings]
        super().add_usage(usage, [*shown, argparse.Action([], "[options]")], [], prefix)

    def _format_args(self, action: argparse.Action, default_metavar: str) -> str:
        many = action.nargs == argparse.ONE_OR_MORE
        return f"{action.metavar or default_metavar} ..." if many else super()._format_args(action, default_metavar)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if text.startswith(EXAMPLES):
            return text.replace(EXAMPLES, bold(EXAMPLES), 1)
        return argparse.HelpFormatter._fill_text(self, text, width, indent)


def bold(text: str) -> str:
    """Return a text in bold if standard output is a terminal, unless NO_COLOR (no-color.org) forbids it."""
    plain = not sys.stdout.isatty() or os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
    return text if plain else f"\033[1m{text}\033[0m"


def examples_text(examples: Iterable[str]) -> str:
    """Return the end of a help with examples."""
    return "\n  ".join([EXAMPLES, *examples])


def add_options(parser: argparse.ArgumentParser, *names: str, **changes: dict[str, Any]) -> None:
    """Add common arguments of commands to a parser.

    Args:
        parser: parser of the command.
        names: "scene", "agent", "--env", "--episodes", "--seed", "--set", "--trust" or "--json".
        changes: name of an argument without dashes -> keyword arguments of `add_argument` for this command.
    """
    from flexman_gym.envs.config.configuration import SET_HELP
    from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
    from flexman_gym.evaluation.rollouts import TEST_SEEDS
    from flexman_gym.evaluation.trained_agents import AGENTS

    ids = ", ".join(sorted(NAMED_ENVIRONMENTS))
    environment = f"environment: a file, an id with a condition such as FlexRRR-v0/delay, or {ids}"
    shared: dict[str, dict[str, Any]] = {
        "scene": {"help": f"scene, a .json or .yaml file, or {', '.join(SCENES)}"},
        "agent": {
            "help": "folder of a run or a policy, a Python file with a function make of a Plant that returns a "
            f"controller, a zip of Stable-Baselines3 (with --trust), or {', '.join(AGENTS)}"
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
        "--json": {"action": "store_true", "help": "print one JSON document, with unrounded numbers"},
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


def load_scene(name: str) -> "Scene":
    """Return a scene by its name in SCENES or from a file.

    Raises:
        FileNotFoundError, ValueError: for a name without a scene, or a damaged file, with a one-line message.
    """
    from flexman_gym.common.errors import unknown_name
    from flexman_gym.scene.catalog import paper_scene
    from flexman_gym.scene.scene import Scene

    if name in SCENES:
        return paper_scene(SCENES[name])
    if not Path(name).suffix:
        raise unknown_name("scene", name, SCENES, "a .json or .yaml file")
    return Scene.load(name)


def agent_name(name: str) -> str:
    """Return the name of an agent; a Python file with a controller is registered and known by the name of the file."""
    from flexman_gym.common.registry import register_file

    return register_file("controller", name) if name.endswith(".py") else name


def load_agent(name: str, trust: bool, environment: "Configuration | None" = None) -> "AgentSpec":
    """Return an agent by its name or folder.

    Files of Stable-Baselines3 are read only if trusted, as reading them can run code.

    Args:
        name: name of an agent, folder of a run or a policy, a Python file with a controller, or a zip of
            Stable-Baselines3.
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
    return find_agent(agent_name(name))


def name_unused(
    source: str, named: "Configuration | None", environment: "Configuration", agents: "Iterable[AgentSpec]"
) -> None:
    """Print the settings of an agent in a file of an environment that no agent uses, on standard error.

    Args:
        source: file of the environment, or its name; conditions of a name bring settings of policies without a message.
        named: configuration of the source; None without one.
        environment: configuration of the evaluation.
        agents: the agents; the policy of a zip has the settings of the file.
    """
    from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
    from flexman_gym.evaluation.agent_spec import INTERFACE

    if named is None or source.partition("/")[0] in NAMED_ENVIRONMENTS:
        return
    used = [each.interface or {} for each in agents]
    unused = [
        name
        for name, value in named.given.items()
        if name in INTERFACE and name not in environment.given and all(each.get(name) != value for each in used)
    ]
    if unused:
        reason = "settings of an agent, which the agents here do not use"
        print(f"{source} without {', '.join(unused)}: {reason}", file=sys.stderr)
