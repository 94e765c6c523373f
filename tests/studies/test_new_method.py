"""Tests of a new entry of `METHODS`: it is in every grid of the studies; and of the line styles of charts."""

from dataclasses import replace

import numpy as np
import pytest

from flexman_gym.common.plot_style import rgb
from flexman_gym.scene import catalog
from flexman_gym.simulation.methods import METHODS
from flexman_gym.toolbox.precision.runs import PrecisionRow as Run
from flexman_gym.toolbox.precision.runs import PrecisionScene, ReferenceSolution
from studies.methods import explicit_methods, line_styles
from studies.precision.charts import SHOWN as precision
from studies.precision.measure import grid
from studies.ringdown.page import SHOWN as ring_down
from studies.stability.rows import amplification_rows, drift_rows, limit_rows

NEW, MODEL = "a_new_method", "2 elements a link"
KINDS = ["rk4", "dopri5", "ros2", "extrapolated_euler_4", "gauss_2", "implicit_midpoint", "generalised_alpha"]
RUN = Run("a scene", MODEL, NEW, None, None, 1.0, 1.0, 100.0, 1e-6, 1e-2, "ok")


def add(monkeypatch, model):
    """Add a method that equals an existing one except for its name."""
    monkeypatch.setitem(METHODS._own, NEW, replace(METHODS[model], name=NEW))


def runs(monkeypatch):
    """Return the rows of the full grid of one model without computing them."""

    def ladder(study, model, method, settings, patience, adaptive=False):
        for setting in settings:
            known = {"rtol" if adaptive else "step": setting, "cpu": 1.0 / setting, "time_error": 0.01 * setting}
            yield replace(RUN, model=model, method=method, **known)

    monkeypatch.setattr(PrecisionScene, "ladder", ladder)
    return list(
        grid(
            PrecisionScene("a scene", catalog.paper_scene("ff"), {MODEL: None}, ReferenceSolution(None, 0.0, ""), {}),
            (MODEL,),
        )
    )


@pytest.mark.parametrize("kind", KINDS)
def test_a_new_method_takes_as_many_steps_and_tolerances_as_its_kind(kind, monkeypatch):
    add(monkeypatch, kind)
    result = runs(monkeypatch)
    new, old = ([row.step or row.rtol for row in result if row.method == name] for name in (NEW, kind))
    assert len(new) > 5 and set(new) <= set(old)


@pytest.mark.slow
def test_a_new_method_is_measured_by_the_study_of_stability(monkeypatch):
    add(monkeypatch, "ros2")
    assert NEW in {row.method for row in amplification_rows()}
    assert NEW in {row.method for row in drift_rows(100)}
    add(monkeypatch, "rk4")
    assert NEW in {row.method for row in limit_rows("payload", quick=True)}


@pytest.mark.parametrize("shown", [precision, ring_down, explicit_methods()])
def test_no_two_lines_of_a_chart_have_the_same_style(shown):
    styles = line_styles(shown)
    assert list(styles) == list(shown) and set(shown) <= set(METHODS)
    for key in ("color", "marker"):
        assert len({style[key] for style in styles.values()}) == len(shown)
    assert all(contrast(style["color"]) >= 3.0 for style in styles.values())


def contrast(colour):
    """Return the contrast of a colour on white, after WCAG 2."""
    parts = rgb(colour) / 255.0
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return 1.05 / (linear @ (0.2126, 0.7152, 0.0722) + 0.05)
