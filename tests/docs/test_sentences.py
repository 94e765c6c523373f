"""Sentences: those of the pages are short, and numbers stand in tables."""

import re
from statistics import median

import pytest

from oracles.files import ROOT

DOCS = ROOT / "docs"
PAGES = ["../README.md", *sorted(str(path.relative_to(DOCS)) for path in DOCS.rglob("*.md"))]
HALF, WORDS, SHARE, NUMBERS = 18, 30, 0.9, 3  # words of the median; at most, in so many of the sentences; numbers
NO_PROSE = re.compile(r"\s*(\||#|!\[)")  # tables, headings, pictures
VERSIONS = "Computed with "  # a list of packages
END = re.compile(r"(?<=[.?!])\s+(?=[A-Z`\"(])|(?<=[:;])\s+(?=[A-Z])")
NUMBER = re.compile(r"(?<![\w.])\d[\d.,]*(e[+-]?\d+)?")


def sentences(page):
    """The sentences of a page; a span of code or an equation is one word."""
    text = re.sub(r"^```.*?^```$", "", page, flags=re.MULTILINE | re.DOTALL)
    text = "\n".join("" if NO_PROSE.match(line) else line for line in text.split("\n"))
    text = re.sub(r"\$\$.*?\$\$|\$[^$]*\$", "`", text, flags=re.DOTALL)
    text = re.sub(r"`[^`]*`", "`", text)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text).replace("*", "")
    blocks = re.split(r"\n\s*\n", re.sub(r"^\s*- ", "\n\n", text, flags=re.MULTILINE))
    result = [each for block in blocks for each in END.split(" ".join(block.split())) if each]
    return [each for each in result if not each.startswith(VERSIONS)]


def long_ones(page):
    """The sentences with too many words."""
    return [each for each in sentences(page) if len(each.split()) > WORDS]


def laden(page):
    """The sentences with too many numbers."""
    return [each for each in sentences(page) if len(NUMBER.findall(each)) > NUMBERS]


@pytest.mark.parametrize("name", PAGES)
def test_sentences_of_a_page_are_short_and_hold_few_numbers(name):
    page = (DOCS / name).read_text(encoding="utf-8")
    known, found = sentences(page), long_ones(page)
    assert median(len(each.split()) for each in known) <= HALF
    assert len(found) <= (1.0 - SHARE) * len(known), "\n".join([f"{len(found)} of {len(known)} are long:", *found])
    assert laden(page) == []


def test_code_tables_headings_and_links_are_no_words():
    page = (
        "# One\n\n```sh\na b\n```\n\n| a | b |\n\nSee `a b` in\n[c d](e f). And: `g` 1e-02 m.\n- More $1 + 2 h$ 2.5\n"
    )
    assert sentences(page) == ["See ` in c d.", "And: ` 1e-02 m.", "More ` 2.5"]


def test_a_long_sentence_and_four_numbers_are_found():
    page = f"A {'very ' * WORDS}long one. It has 1, 2.5, 3e-04 and 4,000. `rk4` has 1, 2 and 3. Short: 1 `rk4`, 2."
    assert [each.split()[-1] for each in long_ones(page)] == ["one."]
    assert laden(page) == ["It has 1, 2.5, 3e-04 and 4,000."]
