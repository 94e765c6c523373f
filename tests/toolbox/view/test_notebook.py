"""Tests of what a terminal prints and a notebook shows of arms, scenes, configurations, choices and solutions."""

import io
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym as fm

JOINT = fm.Joint((0.0, 0.0, 1.0), rotor_inertia=0.01, stiffness=30.0, torque_limit=2.0)
TUBE = fm.Link.tube(0.5, diameter=0.02, wall=0.001)


@pytest.fixture(scope="module")
def scene():
    return fm.catalog.paper_scene("ff")


@pytest.fixture(scope="module")
def trajectory():
    return fm.simulate(fm.catalog.paper_scene("rr"), step=0.01)


def fits(text):
    """Return True for a text that fits a screen."""
    lines = text.splitlines()
    return 1 < len(lines) <= 40 and max(map(len, lines)) <= 100


def test_print_of_an_arm_has_its_links_and_joints(scene):
    text = str(scene.arm)
    assert fits(text) and "reach 8.5 m" in text
    _, first, *_ = text.splitlines()[1:]
    link = scene.arm.links[0]
    numbers = [1, link.length, link.mass, *[link.youngs_modulus * link.second_moment_y] * 2]
    assert [float(each) for each in first.split()] == pytest.approx(numbers, rel=1e-3)
    joint = text.splitlines()[-1]
    assert joint.split()[:5] == ["3", "(0,", "-1,", "0)", "5000"]


def test_print_of_a_link_of_several_sections_has_the_range_of_its_stiffness():
    thick = fm.Link.tube(0.5, diameter=0.03, wall=0.001)
    arm = fm.Arm([fm.NonUniformLink([thick, TUBE])], [JOINT])
    smallest, largest = (each.youngs_modulus * each.second_moment_y for each in (TUBE, thick))
    assert f"{smallest:.4g} to {largest:.4g}" in str(arm)


def test_print_of_an_arm_with_many_links_fits():
    text = str(fm.Arm([TUBE] * 60, [JOINT] * 60))
    assert fits(text) and "..." in text
    assert text.splitlines()[-1].split()[0] == "60"


def test_print_of_a_scene_has_every_field_that_is_given(scene):
    text = str(scene)
    assert fits(text)
    assert all(f"\n{name} " in text for name in ("model", "torque", "initial", "duration", "output_step", "note"))
    assert "\ntip_force" not in text
    samples = fm.SampledTorque(0.01 * np.arange(5001), np.ones((5001, 3)))
    long = fm.Scene(scene.arm, scene.model, samples, scene.initial, 1.0, 0.01)
    assert fits(str(long)) and " ..." in str(long)


@pytest.mark.parametrize("name", sorted(each for each in gym.registry if each.startswith("Flex") and "/" not in each))
def test_print_of_a_configuration_has_its_settings(name):
    configuration = gym.make(name).unwrapped.configuration
    text = str(configuration)
    assert fits(text) and text.split()[:2] == ["id", name]
    period = next(line for line in text.splitlines() if line.startswith("control_period "))
    assert float(period.split()[1]) == configuration.control_period


@pytest.mark.slow
def test_print_of_a_choice_fits():
    choice = fm.choose_model(fm.catalog.paper_scene("rr"), tolerance=0.1)
    assert fits(str(choice)) and choice.method in str(choice)


def picture(png):
    """Return the pixels of a PNG."""
    return pytest.importorskip("matplotlib.image").imread(io.BytesIO(png), format="png")[..., :3]


@pytest.mark.slow
def test_a_notebook_shows_an_arm(scene):
    pixels = picture(scene.arm._repr_png_())
    model = fm.build_model(scene.arm, elements=1)
    assert (pixels == np.float32(fm.draw.arm_frame(model, np.zeros(2 * model.n_dof)) / 255)).all()


@pytest.mark.slow
def test_a_notebook_shows_a_trajectory(trajectory, monkeypatch):
    pixels = picture(trajectory._repr_png_())
    assert pixels.shape[0] > 300 and len(np.unique(pixels.reshape(-1, 3), axis=0)) > 10
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    assert trajectory._repr_png_() is None  # a notebook then shows the text


@pytest.mark.slow
def test_a_notebook_shows_an_episode_of_an_agent_and_of_a_scene(trajectory):
    of_agent = fm.rollout("zero", "FlexOne-v0", [9000]).episode(0)
    for episode in (of_agent, fm.Episode.from_trajectory(trajectory)):
        frames = np.split(picture(episode._repr_png_()), 3, axis=1)
        assert frames[0].shape == (240, 320, 3)
    assert not (frames[0] == frames[2]).all()  # the scene moves


@pytest.mark.slow
def test_importing_the_package_imports_no_plotting_library():
    code = "import sys, flexman_gym; raise SystemExit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
