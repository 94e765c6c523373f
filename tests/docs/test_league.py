"""League: the page that is kept says what the rows beside it hold."""

from flexman_gym.evaluation.league import Book
from flexman_gym.evaluation.league_page import conclusion
from flexman_gym.evaluation.standing import Standing
from flexman_gym.evaluation.venues import ASKED

from oracles.files import ROOT

FOLDER = ROOT / "docs" / "league"


def test_the_page_concludes_what_its_rows_say():
    assert conclusion(Standing(Book.load(FOLDER))) in (FOLDER / "league.md").read_text(encoding="utf-8")


def test_known_rows_come_out():
    """As they were measured by another study, within 3 points and 0.1 s."""
    standing = Standing(Book.load(FOLDER))
    for entrant, venue, known in (("lqr-tracking", "FlexRRR-v0", 2.98), ("adaptive-lqr", ASKED, 3.62),
                                  ("privileged-lqr", "FlexRRR-v0/unknown", 3.58)):  # fmt: skip
        settled, time = standing.settled(entrant, venue)
        assert settled >= 0.97 and abs(-time - known) <= 0.1, (entrant, venue)
