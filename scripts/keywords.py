"""Writes the page of the keywords of environments: python scripts/keywords.py --folder docs/environments"""

import argparse
from pathlib import Path

from flexman_gym.common.markdown import markdown_table
from flexman_gym.envs.config.settings import SETTINGS
from studies.files import folder

HEAD = """# Keywords of environments

`gym.make` and `gym.make_vec` take these keywords, the same for every environment; so do files of environments and
`--set NAME=VALUE` of the commands. `condition` names a condition of an environment, which changes keywords that are not
given. `python scripts/keywords.py --folder docs/environments` writes this page from the declarations in
`flexman_gym/envs/config/settings.py`.
"""


def page() -> str:
    """Return the page, in Markdown."""
    rows = [
        [f"`{name}`", each.unit, "of the named environment" if each.named else f"`{each.default!r}`", each.help]
        for name, each in SETTINGS.items()
    ]
    old = [f"`{old}` is the deprecated name of `{name}`." for name, each in SETTINGS.items() for old in each.deprecated]
    return "\n".join([HEAD, *markdown_table(["keyword", "unit", "default", "meaning"], rows), "", *old, ""])


def main() -> None:
    """Write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=folder, default="out/environments", help="where the page goes")
    path: Path = parser.parse_args().folder / "keywords.md"
    path.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
