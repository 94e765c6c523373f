"""Peers: MuJoCo's chain of pieces is the same arm: mass, place of the tip, lowest frequencies."""

from dataclasses import replace

import numpy as np
import pytest
from commands import command
from scipy.linalg import eigh

import flexman_gym as fm

mujoco = pytest.importorskip("mujoco")
ARM = fm.catalog.paper_rrr()


@pytest.fixture(scope="module")
def peers():
    """The room of MuJoCo's models as a module."""
    return command("peers_mujoco")


@pytest.mark.parametrize("pieces", [1, 4])
def test_mass_and_tip_are_those_of_the_arm(peers, pieces):
    model = mujoco.MjModel.from_xml_string(peers.description(ARM, pieces, "Euler", 1e-3))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert model.body_mass.sum() == pytest.approx(sum(link.mass for link in ARM.links), rel=1e-9)
    assert np.allclose(data.site("tip").xpos, (7.5, 0.0, 1.0), rtol=0.0, atol=1e-9)
    assert model.nv == 3 * (2 + 3 * pieces)


def test_lowest_frequencies_are_those_of_our_model(peers):
    model = mujoco.MjModel.from_xml_string(peers.description(ARM, 16, "Euler", 1e-3))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    columns = np.eye(model.nv)
    mass = np.zeros((model.nv, model.nv))
    for column, out in zip(columns, mass, strict=True):
        mujoco.mj_mulM(model, data, out, column)
    stiffness = np.diag(np.reshape(model.jnt_stiffness, (model.njnt, -1))[:, 0])
    found = np.sqrt(np.abs(eigh(stiffness, mass, eigvals_only=True))) / (2 * np.pi)
    expected = fm.frequencies(fm.build_model(ARM, elements=3))
    assert np.all(found[:3] < 1e-3) and np.all(expected[:3] < 1e-3)
    assert np.allclose(found[3:12], expected[3:12], rtol=0.01)


def test_a_step_that_is_too_long_is_seen(peers):
    scene = fm.catalog.paper_scene("ff")
    assert not peers.run(scene, 4, "Euler", 1e-3).finite
    with pytest.raises(ValueError, match=r"step: 0.003 is not allowed"):
        peers.run(scene, 4, "Euler", 3e-3)


def test_a_short_run_is_near_ours(peers):
    scene = replace(fm.catalog.paper_scene("ff"), duration=0.2)
    found = peers.run(scene, 4, "RK4", 1e-4)
    expected = fm.simulate(scene, fm.build_model(scene.arm), "implicit_midpoint", step=1e-3)
    assert found.finite and found.cpu > 0.0
    assert np.linalg.norm(found.tip - expected.tip, axis=1).max() < 2e-3
