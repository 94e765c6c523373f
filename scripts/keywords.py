"""Write the pages of keywords and commands: python scripts/keywords.py --folder docs"""

import argparse
import importlib
from pathlib import Path

from flexman_gym.__main__ import COMMAND_GROUPS
from flexman_gym.common.markdown import markdown_table
from flexman_gym.envs.config.settings import SETTINGS
from studies.files import folder

KEYWORDS_PAGE = Path("environments", "keywords.md")
COMMANDS_PAGE = Path("command_line.md")
BEGIN, END = "<!-- commands: begin -->\n", "<!-- commands: end -->\n"
KEYWORDS_HEAD = """# Keywords of environments

`gym.make` and `gym.make_vec` take these keywords, the same for every environment; so do files of environments and
`--set NAME=VALUE` of the commands. `condition` names a condition of an environment, which changes keywords that are not
given. `python scripts/keywords.py --folder docs` writes this page from the declarations in
`flexman_gym/envs/config/settings.py`.
"""


def keywords_page() -> str:
    """Return the reference page of environment keywords as Markdown."""
    rows = [
        [f"`{name}`", each.unit, "of the named environment" if each.named else f"`{each.default!r}`", each.help]
        for name, each in SETTINGS.items()
    ]
    return "\n".join([KEYWORDS_HEAD, *markdown_table(["keyword", "unit", "default", "meaning"], rows), ""])


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
    if (path := target / COMMANDS_PAGE).exists():
        path.write_text(commands_page(path.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
