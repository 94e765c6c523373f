"""Command line `flexman COMMAND`. Each command is a file in the folder `commands`, imported only when it runs."""

import argparse
import ast
import importlib
import os
import pkgutil
import re
import signal
import sys
from pathlib import Path
from textwrap import wrap

from flexman_gym import __version__, commands
from flexman_gym.common.errors import suggestion

COMMAND_GROUPS = {  # group -> commands, in the order of the help
    "start": ("demo", "live", "arm", "check", "compile", "list", "verify"),
    "learn": ("train", "imitate", "search"),
    "evaluate": ("evaluate", "league", "why"),
    "simulate": ("simulate", "paper", "choose", "precision", "draw"),
    "control": ("optimise", "shape", "drive"),
    "data": ("record", "replay", "export"),
}
COLUMNS, INDENT = 80, 15  # characters; width of the help, and start of the summaries of the commands
CLOSED_PIPE = 128 + signal.SIGPIPE  # exit status, that of a program ended by this signal


def main(arguments: list[str] | None = None) -> int:
    """Run a command and return the exit status, 141 if the reader of its output, such as `head`, has gone."""
    try:
        try:
            return _run(arguments)
        except SystemExit:  # of a parser, such as after a help
            sys.stdout.flush()
            raise
    except BrokenPipeError:
        nowhere = os.open(os.devnull, os.O_WRONLY)  # for what is flushed when the program ends
        for stream in (sys.stdout, sys.stderr):
            os.dup2(nowhere, stream.fileno())
        return CLOSED_PIPE


def _run(arguments: list[str] | None) -> int:
    """Run a command and return the exit status."""
    given = sys.argv[1:] if arguments is None else arguments
    about = "Simulate, train and test controllers of flexible robot arms."
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog="flexman",
        usage="flexman COMMAND [options]",
        description=f"{about}\n\n{_overview()}",
        epilog="flexman COMMAND --help shows the arguments of a command.",
        formatter_class=form,
    )
    parser.add_argument("--version", action="version", version=__version__)
    chosen = parser.add_subparsers(
        prog="flexman", dest="command", required=True, metavar="command", help=argparse.SUPPRESS
    )
    for each in pkgutil.iter_modules(commands.__path__):
        chosen.add_parser(each.name, description=_description(each.name))
    if not given or given[0] not in chosen.choices:
        if given and not given[0].startswith("-"):
            near = suggestion(given[0], chosen.choices)
            parser.error(f"command: {given[0]!r} is not allowed{near}; flexman --help lists all")
        parser.parse_args(given)
    command_parser = chosen.choices[given[0]]
    try:
        command = importlib.import_module(f"flexman_gym.commands.{given[0]}").COMMAND
        command.arguments(command_parser)
        status = int(command.run(parser.parse_args(given, argparse.Namespace(parser=command_parser))))
        sys.stdout.flush()
        return status
    except ImportError as error:
        text = str(error)
        if error.name == "matplotlib":
            text = "plots need Matplotlib: pip install 'flexman_gym[render]'"
        if "pip install" not in text:  # an error of the library, no missing optional package
            raise
        if given[0] == "demo":  # the demonstration needs both extras
            text = re.sub(r"flexman_gym\[\w+\]", "flexman_gym[train,render]", text)
        print(text, file=sys.stderr)
    except (ValueError, OSError) as error:  # invalid input; one line
        if isinstance(error, BrokenPipeError):
            print(flush=True)  # raises again if the pipe is that of the output
        print(error, file=sys.stderr)
    return 2


def _overview() -> str:
    """Return the help of all commands in groups: name and whole summary of each."""
    lines = []
    for group, names in COMMAND_GROUPS.items():
        lines.append(f"{group}:")
        for name in names:
            head = f"    {name}".ljust(INDENT)
            lines += wrap(_summary(name).rstrip("."), COLUMNS, initial_indent=head, subsequent_indent=" " * INDENT)
    return "\n".join(lines)


def _description(name: str) -> str:
    """Return the docstring of a command, without importing its file."""
    text = (Path(commands.__path__[0]) / f"{name}.py").read_text(encoding="utf-8")
    return ast.get_docstring(ast.parse(text)) or name


def _summary(name: str) -> str:
    """Return the first line of the docstring of a command."""
    return _description(name).splitlines()[0]


if __name__ == "__main__":
    sys.exit(main())
