"""Files of a study: the output folder, and tables of rows in CSV."""

import argparse
import csv
import os
from collections.abc import Sequence
from dataclasses import fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

from flexman_gym.common.files import CONVERSION


def folder(text: str) -> Path:
    """Return a writable folder, created if necessary; for `type` of an argument.

    Raises:
        argparse.ArgumentTypeError: one line with what is wrong.
    """
    path = Path(text)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    if not os.access(path, os.W_OK):
        raise argparse.ArgumentTypeError(f"{path} cannot be written; give a folder of yours")
    return path


Kind = TypeVar("Kind")
COMMENT = "# "  # prefix of a comment line in a CSV file
MADE = "; made "  # begins the part of a comment with the date of the rows, their number, and the hash of their code
CODE = ", code "  # begins the hash
WAITING = "waiting for new rows: "  # begins the reason in a comment for which the rows are no longer current


def write_rows(rows: Sequence[Any], path: Path, digits: int = 6, comment: str = "", kind: type | None = None) -> None:
    """Write rows of the same dataclass to a CSV file below an optional comment; None is an empty cell.

    Args:
        rows: rows; at least one, if `kind` is not given.
        path: path of the file.
        digits: significant digits.
        comment: text of the first line; "" for none.
        kind: dataclass of the rows.
    """
    names = [field.name for field in fields(kind or type(rows[0]))]
    with path.open("w", newline="", encoding="utf-8") as file:
        if comment:
            file.write(f"{COMMENT}{comment}\n")
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        for row in rows:
            values = (getattr(row, name) for name in names)
            writer.writerow([f"{value:.{digits}g}" if isinstance(value, float) else value for value in values])


def read_rows(path: Path, kind: type[Kind]) -> list[Kind]:
    """Read the rows of a CSV file as a dataclass whose fields are strings, numbers or None.

    Raises:
        ValueError: for a column that is no field of the dataclass.
    """
    texts = {field.name for field in fields(kind) if field.type is str}  # type: ignore[arg-type]
    with path.open(newline="", encoding="utf-8") as file:
        lines = csv.DictReader(line for line in file if not line.startswith(COMMENT))
        for name in lines.fieldnames or ():
            if name not in {field.name for field in fields(kind)}:  # type: ignore[arg-type]
                raise ValueError(f"{path}: {name} is not a column of {kind.__name__}; {CONVERSION}")
        return [kind(**{name: _value(text, name in texts) for name, text in line.items()}) for line in lines]


def read_comment(path: Path) -> str:
    """Return the comment above the rows of a CSV file."""
    with path.open(newline="", encoding="utf-8") as file:
        return file.readline().removeprefix(COMMENT).strip()


def read_comments(*paths: Path) -> dict[str, str]:
    """Return file name -> comment of CSV files."""
    return {path.name: read_comment(path) for path in paths}


def today() -> str:
    """Return the date of today, as 2026-11-30."""
    return datetime.now(UTC).date().isoformat()


def made_comment(computer: str, date: str, rows: int) -> str:
    """Return the comment of rows that are made: computer, date (2026-11-30) and number of rows."""
    return f"{computer}{MADE}{date}, {rows} row{'s' * (rows != 1)}"


def add_code(path: Path, code: str) -> None:
    """Add the hash of the code to the comment of a CSV file that has the date of its rows."""
    head, _, rows = path.read_text(encoding="utf-8").partition("\n")
    if MADE in head:
        path.write_text(f"{head.partition(CODE)[0]}{CODE}{code}\n{rows}", encoding="utf-8")


def split_made(computer: str) -> tuple[str, str]:
    """Return the computer of a comment without the rest, and the date of the rows; "" if it is not recorded."""
    computer, _, made = computer.partition(MADE)
    return computer, made.partition(",")[0]


def split_waiting(comment: str) -> tuple[str, str]:
    """Return the computer of a comment, and the reason for which its rows wait for new ones; "" if they do not.

    A new run of a study writes a new comment, so that the reason goes with the rows that it describes.
    """
    computer, _, reason = comment.partition(WAITING)
    return computer.removesuffix("; "), reason


def _value(text: str, is_text: bool) -> Any:
    if is_text:
        return text
    return float(text) if text else None
