"""Figures of the paper: curves, plots and tables have the differences that their titles and heads name."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread

import flexman_gym as fm
from flexman_gym.toolbox.view.paper import FIGURES, paper_curves, paper_figures

DURATION = 0.1  # s


def simulated(case, **changes):
    """Return the trajectory of a case of the paper for a tenth of a second."""
    scene = replace(fm.catalog.paper_scene(case), **{"duration": DURATION, "output_step": 0.02} | changes)
    return fm.simulate(scene, method="ros2", step=1e-3)


@pytest.fixture(scope="module")
def cases():
    """The paper's cases for a tenth of a second."""
    return [simulated(case) for case in ("rr", "fr", "ff")]


def ended(trajectory):
    """Return a trajectory that diverges after its third output."""
    parts = {name: value[:3] for name, value in vars(trajectory).items() if isinstance(value, np.ndarray)}
    return replace(trajectory, **parts, status="diverged")


def table(path):
    """Return head and rows of a CSV file."""
    head, *rows = path.read_text().splitlines()
    return head.split(","), np.array([[float(each) for each in row.split(",")] for row in rows])


@pytest.mark.slow
def test_every_curve_is_the_flexible_arm_less_the_rigid_one(cases, drawn, tmp_path):
    """Figures 6 to 8 are of the tip along x, y and z, 9 to 11 of the three joints; the page of all repeats them."""
    rigid, *flexible = cases
    paper_figures(*cases, tmp_path)
    whole = [figure.axes[0] for figure in drawn[:6]], drawn[6].axes
    for number, pair in enumerate(zip(*whole, strict=True), start=6):
        kind, column, unit = ("tip", number - 6, "m") if number < 9 else ("joint_angles", number - 9, "rad")
        expected = [getattr(case, kind)[:, column] - getattr(rigid, kind)[:, column] for case in flexible]
        for axes in pair:
            curves = {line.get_label(): line.get_data() for line in axes.get_lines() if line.get_label()[0] != "_"}
            assert axes.get_title().startswith(f"Figure {number}: ")
            assert list(curves) == ["flexible links, rigid joints", "flexible links and joints"]
            for (time, values), case, difference in zip(curves.values(), flexible, expected, strict=True):
                assert np.array_equal(time, case.time) and np.array_equal(values, difference)
        assert pair[0].get_ylabel() == f"difference to the rigid arm ({unit})"
        head, rows = table(tmp_path / f"figure_{number:02d}.csv")
        assert head == ["time (s)", f"fr - rr ({unit})", f"ff - rr ({unit})"]
        assert np.array_equal(rows.T, [rigid.time, *expected])
    assert [axes.get_ylabel()[-4:] for axes in drawn[6].axes] == [" (m)", "", "", "rad)", "", ""]


@pytest.mark.slow
def test_a_case_that_ended_early_is_drawn_to_its_end_and_its_label_says_when(cases, drawn, tmp_path):
    rigid, links, both = cases
    paper_figures(rigid, links, ended(both), tmp_path)
    for figure in drawn:
        for axes in figure.axes:
            curve = axes.get_lines()[-1]
            assert curve.get_label() == "flexible links and joints (diverged after 0.04 s)"
            assert curve.get_xdata().tolist() == rigid.time[:3].tolist()
            assert len(axes.get_lines()[-2].get_xdata()) == len(rigid.time)
    assert len(table(tmp_path / "figure_06.csv")[1]) == 3, "the rows that both curves have"


def test_a_curve_ends_where_the_rigid_arm_ended(cases):
    rigid, links, both = cases
    for time, difference in paper_curves({"rr": ended(rigid), "fr": links, "ff": both}, 6).values():
        assert time.tolist() == rigid.time[:3].tolist() and len(difference) == 3


@pytest.mark.slow
@pytest.mark.parametrize("figures", [FIGURES, (8,), (9, 6)])
def test_the_files_are_those_of_the_wanted_figures(cases, figures, tmp_path):
    folder = tmp_path / "new" / "folder"
    paths = paper_figures(*cases, folder, figures)
    names = [f"figure_{number:02d}" for number in figures]
    together = ["paper_figures.png"] if figures is FIGURES else []
    assert paths == [folder / name for name in [*(f"{name}.png" for name in names), *together]]
    assert {path.name for path in folder.iterdir()} == {
        *(f"{name}.csv" for name in names),
        *(path.name for path in paths),
    }
    for path in paths:
        picture = imread(path)
        assert min(picture.shape[:2]) > 300 and len(np.unique(picture)) > 20


def test_figures_of_trajectories_that_do_not_fit_together_are_refused(cases, tmp_path):
    rigid, links, both = cases
    with pytest.raises(ValueError, match=r"^flexible_both\.time: .*output times of the rigid case$"):
        paper_figures(rigid, links, simulated("ff", output_step=0.025), tmp_path)
    still = fm.Initial((0.0,) * 2, (0.0,) * 2)
    choice, torque = fm.ModelChoice(False, 1), fm.ConstantTorque((0.0,) * 2)
    planar = fm.Scene(fm.catalog.planar_2r(), choice, torque, still, DURATION, 0.02)
    with pytest.raises(ValueError, match=r"^flexible_links\.joint_angles: .*; give 3 joints"):
        paper_figures(fm.simulate(planar), links, both, tmp_path)
    with pytest.raises(ValueError, match=r"^figures: 5 is not allowed; give numbers from 6 to 11$"):
        paper_figures(*cases, tmp_path, (6, 5))
    assert not list(tmp_path.iterdir())


def test_without_matplotlib_one_line_names_the_extra(cases, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ImportError, match=r"^pictures need Matplotlib: pip install 'flexman_gym\[render\]'$"):
        paper_figures(*cases, tmp_path)
