"""Tests that the numbers of README and pages come from stored rows: each is traced to a file, a column and a row.

A change of an entry of a file is a change of the number that is computed from it. The tests search for such an entry.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache, partial
from itertools import product
from typing import NamedTuple

import numpy as np
import pytest

from flexman_gym.envs.config.named_environments import DEFAULT_ID
from flexman_gym.toolbox.league.rows import VALUES, EpisodeRow, LeagueRows
from flexman_gym.toolbox.league.standings import Standings
from studies.control.cases import ControlRow
from studies.control.page import AGENTS as CONTROL_AGENTS
from studies.control.page import page as control_page
from studies.files import read_comments
from studies.machine.measure import FitRow
from studies.machine.page import page as machine_page
from studies.readme import UNKNOWN, readme, results
from studies.results import Results
from studies.safety.measure import SafetyRow
from studies.safety.page import cells as safety_cells
from studies.sentences import DEFINITIONS, SENTENCES, updated
from studies.servos.measure import FrictionRow, ServoRow
from studies.servos.page import page as servos_page
from studies.sources import Sources

from oracles.files import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")
DRAWN = {"README": 40, "control": 12, "machine": 4, "safety": 12, "servos": 12}  # numbers by page
SENTENCE_FILES = {
    "baselines": "baselines.csv",
    "control": "control.csv",
    "peers": "peers.csv",
    "learning": "learning.csv",
    "benchmark": "benchmark.csv",
    "machine": "machine.csv",
    "safety": "safety.csv",
    "starts": "starts.csv",
    "verification": "verification.csv",
}  # attribute of the sources -> file
CONTROL_SCENARIOS = [f"{DEFAULT_ID}/{end}" for end in ("unknown", "unknown-lab", "uncertain", "unmodelled")]
FIRST, LAST = "first", "last"  # rows that are removed
NUMBER = re.compile(r"(?<![\w.`/=-])\d[\d,]*(?:\.\d+)?(?:e[+-]\d+)?(?![\w`/])")


@dataclass(frozen=True, eq=False)
class Source:
    """Text that is computed from the rows of a file.

    Attributes:
        file: name of the file.
        rows: its rows.
        text: function: rows -> text.
    """

    file: str
    rows: list
    text: Callable[[list], str]

    @cache  # noqa: B019 (a source lives as long as the tests)
    def shown(self, column, way, count):
        """Return place -> digits of the numbers of the text after a change of the first rows; None after an error.

        Args:
            column: changed column; "" to remove the rows.
            way: function: value -> changed value; LAST to remove the last rows instead of the first ones.
            count: number of changed rows.
        """
        rows = [changed(row, column, way) for row in self.rows[:count]] if column else []
        rows = self.rows[: len(self.rows) - count] if way is LAST else rows + self.rows[count:]
        try:
            return dict(reversed(numbers(self.text(rows), tables=False)))
        except Exception:  # a text that needs the removed rows
            return None


class Number(NamedTuple):
    """Number of a text: its place, a tuple of texts without it, and its digits."""

    place: tuple
    digits: str


def numbers(text, tables=True):
    """Return the numbers of a text without its code; with `tables` only those of cells outside the first column.

    The place in a table is the text above the table, the head and the first cell of the line, and the column.
    """
    result, above, head = [], "", ""
    for line in re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE).splitlines():
        if not line.startswith("|"):
            above, head = (NUMBER.sub("#", line), "") if line else (above, "")
            parts = [((NUMBER.sub("#", line),), line)] if not tables else []
        else:
            head, (label, *cells) = head or line, line.strip("| ").split(" | ")
            parts = [((above, head, label, column), cell) for column, cell in enumerate(cells)] if line != head else []
        result += [Number((*place, index), match.group())
                   for place, part in parts for index, match in enumerate(NUMBER.finditer(part))]  # fmt: skip
    return result


def changed(row, column, way):
    """Return a row with a changed entry of a column, if the entry is a number."""
    if isinstance(row, EpisodeRow):
        at = VALUES.index(column)
        return row._replace(values=(*row.values[:at], way(row.values[at]), *row.values[at + 1 :]))
    value = getattr(row, column)
    try:
        entry = {column: type(value)(way(float(value)))}
    except (TypeError, ValueError):
        return row
    return replace(row, **entry) if is_dataclass(row) else row._replace(**entry)


def columns(row):
    if isinstance(row, EpisodeRow):
        return VALUES
    return [field.name for field in fields(row)] if is_dataclass(row) else row._fields


def scaled(value):
    return 1.37 * value


def halved(value):
    return 0.5 * value


def one(value):
    return 1.0


def infinite(value):
    return np.inf


def trace(number, source):
    """Return the column and the index of a row on which a number depends; None if there is none.

    A column is changed, at first in all rows, or rows are removed from either end. The row without which the number
    stays the same is searched by bisection.
    """
    for column, way in [*product(columns(source.rows[0]), (scaled, halved, one, infinite)), ("", FIRST), ("", LAST)]:

        def digits(count, column=column, way=way):
            found = source.shown(column, way, count)
            return None if found is None else found.get(number.place)

        low, high = 0, len(source.rows)
        if digits(high) == number.digits:
            continue
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if digits(middle) == number.digits else (low, middle)
        if digits(high) is not None:
            return column or "number of rows", source.rows[-high if way is LAST else low]
    return None


def table_of_agents(cells, rows):
    return "\n".join(results(Standings(LeagueRows(rows, cells))))


@cache
def sources():
    """Return the texts computed from rows, by their page."""
    known = Sources(ROOT / "docs")
    league = known.standings.results
    cells = [cell for cell in league.cells.values() if cell.scenario in (DEFAULT_ID, UNKNOWN)]
    known.standings = Standings(
        LeagueRows([row for row in league.rows.values() if row.scenario in (DEFAULT_ID, UNKNOWN)], cells)
    )

    pages = README + (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
    sentences = "\n\n".join(re.search(each.pattern.replace(" ", r"\s+"), pages).group() for each in SENTENCES)

    def of_sentences(name):
        def text(rows):
            other = Sources(ROOT / "docs")
            vars(other).update(vars(known), **{name: rows})
            return updated(sentences, other)

        return text

    result = []
    for agent in dict.fromkeys(cell.agent for cell in cells):
        own = [cell for cell in cells if cell.agent == agent]
        rows = [row for row in known.standings.results.rows.values() if row.agent == agent]
        result += [("README", Source("rows.csv", rows, partial(table_of_agents, own)))] if rows else []
    result += [
        ("README", Source(file, getattr(known, name), of_sentences(name))) for name, file in SENTENCE_FILES.items()
    ]
    uncertain = known.rows("control.csv", ControlRow)
    shown = [row for row in league.rows.values() if row.agent in CONTROL_AGENTS and row.scenario in CONTROL_SCENARIOS]

    def control_of(rows):
        other = Results()
        vars(other)["standings"] = Standings(LeagueRows(rows, league.cells.values()))
        return control_page(uncertain, other)

    result.append(("control", Source("rows.csv", shown, control_of)))
    machine = read_comments(known.path("machine.csv"))
    servos = read_comments(known.path("servos.csv"), known.path("servos_friction.csv"))
    rubbing = known.rows("servos_friction.csv", FrictionRow)
    for name, kind, text in (
        ("control", ControlRow, lambda rows: control_page(rows, known.results)),
        ("machine", FitRow, lambda rows: machine_page(rows, machine)),
        ("safety", SafetyRow, lambda rows: "\n".join(safety_cells(rows))),
        ("servos", ServoRow, lambda rows: servos_page(rows, rubbing, servos)),
    ):
        result.append((name, Source(f"{name}.csv", known.rows(f"{name}.csv", kind), text)))
    return result


def universe(page):
    """Return the numbers of the sentences and the table of agents of the README, or of the tables of a page."""
    return [*dict.fromkeys(each for name, source in sources() if name == page
                           for each in numbers(source.text(source.rows), tables=page != "README"))]  # fmt: skip


@pytest.mark.slow
def test_the_numbers_of_readme_and_pages_are_those_of_the_rows():
    known = Sources(ROOT / "docs")
    assert readme(README, known) == README, "run python scripts/readme.py"
    for page in (ROOT / "docs").rglob("*.md"):
        text = page.read_text(encoding="utf-8")
        assert page.name == "changelog.md" or updated(text, known) == text, f"{page.name}: run python scripts/readme.py"


def test_every_number_of_a_sentence_of_the_readme_is_computed():
    text = re.sub(r"^```.*?^```|^<!-- results -->.*?<!-- end of|^\|.*?$", "", README, flags=re.DOTALL | re.MULTILINE)
    for sentence in (*SENTENCES, *DEFINITIONS):
        text = re.sub(sentence.pattern.replace(" ", r"\s+"), "", text)
    text = re.sub(r"\]\([^)]*\)", "", text)
    assert [*NUMBER.findall(text)] == ["3.11", "3.12", "3.13"]  # versions of Python


def origin(page, number):
    """Return file, column and row of a number of a page; None if there are none."""
    for name, source in sources():
        if name == page and (found := trace(number, source)):
            return source.file, *found
    return None


@pytest.mark.slow
@pytest.mark.parametrize("page", DRAWN)
@pytest.mark.filterwarnings("ignore:Mean of empty slice", "ignore:invalid value")  # rows are taken away
def test_drawn_numbers_are_traced_to_a_file_a_column_and_a_row(page):
    every = universe(page)
    drawn = [every[i] for i in np.random.default_rng(48).choice(len(every), DRAWN[page], replace=False)]
    found = {number: origin(page, number) for number in drawn}
    print(*(f"{number.digits}: {where}" for number, where in found.items()), sep="\n")
    assert not [number for number, where in found.items() if not where]
