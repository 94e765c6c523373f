"""Finite-element beam of one link: stiffness, mass, shape functions and stations against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import eigh
from scipy.sparse import csr_matrix

from flexman_gym.model.beam import build_beam
from flexman_gym.model.element import Element, section_points
from flexman_gym.model.model import build_model
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.joint import Joint
from flexman_gym.scene.link import IDENTITY, Link, NonUniformLink

from oracles.chains import QUICK, random_link
from oracles.dense import beam_points
from oracles.ritz import beam_eigenvalues

EXACT = 1e-9  # relative; the stiffness of three elements has a condition number of 1e6

links = st.integers(0, 10**6).map(lambda seed: random_link(np.random.default_rng(seed)))
counts = st.integers(1, 4)


def tip_response(beam, load):
    """Displacement and rotation vector (6,) of the tip under a force and moment (6,) there."""
    tip = np.vstack([beam.tip_translation, beam.tip_rotation])
    return tip @ np.linalg.solve(beam.stiffness, tip.T @ load)


def constants(link, elements):
    """Return the constants of the kernels for an arm of one link on a rigid joint."""
    return build_model(Arm([link], [Joint((0.0, 0.0, 1.0))]), elements).constants


def close(actual, expected):
    """Return whether two arrays agree to EXACT relative to the largest entry."""
    return np.abs(actual - expected).max() <= EXACT * np.abs(expected).max()


@settings(QUICK)
@given(links, counts)
def test_mass_and_its_moments_are_those_of_a_prism(link, elements):
    parts, m, length = constants(link, elements), link.mass, link.length
    assert parts.mass == pytest.approx(m)
    assert close(parts.first_moment[0], m * length / 2 * np.eye(3)[0])
    section = m / link.area * np.array([link.second_moment_z, link.second_moment_y])  # int y^2, int z^2 over the mass
    assert close(parts.second_moment.reshape(3, 3), np.diag([m * length**2 / 3, *section]))


@settings(QUICK)
@given(links)
def test_section_points_have_the_moments_of_the_section(link):
    y, z = section_points(link).T
    weight = link.area / len(y)
    assert [weight * (y**2).sum(), weight * (z**2).sum()] == pytest.approx([link.second_moment_z, link.second_moment_y])
    assert [y.sum(), z.sum(), (y * z).sum()] == pytest.approx([0.0, 0.0, 0.0])


@settings(QUICK)
@given(links, counts)
def test_a_load_at_the_tip_bends_twists_and_stretches_it_exactly(link, elements):
    """P L^3/3EI, P L^2/2EI, M L^2/2EI, M L/EI in both planes, T L/GJ and P L/EA."""
    beam, length = build_beam(link, elements), link.length
    flexibility = np.zeros((6, 6))
    flexibility[0, 0] = length / (link.youngs_modulus * link.area)
    flexibility[3, 3] = length / (link.shear_modulus * link.torsion_constant)
    planes = (1, 5, link.second_moment_z, 1), (2, 4, link.second_moment_y, -1)
    for deflection, rotation, second_moment, sign in planes:
        rigidity = link.youngs_modulus * second_moment
        flexibility[deflection, deflection] = length**3 / (3 * rigidity)
        flexibility[deflection, rotation] = flexibility[rotation, deflection] = sign * length**2 / (2 * rigidity)
        flexibility[rotation, rotation] = length / rigidity
    result = np.transpose([tip_response(beam, load) for load in np.eye(6)])
    scale = np.sqrt(np.diag(flexibility))
    assert close(result / np.outer(scale, scale), flexibility / np.outer(scale, scale))


@pytest.mark.slow
@settings(QUICK)
@given(links, counts)
def test_its_own_weight_bends_it_exactly(link, elements):
    """w L^4/8EI and w L^3/6EI in both planes, under the weight of its mass integrals."""
    beam, length = build_beam(link, elements), link.length
    shapes = constants(link, elements).first_moment_shape
    w = 9.81 * link.mass / length
    planes = (1, 2, link.second_moment_z, 1), (2, 1, link.second_moment_y, -1)
    for direction, rotation, second_moment, sign in planes:
        bent = np.linalg.solve(beam.stiffness, 9.81 * shapes[:, direction])
        rigidity = link.youngs_modulus * second_moment
        assert beam.tip_translation[direction] @ bent == pytest.approx(w * length**4 / (8 * rigidity), rel=EXACT)
        assert beam.tip_rotation[rotation] @ bent == pytest.approx(sign * w * length**3 / (6 * rigidity), rel=EXACT)


def slender(elements):
    """A link of unit mass per length and unit EI_z, with negligible rotary inertia, and its bending matrices in x-y."""
    link = Link(1.0, 1e-12, 1e-24, 1e-24, 1e-24, youngs_modulus=1e24, shear_modulus=1e24, density=1e12)
    beam = build_beam(link, elements)
    bending = np.sort(np.r_[1 : 6 * elements : 6, 5 : 6 * elements : 6])  # v, theta_z of every free node
    return (matrix[np.ix_(bending, bending)] for matrix in (beam.stiffness, beam.mass_matrix))


def cantilever_errors(elements):
    """Relative errors of the first two eigenvalues of a cantilever."""
    stiffness, mass = slender(elements)
    return np.sqrt(eigh(stiffness, mass, eigvals_only=True)[:2]) / beam_eigenvalues(2) - 1


@pytest.mark.parametrize(
    ("elements", "percent"),
    [(1, ("0.475", "58")), (2, ("0.0483", "0.849")), (4, ("0.0033", "0.117")), (8, ("0.0002", "0.0080"))],
)
def test_a_cantilever_is_too_stiff_by_the_known_percentages(elements, percent):
    """verification.md, Hermite elements with consistent mass: percent of f1 and f2."""
    for error, expected in zip(100 * cantilever_errors(elements), percent, strict=True):
        last_digit = 10.0 ** -len(expected.partition(".")[2])
        assert error == pytest.approx(float(expected), abs=0.51 * last_digit)


def test_cantilever_frequencies_converge_with_fourth_order():
    errors = np.array([cantilever_errors(elements) for elements in (4, 8, 16)])
    assert np.log2(errors[:-1] / errors[1:]) == pytest.approx(4.0, abs=0.15)


@pytest.mark.parametrize(
    ("ratio", "expected"),
    [  # verification.md
        (0.1, (2.96783835, 19.35580101, 55.51824555)),
        (0.5, (2.01629898, 16.90141772, 51.70092089)),
        (1.0, (1.55729786, 16.25008516, 50.89584283)),
        (5.0, (0.75693734, 15.60234588, 50.1623389)),
    ],
)
def test_a_mass_at_the_tip_lowers_its_frequencies(ratio, expected):
    stiffness, mass = slender(24)
    mass[-2, -2] += ratio
    assert np.sqrt(eigh(stiffness, mass, eigvals_only=True)[:3]) == pytest.approx(expected, rel=1e-5)
    assert beam_eigenvalues(3, ratio) == pytest.approx(expected, rel=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(("rows", "modulus"), [(0, "youngs_modulus"), (3, "shear_modulus")])
def test_axial_and_torsional_frequencies_converge_with_second_order(rows, modulus):
    """(2 n - 1) / (4 L) sqrt(E / rho), and sqrt(G / rho) where the torsion constant is the polar moment."""
    link = random_link(np.random.default_rng(1))
    link = replace(link, torsion_constant=link.second_moment_y + link.second_moment_z)
    exact = np.array([1, 3]) * np.pi / (2 * link.length) * np.sqrt(getattr(link, modulus) / link.density)
    errors = []
    for elements in (16, 32):
        beam = build_beam(link, elements)
        block = np.ix_(*[np.arange(rows, 6 * elements, 6)] * 2)
        errors.append(np.sqrt(eigh(beam.stiffness[block], beam.mass_matrix[block], eigvals_only=True)[:2]) / exact - 1)
    assert (errors[1] > 0.0).all() and (errors[1] < 1e-2).all()
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.05)


@settings(QUICK)
@given(links, st.floats(0.0, 1.0), st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)))
def test_shapes_of_an_element_hold_its_rigid_motions(link, xi, section):
    """Node values of a small rigid motion move every point rigidly and store no elastic energy."""
    length, point = link.length, np.array([xi * link.length, *section])
    whole, near, far = build_beam(replace(link, length=2.0 * length), 2).stiffness, slice(6), slice(6, 12)
    stiffness = whole.copy()
    stiffness[near, near] -= whole[far, far]  # of the outboard element alone
    element = Element(link, 0.0, length, slice(0, 12))
    for shift, turn in zip(np.eye(6)[:, :3], np.eye(6)[:, 3:], strict=True):
        nodes = np.r_[shift, turn, shift + np.cross(turn, [length, 0.0, 0.0]), turn]
        assert element.shapes(xi, *section) @ nodes == pytest.approx(shift + np.cross(turn, point), abs=1e-12)
        assert np.abs(stiffness @ nodes).max() <= 1e-12 * np.abs(stiffness).max()


@settings(QUICK)
@given(links, counts, st.booleans())
def test_stiffness_and_mass_are_symmetric_and_positive(link, elements, flexible):
    beam = build_beam(link, elements, flexible)
    assert beam.stiffness.shape == (6 * elements if flexible else 0,) * 2
    for matrix in (beam.stiffness, beam.mass_matrix):
        assert np.allclose(matrix, matrix.T, rtol=1e-12, atol=1e-12 * np.abs(matrix).max(initial=0.0))
        scale = np.sqrt(np.diag(matrix))
        assert np.linalg.eigvalsh(matrix / np.outer(scale, scale)).min(initial=1.0) > 0.0


@settings(QUICK)
@given(links, counts, st.integers(0, 10**6))
def test_shape_integrals_are_the_volume_integrals(link, elements, seed):
    """Against sums over the oracle's mass points of a bent beam, r = r0 + S q."""
    parts, oracle, k = constants(link, elements), beam_points(link, elements), 6 * elements
    q = np.random.default_rng(seed).uniform(-1.0, 1.0, k)
    bent = oracle.r0 + oracle.S @ q
    assert close((parts.first_moment + q @ parts.first_moment_shape)[0], oracle.masses @ bent)
    moved = np.einsum("a,aij->ij", q, parts.position_shape.reshape(k, 3, 3))
    entries = csr_matrix((parts.shape_value, parts.shape_source, parts.shape_start), shape=(9 * k, k)).toarray()
    shape_shape = entries.reshape(k, 3, 3, k)  # [a, i, j, b]
    square = np.einsum("b,aijb,a->ij", q, shape_shape, q)
    second = parts.second_moment.reshape(3, 3) + moved + moved.T + square
    assert close(second, np.einsum("p,pi,pj->ij", oracle.masses, bent, bent))
    assert close(shape_shape.transpose(3, 2, 1, 0), shape_shape)
    assert close(np.trace(shape_shape, axis1=1, axis2=2).ravel(), parts.elastic_mass[: k * k])


@settings(QUICK)
@given(links, counts, st.integers(0, 10**6))
def test_another_basis_is_the_same_beam(link, elements, seed):
    beam = build_beam(link, elements)
    basis = np.random.default_rng(seed).uniform(-1.0, 1.0, (6 * elements, 4))
    reduced = beam.reduced(basis)
    assert close(reduced.mass_matrix, basis.T @ beam.mass_matrix @ basis)
    assert close(reduced.stiffness, basis.T @ beam.stiffness @ basis)
    assert close(reduced.tip_translation, beam.tip_translation @ basis)
    assert close(reduced.tip_rotation, beam.tip_rotation @ basis)


@pytest.mark.slow
@settings(QUICK)
@given(st.integers(0, 10**6), st.integers(1, 4), st.integers(1, 3))
def test_stations_have_the_moments_of_mass_of_a_stepped_link(seed, count, elements):
    """Sum of m x^p = sum of rho A (b^(p+1) - a^(p+1)) / (p + 1) over the sections, to the degree of a Gauss rule."""
    rng = np.random.default_rng(seed)
    link = NonUniformLink([replace(random_link(rng), orientation=IDENTITY) for _ in range(count)])
    masses, places = build_beam(link, elements).stations[:, :2].T
    assert masses[0] == 0.0 and np.isclose(places[0], link.length, rtol=1e-12), "the first one is the tip"
    assert (masses[1:] > 0.0).all()
    ends = np.cumsum([0.0, *(section.length for section in link.sections)]) / link.length
    density = np.array([section.density * section.area for section in link.sections]) * link.length
    for power in range(2 * len(masses[1:])):
        expected = density @ (ends[1:] ** (power + 1) - ends[:-1] ** (power + 1)) / (power + 1)
        np.testing.assert_allclose(masses @ (places / link.length) ** power, expected, rtol=1e-9)


@settings(QUICK)
@given(st.integers(0, 10**6), st.integers(1, 3), st.integers(1, 3))
def test_a_link_that_only_stretches_moves_its_stations_with_its_own_mass(seed, count, elements):
    """A unit stretch u = x is a polynomial: its stations hold all of its kinetic energy, the integral of rho A x^2."""
    rng = np.random.default_rng(seed)
    link = NonUniformLink([replace(random_link(rng), orientation=IDENTITY) for _ in range(count)])
    beam = build_beam(link, elements)
    stretch = np.zeros(len(beam.stiffness))
    stretch[0::6] = [element.start + element.length for element in Element.divide(link, elements)]
    np.testing.assert_allclose(beam.station_shapes[:, 0] @ stretch, beam.stations[:, 1], rtol=1e-8)
