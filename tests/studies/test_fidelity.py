"""Fidelity study: its rows judge the choices, and its page explains every column."""

import math
import sys
from dataclasses import fields, replace

import pytest

from studies.fidelity import measure
from studies.fidelity.measure import FidelityRow, open_scenes, rows, scenes
from studies.fidelity.page import COLUMNS, conclusion, page
from studies.files import read_rows, write_rows

from oracles.files import ROOT, command

NAMES = [field.name for field in fields(FidelityRow)]
ROW = FidelityRow("a scene", 1e-2, 8e-3, 9e-3, 9 / 8, 20.0, "ros2", 5e-3, 1e-3, 2e-3, 0.5)


@pytest.fixture(scope="module")
def published():
    """The rows in docs."""
    return read_rows(ROOT / "docs" / "fidelity.csv", FidelityRow)


def test_the_published_rows_have_the_columns_of_the_study(published):
    head = (ROOT / "docs" / "fidelity.csv").read_text(encoding="utf-8").splitlines()[0]
    assert head.split(",") == NAMES
    assert len(published) == len(scenes()) * len(measure.TOLERANCES)


def test_rows_survive_their_file(tmp_path):
    result = [ROW, replace(ROW, grid=math.inf, dearer=0.0)]
    write_rows(result, tmp_path / "rows.csv", 9)
    assert read_rows(tmp_path / "rows.csv", FidelityRow) == result


def test_every_column_of_the_table_is_explained_above_it(published):
    text = page(published)
    above, head, below = text.partition("| " + " | ".join(NAMES) + " |\n")
    assert head and list(COLUMNS) == NAMES
    assert all(f"- `{name}`: " in above for name in NAMES)
    assert below.count("\n") == 1 + len(published)
    first = published[0]
    assert f"| {first.scene} | {first.tolerance:.3g} | {first.error:.3g} |" in below


def test_the_conclusion_counts_choices():
    wrong, unsure, dear = replace(ROW, error=2e-2), replace(ROW, ratio=0.1), replace(ROW, dearer=2.1)
    text = conclusion([ROW, wrong, unsure, dear])
    assert "Of 4 choices:" in text and all(f"3 {verb} " in text for verb in ("meet", "know", "cost"))


def test_a_choice_is_measured_beside_plain_runs(monkeypatch):
    monkeypatch.setattr(measure, "TOLERANCES", (1e-1,))
    monkeypatch.setattr(measure, "GRID_METHODS", ("rk4",))
    monkeypatch.setattr(measure, "GRID_MODES", (2,))
    (row,) = rows("one link", scenes()["one link"])
    assert row.scene == "one link" and 0.0 < row.error <= row.tolerance == 1e-1
    assert row.ratio == pytest.approx(row.estimate / row.error) and 0.2 < row.ratio < 5.0
    assert row.dearer == pytest.approx(row.cost / row.grid) and 0.0 < row.cost < 1.0 and math.isfinite(row.grid)


def test_a_choice_with_an_open_mesh_is_measured_beside_plain_meshes(monkeypatch):
    monkeypatch.setattr(measure, "TOLERANCES", (1e-1,))
    monkeypatch.setattr(measure, "OPEN_METHODS", ("midpoint_2_sweeps",))
    monkeypatch.setattr(measure, "GRID_MODES", (2, 9))
    scene = open_scenes()["one link"]
    assert scene.model.elements is None
    (row,) = rows("one link", scene)
    assert 0.0 < row.error <= row.tolerance == 1e-1 and 1.0 / 3.0 < row.ratio < 3.0 and math.isfinite(row.grid)


def test_the_page_tells_of_open_meshes_apart():
    text = page([ROW], [replace(ROW, scene="an open one", error=2e-2)])
    first, _, second = text.partition("## With an open mesh")
    assert "| a scene |" in first and "| an open one |" in second and "Of 1 choices:" in second and "0 meet" in second


def test_the_command_writes_the_page_of_known_rows(tmp_path, monkeypatch, published):
    write_rows(published, tmp_path / "fidelity.csv", 9)
    monkeypatch.setattr(sys, "argv", ["fidelity.py", "--redraw", str(tmp_path)])
    command("fidelity").main()
    assert (tmp_path / "fidelity.md").read_text(encoding="utf-8") == page(published)
