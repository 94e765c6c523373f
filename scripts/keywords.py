"""Write the pages of keywords, migration and commands: python scripts/keywords.py --folder docs"""

import argparse
import importlib
from collections.abc import Mapping
from pathlib import Path

from flexman_gym.__main__ import COMMAND_GROUPS
from flexman_gym.common import renamed
from flexman_gym.common.markdown import markdown_table
from flexman_gym.envs.config.settings import SETTINGS
from flexman_gym.simulation.parameters import UNCERTAIN
from studies.files import folder

KEYWORDS_PAGE, MIGRATION_PAGE = Path("environments", "keywords.md"), Path("migration.md")
COMMANDS_PAGE = Path("command_line.md")
BEGIN, END = "<!-- commands: begin -->\n", "<!-- commands: end -->\n"
KEYWORDS_HEAD = """# Keywords of environments

`gym.make` and `gym.make_vec` take these keywords, the same for every environment; so do files of environments and
`--set NAME=VALUE` of the commands. `condition` names a condition of an environment, which changes keywords that are not
given. `python scripts/keywords.py --folder docs` writes this page from the declarations in
`flexman_gym/envs/config/settings.py`.
"""
MIGRATION_HEAD = """---
search:
  exclude: true
---

# Migration to 0.3

Release 0.3 renames modules, functions, arguments and keys. Old names work until release 0.4, with a
`DeprecationWarning` that names the present one; `python -W error::DeprecationWarning` finds them in your code. Files of
release 0.2 load without a warning: run folders, policies, certificates, scene files, states of environments, and rows
of a league. `python scripts/keywords.py --folder docs` writes this page from `flexman_gym/common/renamed.py`.
"""


def keywords_page() -> str:
    """Return the reference page of environment keywords as Markdown."""
    rows = [
        [f"`{name}`", each.unit, "of the named environment" if each.named else f"`{each.default!r}`", each.help]
        for name, each in SETTINGS.items()
    ]
    old = [f"`{old}` is the deprecated name of `{name}`." for name, each in SETTINGS.items() for old in each.deprecated]
    return "\n".join([KEYWORDS_HEAD, *markdown_table(["keyword", "unit", "default", "meaning"], rows), "", *old, ""])


def migration_page() -> str:
    """Return the page of renamed names as Markdown."""
    keywords = {old: name for name, each in SETTINGS.items() for old in each.deprecated}
    ranges = {key: name for name, key in ((name, key) for key, name in UNCERTAIN.items()) if key != name}
    sections: Mapping[str, tuple[str, Mapping[str, Mapping[str, str]]]] = {
        "Modules": ("module", {"": renamed.MODULES}),
        "Functions, classes and constants": ("module", renamed.NAMES),
        "Arguments of functions": ("function", renamed.ARGUMENTS),
        "Members of classes": ("class or protocol", renamed.MEMBERS),
        "Arguments of base controllers": ("", {"": renamed.BASE_ARGUMENTS}),
        "Keywords of environments": ("", {"": keywords}),
        "Physical parameters": ("", {"": renamed.PARAMETER_KEYS}),
        "Ranges in `unknown=` of a base controller": ("", {"": {new: old for old, new in ranges.items()}}),
        "Integration methods": ("", {"": renamed.METHODS}),
        "Settings of training runs": ("", {"": renamed.RUN_SETTINGS}),
        "Commands of `flexman`": ("", {"": renamed.COMMANDS}),
        "Options of commands": ("command", renamed.OPTIONS),
        "Columns of league rows": ("", {"": renamed.LEAGUE_COLUMNS}),
        "Keys of certificates": ("", {"": renamed.CERTIFICATE_KEYS}),
    }
    lines = [MIGRATION_HEAD]
    for title, (place, tables) in sections.items():
        rows = [
            [f"`{key}`"] * bool(key) + [f"`{old}`", f"`{present}`"]
            for key, names in tables.items()
            for old, present in names.items()
        ]
        heads = [place] * bool(rows and len(rows[0]) == 3)
        lines += [f"## {title}", "", *markdown_table([*heads, "before", "now"], rows), ""]
    return "\n".join(lines)


def commands_table() -> str:
    """Return the commands of `flexman` by group, with their summaries and arguments, as a Markdown table."""
    rows = []
    for group, names in COMMAND_GROUPS.items():
        rows.append([f"**{group}**", "", ""])
        for name in names:
            module = importlib.import_module(f"flexman_gym.commands.{name}")
            parser = argparse.ArgumentParser(add_help=False)
            module.COMMAND.arguments(parser)
            shown = [each for each in parser._actions if each.help != argparse.SUPPRESS]
            words = [each.option_strings[-1] if each.option_strings else each.dest.upper() for each in shown]
            summary = (module.__doc__ or "").partition("\n")[0].rstrip(".")
            rows.append([f"`{name}`", summary, " ".join(f"`{word}`" for word in words)])
    return "\n".join([*markdown_table(["command", "purpose", "arguments"], rows), ""])


def commands_page(page: str) -> str:
    """Return the page of the command line with its present table of commands."""
    before, _, rest = page.partition(BEGIN)
    return before + BEGIN + commands_table() + END + rest.partition(END)[2]


def main() -> None:
    """Write the pages; that of the commands must exist."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=folder, default="out", help="output folder of the pages")
    target: Path = parser.parse_args().folder
    (target / KEYWORDS_PAGE).parent.mkdir(parents=True, exist_ok=True)
    (target / KEYWORDS_PAGE).write_text(keywords_page(), encoding="utf-8")
    (target / MIGRATION_PAGE).write_text(migration_page(), encoding="utf-8")
    if (path := target / COMMANDS_PAGE).exists():
        path.write_text(commands_page(path.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
