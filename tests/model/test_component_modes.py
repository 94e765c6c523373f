"""Loaded component modes and modal damping of links."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import flexman_gym as fm
from flexman_gym.model.beam import build_beam
from flexman_gym.model.component_modes import LoadedModes
from flexman_gym.model.outboard_inertia import outboard_inertias

from oracles.chains import QUICK, samples, slender_link
from oracles.ritz import beam_eigenvalues


def beams_of(sample):
    """The beams of an arm, before any reduction."""
    return tuple(map(build_beam, sample.arm.links, sample.elements, sample.flexible_links))


@pytest.mark.parametrize("ratio", [0.0, 0.1, 1.0, 5.0])
def test_loaded_modes_of_a_link_with_a_tip_mass_have_its_frequencies(ratio):
    link = slender_link(1.0, 1.0, 1.0)
    arm = fm.Arm([link], [fm.Joint((0.0, 0.0, 1.0))], fm.Payload(ratio * link.mass))
    beam = build_beam(link, 24)
    result, _ = LoadedModes.of(beam, outboard_inertias(arm, (beam,))[0])
    assert result[:3] == pytest.approx(beam_eigenvalues(3, ratio), rel=2e-5)


def test_modes_of_a_round_link_bend_along_one_axis():
    """The planes of two modes of equal frequency are arbitrary, so rounding must not determine them."""
    axial, bending_y, bending_z, torsion = (0,), (1, 5), (2, 4), (3,)  # node coordinates that move
    for basis in fm.build_model(fm.catalog.paper_rrr(), 2, 12).bases[1:]:
        moved = [tuple(np.flatnonzero(shape.reshape(2, 6).any(axis=0))) for shape in basis.T]
        assert {*moved} == {axial, bending_y, bending_z, torsion}
        assert moved[:4] == [bending_y, bending_z] * 2


@pytest.mark.parametrize("change", [-1e-12, 1e-12])
def test_rounding_does_not_choose_which_of_two_equal_modes_comes_first(change):
    """A round link with moments that differ by rounding only: its modes keep their order."""
    link = fm.catalog.paper_rrr().links[1]
    assert link.second_moment_y == link.second_moment_z
    beams = [build_beam(replace(link, second_moment_z=part * link.second_moment_y), 2) for part in (1.0, 1.0 + change)]
    planes = [np.abs(LoadedModes.of(beam, np.zeros((6, 6)))[1]) > 0.0 for beam in beams]
    assert np.array_equal(*planes)


@pytest.mark.slow
@settings(QUICK)
@given(samples(flexible_links=True))
def test_loaded_modes_are_orthonormal_and_ascend(sample):
    for beam, outboard in zip(beams_of(sample), outboard_inertias(sample.arm, beams_of(sample)), strict=True):
        frequencies, shapes = LoadedModes.of(beam, outboard)
        tip = np.vstack([beam.tip_translation, beam.tip_rotation])
        mass = beam.mass_matrix + tip.T @ outboard @ tip
        assert (np.diff(frequencies) >= 0.0).all() and frequencies[0] > 0.0
        assert np.allclose(shapes.T @ mass @ shapes, np.eye(len(mass)), rtol=0.0, atol=1e-8)
        scaled = shapes.T @ beam.stiffness @ shapes / np.outer(frequencies, frequencies)
        assert np.allclose(scaled, np.eye(len(mass)), rtol=0.0, atol=1e-6)


@pytest.mark.slow
@settings(QUICK)
@given(samples(most_links=1, flexible_links=True, flexible_joints=False), st.floats(1e-4, 0.9))
def test_modal_damping_gives_every_mode_its_ratio(sample, ratio):
    """One link on a held joint: its modes are the loaded ones, with w and c on the diagonals, c = 2 ratio w."""
    arm = fm.Arm(sample.arm.links, sample.arm.joints, sample.arm.payload, modal_damping_ratio=ratio)
    model = fm.build_model(arm, sample.elements, sample.modes)
    k = model.n_elastic
    mass = fm.mass_matrix(model, np.zeros(2 * model.n_dof))[1:, 1:]
    stiffness, damping = (getattr(model.constants, name)[: k * k].reshape(k, k) for name in ("stiffness", "damping"))
    if k:
        factor = np.linalg.inv(np.linalg.cholesky(mass))
        squares, shapes = np.linalg.eigh(factor @ stiffness @ factor.T)
        modal = shapes.T @ factor @ damping @ factor.T @ shapes / np.sqrt(np.sqrt(np.outer(squares, squares)))
        assert np.allclose(modal, 2 * ratio * np.eye(k), rtol=0.0, atol=1e-5 * ratio)


@pytest.mark.slow
@settings(QUICK)
@given(samples(reduced=False))
def test_all_modes_are_the_finite_element_model(sample):
    all_modes = replace(sample, modes=tuple(6 * count for count in sample.elements)).model
    change = np.eye(all_modes.n_dof)  # x of the finite elements = change @ x of the modes
    beams = beams_of(sample)
    for i, outboard in enumerate(outboard_inertias(sample.arm, beams)):
        columns = all_modes.elastic_columns(i)
        if sample.flexible_links[i]:
            change[columns, columns] = LoadedModes.of(beams[i], outboard)[1]
    (x, v), torque = sample.state(), sample.torque()
    modal = np.r_[np.linalg.solve(change, x), np.linalg.solve(change, v)]
    result = change @ fm.acceleration(all_modes, modal, torque)
    expected = fm.acceleration(sample.model, np.r_[x, v], torque)
    scale = np.sqrt(np.diag(fm.mass_matrix(sample.model, np.r_[x, v])))
    assert np.abs(scale * (result - expected)).max() <= 1e-7 * np.abs(scale * expected).max()


@pytest.mark.slow
@settings(QUICK)
@given(samples(reduced=True))
def test_kept_modes_count_as_asked_and_rigid_links_have_none(sample):
    model = sample.model
    for i, (modes, flexible) in enumerate(zip(sample.modes, sample.flexible_links, strict=True)):
        columns = model.elastic_columns(i)
        assert columns.stop - columns.start == (modes if flexible else 0)
    assert columns.stop == model.n_dof


def test_modes_may_be_chosen_by_their_numbers():
    arm = fm.catalog.paper_rrr()
    every, chosen = fm.build_model(arm, modes=12), fm.build_model(arm, modes=((1, 4, 11), 3, 0))
    for i, numbers in enumerate(([1, 4, 11], [0, 1, 2], [])):
        assert np.array_equal(chosen.bases[i], every.bases[i][:, numbers])


def test_modes_of_an_assembled_arm_come_down_to_those_of_the_full_model():
    """Rayleigh-Ritz: with more modes no frequency rises, and none falls below the full model's."""
    arm = fm.catalog.paper_rrr()
    full = fm.frequencies(fm.build_model(arm), (0.0, 0.4, -0.8))[3:9]
    last = np.full(6, np.inf)
    for modes in (2, 4, 6, 9, 12):
        result = fm.frequencies(fm.build_model(arm, modes=modes), (0.0, 0.4, -0.8))[3:9]
        assert (result <= last * (1 + 1e-6)).all() and (result >= full * (1 - 1e-6)).all()
        last = result
    assert last == pytest.approx(full, rel=1e-6)
