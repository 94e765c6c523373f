"""Tests of the published pages against their rows."""

from functools import cache

import pytest

from studies.evidence import studies
from studies.files import read_comments, read_rows
from studies.planted.measure import Planted
from studies.planted.page import page as planted_page
from studies.screen import LEADING, index

from oracles.files import ROOT, STUDIES, runner

pytestmark = pytest.mark.evidence

EVIDENCE, KNOWN = ROOT / "docs" / "evidence", studies()
LISTS = ("control", "index", "papers", "two_masses")  # pages of more than one screen, and a part of papers
SCREENS = [path.stem for path in sorted(EVIDENCE.glob("*.md")) if path.stem not in LISTS]
WORDS, TABLE_ROWS, CHARTS = 250, 8, 1  # limits of a page of one screen


@cache
def texts(name):
    """Return the pages of the stored rows of a study: path -> text."""
    folder = ROOT / KNOWN[name].folder
    return {folder / file: text for file, text in runner(name).texts(folder).items()}


@pytest.mark.parametrize("name", [name for name in STUDIES if KNOWN[name].drawn])
def test_a_published_page_is_made_of_its_rows(name):
    assert texts(name)
    for path, text in texts(name).items():
        assert path.read_text(encoding="utf-8") == text, f"python -m studies evidence {name} --redraw"


def test_the_page_of_planted_errors_is_made_of_its_rows():
    path = EVIDENCE / "planted.csv"
    text = planted_page(read_rows(path, Planted), read_comments(path))
    assert (EVIDENCE / "planted.md").read_text(encoding="utf-8") == text


@pytest.mark.parametrize("name", SCREENS)
def test_a_page_of_evidence_fits_a_screen(name):
    text = (EVIDENCE / f"{name}.md").read_text(encoding="utf-8")
    assert "flexman_gym 0." in " ".join(text.split())
    lines = text.splitlines()
    table = [line for line in lines if line.startswith("|")]
    prose = "\n".join(line for line in lines if not line.startswith("|"))
    assert len(prose.split()) <= WORDS and len(table) <= 2 + TABLE_ROWS and text.count("](") - CHARTS <= 8
    assert prose.count("![") <= CHARTS and max(len(line) for line in prose.splitlines() if line[:2] != "![") <= 120


def test_the_index_has_every_page_and_the_sentence_of_six():
    published = (EVIDENCE / "index.md").read_text(encoding="utf-8")
    assert published == index(path for path in sorted(EVIDENCE.glob("*.md")) if path.name != "index.md")
    assert all(f"]({path.name})" in published for path in EVIDENCE.glob("*.md") if path.name != "index.md")
    assert all(f"]({name}.md): " in published for name in LEADING)
