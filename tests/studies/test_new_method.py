"""Tests of a new entry of `METHODS`: it is in every grid, table and chart of the studies, with its own line style."""

from dataclasses import replace

import pytest

from flexman_gym.scene import catalog
from flexman_gym.simulation.methods import METHODS
from studies.methods import COLOURS, MARKERS, line_styles
from studies.precision.measure import PrecisionRow as Run
from studies.precision.measure import ReferenceSolution, Study, grid
from studies.stability.rows import amplification_rows, drift_rows, limit_rows

NEW, MODEL = "a_new_method", "2 elements a link"
KINDS = ["rk4", "dopri5", "ros2", "extrapolated_euler_4", "gauss_2", "implicit_midpoint", "generalised_alpha"]
RUN = Run("a scene", MODEL, NEW, None, None, 1.0, 1.0, 100.0, 1e-6, 1e-2, "ok")


def add(monkeypatch, model):
    """Add a method that equals an existing one except for its name."""
    monkeypatch.setitem(METHODS, NEW, replace(METHODS[model], name=NEW))


def runs(monkeypatch):
    """Return the rows of the full grid of one model without computing them."""

    def ladder(study, model, method, settings, patience, adaptive=False):
        for setting in settings:
            known = {"rtol" if adaptive else "step": setting, "cpu": 1.0 / setting, "time_error": 0.01 * setting}
            yield replace(RUN, model=model, method=method, **known)

    monkeypatch.setattr(Study, "ladder", ladder)
    return list(
        grid(Study("a scene", catalog.paper_scene("ff"), {MODEL: None}, ReferenceSolution(None, 0.0, ""), {}), (MODEL,))
    )


@pytest.mark.parametrize("kind", KINDS)
def test_a_new_method_takes_as_many_steps_and_tolerances_as_its_kind(kind, monkeypatch):
    add(monkeypatch, kind)
    result = runs(monkeypatch)
    new, old = ([row.step or row.rtol for row in result if row.method == name] for name in (NEW, kind))
    assert len(new) > 5 and set(new) <= set(old)


def test_a_new_method_is_measured_by_the_study_of_stability(monkeypatch):
    add(monkeypatch, "ros2")
    assert NEW in {row.method for row in amplification_rows()}
    assert NEW in {row.method for row in drift_rows(100)}
    add(monkeypatch, "rk4")
    assert NEW in {row.method for row in limit_rows("payload", quick=True)}


def test_no_two_methods_have_the_same_look(monkeypatch):
    before = line_styles()
    assert len(set(before.values())) == len(before) == len(METHODS) and len(COLOURS) == len(MARKERS)
    for number in range(50):
        monkeypatch.setitem(METHODS, f"{NEW}_{number}", METHODS["ros2"])
    after = line_styles()
    assert len(set(after.values())) == len(after) == len(METHODS)
    fixed = [name for name in before if not METHODS[name].adaptive]
    assert [after[name] for name in fixed] == [before[name] for name in fixed]  # the old ones keep theirs
