"""Figure of a trajectory: it is written, shows what it is given, and suits arms of any number of joints."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread

import flexman_gym as fm
from flexman_gym.toolbox.view.trajectories import trajectory_figure

CHOICE = fm.ModelChoice(True, 1, modes=0)


def run(joints=2, torque=5.0):
    """A trajectory of 0.1 s."""
    arm = fm.catalog.planar_2r() if joints == 2 else fm.Arm([fm.catalog.planar_2r().links[0]] * joints, JOINTS[:joints])
    still = (0.0,) * joints
    return fm.simulate(fm.Scene(arm, CHOICE, fm.ConstantTorque([torque] * joints), fm.Initial(still, still), 0.1, 0.01))


JOINTS = [fm.Joint((0.0, 0.0, 1.0), 0.1, 100.0)] * 8


@pytest.mark.slow
@pytest.mark.parametrize("joints", [1, 2, 8])
def test_a_picture_is_written_into_a_new_folder(joints, tmp_path):
    path = trajectory_figure(run(joints), tmp_path / "new" / "run.png")
    picture = imread(path)
    assert path == tmp_path / "new" / "run.png" and min(picture.shape[:2]) > 600 and len(np.unique(picture)) > 20


@pytest.mark.slow
def test_another_trajectory_gives_another_picture_and_one_without_motion_can_be_drawn(tmp_path):
    pictures = [imread(trajectory_figure(run(torque=torque), tmp_path / "a.png")) for torque in (5.0, 5.0, 6.0, 0.0)]
    assert np.array_equal(pictures[0], pictures[1])
    assert all(not np.array_equal(pictures[0], other) for other in pictures[2:])


def labelled(figure):
    """The axes of a figure by the label on their left."""
    return {axes.get_ylabel(): axes for axes in figure.axes}


def curves(axes):
    """What the lines (T, count) of some axes show, without that of zero."""
    return np.array([line.get_ydata() for line in axes.get_lines() if len(line.get_ydata()) > 2]).T


def test_the_axes_show_what_is_written_on_them(drawn, tmp_path):
    """A motor that is pushed winds its spring up before the link follows: motor less joint is positive at first."""
    arm, still = fm.catalog.planar_2r(joint_stiffness=50.0), fm.Initial((0.0, 0.0), (0.0, 0.0))
    whole = fm.simulate(fm.Scene(arm, CHOICE, fm.ConstantTorque((5.0, 5.0)), still, 0.1, 0.01))
    trajectory_figure(whole, tmp_path / "a.png")
    axes = labelled(drawn[-1])
    assert np.array_equal(curves(axes["tip (m)"]), whole.tip)
    assert np.array_equal(curves(axes["angle (rad)"]), np.hstack([whole.joint_angles, whole.motor_angles]))
    twists = curves(axes["motor - joint (rad)"])
    assert np.array_equal(twists, whole.motor_angles - whole.joint_angles)
    named = [text.get_text() for text in axes["angle (rad)"].get_legend().get_texts()]
    assert named == ["joint 1", "joint 2", "motors"]
    assert (twists[1] > 0.0).all()


@pytest.mark.slow
def test_the_residual_is_a_part_of_what_was_turned_over_or_in_joules_where_nothing_was(drawn, tmp_path):
    moved, still = run(), run(torque=0.0)
    for trajectory, unit, whole in (
        (moved, "of the turnover", moved.energy_turnover[-1]),
        (still, "J", 1.0),
        (replace(still, work=np.linspace(0.0, 3.0, 11), moving_energy=np.zeros(11)), "of the turnover", 3.0),
    ):
        trajectory_figure(trajectory, tmp_path / "a.png")
        result = curves(labelled(drawn[-1])[f"energy residual\n({unit})"])[:, 0]
        assert result == pytest.approx(trajectory.energy_residual / whole, rel=1e-12, abs=0.0)
    assert moved.energy_turnover[-1] > 0.0 == still.energy_turnover[-1] and result[-1] == pytest.approx(1.0)


@pytest.mark.slow
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


@pytest.mark.slow
def test_the_title_says_when_a_solution_ended(drawn, tmp_path):
    whole = run()
    parts = {name: value[:5] for name, value in vars(whole).items() if isinstance(value, np.ndarray)}
    trajectory_figure(replace(whole, **parts, status="diverged"), tmp_path / "a.png")
    assert labelled(drawn[-1])["tip (m)"].figure.get_suptitle() == "diverged after 0.04 s"


def test_without_a_path_the_figure_is_shown(monkeypatch):
    """In a window, or below the cell of a notebook, as Matplotlib is set."""
    from matplotlib import pyplot

    pyplot.close("all")  # figures of other tests in this process
    shown = []
    monkeypatch.setattr(pyplot, "show", lambda: shown.extend(pyplot.get_fignums()))
    assert trajectory_figure(run()) is None
    assert len(shown) == 1 and pyplot.figure(shown[0]).axes[0].get_ylabel() == "tip (m)"
    pyplot.close("all")
