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
from traceback import extract_tb

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
ABOUT = """Simulate, train and test controllers of flexible robot arms.
flexman COMMAND --help shows the arguments of a command, with examples."""
SHELLS = ("bash", "zsh", "fish")  # shells that complete words
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
    given = (sys.argv[1:] if arguments is None else arguments) or ["--help"]
    parser, chosen = _command_parsers()
    parsers = chosen.choices
    if given[0] not in parsers:
        if not given[0].startswith("-"):
            near = suggestion(given[0], parsers)
            parser.error(f"command: {given[0]!r} is not allowed{near}; flexman --help lists all")
        if shell := parser.parse_args(given).print_completion:
            return _print_completion(parser, chosen, shell)
        parser.error("no command is given; flexman --help lists all")
    try:
        run = _add_arguments(given[0], parsers[given[0]])
        status = int(run(parser.parse_args(given, argparse.Namespace(parser=parsers[given[0]]))))
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
        print(f"{_user_place(error)}{error}", file=sys.stderr)
    return 2


def _user_place(error: BaseException) -> str:
    """Return file, line and kind of an error that passed through a file of the user, else ""."""
    packages = (sys.modules.get(name) for name in ("flexman_gym", "flexman_agents"))
    known = [str(Path(each.__file__).parent) for each in packages if each and each.__file__]
    known += [sys.prefix, sys.base_prefix, "<"]  # "<": frames without a file
    frames = [each for each in extract_tb(error.__traceback__) if not each.filename.startswith(tuple(known))]
    if not frames or isinstance(error, OSError):
        return ""
    kind = "" if type(error) is ValueError else f"{type(error).__name__}: "
    return f"{Path(frames[-1].filename).name}, line {frames[-1].lineno}: {kind}"


def _command_parsers() -> "tuple[argparse.ArgumentParser, argparse._SubParsersAction[argparse.ArgumentParser]]":
    """Return the parser of the program, and its argument whose choices are the commands, without arguments yet."""
    parser = argparse.ArgumentParser(
        prog="flexman",
        usage="flexman COMMAND [options]",
        description=f"{ABOUT}\n\n{_overview()}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        add_help=False,
    )
    parser.add_argument("-h", "--help", action="help", help=argparse.SUPPRESS)
    parser.add_argument("-V", "--version", action="version", version=__version__)
    completion = f"print a script that completes words in {', '.join(SHELLS)}"
    parser.add_argument("--print-completion", choices=SHELLS, metavar="SHELL", help=completion)
    chosen = parser.add_subparsers(prog="flexman", dest="command", metavar="command", help=argparse.SUPPRESS)
    for each in pkgutil.iter_modules(commands.__path__):
        text, form = _description(each.name), commands.CommandHelp
        chosen.add_parser(each.name, help=text.splitlines()[0], description=text, formatter_class=form)
    return parser, chosen


def _add_arguments(name: str, parser: argparse.ArgumentParser) -> Callable[[argparse.Namespace], int]:
    """Add the arguments and the examples of a command to its parser, and return the function that runs it."""
    command = importlib.import_module(f"flexman_gym.commands.{name}").COMMAND
    command.arguments(parser)
    parser.epilog = commands.examples_text(command.examples)
    run: Callable[[argparse.Namespace], int] = command.run
    return run


def _print_completion(parser: argparse.ArgumentParser, chosen: argparse.Action, shell: str) -> int:
    """Print the script by which a shell completes command lines; return the exit status."""
    from flexman_gym.completion import completion_script

    try:
        for name, each in dict(chosen.choices or {}).items():
            _add_arguments(name, each)
        chosen.help = None  # the script leaves out arguments with a suppressed help
        print(completion_script(parser, shell))
    except ImportError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def _overview() -> str:
    """Return the help of all commands in groups: name and whole summary of each."""
    lines = []
    for group, names in COMMAND_GROUPS.items():
        lines.append(commands.bold(f"{group}:"))
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
