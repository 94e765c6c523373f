"""Figures of the paper: each shows what its title and its axis say, with the sign that they say."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.toolbox.view.trajectories import paper_figures


@pytest.fixture(scope="module")
def cases():
    """The paper's cases for a tenth of a second."""
    scenes = [replace(fm.catalog.paper_scene(name), duration=0.1, output_step=0.02) for name in ("rr", "fr", "ff")]
    return [fm.simulate(scene, method="ros2", step=1e-3) for scene in scenes]


@pytest.mark.slow
def test_every_curve_is_the_flexible_arm_less_the_rigid_one(cases, drawn, tmp_path):
    """Figures 6 to 8 are of the tip along x, y and z, 9 to 11 of the three joints; the page of all repeats them."""
    rigid, *flexible = cases
    paper_figures(*cases, tmp_path)
    whole = [figure.axes[0] for figure in drawn[:6]], drawn[6].axes
    for number, pair in enumerate(zip(*whole, strict=True), start=6):
        kind, column = ("tip", number - 6) if number < 9 else ("joint_angles", number - 9)
        for axes in pair:
            curves = {line.get_label(): line.get_data() for line in axes.get_lines() if line.get_label()[0] != "_"}
            assert axes.get_title().startswith(f"Figure {number}: ")
            assert list(curves) == ["flexible links, rigid joints", "flexible links and joints"]
            for (time, values), case in zip(curves.values(), flexible, strict=True):
                assert np.array_equal(time, case.time)
                assert values == pytest.approx(getattr(case, kind)[:, column] - getattr(rigid, kind)[:, column], abs=0)
        assert pair[0].get_ylabel() == f"difference to the rigid arm ({'m' if number < 9 else 'rad'})"


@pytest.mark.slow
def test_a_case_that_ended_early_is_drawn_to_its_end_and_its_label_says_when(cases, drawn, tmp_path):
    rigid, links, both = cases
    parts = {name: value[:3] for name, value in vars(both).items() if isinstance(value, np.ndarray)}
    paper_figures(rigid, links, replace(both, **parts, status="diverged"), tmp_path)
    for figure in drawn:
        for axes in figure.axes:
            curve = axes.get_lines()[-1]
            assert curve.get_label() == "flexible links and joints (diverged after 0.04 s)"
            assert curve.get_xdata().tolist() == rigid.time[:3].tolist()
