"""Page of the planted errors: numbers and tables by part of the library."""

from collections.abc import Iterable, Sequence

from flexman_gym.common.markdown import markdown_table
from studies.planted.measure import CAUGHT, EQUIVALENT, SURVIVED, Planted

PAGE = """# Planted errors

The test suite is checked by mutation testing: errors are planted in the sources, one at a time, and the tests should
detect them. Of {planted} planted errors {caught_count} are caught, {equivalent_count} cannot be detected by any input,
and {survived_count} survive. A test suite is only useful if it fails when the code is wrong.

`python scripts/plant.py` plants each error, runs the tests of its part of the library until one fails, and reverts the
error. It rewrites this page and its rows ([planted.csv](planted.csv)); `--part` and `--only` select errors and keep the
other rows. The errors are defined in `scripts/studies/planted/errors`.

An error is *caught* if a test fails. It is *equivalent* if no input reveals it; the table gives the reason. A
*surviving* error needs another test.

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
    """Return the numbers of planted, caught, equivalent and surviving errors of each part, and of all parts."""
    names = dict.fromkeys(row.part for row in rows)
    result = [(part, *_counted(row for row in rows if row.part == part)) for part in names]
    return [*result, ("all", *_counted(rows))]


def page(rows: Sequence[Planted]) -> str:
    """Return the page as Markdown."""
    heads = ("part", "planted", *OUTCOMES)
    known = dict(zip(("planted", "caught_count", "equivalent_count", "survived_count"), _counted(rows), strict=True))
    parts = {
        "counts": "\n".join(markdown_table(heads, counts(rows))),
        "surviving": _table(rows, SURVIVED, "tests run"),
        "equivalent": _table(rows, EQUIVALENT, "reason"),
        "caught": _table(rows, CAUGHT, "first failing test"),
    }
    return PAGE.format(**parts, **known)


def _counted(rows: Iterable[Planted]) -> list[int]:
    outcomes = [row.outcome for row in rows]
    return [len(outcomes), *(outcomes.count(outcome) for outcome in OUTCOMES)]


def _table(rows: Iterable[Planted], outcome: str, head: str) -> str:
    result = [(row.part, row.error, row.file.removeprefix("flexman_gym/"), row.by) for row in rows]
    kept = [cells for cells, row in zip(result, rows, strict=True) if row.outcome == outcome]
    return "\n".join(markdown_table(("part", "error", "file", head), kept)) if kept else "None."
