"""Count pages and words of the site by tab, without tables, code and docstrings: python scripts/site_counts.py"""

import argparse
import re
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).parents[1]
TEACHING = ("Start", "Tutorials", "Learning", "Control", "Simulator")  # tabs; Concepts is a page of Start
REFERENCE = ("api/", "environments/keywords", "glossary")  # pages to look up names, whose length is not limited
APART = re.compile(r"\A---\n.*?^---$|^```.*?^```$|^\|.*?$|^::: .*?$|^    .*?$|<!--.*?-->", re.MULTILINE | re.DOTALL)


def pages(node: Any) -> list[str]:
    """Return the paths of the pages below a node of the navigation, without suffix."""
    if isinstance(node, str):
        return [node.removesuffix(".md")]
    parts = node.values() if isinstance(node, dict) else node
    return [page for part in parts for page in pages(part)]


def words(page: str) -> int:
    """Return the number of words of a Markdown page outside tables, code and docstrings."""
    return sum(any(letter.isalnum() for letter in word) for word in APART.sub("", page).split())


def counts() -> dict[str, dict[str, int]]:
    """Return tab -> page -> number of words."""
    result: dict[str, dict[str, int]] = {}
    for tab in yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]:
        ((name, node),) = tab.items()
        for page in pages(node):
            text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
            result.setdefault(name, {})[page] = words(text)
    return result


def share(tabs: dict[str, dict[str, int]]) -> float:
    """Return the share of the words on pages that teach."""
    sums = {name: sum(each.values()) for name, each in tabs.items()}
    return sum(sums[name] for name in TEACHING) / sum(sums.values())


def main() -> None:
    """Print a line per tab, and the share of the words on pages that teach."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    tabs = counts()
    for name, each in tabs.items():
        print(f"{name:<13}{len(each):>3} pages {sum(each.values()):>7,} words")
    print(f"{sum(map(len, tabs.values()))} pages; {share(tabs):.0%} of the words are in {', '.join(TEACHING)}")


if __name__ == "__main__":
    main()
