"""Figure of a trajectory: it is written, shows what it is given, and suits arms of any number of joints."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread

import flexman_gym as fm
from flexman_gym.draw import trajectory_figure

CHOICE = fm.ModelChoice(True, 1, modes=0)


def run(joints=2, torque=5.0):
    """A trajectory of 0.1 s."""
    arm = fm.catalog.planar_2r() if joints == 2 else fm.Arm([fm.catalog.planar_2r().links[0]] * joints, JOINTS[:joints])
    still = (0.0,) * joints
    return fm.simulate(fm.Scene(arm, CHOICE, fm.ConstantTorque([torque] * joints), fm.Initial(still, still), 0.1, 0.01))


JOINTS = [fm.Joint((0.0, 0.0, 1.0), 0.1, 100.0)] * 8


@pytest.mark.parametrize("joints", [1, 2, 8])
def test_a_picture_is_written_into_a_new_folder(joints, tmp_path):
    path = trajectory_figure(run(joints), tmp_path / "new" / "run.png")
    picture = imread(path)
    assert path == tmp_path / "new" / "run.png" and min(picture.shape[:2]) > 600 and len(np.unique(picture)) > 20


def test_another_trajectory_gives_another_picture_and_one_without_motion_can_be_drawn(tmp_path):
    pictures = [imread(trajectory_figure(run(torque=torque), tmp_path / "a.png")) for torque in (5.0, 5.0, 6.0, 0.0)]
    assert np.array_equal(pictures[0], pictures[1])
    assert all(not np.array_equal(pictures[0], other) for other in pictures[2:])


def test_a_solution_that_ended_early_is_drawn_to_its_end(tmp_path):
    whole = run()
    parts = {name: value[:1] for name, value in vars(whole).items() if isinstance(value, np.ndarray)}
    ended = replace(whole, **parts, status="diverged")
    assert not np.array_equal(*(imread(trajectory_figure(each, tmp_path / "a.png")) for each in (whole, ended)))


def test_what_cannot_be_drawn_is_refused(tmp_path, monkeypatch):
    with pytest.raises(ValueError, match="xyz"):
        trajectory_figure(run(), tmp_path / "run.xyz")
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ImportError, match=r"pip install 'flexman_gym\[render\]'"):
        trajectory_figure(run(), tmp_path / "run.png")
