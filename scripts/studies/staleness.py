"""Notes of old rows: on the pages of the site, and before a release."""

import re
from collections.abc import Iterable, Iterator
from pathlib import Path

import flexman_gym
from studies.evidence import CURRENT, STALE, Age, Checkout, EvidenceStudy
from studies.files import read_comment

NAMED = 3  # changes that a line names
NUMBERS = "scripts/readme.py --check --only README.md docs/index.md"  # reads the rows of the numbers of these pages
NOTE = '<p class="old"><em>{}</em></p>'
CHANGED = "These rows are older than the code: {} changed since version {} of {}."
UNRECORDED = "Measured numbers of this page{} may be older than the code: no record of it was kept when they were made."
VERSION = re.compile(r"flexman_gym (\d+\.\d+\.\d+)")


def described(age: Age) -> str:
    """Return the state of an age with the first changes."""
    return f"{age.state}: {_listed(age.changes)}" if age.changes else age.state


def _listed(changes: Iterable[str]) -> str:
    first = list(changes)
    more = len(first) - NAMED
    return ", ".join(first[:NAMED]) + (f" and {more} more" if more > 0 else "")


def versions(study: EvidenceStudy, root: Path) -> list[tuple[int, ...]]:
    """Return the versions (major, minor, patch) that the rows of a study name, the oldest first."""
    return sorted(_numbers(match[1]) for text in _comments(study, root) for match in VERSION.finditer(text))


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in version.split("."))


def _text(version: tuple[int, ...]) -> str:
    return ".".join(map(str, version))


def _comments(study: EvidenceStudy, root: Path) -> Iterator[str]:
    paths = (path for pattern in study.rows for path in sorted(root.glob(pattern)) if path.suffix == ".csv")
    yield from (read_comment(path) for path in paths)


def note(checkout: Checkout, study: EvidenceStudy) -> str:
    """Return the note on the pages of a study; "" if its rows are current."""
    age = checkout.rows_age(study)
    if age.state == CURRENT:
        return ""
    if age.state == STALE:
        known = checkout.record(study.name)
        return CHANGED.format(_listed(age.changes), known["version"], known["date"])
    oldest = "".join(f" are of version {_text(each)} and" for each in versions(study, checkout.root)[:1])
    return UNRECORDED.format(oldest)


def insert_notes(checkout: Checkout, known: Iterable[EvidenceStudy], site: Path) -> list[str]:
    """Insert a note below the title of each page of a built site whose rows are not current; return a line for each."""
    result, docs = [], checkout.root / "docs"
    for study in known:
        pages = {path for pattern in study.drawn for path in checkout.root.glob(pattern) if path.suffix == ".md"}
        text = note(checkout, study) if pages else ""
        for page in sorted(pages) if text else ():
            path = site / page.relative_to(docs).with_suffix(".html")
            title, end, rest = path.read_text(encoding="utf-8").partition("</h1>")
            path.write_text(f"{title}{end}\n{NOTE.format(text)}{rest}", encoding="utf-8")
            result.append(f"{path.relative_to(site)}: {text}")
    return result


def release_faults(checkout: Checkout, known: Iterable[EvidenceStudy]) -> list[str]:
    """Return a line for each study whose rows are too old for a release.

    Rows of the numbers of README and home must be current; others may be one version old.
    """
    result, read = [], checkout.files_read(NUMBERS)
    major, minor, _ = _numbers(flexman_gym.__version__)
    for study in known:
        age, root = checkout.rows_age(study), checkout.root
        own = {path.relative_to(root).as_posix() for pattern in study.rows for path in root.glob(pattern)}
        old = [each for each in versions(study, root) if each[:2] < (major, minor - 1)]
        if own & read and age.state != CURRENT:
            result.append(f"{study.name}, of README or home: {described(age)}")
        elif old:
            result.append(f"{study.name}: rows of version {_text(old[0])}, more than one version old")
    return result
