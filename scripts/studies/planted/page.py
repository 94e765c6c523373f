"""Page of the planted errors: numbers by part of the library."""

from collections.abc import Iterable, Mapping, Sequence

from studies.planted.measure import CAUGHT, EQUIVALENT, SURVIVED, Planted
from studies.screen import screen

OUTCOMES = (CAUGHT, EQUIVALENT, SURVIVED)
QUESTION = "Does the test suite fail when the code is wrong?"
ANSWER = """**Of {planted} errors planted in the sources, one at a time, {caught} are caught by a test, {equivalent}
cannot be detected by any input, and {survived} survive.**"""
BODY = """Errors by part of the library: {parts}.

An error is a small change of a line, such as a wrong sign. `scripts/plant.py` plants it, runs the tests of its part
until one fails, and reverts it. The errors are in `scripts/studies/planted/errors`; the rows name the first failing
test of each error, or the reason why no input can reveal it."""


def counts(rows: Sequence[Planted]) -> list[tuple[object, ...]]:
    """Return the numbers of planted, caught, equivalent and surviving errors of each part, and of all parts."""
    names = dict.fromkeys(row.part for row in rows)
    result = [(part, *_counted(row for row in rows if row.part == part)) for part in names]
    return [*result, ("all", *_counted(rows))]


def page(rows: Sequence[Planted], files: Mapping[str, str]) -> str:
    """Return the page as Markdown; `files` is the file of the rows with its comment."""
    *parts, (_, planted, caught, equivalent, survived) = counts(rows)
    answer = ANSWER.format(planted=planted, caught=caught, equivalent=equivalent, survived=survived)
    body = BODY.format(parts=", ".join(f"{name} {number}" for name, number, *_ in parts))
    return screen("Planted errors", QUESTION, answer, body, files, "planted")


def _counted(rows: Iterable[Planted]) -> list[int]:
    outcomes = [row.outcome for row in rows]
    return [len(outcomes), *(outcomes.count(outcome) for outcome in OUTCOMES)]
