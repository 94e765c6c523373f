"""Tests of pages of one screen: the mark of numbers that wait for new rows."""

import re

import pytest

from studies.files import WAITING, made_comment, read_comment, split_waiting
from studies.screen import MARK, index, screen

from oracles.files import ROOT

EVIDENCE = ROOT / "docs" / "evidence"
COMPUTER, REASON = "processor A, flexman_gym 0.1.0", "the kernels have changed since"
WAITS = {path.stem: split_waiting(read_comment(path))[1] for path in sorted(EVIDENCE.glob("*.csv"))}


def page(comment):
    """Return a page of two files of rows, of which one has a comment."""
    return screen("Title", "Question?", "**Answer of 3 mm.**", "Body", {"a.csv": comment, "b.csv": COMPUTER}, "study")


def test_a_comment_is_split_into_computer_and_reason():
    assert split_waiting(f"{COMPUTER}; {WAITING}{REASON}") == (COMPUTER, REASON)
    assert split_waiting(COMPUTER) == (COMPUTER, "")


def test_a_page_whose_rows_wait_for_new_ones_is_marked_below_its_answer_and_in_the_index(tmp_path):
    texts = {"new": page(COMPUTER), "old": page(f"{COMPUTER}; {WAITING}{REASON}")}
    assert texts["old"].replace(f"*Waiting for new rows: {REASON}.*\n\n", "") == texts["new"]
    assert f"**Answer of 3 mm.**\n\n*Waiting for new rows: {REASON}.*\n\nBody" in texts["old"]
    for name, state in {"safety": "new", "machine": "old", "servos": "new", "starts": "old"}.items():
        (tmp_path / f"{name}.md").write_text(texts[state], encoding="utf-8")
    items = dict(re.findall(r"\]\((\w+)\.md\)(.*)$", index(sorted(tmp_path.glob("*.md"))), re.MULTILINE))
    assert items == {
        "machine": f": Answer of 3 mm {MARK}.", "safety": ": Answer of 3 mm.", "servos": "", "starts": f" {MARK}",
    }  # fmt: skip


def test_a_page_has_the_date_of_its_rows_once():
    made = [made_comment(COMPUTER, "2026-11-30", number) for number in (3, 4)]
    text = screen("Title", "Question?", "Answer.", "Body", {"a.csv": made[0], "b.csv": made[1]}, "study")
    assert f"computed with {COMPUTER}, 2026-11-30. `make" in " ".join(text.split())


@pytest.mark.evidence
@pytest.mark.parametrize("name", [name for name in WAITS if (EVIDENCE / f"{name}.md").exists()])
def test_a_published_page_is_marked_if_and_only_if_its_rows_wait(name):
    text = " ".join((EVIDENCE / f"{name}.md").read_text(encoding="utf-8").split())
    assert (f"*Waiting for new rows: {WAITS[name]}.*" in text) == ("Waiting for new rows" in text) == bool(WAITS[name])


@pytest.mark.evidence
def test_the_speed_in_the_readme_is_marked_as_its_rows_are():
    text = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert text.count("; waiting for new rows)") == bool(WAITS["benchmark"]) + bool(WAITS["starts"])
