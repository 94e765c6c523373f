"""Links of several sections: a stepped beam against its closed form, a tapered beam as the limit of many steps."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import eigh

import flexman_gym as fm
from flexman_gym.model.beam import build_beam
from flexman_gym.model.dynamics import stiffness_matrix
from flexman_gym.scene.link import IDENTITY

from oracles.chains import QUICK, random_link, samples
from oracles.ritz import beam_eigenvalues

HUB = fm.Joint((0.0, 0.0, 1.0))


def close(result, expected, accuracy=1e-9):
    """Return whether two arrays agree to an accuracy relative to the largest entry."""
    return np.abs(result - expected).max(initial=0.0) <= accuracy * np.abs(expected).max(initial=0.0)


def halved(link):
    """The same link as two equal sections."""
    half = replace(link, length=link.length / 2, orientation=IDENTITY)
    return fm.NonUniformLink([half, half], link.orientation)


def sections(seed, count):
    """A link of random sections."""
    rng = np.random.default_rng(seed)
    return fm.NonUniformLink([replace(random_link(rng), orientation=IDENTITY) for _ in range(count)])


def bending(beam):
    """Stiffness and mass of the coordinates that bend a link in x-y."""
    size = len(beam.stiffness)
    columns = np.sort(np.r_[1:size:6, 5:size:6])
    return (matrix[np.ix_(columns, columns)] for matrix in (beam.stiffness, beam.mass_matrix))


@pytest.mark.slow
@settings(QUICK)
@given(samples(most_links=3, reduced=False), st.booleans(), st.floats(0.0, 1.0))
def test_two_equal_halves_are_the_uniform_link(sample, stiffening, along):
    whole = replace(sample, elements=tuple(2 * count for count in sample.elements))
    choice = (sample.flexible_links, sample.flexible_joints, stiffening)
    parted = fm.Arm(**vars(sample.arm) | {"links": [halved(link) for link in sample.arm.links]})
    one = fm.build_model(sample.arm, whole.elements, None, *choice)
    two = fm.build_model(parted, sample.elements, None, *choice)
    (x, v), torque = whole.state(), whole.torque()
    state, matrix = np.r_[x, v], fm.mass_matrix(one, np.r_[x, v])
    scale = np.sqrt(np.diag(matrix))
    assert close(fm.mass_matrix(two, state) / np.outer(scale, scale), matrix / np.outer(scale, scale))
    assert close(stiffness_matrix(two), stiffness_matrix(one))
    assert close(scale * fm.acceleration(two, state, torque), scale * fm.acceleration(one, state, torque), 1e-7)
    assert close(fm.curves(two, state, 16).positions, fm.curves(one, state, 16).positions)
    for i, link in enumerate(sample.arm.links):
        place = along * link.length
        assert close(fm.curvature(two, state, i, place), fm.curvature(one, state, i, place), 1e-7)
        result, expected = (fm.strain(model, state, i, place, 0.01, -0.02) for model in (two, one))
        assert result == pytest.approx(expected, rel=1e-7, abs=1e-9)


@settings(QUICK)
@given(st.integers(0, 10**6), st.integers(1, 4), st.integers(1, 3))
def test_a_load_at_the_tip_bends_twists_and_stretches_every_section_exactly(seed, count, elements):
    """Unit load integrals, section by section: of s^2, s and 1 over EI, s from the tip, and of 1 over GJ and EA."""
    link = sections(seed, count)
    beam, ends = build_beam(link, elements), np.cumsum([0.0, *(section.length for section in link.sections)])
    flexibility = np.zeros((6, 6))
    for section, base, tip in zip(link.sections, link.length - ends[:-1], link.length - ends[1:], strict=True):
        flexibility[0, 0] += section.length / (section.youngs_modulus * section.area)
        flexibility[3, 3] += section.length / (section.shear_modulus * section.torsion_constant)
        for v, turn, moment, sign in ((1, 5, section.second_moment_z, 1.0), (2, 4, section.second_moment_y, -1.0)):
            first, second, third = ((base**p - tip**p) / (p * section.youngs_modulus * moment) for p in (1, 2, 3))
            flexibility[v, v] += third
            flexibility[turn, turn] += first
            flexibility[[v, turn], [turn, v]] += sign * second
    tip = np.vstack([beam.tip_translation, beam.tip_rotation])
    own = 1.0 / np.sqrt(np.diag(beam.stiffness))  # metres and radians of stiff and soft sections weigh alike
    bent = own[:, None] * np.linalg.solve(beam.stiffness * np.outer(own, own), own[:, None] * tip.T)
    result, scale = tip @ bent, np.sqrt(np.diag(flexibility))
    assert close(result / np.outer(scale, scale), flexibility / np.outer(scale, scale))


def stepped_link(position, ratio):
    """Return a strip of unit length, EI_z and mass per length, with a step in its thickness at a position (m)."""
    segments = ((position, 1.0), (1.0 - position, ratio))
    return fm.NonUniformLink([fm.Link(x, t / 100, t, t**3 / 12e6, t, 12e6, 12e6, 100.0) for x, t in segments])


@pytest.mark.parametrize(("place", "ratio"), [(0.5, 0.5), (0.3, 0.7), (0.7, 1.8)])
def test_frequencies_of_a_stepped_cantilever_converge_with_fourth_order(place, ratio):
    segments = ((place, 1.0, 1.0), (1.0 - place, ratio**3, ratio))
    exact, errors = beam_eigenvalues(2, segments=segments), []
    for elements in (4, 8):
        stiffness, mass = bending(build_beam(stepped_link(place, ratio), elements, rotary_inertia=False))
        errors.append(np.sqrt(eigh(stiffness, mass, eigvals_only=True)[:2]) / exact - 1.0)
    assert (errors[1] > 0.0).all()
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.15)


def wedge(count, width=0.1, root=0.2, tip=0.05):
    """A cantilever of 1 m, its height falling linearly, as sections of equal length with the height in their middle."""
    heights = root + (tip - root) * (np.arange(count) + 0.5) / count
    return fm.NonUniformLink(
        [
            fm.Link(1.0 / count, width * h, h * width**3 / 12, width * h**3 / 12, 1e-5, 70e9, 26e9, 2700.0)
            for h in heights
        ]
    )


def wedge_frequencies(rotary_inertia, width=0.1, root=0.2, tip=0.05, degree=14):
    """Its first two frequencies in rad/s by Rayleigh and Ritz: polynomials x^2 P_j(2 x - 1), integrated exactly."""
    abscissae, weights = np.polynomial.legendre.leggauss(degree + 8)
    x, weights = (1.0 + abscissae) / 2.0, weights / 2.0
    height = root + (tip - root) * x
    shapes = [
        np.polynomial.Polynomial([0.0, 0.0, 1.0])
        * np.polynomial.Legendre.basis(j)(np.polynomial.Polynomial([-1.0, 2.0]))
        for j in range(degree)
    ]
    values, slopes, bends = (np.array([shape.deriv(m)(x) if m else shape(x) for shape in shapes]) for m in range(3))
    area, moment = width * height, width * height**3 / 12
    stiffness = (bends * weights * 70e9 * moment) @ bends.T
    mass = (values * weights * 2700.0 * area) @ values.T
    if rotary_inertia:
        mass += (slopes * weights * 2700.0 * moment) @ slopes.T
    return np.sqrt(eigh(stiffness, mass, eigvals_only=True)[:2])


@pytest.mark.slow
@pytest.mark.parametrize("rotary_inertia", [True, False])
def test_a_wedge_of_many_sections_converges_with_second_order(rotary_inertia):
    exact, errors = wedge_frequencies(rotary_inertia), []
    assert wedge_frequencies(rotary_inertia, degree=12) == pytest.approx(exact, rel=1e-7)
    for count in (16, 32):
        stiffness, mass = bending(build_beam(wedge(count), 1, rotary_inertia=rotary_inertia))
        errors.append(np.sqrt(eigh(stiffness, mass, eigvals_only=True)[:2]) / exact - 1.0)
    assert np.abs(errors[1]).max() < 2e-3
    assert np.log2(np.abs(errors[0] / errors[1])) == pytest.approx(2.0, abs=0.15)


@pytest.mark.slow
@settings(QUICK)
@given(st.integers(0, 10**6), st.integers(2, 4), st.integers(1, 2))
def test_at_a_step_the_curvature_is_that_of_the_outboard_section(seed, count, elements):
    """Under a moment at the tip EI v'' is the same everywhere."""
    link, moment = sections(seed, count), 3.0
    model = fm.build_model(fm.Arm([link], [HUB]), elements)
    state, columns = np.zeros(2 * model.n_dof), model.elastic_columns(0)
    state[columns] = np.linalg.solve(
        stiffness_matrix(model)[columns, columns], moment * np.eye(6)[5] @ model.bases[0][-6:]
    )
    place = 0.0
    for section in link.sections:
        expected = moment / (section.youngs_modulus * section.second_moment_z)
        for inside in (place, place + 0.5 * section.length, np.nextafter(place + section.length, 0.0)):
            assert fm.curvature(model, state, 0, inside)[2] == pytest.approx(expected, rel=1e-6)
        place += section.length
    assert fm.curvature(model, state, 0, link.length)[2] == pytest.approx(expected, rel=1e-6)


@settings(QUICK)
@given(st.integers(0, 10**6), st.integers(1, 4))
def test_a_rigid_link_of_sections_turns_like_its_bodies(seed, count):
    """Sum of m (L^2 / 12 + c^2) + rho L I_z about the joint, c to the middle of a section (Huygens and Steiner)."""
    link, expected, start = sections(seed, count), 0.0, 0.0
    for section in link.sections:
        middle = start + section.length / 2
        expected += section.mass * (section.length**2 / 12 + middle**2)
        expected += section.density * section.length * section.second_moment_z
        start += section.length
    model = fm.build_model(fm.Arm([link], [HUB]), flexible_links=False)
    assert fm.mass_matrix(model, [0.3, 0.0])[0, 0] == pytest.approx(expected)


def test_an_arm_of_stepped_and_uniform_links_keeps_its_energy():
    """Without torques, with modes of a stepped link that carries a uniform one, to the tolerance of dop853."""
    uniform = fm.catalog.planar_2r().links[1]
    thin = replace(uniform, length=0.2, area=6e-5, second_moment_y=4e-9, second_moment_z=1.1e-11)
    arm = fm.Arm([fm.NonUniformLink([replace(uniform, length=0.3), thin]), uniform], [HUB, HUB])
    choice = fm.ModelChoice(True, 2, (6, 4))
    still = fm.ConstantTorque([0.0, 0.0])
    scene = fm.Scene(arm, choice, still, fm.Initial([0.0, 0.5], [2.0, -1.0]), 0.2, 0.02)
    result = fm.simulate(scene, rtol=1e-9, atol=1e-12)
    assert result.status == "ok" and np.abs(result.deflection[:, 1]).max() > 1e-4
    assert np.abs(result.energy_residual).max() < 1e-7 * result.energy[0]


def test_modes_count_for_all_sections():
    arm = fm.Arm([sections(0, 3)], [HUB])
    assert fm.build_model(arm, 1, 18).n_elastic == fm.build_model(arm, 1).n_elastic == 18
