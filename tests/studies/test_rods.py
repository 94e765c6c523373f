"""Tests of MuJoCo's 1-D flexes against our links: mass, inertia, beam frequency, motion."""

import importlib
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.toolbox.interchange.mjcf import to_mjcf
from flexman_gym.toolbox.precision.runs import PrecisionScene, ReferenceSolution

ARM, SCENE = fm.catalog.paper_rrr(), fm.catalog.paper_scene("ff")


@pytest.fixture(scope="module")
def rods(mujoco_peer):
    """Return the module of the MuJoCo rods."""
    return importlib.import_module("studies.peers.rods")


def with_rods(mujoco, mujoco_peer, rods, arm, length):
    """Return the MuJoCo model of an arm of rods in pieces of a length (m), and its data."""
    model = mujoco.MjModel.from_xml_string(to_mjcf(arm, 0, "Euler", 2e-5, partial(rods.rod, length)))
    return model, mujoco.MjData(model)


def test_an_arm_of_rods_has_mass_tip_and_inertia_of_ours(mujoco, mujoco_peer, rods):
    model, data = with_rods(mujoco, mujoco_peer, rods, ARM, 0.5)
    mujoco.mj_forward(model, data)
    assert model.body_mass.sum() == pytest.approx(sum(link.mass for link in ARM.links), rel=1e-6)
    assert np.allclose(data.site("tip").xpos, (7.5, 0.0, 1.0), rtol=0.0, atol=1e-9)
    turned = np.zeros(model.nv)
    turned[model.joint("spring 1").dofadr] = 1.0  # everything behind joint 2 moves as if it were rigid
    for i in range(model.nbody):
        if (name := model.body(i).name).startswith(("link_1_", "link_2_")) and "twist" not in name:
            turned[model.body_dofadr[i] + 2] = data.xpos[i, 0]
            if name.endswith("tip"):
                turned[model.body_dofadr[i] + 4] = -1.0
    moved = np.zeros(model.nv)
    mujoco.mj_mulM(model, data, moved, turned)
    rigid = fm.build_model(ARM, flexible_links=False, flexible_joints=False)
    rigid = fm.mass_matrix(rigid, np.zeros(2 * rigid.n_dof))
    assert turned @ moved == pytest.approx(rigid[1, 1] - ARM.joints[1].rotor_inertia, rel=1e-6)


@pytest.mark.parametrize("integrator", ["implicit", "implicitfast", "discrete"])
def test_other_integrators_of_mujoco_refuse_rods_that_stretch(mujoco, mujoco_peer, rods, integrator):
    with pytest.raises(ValueError, match="flex"):
        mujoco.MjModel.from_xml_string(to_mjcf(ARM, 0, integrator, 1e-5, partial(rods.rod, 0.5)))


@pytest.mark.slow
def test_a_clamped_rod_of_mujoco_vibrates_as_beam_theory_says(mujoco, mujoco_peer, rods):
    link = ARM.links[2]
    clamped = fm.Arm((link,), (fm.Joint(axis=(0.0, -1.0, 0.0), rotor_inertia=1e9),))
    model, data = with_rods(mujoco, mujoco_peer, rods, clamped, 0.25)
    for i in range(model.nbody):
        if (name := model.body(i).name).startswith("link_0_") and "twist" not in name:
            data.qvel[model.body_dofadr[i] + 2] = 0.1 * model.body_pos[i, 0] ** 2
            if name.endswith("tip"):
                data.qvel[model.body_dofadr[i] + 4] = -0.2 * model.body_pos[i, 0]
    heights = []
    for _ in range(250):
        mujoco.mj_step(model, data, 100)
        heights.append(data.site("tip").xpos[2])
    crossings = np.flatnonzero(np.diff(np.sign(heights)))
    measured = (len(crossings) - 1) / (2 * 2e-3 * np.ptp(crossings))
    (section,) = link.sections
    bending = section.youngs_modulus * section.second_moment_y / (section.density * section.area)
    assert measured == pytest.approx(1.8751**2 * np.sqrt(bending) / link.length**2 / (2 * np.pi), rel=0.02)


@pytest.mark.slow
def test_a_short_run_of_rods_is_near_ours(rods):
    scene = replace(SCENE, duration=0.3)
    model = fm.build_model(ARM, elements=3, stiffening=True)
    solution = ReferenceSolution(fm.simulate(scene, model, "implicit_midpoint", step=1e-3).tip, 0.0, "")
    study = PrecisionScene("short", scene, {}, solution, {})
    errors = [rods.run(study, length, "Euler", parts).total_error for length, parts in ((0.5, 110), (0.25, 220))]
    assert errors[1] < 0.4 * errors[0] < 2e-3
