"""List the programs that compute rows and pages of docs, or run one: python -m studies servos --folder docs/evidence"""

import argparse
import ast
import importlib
import pkgutil
import sys
from pathlib import Path

from studies import runners


def main(arguments: list[str] | None = None) -> int:
    """Run a program and return its exit status; list all programs if none is named."""
    given = sys.argv[1:] if arguments is None else arguments
    names = [each.name for each in pkgutil.iter_modules(runners.__path__)]
    if not given:
        print("\n".join(f"{name:16}{_summary(name)}" for name in names))
        return 0
    parser = argparse.ArgumentParser("python -m studies", description=__doc__)
    parser.add_argument("study", choices=names, help="name of a program")
    name = parser.parse_args(given[:1]).study
    module = importlib.import_module(f"studies.runners.{name}")
    own = argparse.ArgumentParser(f"python -m studies {name}", description=module.__doc__)
    module.RUNNER.arguments(own)
    options = own.parse_args(given[1:])
    try:
        return int(module.RUNNER.run(options))
    except (ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2


def _summary(name: str) -> str:
    """Return the first line of the docstring of a program, without importing its file."""
    text = (Path(runners.__path__[0]) / f"{name}.py").read_text(encoding="utf-8")
    return (ast.get_docstring(ast.parse(text)) or "").partition("\n")[0]


if __name__ == "__main__":
    sys.exit(main())
