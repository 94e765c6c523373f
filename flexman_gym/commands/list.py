"""List environments, agents, sensors, methods, arms and recipes."""

import argparse
import ast
from collections.abc import Iterable, Mapping
from itertools import takewhile, zip_longest
from pathlib import Path
from textwrap import wrap

from flexman_gym.commands import CommandLine, add_options, bold
from flexman_gym.common.errors import suggestion
from flexman_gym.common.formatting import WIDTH, json_text

KINDS = (
    "environments", "conditions", "settings", "controllers", "policies", "sensors", "methods", "arms", "recipes",
    "examples",
)  # fmt: skip
AGENTS = ("controllers", "policies")  # kinds of the kind "agents"
MAX_NAME_LENGTH = 30  # characters; the description of a longer name is below it
PACKAGE_FOLDER = Path(__file__).parents[1]
EXAMPLE_FOLDERS = (
    PACKAGE_FOLDER / "examples",
    PACKAGE_FOLDER.parent / "docs" / "examples",
)  # in a wheel, in a checkout


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    parser.add_argument("what", nargs="*", metavar="kind", help=f"{', '.join(KINDS)}, or agents (default: all)")
    add_options(parser, "--json")


def _run(options: argparse.Namespace) -> int:
    """Print the names of each kind with a short description; return 0."""
    given = [kind for what in options.what for kind in (AGENTS if what == "agents" else (what,))]
    for what in given:
        if what not in KINDS:
            allowed = f"some of {', '.join(KINDS)}{suggestion(what, KINDS)}"
            options.parser.error(f"what: {what} is not allowed; give {allowed}")
    kinds = given or KINDS
    if options.json:
        print(json_text({what: dict(_entries(what)) for what in kinds}))
        return 0
    for what in kinds:
        print("\n".join([bold(f"{what}:"), *_lines(dict(_entries(what)))]))
    return 0


def _lines(entries: Mapping[str, str]) -> Iterable[str]:
    """Yield the lines of names and descriptions, of at most 100 characters unless a name is longer."""
    width = max((len(name) for name in entries if len(name) <= MAX_NAME_LENGTH), default=0) + 2
    for name, description in entries.items():
        texts = wrap(description, WIDTH - 2 - width) or [""]
        if len(name) > MAX_NAME_LENGTH:
            texts.insert(0, "")
        yield from (f"  {head:<{width}}{text}".rstrip() for head, text in zip_longest([name], texts, fillvalue=""))


def _entries(what: str) -> Iterable[tuple[str, str]]:
    """Yield each name of a kind with a short description."""
    from flexman_gym.agent.base_controllers import BASES
    from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
    from flexman_gym.envs.config.settings import SETTINGS
    from flexman_gym.envs.registration import CONDITION_FOLDER, CONDITIONS
    from flexman_gym.envs.sensors import SENSOR_SETS, SENSORS
    from flexman_gym.scene.serialization import ARMS, named_arm
    from flexman_gym.simulation.methods import METHODS

    if what == "environments":
        for id, each in NAMED_ENVIRONMENTS.items():
            yield id, f"{type(each.task).__name__.lower()}, {each.control_period:g} s a period, {each.horizon:g} s"
    elif what == "conditions":
        descriptions = {path.stem: _first_sentence(path) for path in sorted(CONDITION_FOLDER.glob("*/*.yaml"))}
        yield from ((name, descriptions.get(name, "No change.")) for name in CONDITIONS)
    elif what == "settings":
        yield from ((name, each.help + f" ({each.unit})" * bool(each.unit)) for name, each in SETTINGS.items())
    elif what == "controllers":
        yield from (
            (name, f"information: {', '.join(base.information) or 'motor angles and rates'}")
            for name, base in BASES.items()
        )
    elif what == "policies":
        from flexman_gym.evaluation.policy_files import POLICIES
        from flexman_gym.toolbox.league.certificate_file import describe_policy

        yield from ((name, describe_policy(name)) for name in POLICIES)
    elif what == "sensors":
        parts: Mapping[str, object] = {name: "" for name in SENSORS} | {
            name: " + ".join(SENSOR_SETS[name]) for name in SENSOR_SETS
        }
        yield from ((name, str(content)) for name, content in parts.items())
    elif what == "methods":
        yield from ((name, f"{method.kind}, order {method.order}") for name, method in METHODS.items())
    elif what == "arms":
        yield from ((name, (named_arm(name).__doc__ or "").splitlines()[0]) for name in ARMS)
    elif what == "examples":
        folder = next(path for path in EXAMPLE_FOLDERS if path.is_dir())
        yield from ((str(path), _first_sentence(path)) for path in sorted(folder.glob("*.*")))
    else:
        yield from _recipes()


def _recipes() -> Iterable[tuple[str, str]]:
    """Yield each recipe with its description; without the training extra, a line that names it."""
    try:
        from flexman_agents.settings import RECIPE_FOLDER, RECIPES
    except ImportError as error:
        yield "none:", str(error)
        return
    yield from ((name, _first_sentence(RECIPE_FOLDER / f"{name}.yaml")) for name in RECIPES)


def _first_sentence(path: Path) -> str:
    """Return the first sentence of a file: of its first comment, or of the docstring of Python code."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        return (ast.get_docstring(ast.parse(text)) or "").splitlines()[0]
    if path.suffix == ".urdf":
        return text.partition("<!--")[2].partition("-->")[0].strip()
    lines = takewhile(lambda line: line.startswith("#"), text.splitlines())
    return " ".join(line.lstrip("# ") for line in lines).split(". ")[0].rstrip(".") + "."


EXAMPLES = (
    "flexman list environments recipes",
    "flexman list settings | head  # of environments, for --set",
    "flexman list conditions --json | python3 -m json.tool",
)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)
