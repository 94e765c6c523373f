"""Tests of tables: all ways of writing numbers give the same ones, and other files are refused in one line."""

import numpy as np
import pytest

from flexman_gym.common.tables import read_table

from oracles.assertions import refusal

NUMBERS = np.array([[0.25 * i, 1.5 - 0.125 * i, -3.0 * i] for i in range(20)])
HEADS = ["time (s)", "acc (g)", "q"]


def text(separator=",", decimal=".", end="\n", heads=HEADS, rows=NUMBERS, tail=""):
    """The numbers with a line of headers."""
    lines = [separator.join(heads)] * bool(heads)
    lines += [separator.join(f"{each:.6f}".replace(".", decimal) for each in row) + tail for row in rows]
    return end.join(lines) + end


def written(path, content):
    """The table of a file."""
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_table(path)


FORMS = {
    "commas": text(),
    "semicolons": text(";"),
    "semicolons and decimal commas": text(";", ","),
    "tabs": text("\t"),
    "tabs and decimal commas": text("\t", ","),
    "carriage returns": text(end="\r\n"),
    "blank lines": text(end="\n\n"),
    "byte order mark": "\ufeff" + text(),
    "UTF-16": text("\t").encode("utf-16"),
    "quoted numbers with decimal commas": text('","', ",", rows=NUMBERS, heads=[]).replace("\n", '"\n"')[:-1].join(
        ['"time (s)","acc (g)","q"\n"', ""]),
    "comments": "# made by hand\n" + text().replace("\n", "\n# a remark\n", 3),
    "headers in a comment": "#" + text(),
    "spaces": text(" ", heads=["time", "acc", "q"]),
    "spaces and headers with brackets": text("   "),
    "spaces and headers with commas": "# time (s),acc (g),q\n" + text(" ", heads=[]),
    "trailing commas": text(tail=",", heads=[*HEADS, ""]),
    "trailing commas in numbers only": text(tail=","),
    "sep= of Excel": "sep=;\n" + text(";", ","),
    "preamble": "Device,Logger 3\nRate,1000\nComment\n" + text(),
    "zeros after a loss of power": text() + "\0" * 512,
    "times of arrival": "".join(f"12:00:00.{i:03d} -> {line}\n" for i, line in enumerate(text().splitlines())),
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_numbers_are_the_same_in_every_form(form, tmp_path):
    table = written(tmp_path / "a.csv", FORMS[form])
    assert table.values[:, :3] == pytest.approx(NUMBERS, abs=1e-6), form
    assert [each.strip() for each in table.headers[:3]] in (HEADS, ["time", "acc", "q"])


def test_symbols_in_windows_text_are_read(tmp_path):
    table = written(tmp_path / "a.csv", text(heads=["time (s)", "a (m/s²)", "q (°)"]).encode("cp1252"))
    assert table.headers == ["time (s)", "a (m/s²)", "q (°)"]


def test_a_line_of_units_below_the_headers_is_no_header(tmp_path):
    content = "time,acc,q\ns,m/s²,\n" + text(heads=[])
    table = written(tmp_path / "a.csv", content)
    assert (table.headers, table.units) == (["time", "acc", "q"], ["s", "m/s^2", ""])


def test_a_file_without_headers_has_none(tmp_path):
    assert written(tmp_path / "a.csv", text(heads=[])).headers is None


def test_empty_cells_are_nan_and_columns_of_text_are_kept_apart(tmp_path):
    rows = [f"{0.1 * i:.1f},base,{'' if i % 2 else i},{'NaN' if i == 4 else i}" for i in range(12)]
    table = written(tmp_path / "a.csv", "\n".join(["t,frame,a,b", *rows]))
    assert np.isnan(table.values[1::2, 2]).all() and np.isfinite(table.values[::2, 2]).all()
    assert np.flatnonzero(np.isnan(table.values[:, 3])).tolist() == [4]
    assert table.texts == {1: ["base"] * 12}


def test_columns_that_take_turns_are_numbers_whatever_their_period(tmp_path):
    for period in (2, 3, 4, 5, 8):
        lines = ["t,a,b", *(f"{i},{i if i % period else ''},{'' if i % period else i}" for i in range(720))]
        table = written(tmp_path / "a.csv", "\n".join(lines))
        assert not table.texts and np.isfinite(table.values[:, 2]).sum() == 720 // period


def test_what_is_not_read_is_in_the_notes(tmp_path):
    path = tmp_path / "a.csv"
    assert written(path, text()).notes == ()
    assert written(path, "Device,7 b\n" + text()).notes == ("1 line(s) before the numbers not read",)
    assert written(path, text() + "5.0,1").notes == ("line 22, the last one, is incomplete and not read",)
    assert written(path, text(";", ",")).notes == ("numbers have decimal commas",)


@pytest.mark.parametrize(
    ("content", "line"),
    [
        ("", "a.csv: this is no table; give headers, such as time (s),acc (m/s^2), and lines of numbers"),
        ("secret:x:0\nanother:y:1\n", "a.csv: this is no table; "),
        ("time (s),a (g)\n", "a.csv: this is no table; "),
        ("t:0.1,a:0.2\nt:0.2,a:0.3\n", "a.csv: this is no table; "),
        ("t,a\n0,1\n1,two\n2,3\n3,4\n", "a.csv: line 3: '1,two' is not allowed; give 2 finite numbers"),
        ("t,a\n0,1\n1,inf\n2,3\n", "a.csv: line 3: '1,inf' is not allowed; give 2 finite numbers"),
        ("t,a\n0,1\n1\n2,3\n3,4\n", "a.csv: line 3: '1' is not allowed; give 2 finite numbers"),
        ("t,a\n0,1\n1,2,3\n2,3\n3,4\n", "a.csv: line 3: '1,2,3' is not allowed; give 2 finite numbers"),
        ("t,a\n0,1\n1,2\nt,a\n0,1\n1,2\n", "a.csv: line 4 repeats the headers; give one record"),
        ("t,a,b\n0,1\n1,2\n", "a.csv: line 1: '3 headers' is not allowed; give 2, one for each column"),
        ('"t" "a"\n"1" 0 1\n"2" 1 2\n', "a.csv: line 1: '2 headers' is not allowed; give 3, one for each column"),
        ('t,a\n0,1\n"1,2\n2,3\n3,4\n', "a.csv: line 3: a quotation mark is not closed"),
        ("t;a\n0;1.234,5\n1;1.235,5\n", "a.csv: numbers have thousands separators, such as 1.234,5; write 1234.5"),
        (f"t,{'a' * 300}\n0,1\n1,2\n", "a.csv: the header: 'aaaa"),
        (bytes(range(256)), "a.csv: "),
    ],
)
def test_other_files_are_refused_in_one_line(content, line, tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    said = refusal(read_table, path)
    assert said.startswith(line) and "secret" not in said
