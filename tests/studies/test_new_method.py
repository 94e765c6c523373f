"""New methods: one more entry of `METHODS` is in every grid, table and chart of the studies, with a look of its own."""

from dataclasses import replace

import pytest

from flexman_gym.scene import catalog
from flexman_gym.simulation.methods import METHODS
from studies.files import read_rows
from studies.methods import COLOURS, MARKERS, fixed_step_methods, looks
from studies.precision import charts as precision_charts
from studies.precision.measure import Floor, ReferenceSolution, Study, grid
from studies.precision.measure import PrecisionRow as Run
from studies.precision.page import cost_table, page
from studies.stability import charts as stability_charts
from studies.stability.measure import StabilityRow
from studies.stability.page import map_sections
from studies.stability.page import page as stability_page
from studies.stability.rows import amplification_rows, drift_rows, limit_rows

from oracles.files import ROOT

NEW, MODEL = "a_new_method", "2 elements a link"
KINDS = ["rk4", "dopri5", "ros2", "extrapolated_euler_4", "gauss_2_sweeps", "implicit_midpoint", "generalised_alpha"]
RUN = Run("a scene", MODEL, NEW, None, None, 1.0, 1.0, 100.0, 1e-6, 1e-2, "ok")


def add(monkeypatch, model):
    """Offers one more method, the same as a model but for its name."""
    monkeypatch.setitem(METHODS, NEW, replace(METHODS[model], name=NEW))


def runs(monkeypatch):
    """The rows of the full grid on one model, of which none is computed."""

    def ladder(study, model, method, settings, patience, adaptive=False):
        for setting in settings:
            known = {"rtol" if adaptive else "step": setting, "cpu": 1.0 / setting, "time_error": 0.01 * setting}
            yield replace(RUN, model=model, method=method, **known)

    monkeypatch.setattr(Study, "ladder", ladder)
    return list(
        grid(Study("a scene", catalog.paper_scene("ff"), {MODEL: None}, ReferenceSolution(None, 0.0, ""), {}), (MODEL,))
    )


def lines_of(text, name):
    """Lines of tables about a method."""
    return [line for line in text.splitlines() if line.startswith(f"| {name} |")]


def doubled(model):
    """The published rows of the study of stability, those of a method once more under the new name."""
    rows = read_rows(ROOT / "docs" / "stability.csv", StabilityRow)
    return [*rows, *(replace(row, method=NEW) for row in rows if row.method == model)]


def texts_of(figure):
    """Titles, legends and ticks of a figure."""
    result = [label for axes in figure.get_axes() for label in axes.get_legend_handles_labels()[1]]
    for axes in figure.get_axes():
        result += [axes.get_title(), *(tick.get_text() for tick in axes.get_yticklabels())]
    return " ".join(result)


@pytest.mark.parametrize("kind", KINDS)
def test_a_new_method_takes_as_many_steps_and_tolerances_as_its_kind(kind, monkeypatch):
    add(monkeypatch, kind)
    result = runs(monkeypatch)
    new, old = ([row.step or row.rtol for row in result if row.method == name] for name in (NEW, kind))
    assert len(new) > 5 and set(new) <= set(old)


def test_a_new_method_is_in_the_tables_and_charts_of_precision(monkeypatch, tmp_path):
    pytest.importorskip("matplotlib")
    add(monkeypatch, "extrapolated_euler_4")
    result = runs(monkeypatch)
    assert len(lines_of("\n".join(cost_table(result, MODEL)), NEW)) == 1
    floors = [Floor("a scene", "a title", model, 1e-9, "a source") for model in ("", MODEL)]
    lines = page(result, floors).splitlines()
    (head,) = (i for i, line in enumerate(lines) if line.startswith("| scene |") and f"| {NEW} |" in line)
    ratios = dict(zip(lines[head].split(" | "), lines[head + 2].split(" | "), strict=True))
    assert ratios[f"{NEW} |"] == "1 |"  # as dear as ros2
    figures = []
    monkeypatch.setattr(precision_charts, "finish", lambda figure, panels, path: figures.append(figure))
    precision_charts.time_error_chart(result, {MODEL: 1e-9}, "a title", tmp_path / "a.png")
    assert NEW in texts_of(figures[0]) and f"{NEW}, adaptive" in texts_of(figures[0])


@pytest.mark.parametrize("kind", ["rk4", "ros2"])
def test_a_new_method_is_in_the_tables_and_charts_of_stability(kind, monkeypatch):
    pytest.importorskip("matplotlib")
    add(monkeypatch, kind)
    rows = doubled(kind)
    text = stability_page("a machine", rows)
    assert len(lines_of(text, NEW)) == len(lines_of(text, kind)) == 9
    assert sum(line.startswith(f"| {NEW} |") for line in map_sections(rows)) == 5
    for study, chart in stability_charts.CHARTS.items():
        if kind == "rk4" or study != stability_charts.LIMIT:
            assert NEW in texts_of(chart(study, rows)), study


def test_a_map_has_a_panel_for_each_method(monkeypatch):
    pytest.importorskip("matplotlib")
    add(monkeypatch, "ros2")
    rows = doubled("ros2")
    panels = stability_charts.CHARTS["modes"]("modes", rows).get_axes()
    shown = [axes for axes in panels if axes.get_visible()]
    methods = {row.method for row in rows if row.study == "modes"}
    assert NEW in methods and len(shown) == len(methods) == len(fixed_step_methods())


def test_a_new_method_is_measured_by_the_study_of_stability(monkeypatch):
    add(monkeypatch, "ros2")
    assert NEW in {row.method for row in amplification_rows()}
    assert NEW in {row.method for row in drift_rows(100)}
    add(monkeypatch, "rk4")
    assert NEW in {row.method for row in limit_rows("payload", quick=True)}


def test_no_two_methods_have_the_same_look(monkeypatch):
    before = looks()
    assert len(set(before.values())) == len(before) == len(METHODS) and len(COLOURS) == len(MARKERS)
    for number in range(50):
        monkeypatch.setitem(METHODS, f"{NEW}_{number}", METHODS["ros2"])
    after = looks()
    assert len(set(after.values())) == len(after) == len(METHODS)
    fixed = [name for name in before if not METHODS[name].adaptive]
    assert [after[name] for name in fixed] == [before[name] for name in fixed]  # the old ones keep theirs
