"""Geometric stiffening: foreshortening against reference solutions, and identities on random chains."""

import numpy as np
import pytest
from hypothesis import given, settings

import flexman_gym as fm
from flexman_gym.kernels import inverse, layout
from flexman_gym.model.model import scene_model

from oracles.chains import QUICK, observed, samples
from oracles.files import REFERENCE


def reference(name):
    """Rows of a reference trajectory: time, tip, joint angles, ..."""
    return np.loadtxt(REFERENCE / f"{name}.csv", delimiter=",", skiprows=1)


def stiffened(sample):
    """The model of a random chain with foreshortening."""
    choice = sample.model.choice
    return fm.build_model(
        sample.arm, choice.elements, choice.modes, choice.flexible_links, choice.flexible_joints, stiffening=True
    )


@pytest.mark.slow
def test_a_link_spun_past_its_first_bending_frequency_follows_the_reference():
    scene, expected = fm.Scene.load(REFERENCE / "spin_up_stiffened.json"), reference("spin_up_stiffened")
    trajectory = fm.simulate(scene, rtol=1e-8, atol=1e-10)
    assert trajectory.status == "ok"
    assert np.abs(trajectory.tip - expected[:, 1:4]).max() < 1e-6
    assert np.abs(trajectory.energy - expected[:, -1]).max() < 1e-6 * expected[:, -1].max()


@pytest.mark.slow
def test_without_foreshortening_the_same_link_bends_by_half_its_length_and_more():
    scene = fm.Scene.load(REFERENCE / "spin_up_stiffened.json")
    linear = fm.build_model(scene.arm, elements=3, flexible_joints=False)
    trajectory = fm.simulate(scene, model=linear, rtol=1e-8, atol=1e-10)
    assert np.linalg.norm(trajectory.deflection, axis=1).max() > 0.5 * scene.arm.links[0].length


@pytest.mark.parametrize(("stiffening", "first", "second"), [(True, 2e-3, 6e-3), (False, 9e-3, 33e-3)])
def test_the_papers_arm_stays_near_the_large_rotation_solution(stiffening, first, second):
    scene, expected = fm.catalog.paper_scene("ff"), reference("paper_ff_large_rotation")
    model = fm.build_model(scene.arm, stiffening=stiffening)
    tip = fm.simulate(scene, model=model, method="ros2", step=0.00025).tip
    error = np.linalg.norm(tip - expected[:, 1:4], axis=1)
    assert error[:101].max() < first
    assert error.max() < second
    if not stiffening:
        assert error.max() > 5e-3  # what foreshortening repairs


@pytest.mark.slow
@settings(QUICK)
@given(samples())
def test_forward_and_inverse_dynamics_undo_each_other(sample):
    model = stiffened(sample)
    (x, v), torque = sample.state(), sample.torque()
    accelerations, forces = fm.acceleration(model, np.r_[x, v], torque), np.zeros(model.n_dof)
    work = layout.make_work(model.constants)
    inverse.inertial_forces(model.constants, work, x, v, accelerations, forces)
    # Springs and dampers are linear, so the forces of the unstiffened model balance the same torques.
    plain, expected = fm.acceleration(sample.model, np.r_[x, v], torque), np.zeros(model.n_dof)
    inverse.inertial_forces(sample.model.constants, layout.make_work(sample.model.constants), x, v, plain, expected)
    assert np.abs(forces - expected).max() <= 1e-8 * max(np.abs(expected).max(), 1e-9)


@pytest.mark.slow
@settings(QUICK)
@given(samples())
def test_the_mass_matrix_is_positive_and_gives_the_kinetic_energy(sample):
    model = stiffened(sample)
    x, v = sample.state()
    mass = fm.mass_matrix(model, np.r_[x, v])
    scale = np.sqrt(np.diag(mass))
    assert np.linalg.eigvalsh(mass / np.outer(scale, scale)).min() > 0.0
    assert v @ mass @ v / 2 == pytest.approx(observed(model, x, v)[layout.KINETIC], rel=1e-9)


@pytest.mark.slow
def test_energy_is_kept_while_the_link_bends_and_straightens():
    scene = fm.Scene.load(REFERENCE / "spin_up_stiffened.json")
    trajectory = fm.simulate(scene, rtol=1e-9, atol=1e-11)
    assert np.abs(trajectory.energy_residual).max() < 1e-9 * trajectory.energy.max()


def test_an_undeformed_arm_does_not_know_of_foreshortening():
    scene = fm.catalog.paper_scene("ff")
    state = scene_model(scene).initial_state([0.3, -0.2, 0.5])
    plain, with_it = (fm.mass_matrix(fm.build_model(scene.arm, stiffening=on), state) for on in (False, True))
    np.testing.assert_allclose(with_it, plain, rtol=1e-12, atol=1e-12 * np.abs(plain).max())
