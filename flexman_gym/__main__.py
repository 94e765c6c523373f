"""Command line `flexman COMMAND`. Each command is a file in the folder `commands`, imported only when it runs."""

import argparse
import ast
import importlib
import os
import pkgutil
import re
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from textwrap import wrap

from flexman_gym import __version__, commands
from flexman_gym.common.checks import suggestion, warn_caller
from flexman_gym.common.renamed import COMMANDS, OPTIMISED, OPTIONS, REMOVED_OPTIONS

COMMAND_GROUPS = {  # group -> commands, in the order of the help
    "start": ("demo", "live", "check", "compile", "list", "verify"),
    "learn": ("train", "imitate", "search"),
    "evaluate": ("evaluate", "league", "why"),
    "simulate": ("simulate", "choose", "precision", "draw"),
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
    given = _present_options(sys.argv[1:], _print_line) if arguments is None else _present_options(arguments, _warn)
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
        _refuse_removed_options(given[0], given[1:])
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


def _warn(message: str) -> None:
    warn_caller(message, DeprecationWarning)


def _print_line(message: str) -> None:
    print(message, file=sys.stderr)


def _present_options(arguments: list[str], report: Callable[[str], None]) -> list[str]:
    """Return a command line with present names of commands and options; report each old name."""
    if not arguments:
        return []
    command, *words = arguments
    old = "optimise ENVIRONMENT" if command == "optimise" and words and not words[0].startswith("-") else command
    if old in COMMANDS and not (command == "optimise" and words[0] in OPTIMISED):
        report(f"flexman {old} is flexman {COMMANDS[old]} now")
        command, *added = COMMANDS[old].split()[:2]
        words = [*added, *words]
    names, result = OPTIONS.get(command, {}), [command]
    for word in words:
        name, mark, value = word.partition("=")
        if name in names:
            report(f"flexman {command}: {name} is {names[name]} now")
        present = names.get(name, "")
        result += [value] * bool(mark) if present.isupper() else [(present or name) + mark + value]
    return result


def _refuse_removed_options(command: str, words: list[str]) -> None:
    """Raise ValueError for an option that the command had in an earlier release."""
    for name in (word.partition("=")[0] for word in words):
        if name in (removed := REMOVED_OPTIONS.get(command, {})):
            raise ValueError(f"{name}: this option of flexman {command} was removed: {removed[name]}")


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
