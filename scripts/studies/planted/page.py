"""Planted errors, page: what the tests of each room notice."""

from collections.abc import Iterable, Sequence

from flexman_gym.common.markdown import markdown_table
from studies.planted.measure import CAUGHT, EQUIVALENT, SURVIVED, Planted

PAGE = """# Which errors the tests notice

Errors are planted in the sources, one at a time, and the tests are asked to notice.
Of {planted} they catch {caught_count}. No input shows {equivalent_count} of the others, and {survived_count} survive.
A test suite that passes says little; one that fails when the code is wrong says more.

`python scripts/plant.py` makes one place in the sources wrong, runs the tests of its room until one fails, and takes
the error back. It writes this page and its rows ([planted.csv](planted.csv)) anew; `--room` and `--only` run a part
and keep the other rows. The errors are files in `scripts/studies/planted/errors`.

An error is caught when a test fails. It is equivalent when no input shows it; the table says why. What survives is
work to do.

{counts}

## Surviving

{surviving}

## Equivalent

{equivalent}

## Caught

{caught}
"""
OUTCOMES = (CAUGHT, EQUIVALENT, SURVIVED)


def counts(rows: Sequence[Planted]) -> list[tuple[object, ...]]:
    """Return name and numbers of planted, caught, equivalent and surviving errors of each folder, and of all."""
    rooms = dict.fromkeys(row.room for row in rows)
    result = [(room, *_counted(row for row in rows if row.room == room)) for room in rooms]
    return [*result, ("all", *_counted(rows))]


def page(rows: Sequence[Planted]) -> str:
    """Return the page as Markdown."""
    heads = ("room", "planted", *OUTCOMES)
    known = dict(zip(("planted", "caught_count", "equivalent_count", "survived_count"), _counted(rows), strict=True))
    parts = {
        "counts": "\n".join(markdown_table(heads, counts(rows))),
        "surviving": _table(rows, SURVIVED, "tests run"),
        "equivalent": _table(rows, EQUIVALENT, "why nothing shows"),
        "caught": _table(rows, CAUGHT, "first test that fails"),
    }
    return PAGE.format(**parts, **known)


def _counted(rows: Iterable[Planted]) -> list[int]:
    outcomes = [row.outcome for row in rows]
    return [len(outcomes), *(outcomes.count(outcome) for outcome in OUTCOMES)]


def _table(rows: Iterable[Planted], outcome: str, head: str) -> str:
    result = [(row.room, row.error, row.file.removeprefix("flexman_gym/"), row.by) for row in rows]
    kept = [cells for cells, row in zip(result, rows, strict=True) if row.outcome == outcome]
    return "\n".join(markdown_table(("room", "error", "file", head), kept)) if kept else "None."
