"""Form of a program that runs a study: it stores rows, and writes charts and pages from the stored rows."""

import argparse
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from flexman_gym.common.computer import computer_text
from flexman_gym.common.parallel import Workers
from studies.files import folder, made_comment, read_comments, read_rows, today, write_rows


class Table(NamedTuple):
    """File of rows.

    Attributes:
        file: name of the file without suffix, relative to the output folder.
        kind: dataclass of a row.
        digits: significant digits.
    """

    file: str
    kind: type
    digits: int = 6


QUICK: dict[str, dict[str, Any]] = {"--quick": {"action": "store_true", "help": "measure a small grid"}}
KEPT: dict[str, dict[str, Any]] = {
    "--kept": {"type": folder, "help": "folder of finished parts, from which an interrupted study resumes"}
}


@dataclass(frozen=True)
class Study:
    """Study of one or more files of rows.

    Attributes:
        tables: files of rows.
        measure: function of the options that returns the rows of each table, in their order; rows that are generated
            are not computed for tables that are not chosen.
        pages: file, relative to the output folder -> function of the rows of all tables, and of a dictionary of their
            files and comments, that returns the text of the page.
        charts: function of the output folder and the rows of all tables that draws the charts.
        report: function of the rows of all tables that prints a summary and returns the exit status, None for 0.
        options: own options: name -> keywords of `add_argument`.
        parallel: True for a study whose parts can be computed by several processes, see `Workers`.
        comment: function of the options that returns the comment of the files: the computer.
    """

    tables: Sequence[Table]
    measure: Callable[[argparse.Namespace], Iterable[Iterable[Any]]]
    pages: Mapping[str, Callable[..., str]] = field(default_factory=dict)
    charts: Callable[..., Any] | None = None
    report: Callable[..., int | None] | None = None
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    parallel: bool = False
    comment: Callable[[argparse.Namespace], str] = lambda _: computer_text()

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments to a parser."""
        names = [table.file for table in self.tables]
        parser.add_argument("--folder", type=folder, default="out", help="output folder (default: %(default)s)")
        parser.add_argument("--redraw", action="store_true", help="write charts and pages from stored rows")
        parser.add_argument("--tables", nargs="+", choices=names, default=names, help="files of rows to write")
        for name, keywords in self.options.items():
            parser.add_argument(name, **keywords)
        if self.parallel:
            Workers.arguments(parser)

    def run(self, options: argparse.Namespace) -> int:
        """Measure and store the rows, unless they are only drawn, write charts and pages, and return the exit status.

        Raises:
            FileNotFoundError: if a file of rows is missing.
        """
        warnings.filterwarnings("ignore", "Link.second_moment_y", UserWarning)  # printed area of link 1 of the paper
        for table, rows in zip(self.tables, () if options.redraw else self.measure(options), strict=not options.redraw):
            if table.file in options.tables:
                self._store(table, rows, options)
        return self.draw(options.folder)

    def _store(self, table: Table, rows: Iterable[Any], options: argparse.Namespace) -> None:
        """Print and write the rows of a table."""
        measured = []
        for row in rows:
            print(row, flush=True)
            measured.append(row)
        path = self._path(options.folder, table)
        path.parent.mkdir(parents=True, exist_ok=True)
        comment = made_comment(self.comment(options), today(), len(measured))
        write_rows(measured, path, table.digits, comment, table.kind)

    def draw(self, folder: Path) -> int:
        """Write charts and pages from the rows in a folder, print the summary, and return the exit status."""
        rows = self.rows(folder)
        if self.charts is not None:
            self.charts(folder, *rows)
        for file, text in self.texts(folder).items():
            (folder / file).write_text(text, encoding="utf-8")
        return (self.report(*rows) if self.report else 0) or 0

    def rows(self, folder: Path) -> list[list[Any]]:
        """Return the stored rows of all tables."""
        return [read_rows(self._path(folder, table), table.kind) for table in self.tables]

    def texts(self, folder: Path) -> dict[str, str]:
        """Return the pages of the stored rows: file -> text."""
        rows, files = self.rows(folder), read_comments(*(self._path(folder, table) for table in self.tables))
        return {file: page(*rows, files) for file, page in self.pages.items()}

    @staticmethod
    def _path(folder: Path, table: Table) -> Path:
        return folder / f"{table.file}.csv"
