"""Command line: flexman COMMAND, each a file in the folder `commands`, which is imported when it runs."""

import argparse
import ast
import importlib
import pkgutil
import re
import sys
from difflib import get_close_matches
from pathlib import Path

from flexman_gym import __version__, commands
from flexman_gym.common.renamed import OPTIONS, warn_deprecated

COMMAND_GROUPS = {  # commands in the order of the help
    "start": ("demo", "check", "compile", "list", "verify"),
    "learn": ("train", "imitate", "search", "enjoy"),
    "evaluate": ("evaluate", "league", "certify", "why"),
    "simulate": ("simulate", "choose", "precision", "draw"),
    "control": ("tune", "optimise", "resonance"),
    "data": ("record", "replay", "export"),
}
MAX_SUMMARY = 65  # letters of what a command does, on a screen of 80 columns


def main(arguments: list[str] | None = None) -> int:
    """Run a command and return the exit status."""
    given = _present_options(sys.argv[1:] if arguments is None else arguments)
    words = "Robot arms that bend, as Gymnasium environments."
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog="flexman",
        usage="flexman [-h] [--version] command ...",
        description=f"{words}\n\n{_overview()}",
        formatter_class=form,
    )
    parser.add_argument("--version", action="version", version=__version__)
    chosen = parser.add_subparsers(
        prog="flexman", dest="command", required=True, metavar="command", help=argparse.SUPPRESS
    )
    for each in pkgutil.iter_modules(commands.__path__):
        chosen.add_parser(each.name, description=command_summary(each.name))
    if not given or given[0] not in chosen.choices:
        if given and not given[0].startswith("-"):
            near = get_close_matches(given[0], chosen.choices, 1, 0.0)[0]
            parser.error(f"command: {given[0]!r} is not allowed; the nearest is {near}, flexman --help has all")
        parser.parse_args(given)
    runs = chosen.choices[given[0]]
    try:
        command = importlib.import_module(f"flexman_gym.commands.{given[0]}").COMMAND
        command.arguments(runs)
        return int(command.run(parser.parse_args(given, argparse.Namespace(parser=runs))))
    except ImportError as error:
        said = (
            str(error) if error.name != "matplotlib" else "pictures need Matplotlib: pip install 'flexman_gym[render]'"
        )
        if "pip install" not in said:  # which rooms say that need more than is installed
            raise
        if given[0] == "demo":  # which needs both
            said = re.sub(r"flexman_gym\[\w+\]", "flexman_gym[train,render]", said)
        print(said, file=sys.stderr)
    except (ValueError, OSError) as error:  # a refusal, which is one line
        print(error, file=sys.stderr)
    return 2


def _present_options(given: list[str]) -> list[str]:
    """Return a command line under the present names of its options, with a DeprecationWarning for each old one."""
    names, result = OPTIONS.get(given[0], {}) if given else {}, []
    for word in given:
        name, mark, value = word.partition("=")
        if name in names:
            warn_deprecated(f"flexman {given[0]}: {name} is {names[name]} now")
        result.append(names.get(name, name) + mark + value)
    return result


def _overview() -> str:
    """Return the commands in groups, a line for each."""
    lines = []
    for group, names in COMMAND_GROUPS.items():
        lines.append(f"{group}:")
        for name in names:
            words = command_summary(name).rstrip(".")
            words = words if len(words) <= MAX_SUMMARY else words.partition(": ")[0]
            words = words if len(words) <= MAX_SUMMARY else words.partition(", ")[0]
            lines.append(f"    {name:<11}{words[0].lower()}{words[1:]}")
    return "\n".join(lines)


def command_summary(name: str) -> str:
    """Return the first line of the docstring of a command, without importing its file."""
    text = (Path(commands.__path__[0]) / f"{name}.py").read_text(encoding="utf-8")
    return (ast.get_docstring(ast.parse(text)) or name).splitlines()[0]


if __name__ == "__main__":
    sys.exit(main())
