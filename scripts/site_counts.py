"""Count pages and words by tab, without tables, code and docstrings, and words of the built API pages.

python scripts/site_counts.py [--site out/site]
"""

import argparse
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).parents[1]
TEACHING = ("Start", "Learn", "Control", "Simulate", "My arm", "Machine")  # tabs; Concepts is a page of Start
REFERENCE = ("api/", "environments/keywords", "glossary")  # pages to look up names, whose length is not limited
APART = re.compile(r"\A---\n.*?^---$|^```.*?^```$|^\|.*?$|^::: .*?$|^    .*?$|<!--.*?-->", re.MULTILINE | re.DOTALL)


def pages(node: Any) -> list[str]:
    """Return the paths of the pages below a node of the navigation, without suffix."""
    if isinstance(node, str):
        return [node.removesuffix(".md")]
    parts = node.values() if isinstance(node, dict) else node
    return [page for part in parts for page in pages(part)]


def count(text: str) -> int:
    """Return the number of words with a letter or a digit."""
    return sum(any(letter.isalnum() for letter in word) for word in text.split())


def words(page: str) -> int:
    """Return the number of words of a Markdown page outside tables, code and docstrings."""
    return count(APART.sub("", page))


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


class _Article(HTMLParser):
    """Number of words in the article of a built page, with tables and code."""

    def __init__(self) -> None:
        super().__init__()
        self.total, self.inside = 0, False

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.inside |= tag == "article"

    def handle_endtag(self, tag: str) -> None:
        self.inside &= tag != "article"

    def handle_data(self, data: str) -> None:
        self.total += self.inside * count(data)


def api_words(site: Path) -> int:
    """Return the number of words of the API pages of a built site, with signatures, tables and examples."""
    articles = []
    for path in sorted((site / "api").glob("*.html")):
        articles.append(_Article())
        articles[-1].feed(path.read_text(encoding="utf-8"))
    return sum(article.total for article in articles)


def search_entries(site: Path) -> list[str]:
    """Return the addresses of the entries of the search of a built site."""
    return [entry["location"] for entry in json.loads((site / "search.json").read_text(encoding="utf-8"))["items"]]


def main() -> None:
    """Print a line per tab, the share of the words on pages that teach, and counts of a built site."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--site", type=Path, help="folder of a built site")
    site = parser.parse_args().site
    tabs = counts()
    for name, each in tabs.items():
        print(f"{name:<13}{len(each):>3} pages {sum(each.values()):>7,} words")
    print(f"{sum(map(len, tabs.values()))} pages; {share(tabs):.0%} of the words are in {', '.join(TEACHING)}")
    if site:
        entries = search_entries(site)
        api = sum(each.startswith("api/") for each in entries)
        print(f"API: {api_words(site):,} words, {api} of {len(entries)} entries of the search")


if __name__ == "__main__":
    main()
