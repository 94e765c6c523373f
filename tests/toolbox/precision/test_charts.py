"""Charts of error against computing time: front, ring of the default, conclusion."""

import math
from dataclasses import replace

import pytest

from flexman_gym.toolbox.precision.charts import conclusion, draw_panel, draw_scenes, front_of
from flexman_gym.toolbox.precision.runs import PrecisionRow
from flexman_gym.toolbox.precision.scene_runs import DEFAULT, DEFAULT_METHOD

ROW = PrecisionRow("a scene", DEFAULT, DEFAULT_METHOD, 5e-3, None, 2e-3, 2e-3, 600.0, None, 3e-2, "ok")
COARSE = replace(ROW, step=1e-2, cpu=1e-3, total_error=1e-2)  # less error than with half its step: by chance
FINE = replace(ROW, model="a mesh", step=2e-3, cpu=4e-3, total_error=2e-3)
PEER = replace(ROW, model="MuJoCo, 8 pieces", method="Euler", cpu=0.8, total_error=4e-3)


def test_errors_that_cancel_by_chance_are_not_on_the_front():
    assert front_of([ROW, COARSE, FINE, PEER]) == [COARSE, FINE]
    assert front_of([ROW, replace(COARSE, cpu=3e-3), FINE]) == [ROW, FINE], "as if its error was that of the finer step"
    assert front_of([ROW, replace(FINE, status="diverged")]) == [ROW]


def test_errors_below_that_of_the_reference_are_equal():
    finer = replace(FINE, step=1e-3, cpu=8e-3, total_error=1e-3)
    assert front_of([ROW, FINE, finer]) == [ROW, FINE, finer]
    assert front_of([ROW, FINE, finer], floor=2e-3) == [ROW, FINE]


def test_the_conclusion_compares_with_the_cheapest_run_as_accurate():
    slower = replace(PEER, cpu=1.6, total_error=1e-3)
    assert conclusion([ROW, FINE, slower, PEER]).endswith("MuJoCo takes 400 times as long for the same error")
    assert conclusion([ROW, replace(PEER, total_error=5e-2)]).endswith("no other simulator has a smaller error")
    assert conclusion([ROW, replace(PEER, model="MuJoCo, rigid links", total_error=1e-3)]).endswith("2 ms per s")
    assert conclusion([replace(ROW, status="diverged")]) == "The default is diverged"


def test_the_default_has_a_ring_and_all_simulators_a_label():
    axes = pytest.importorskip("matplotlib.figure").Figure().subplots()
    draw_panel(axes, [ROW, COARSE, FINE, PEER, replace(PEER, status="diverged", total_error=math.nan)], 1e-3, "title")
    rings = [line for line in axes.lines if line.get_markerfacecolor() == "none"]
    assert [(*line.get_xdata(), *line.get_ydata()) for line in rings] == [(1e3 * ROW.cpu, 1e3 * ROW.total_error)]
    words = [text.get_text().replace("\n", " ") for text in axes.texts]
    assert words == ["flexman_gym", "MuJoCo, rigid pieces", "default", "error of the reference"]


def test_a_picture_has_a_panel_for_each_scene(tmp_path):
    pytest.importorskip("matplotlib")
    path = draw_scenes([([ROW, FINE], 1e-3, str(i)) for i in range(3)], tmp_path / "a.svg")
    assert path.read_text().count('id="axes_') == 3
