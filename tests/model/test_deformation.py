"""Curvature, strain and centreline curves: closed forms of beams, and the corresponding elastic energy."""

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.spatial.transform import Rotation

import flexman_gym as fm
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.kernels import layout, outputs
from flexman_gym.model.deformation import gauge_radii, root_strain_matrix
from flexman_gym.model.dynamics import stiffness_matrix

from oracles.chains import QUICK, samples

LINK = fm.catalog.one_link().links[0]


def loaded(model, load):
    """State of a single clamped link under forces and moments (6,) at its tip: Fx, Fy, Fz, Mx, My, Mz."""
    columns = model.elastic_columns(0)
    force = model.bases[0][-6:].T @ load
    state = np.zeros(2 * model.n_dof)
    state[columns] = np.linalg.solve(stiffness_matrix(model)[columns, columns], force)
    return state


@pytest.mark.parametrize("elements", [1, 3])
@pytest.mark.parametrize("modes", [None, 6])
def test_a_cantilever_has_the_curvatures_of_its_closed_form(elements, modes):
    """EI v'' = F_y (L - x) + M_z, EI w'' = F_z (L - x) - M_y, GJ phi' = M_x, EA u' = F_x."""
    modes = None if modes is None else 6 * elements
    model = fm.build_model(fm.catalog.one_link(), elements=elements, modes=modes)
    load = np.array([900.0, 3.0, -5.0, 0.7, 1.1, -1.9])
    state, y, z = loaded(model, load), 0.004, -0.007
    for place in (0.0, 0.3, 1.0, 1.7, 2.0):
        arm = LINK.length - place
        about_z = (load[1] * arm + load[5]) / (LINK.youngs_modulus * LINK.second_moment_z)
        about_y = (load[4] - load[2] * arm) / (LINK.youngs_modulus * LINK.second_moment_y)
        twist = load[3] / (LINK.shear_modulus * LINK.torsion_constant)
        stretch = load[0] / (LINK.youngs_modulus * LINK.area)
        result = fm.curvature(model, state, 0, place)
        assert result == pytest.approx([twist, about_y, about_z], rel=1e-8)
        assert fm.strain(model, state, 0, place) == pytest.approx(stretch, rel=1e-8)
        expected = stretch - y * about_z + z * about_y
        assert fm.strain(model, state, 0, place, y, z) == pytest.approx(expected, rel=1e-8)


def test_between_elements_the_outboard_one_is_taken():
    model, state = fm.build_model(fm.catalog.one_link(), elements=2), None
    state = np.zeros(2 * model.n_dof)
    state[model.elastic_columns(0).start + 3] = 0.01  # twist of the middle node only
    assert fm.curvature(model, state, 0, 1.0)[0] == pytest.approx(-0.01)
    assert fm.curvature(model, state, 0, np.nextafter(1.0, 0.0))[0] == pytest.approx(0.01)


@pytest.mark.slow
@settings(QUICK)
@given(samples(most_links=3))
def test_strain_holds_the_elastic_energy_of_the_links(sample):
    """Integral of E strain^2 / 2 and G J phi'^2 / 2, by Gauss points exact for linear curvatures."""
    (x, v), model, energy = sample.state(), sample.model, 0.0
    state = np.r_[x, v]
    abscissae, weights = np.polynomial.legendre.leggauss(2)
    for i, (link, count) in enumerate(zip(sample.arm.links, sample.elements, strict=True)):
        h = link.length / count
        y, z = np.sqrt(2 * link.second_moment_z / link.area), np.sqrt(2 * link.second_moment_y / link.area)
        for place, weight in [
            (h * (e + (1 + a) / 2), h * w / 2) for e in range(count) for a, w in zip(abscissae, weights, strict=True)
        ]:
            section = [fm.strain(model, state, i, place, *point) for point in ((y, 0), (-y, 0), (0, z), (0, -z))]
            energy += weight * link.youngs_modulus * link.area * np.mean(np.square(section)) / 2
            twist = fm.curvature(model, state, i, place)[0]
            energy += weight * link.shear_modulus * link.torsion_constant * twist**2 / 2
    row = np.zeros(layout.OUTPUTS)
    outputs.compute_outputs(model.constants, layout.make_work(model.constants), x, v, row)
    assert energy == pytest.approx(row[layout.LINK_ENERGY], rel=1e-7)


@pytest.mark.parametrize("flexibility", [{"flexible_links": False}, {"modes": 0}])
def test_a_rigid_link_has_no_strain(flexibility):
    model = fm.build_model(fm.catalog.one_link(), **flexibility)
    assert fm.curvature(model, [0.3, 0.4], 0, 1.0).tolist() == [0.0, 0.0, 0.0]
    assert fm.strain(model, [0.3, 0.4], 0, 1.0, 0.01, 0.01) == 0.0


ONE = fm.catalog.one_link()
CURVED_LINK = ONE.links[0]
POINTS = 7


def tip(model, state):
    """Tip position computed by the kernels."""
    row, d = np.zeros(layout.OUTPUTS), model.n_dof
    outputs.compute_outputs(model.constants, layout.make_work(model.constants), state[:d].copy(), state[d:].copy(), row)
    return row[layout.TIP]


def cantilever(load, elements=2, **switches):
    """A clamped link under forces and moments (6,) at its tip, N and N m, and its state."""
    model = fm.build_model(ONE, elements=elements, **switches)
    columns, state = model.elastic_columns(0), np.zeros(2 * model.n_dof)
    inner = fm.stiffness_matrix(model)[columns, columns]
    state[columns] = np.linalg.solve(inner, model.bases[0][-6:].T @ np.array(load))
    return model, state


@pytest.mark.slow
@settings(QUICK, max_examples=15)
@given(samples(most_links=4, stiffening=None))
def test_a_chain_ends_at_its_tip_and_its_links_join(sample):
    state = np.concatenate(sample.state())
    result = fm.curves(sample.model, state, POINTS)
    reach = sample.model.constants.length.sum()
    assert np.allclose(result.positions[-1, -1], tip(sample.model, state), rtol=0.0, atol=1e-12 * max(1.0, reach))
    assert np.array_equal(result.positions[1:, 0], result.positions[:-1, -1])
    frames = result.frames.reshape(-1, 3, 3)
    assert np.allclose(frames @ np.swapaxes(frames, 1, 2), np.eye(3), atol=1e-12)
    assert np.allclose(np.linalg.det(frames), 1.0)


@pytest.mark.parametrize("stiffening", [False, True])
@pytest.mark.parametrize("name", NAMED_ENVIRONMENTS)
def test_the_arm_of_every_environment_ends_at_its_tip(name, stiffening):
    model, random = (
        fm.build_model(NAMED_ENVIRONMENTS[name].arm, modes=4, stiffening=stiffening),
        np.random.default_rng(0),
    )
    states = random.normal(0.0, 0.1, (20, 2 * model.n_dof))
    ends = fm.curves(model, states, 5).positions[:, -1, -1]
    assert np.allclose(ends, [tip(model, state) for state in states], rtol=0.0, atol=1e-12)


def test_a_force_at_the_tip_bends_a_cantilever_by_its_cubic_and_turns_its_sections_by_the_slope():
    """w = F x^2 (3 L - x) / (6 E I), w' = F x (2 L - x) / (2 E I)."""
    model, state = cantilever([0.0, 2.0, -3.0, 0.0, 0.0, 0.0])
    result, x = fm.curves(model, state, POINTS), np.linspace(0.0, CURVED_LINK.length, POINTS)
    rigid = CURVED_LINK.youngs_modulus * np.array([CURVED_LINK.second_moment_z, CURVED_LINK.second_moment_y])
    bent = np.array([2.0, -3.0])[:, None] * (x**2 * (3 * CURVED_LINK.length - x)) / (6 * rigid[:, None])
    slope = np.array([2.0, -3.0])[:, None] * (x * (2 * CURVED_LINK.length - x)) / (2 * rigid[:, None])
    assert result.positions[0] == pytest.approx(np.column_stack([x, *bent]), rel=1e-9, abs=1e-12)
    turned = Rotation.from_rotvec(np.column_stack([0 * x, -slope[1], slope[0]])).as_matrix()
    assert result.frames[0] == pytest.approx(turned, abs=1e-12)


def test_a_torque_at_the_tip_twists_a_cantilever_by_the_right_hand():
    """phi = M x / (G J): y of a section turns towards z."""
    model, state = cantilever([0.0, 0.0, 0.0, 5.0, 0.0, 0.0])
    result, x = fm.curves(model, state, POINTS), np.linspace(0.0, CURVED_LINK.length, POINTS)
    twist = 5.0 * x / (CURVED_LINK.shear_modulus * CURVED_LINK.torsion_constant)
    expected = np.column_stack([0 * x, np.cos(twist), np.sin(twist)])
    assert result.frames[0, :, :, 1] == pytest.approx(expected, abs=1e-12)
    assert result.frames[0, -1, 2, 1] > 1e-4 and np.allclose(result.positions[0, :, 1:], 0.0, atol=1e-15)
    radius = gauge_radii(model)[0, 2]
    assert result.strains[0, :, 3] == pytest.approx(radius * twist[-1] / CURVED_LINK.length, rel=1e-9)


@pytest.mark.slow
@settings(QUICK, max_examples=15)
@given(samples(most_links=3))
def test_curvatures_and_strains_are_those_of_one_place_after_another(sample):
    state, model = np.concatenate(sample.state()), sample.model
    result, gauges = fm.curves(model, state, 4), (state @ root_strain_matrix(model)).reshape(-1, 3)
    assert result.strains[:, 0, 1:] == pytest.approx(gauges, rel=1e-9, abs=1e-15)
    for i, link in enumerate(sample.arm.links):
        for j, place in enumerate(np.linspace(0.0, link.length, 4)):
            assert result.curvatures[i, j] == pytest.approx(fm.curvature(model, state, i, place), rel=1e-9, abs=1e-12)
            assert result.strains[i, j, 0] == pytest.approx(fm.strain(model, state, i, place), rel=1e-9, abs=1e-15)


def test_a_bent_link_keeps_the_length_of_its_centreline():
    """To second order in the slopes, along the whole link."""
    load = [
        0.0,
        0.1 * CURVED_LINK.youngs_modulus * CURVED_LINK.second_moment_z * 3 / CURVED_LINK.length**2,
        0.0,
        0.0,
        0.0,
        0.0,
    ]
    lengths = []
    for gain in (1.0, 0.5):
        line = fm.curves(*cantilever(load, 3, stiffening=True), 400, gain).positions[0]
        assert line[-1, 1] == pytest.approx(0.1 * gain * CURVED_LINK.length, rel=1e-9)
        lengths.append(
            np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)) - np.linspace(0, CURVED_LINK.length, 400)[1:]
        )
    assert np.abs(lengths[0]).max() < 1e-4 * CURVED_LINK.length
    assert np.abs(lengths[0]).max() == pytest.approx(16 * np.abs(lengths[1]).max(), rel=0.02), "order four"


def test_a_gain_multiplies_deflection_twist_and_wind_up_and_leaves_strains():
    model = fm.build_model(fm.catalog.planar_2r(joint_stiffness=50.0), elements=1)
    state = np.random.default_rng(2).normal(0.0, 1e-4, 2 * model.n_dof)
    rigid, plain, more = (fm.curves(model, state, 5, gain) for gain in (0.0, 1.0, 3.0))
    links, joints = (fm.curves(model, state, 5, *gains) for gains in ((3.0, 1.0), (1.0, 3.0)))
    moved = [each.positions - rigid.positions for each in (plain, more)]
    assert moved[1] == pytest.approx(3.0 * moved[0], rel=1e-3, abs=1e-9) and np.abs(moved[0]).max() > 1e-5
    apart = [each.positions - plain.positions for each in (links, joints)]
    assert sum(apart) == pytest.approx(2.0 * moved[0], rel=1e-3, abs=1e-9), "links and joints add up"
    assert min(np.abs(each).max() for each in apart) > 1e-5
    arm = model.initial_state(state[model.motor_columns])
    assert np.allclose(rigid.positions, fm.curves(model, arm, 5).positions, atol=1e-15), "motors, undeformed"
    assert np.array_equal(plain.strains, more.strains) and np.array_equal(plain.curvatures, more.curvatures)


def test_many_states_are_as_one_after_another():
    model = fm.build_model(fm.catalog.paper_rrr(), elements=1, stiffening=True)
    states = np.random.default_rng(0).normal(0.0, 0.1, (2, 3, 2 * model.n_dof))
    result = fm.curves(model, states, 4, 2.0)
    assert result.positions.shape == (2, 3, 3, 4, 3) and result.frames.shape == (2, 3, 3, 4, 3, 3)
    for whole, alone in zip(result, fm.curves(model, states[1, 2], 4, 2.0), strict=True):
        assert np.allclose(whole[1, 2], alone, rtol=0.0, atol=1e-14)


def test_rotations_are_those_of_vectors_of_any_length():
    for axis, angle in zip(np.random.default_rng(1).normal(size=(30, 3)), np.geomspace(1e-12, 3.0, 30), strict=True):
        joint = fm.Joint(axis / np.linalg.norm(axis))
        model = fm.build_model(fm.Arm([CURVED_LINK], [joint]), flexible_links=False)
        result = fm.curves(model, fm.rest_state(model, [angle]), 2).frames[0, -1]
        assert np.allclose(result, Rotation.from_rotvec(angle * np.array(joint.axis)).as_matrix(), rtol=0.0, atol=1e-15)
