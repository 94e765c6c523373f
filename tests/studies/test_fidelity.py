"""Tests of the fidelity study: measured errors and costs of chosen models."""

import math
from dataclasses import fields

import pytest

from studies.fidelity import measure
from studies.fidelity.measure import FidelityRow, open_scenes, rows, scenes
from studies.files import read_rows

from oracles.files import ROOT

NAMES = [field.name for field in fields(FidelityRow)]


@pytest.fixture(scope="module")
def published():
    """Return the published rows."""
    return read_rows(ROOT / "docs" / "evidence" / "fidelity.csv", FidelityRow)


@pytest.mark.evidence
def test_the_published_rows_have_the_columns_of_the_study(published):
    head = (ROOT / "docs" / "evidence" / "fidelity.csv").read_text(encoding="utf-8").splitlines()[1]
    assert head.split(",") == NAMES
    assert len(published) == len(scenes()) * len(measure.TOLERANCES)


@pytest.mark.slow
def test_a_choice_is_measured_beside_plain_runs(monkeypatch):
    monkeypatch.setattr(measure, "TOLERANCES", (1e-1,))
    monkeypatch.setattr(measure, "GRID_METHODS", ("rk4",))
    monkeypatch.setattr(measure, "GRID_MODES", (2,))
    (row,) = rows("one link", scenes()["one link"])
    assert row.scene == "one link" and 0.0 < row.error <= row.tolerance == 1e-1
    assert row.ratio == pytest.approx(row.estimate / row.error) and 0.2 < row.ratio < 5.0
    assert row.dearer == pytest.approx(row.cost / row.grid) and 0.0 < row.cost < 1.0 and math.isfinite(row.grid)


@pytest.mark.slow
def test_a_choice_with_an_open_mesh_is_measured_beside_plain_meshes(monkeypatch):
    monkeypatch.setattr(measure, "TOLERANCES", (1e-1,))
    monkeypatch.setattr(measure, "OPEN_METHODS", ("midpoint_2",))
    monkeypatch.setattr(measure, "GRID_MODES", (2, 9))
    scene = open_scenes()["one link"]
    assert scene.model.elements is None
    (row,) = rows("one link", scene)
    assert 0.0 < row.error <= row.tolerance == 1e-1 and 1.0 / 3.0 < row.ratio < 3.0 and math.isfinite(row.grid)
