"""Figures of the paper: they are written, and what does not fit together is refused."""

import sys

import numpy as np
import pytest
from matplotlib.image import imread

from flexman_gym.draw.figures import paper_figures
from flexman_gym.scene import catalog
from flexman_gym.scene.choice import ModelChoice
from flexman_gym.scene.drive import ConstantTorque
from flexman_gym.scene.scene import Initial, Scene
from flexman_gym.simulation.scenes import simulate

ARM = catalog.paper_rrr()


def trajectory(flexible_links, flexible_joints, output_step=0.01, arm=ARM):
    n = arm.n_joints
    choice = ModelChoice(flexible_links, 1, flexible_joints=flexible_joints)
    start = Initial((0.0,) * n, (0.0,) * n)
    return simulate(Scene(arm, choice, ConstantTorque((400.0,) * n), start, 0.05, output_step), method="rk4", step=1e-5)


@pytest.fixture(scope="module")
def cases():
    return [trajectory(False, False), trajectory(True, False), trajectory(True, True)]


def test_paper_figures_are_written(cases, tmp_path):
    paths = paper_figures(*cases, tmp_path / "new" / "folder")
    assert [path.name for path in paths] == [f"figure_{i:02d}.png" for i in range(6, 12)] + ["paper_figures.png"]
    for path in paths:
        picture = imread(path)
        assert min(picture.shape[:2]) > 300 and len(np.unique(picture)) > 20


def test_paper_figures_refuse_what_does_not_fit_together(cases, tmp_path):
    rigid, links, both = cases
    with pytest.raises(ValueError, match=r"^flexible_both\.time: .*output times of the rigid case$"):
        paper_figures(rigid, links, trajectory(True, True, output_step=0.025), tmp_path)
    planar = trajectory(False, False, arm=catalog.planar_2r())
    with pytest.raises(ValueError, match=r"^flexible_links\.joint_angles: .*; give 3 joints"):
        paper_figures(planar, links, both, tmp_path)
    assert not list(tmp_path.iterdir())


def test_without_matplotlib_one_line_names_the_extra(cases, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ImportError, match=r"^pictures need Matplotlib: pip install 'flexman_gym\[render\]'$"):
        paper_figures(*cases, tmp_path)
