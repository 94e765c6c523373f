"""Tables of numbers in text files: separators, decimal commas, comments, headers, and lines that are no numbers."""

import csv
import io
import math
import re
from array import array
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import chain, islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.checks import MAX_ENTRIES
from flexman_gym.common.errors import short_path, value_error
from flexman_gym.common.files import regular_file
from flexman_gym.common.units import find_unit

MAX_CSV_BYTES = 200_000_000  # bytes of a CSV file
MAX_LINE_LENGTH, MAX_HEADER_LENGTH = 100_000, 200  # characters of a line, and of the header of a column
MAX_NAME_LENGTH = 40  # characters of the name of a file in an error
SAMPLED_LINES, SAMPLED_TEXT = 60, 200_000  # lines, and characters, that decide about separator and columns of numbers
LEADING_LINES = 1000  # lines of a file among which the numbers begin
TABLE_SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".log", ".lvm")
COMMENTS = ("#", "%", "//")
MISSING = frozenset(("", "nan", "-nan", "na", "n/a", "#n/a", "null", "none", "-", "--"))
# (separator, decimal sign), the first of several that fit
DIALECTS = (("\t", "."), ("\t", ","), (";", "."), (";", ","), (",", "."), (",", ","), (" ", "."), (" ", ","))
_SERIAL = re.compile(r"^\d\d:\d\d:\d\d\.\d+ -> ")  # time of arrival that the Arduino monitor writes before a line
_THOUSANDS = re.compile(r"""(?:^|[;\t"])-?\d{1,3}(?:(?:\.\d{3})+,|(?:,\d{3})+\.)\d+(?:$|[;\t"])""")
_WORD = re.compile(r'"[^"]{0,200}"|[^\s(\["]+(?:\s{0,3}[(\[][^)\]\s]{0,40}[)\]])?')


class Table(NamedTuple):
    """Numbers of a text file.

    Attributes:
        path: path of the file.
        headers: header of each column (c,), "" where missing, or None for a file without a line of headers.
        units: units of the columns (c,) in a line below the headers, "" where missing.
        values: numbers (T, c), NaN in empty cells and in columns of text.
        lines: number of the line in the file, of each row (T,).
        texts: cells (T,) of the columns of text, by index of the column.
        notes: lines and columns that were not read, and conversions, of one line each.
    """

    path: Path
    headers: list[str] | None
    units: list[str]
    values: NDArray[np.float64]
    lines: list[int]
    texts: dict[int, list[str]]
    notes: tuple[str, ...]


def read_table(path: str | Path) -> Table:
    """Read a table of numbers from a text file, such as CSV.

    Columns are separated by tabs, semicolons, commas or spaces, whichever gives most numbers; numbers may have decimal
    commas. Comments and lines before the headers are skipped. The headers are the last line before the numbers with as
    many cells, perhaps in a comment, perhaps followed by a line of units.

    Args:
        path: path of the file.

    Raises:
        FileNotFoundError: if the file does not exist.
        ValueError: for a directory, a device or a pipe, more than 200 MB, more than a million lines (counted before
            parsing), a line of more than 100,000 characters, bytes that are no text, and a line that does not fit the
            others, with a one-line message. It contains the text of the file only if this is a table of numbers.
    """
    file = table_name(path)
    try:
        content = _text_lines(path)
        return _Parser(Path(path), content).table()
    except csv.Error as error:
        raise ValueError(f"{file}: {error}; give lines of numbers") from None


def is_table(path: str | Path) -> bool:
    """Return True for the path of a file with the suffix of a table."""
    return Path(path).suffix.lower() in TABLE_SUFFIXES


def table_name(path: str | Path) -> str:
    """Return the name of a file, shortened for an error message."""
    return short_path(Path(path).name, MAX_NAME_LENGTH)


def open_text(path: str | Path, encoding: str | None = None) -> io.TextIOWrapper:
    """Return the text of a file of at most a million lines, as a stream; None finds the encoding of the text.

    Raises:
        FileNotFoundError, ValueError: as in `read_table`; the message does not name the file.
    """
    content = regular_file(path, MAX_CSV_BYTES).read_bytes()
    count = max(content.count(b"\n"), content.count(b"\r"))
    if count > MAX_ENTRIES + 1:
        raise ValueError(f"{count} lines are not allowed; give 1 to {MAX_ENTRIES} of numbers")
    return io.TextIOWrapper(io.BytesIO(content), encoding=encoding or _encoding(content), newline="")


def short_lines(file: io.TextIOWrapper) -> Iterator[str]:
    """Yield the lines of a file after checking that none is longer than MAX_LINE_LENGTH."""
    while line := file.readline(MAX_LINE_LENGTH + 1):
        if len(line) > MAX_LINE_LENGTH:
            raise ValueError(f"a line of more than {MAX_LINE_LENGTH} characters is not allowed; give shorter lines")
        yield line


def _encoding(content: bytes) -> str:
    """Return the encoding of a text: UTF-16 if it starts with its mark, Windows-1252 if it is not UTF-8."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        if not re.search(rb"[\x00-\x08\x0e-\x1f\x7f\x81\x8d\x8f\x90\x9d]", content):
            return "cp1252"
    return "utf-8-sig"


def _text_lines(path: str | Path) -> list[str]:
    """Return the lines of a text file without line ends."""
    try:
        return [line.rstrip("\r\n\0") for line in short_lines(open_text(path))]
    except UnicodeError as error:
        raise ValueError(f"{table_name(path)}: {error}; give UTF-8 text") from None
    except ValueError as error:
        raise ValueError(f"{table_name(path)}: {error}") from None


class _Row(NamedTuple):
    """Number of a line and its cells."""

    line: int
    cells: list[str]


class _Parser:
    """Parser of the lines of a file."""

    def __init__(self, path: Path, lines: list[str]) -> None:
        self.path, self.file, self.notes = path, table_name(path), list[str]()
        numbered = [(i, line) for i, line in enumerate(lines, 1) if line.strip(" \t,;")]
        if numbered and re.fullmatch("sep=.", numbered[0][1].strip()):
            del numbered[0]
        self.comments = {i: line for i, line in numbered if line.lstrip(' "').startswith(COMMENTS)}
        self.lines = [each for each in numbered if each[0] not in self.comments]
        if self.lines and _SERIAL.match(self.lines[-1][1]):
            self.lines = [(number, _SERIAL.sub("", line)) for number, line in self.lines]
            self.notes.append("times of arrival before the lines (hh:mm:ss ->) are not read")
        self.separator, self.decimal, self.numeric, self.is_padded = self._dialect()
        self.count = len(self.numeric)

    def table(self) -> Table:
        """Return the table."""
        rows = self._rows(self.lines, self.separator)
        leading = list(islice(rows, LEADING_LINES))
        first = self._first(leading)
        headers, units = self._headers(leading[:first], leading[first].line)
        numbers, lines = array("d"), list[int]()
        texts = {i: list[str]() for i in np.flatnonzero(~self.numeric).tolist()}
        for row in chain(leading[first:], rows):
            if self._is_complete(row, headers):
                numbers.extend(self._numbers(row))
                lines.append(row.line)
                for i, cells in texts.items():
                    cells.append(row.cells[i])
        return Table(
            self.path, headers, units, np.array(numbers).reshape(-1, self.count), lines, texts, tuple(self.notes)
        )

    def _first(self, leading: Sequence[_Row]) -> int:
        """Return the index of the first row of numbers: after headers, or before another one."""
        data = [self._is_data(row) for row in leading]
        if not any(data):
            raise ValueError(f"{self.file}: its first {LEADING_LINES} lines have no numbers; leave such lines out")
        for i in np.flatnonzero(data).tolist():
            if all(data[i : i + 2]) or (i and self._fitting(leading[i - 1].cells, self.lines[i - 1][1])):
                return int(i)
        return data.index(True)

    def _dialect(self) -> tuple[str, str, NDArray[np.bool_], bool]:
        """Return separator and decimal sign that give most numbers.

        They are followed by (c,), True for columns of numbers, and by True if the last column is empty.
        """
        sample = self.lines[max(len(self.lines) // 4, 1) :] or self.lines
        sample = sample[:-1] if len(sample) > 2 else sample  # the last line may be cut off
        most = min(SAMPLED_LINES, max(SAMPLED_TEXT // max((len(line) for _, line in sample), default=1), 1))
        sample, best = sample[:: 1 + len(sample) // most], (0.0, 0)
        result: tuple[str, str, NDArray[np.bool_], bool] | None = None
        for separator, decimal in DIALECTS:
            rows = [row.cells for row in self._rows(sample, separator)]
            lengths = Counter(map(len, rows))
            count = max(lengths, key=lambda each: (lengths[each], each), default=0)
            if count < 2:
                continue
            cells = [[_number(cell, decimal) for cell in row] for row in rows if len(row) == count]
            numeric = np.array([[each is not None for each in row] for row in cells]).reshape(-1, count).mean(0) >= 0.5
            found = sum(each is not None and not math.isnan(each) for row in cells for each in row)
            filled = sum(cell.strip().lower() not in MISSING for row in rows for cell in row)
            if found and (found / filled, found) > best:
                padded = not any(row[-1].strip() for row in rows if len(row) == count)
                best, result = (found / filled, found), (separator, decimal, numeric, padded)
        if any(_THOUSANDS.search(line) for _, line in sample):
            raise ValueError(f"{self.file}: numbers have thousands separators, such as 1.234,5; write 1234.5")
        if result is None:
            example = "time (s),acc (m/s^2)"
            raise ValueError(f"{self.file}: this is no table; give headers, such as {example}, and lines of numbers")
        if result[1] == ",":
            self.notes.append("numbers have decimal commas")
        return result

    def _rows(self, lines: Sequence[tuple[int, str]], separator: str) -> Iterator[_Row]:
        """Yield the cells of numbered lines."""
        texts = (line.strip() if separator == " " else line.strip(" ") for _, line in lines)
        read, done = csv.reader(texts, delimiter=separator, skipinitialspace=True), 0
        for cells in read:
            if read.line_num > done + 1:
                raise ValueError(f"{self.file}: line {lines[done][0]}: a quotation mark is not closed; close it")
            yield _Row(lines[done][0], cells)
            done = read.line_num

    def _is_data(self, row: _Row) -> bool:
        """Return True for a row with a number, and no other text, in the columns of numbers."""
        cells = [_number(cell, self.decimal) for cell, each in zip(row.cells, self.numeric, strict=False) if each]
        return None not in cells and any(each is not None and not math.isnan(each) for each in cells)

    def _headers(self, before: Sequence[_Row], line: int) -> tuple[list[str] | None, list[str]]:
        """Return headers, None without, and units of the columns from the lines before the numbers."""
        texts, rows = dict(self.lines[: len(before)]), {row.line: row.cells for row in before}
        fitting = {number: cells for number in rows if (cells := self._fitting(rows[number], texts[number]))}
        if not fitting:
            comments = {i: text.lstrip(' "#%/').rstrip('"') for i, text in self.comments.items() if i < line}
            split = {i: [cell.strip(' "') for cell in text.split(self.separator)] for i, text in comments.items()}
            fitting = {i: cells for i, text in comments.items() if (cells := self._fitting(split[i], text))}
        units, numbers, headers = [""] * self.count, sorted(fitting), None
        if len(numbers) > 1 and all(find_unit(cell) or not cell.strip() for cell in fitting[numbers[-1]]):
            units = [find_unit(cell) or "" for cell in fitting[numbers[-1]]]
            rows.pop(numbers.pop(), None)
        if numbers:
            headers = [cell.strip() for cell in fitting[numbers[-1]]]
            rows.pop(numbers[-1], None)
            longest = max(headers, key=len)
            if len(longest) > MAX_HEADER_LENGTH:
                raise value_error(f"{self.file}: the header", longest, f"at most {MAX_HEADER_LENGTH} characters")
        elif before and len(before[-1].cells) > 1 and not self._has_number(before[-1]):
            given = f"{len(before[-1].cells)} headers"
            raise value_error(f"{self.file}: line {before[-1].line}", given, f"{self.count}, one for each column")
        if rows:
            self.notes.append(f"{len(rows)} line(s) before the numbers not read")
        return headers, units

    def _has_number(self, row: _Row) -> bool:
        """Return True for a row with a number or an empty cell."""
        return any(_number(cell, self.decimal) is not None for cell in row.cells)

    def _fitting(self, cells: list[str], text: str) -> list[str] | None:
        """Return the cells of a line before the numbers if they are words, one for each column; None otherwise.

        The separator may be another one than that of the numbers.
        """
        splits = [[cell.strip(' "') for cell in text.split(sign)] for sign in "\t;,"]
        splits = (
            [*splits, [each.strip('"') for each in _WORD.findall(text)]] if self.separator == " " else [cells, *splits]
        )
        for each in splits:
            cut = each[: self.count] if not any(map(str.strip, each[self.count :])) else each
            if len(cut) == self.count - 1 and self.is_padded:
                cut = [*cut, ""]
            words = [cell for cell in cut if cell.strip()]
            if len(cut) == self.count and words and all(_number(cell, self.decimal) is None for cell in words):
                return cut
        return None

    def _is_complete(self, row: _Row, headers: list[str] | None) -> bool:
        """Return True for a row with a cell for each column, False for a last line that was cut off."""
        if len(row.cells) < self.count and row.line == self.lines[-1][0] and len(self.lines) > 2:
            self.notes.append(f"line {row.line}, the last one, is incomplete and not read")
            return False
        if headers and [cell.strip() for cell in row.cells][: self.count] == headers:
            raise ValueError(f"{self.file}: line {row.line} repeats the headers; give one record")
        if len(row.cells) < self.count or any(map(str.strip, row.cells[self.count :])):
            raise self._line_error(row)
        return True

    def _numbers(self, row: _Row) -> list[float]:
        """Return the numbers (c,) of a row, NaN in columns of text."""
        cells = zip(row.cells, self.numeric.tolist(), strict=False)
        found = [_number(cell, self.decimal) if numeric else math.nan for cell, numeric in cells]
        if any(each is None or math.isinf(each) for each in found):
            raise self._line_error(row)
        return found  # type: ignore[return-value]

    def _line_error(self, row: _Row) -> ValueError:
        """Return the error of a line that does not fit the others."""
        text = self.separator.join(row.cells)
        return value_error(f"{self.file}: line {row.line}", text, f"{self.count} finite numbers")


def _number(cell: str, decimal: str) -> float | None:
    """Return the number in a cell, NaN for an empty cell, None for other text."""
    try:
        if decimal == ".":
            return float(cell)
        return None if "." in cell else float(cell.replace(",", "."))
    except ValueError:
        return math.nan if cell.strip().lower() in MISSING else None


def read_csv_rows(path: str | Path) -> Iterator[list[str]]:
    """Read a CSV file of this package line by line.

    Args:
        path: path of the file.

    Yields:
        list[str]: The entries of a line, the header first.

    Raises:
        FileNotFoundError: if the file does not exist.
        ValueError: for a directory, a device or a pipe, more than 200 MB, more than a million lines (counted before
            parsing), a line of more than 100,000 characters and bytes that are not UTF-8, with a one-line message that
            contains the name of the file but not its text.
    """
    try:
        yield from csv.reader(short_lines(open_text(path, "utf-8-sig")))
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{table_name(path)}: {error}; give UTF-8 text with commas") from None
    except ValueError as error:
        raise ValueError(f"{table_name(path)}: {error}") from None
