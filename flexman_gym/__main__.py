"""Command line: flexman COMMAND, each a file in the folder `commands`, which is imported when it runs."""

import argparse
import ast
import importlib
import pkgutil
import re
import sys
from pathlib import Path

from flexman_gym import __version__, commands


def main(arguments: list[str] | None = None) -> int:
    """Runs a command and returns the exit status."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(prog="flexman", description="Robot arms that bend, as Gymnasium environments.")
    parser.add_argument("--version", action="version", version=__version__)
    chosen = parser.add_subparsers(dest="command", required=True, metavar="command")
    for name in sorted(each.name for each in pkgutil.iter_modules(commands.__path__)):
        words = about(name)
        chosen.add_parser(name, help=words[0].lower() + words[1:].rstrip("."), description=words)
    if not given or given[0] not in chosen.choices:
        parser.parse_args(given)
    runs = chosen.choices[given[0]]
    try:
        command = importlib.import_module(f"flexman_gym.commands.{given[0]}")
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


def about(name: str) -> str:
    """The first line of a command's file, which is not run for it."""
    text = (Path(commands.__path__[0]) / f"{name}.py").read_text(encoding="utf-8")
    return (ast.get_docstring(ast.parse(text)) or name).splitlines()[0]


if __name__ == "__main__":
    sys.exit(main())
