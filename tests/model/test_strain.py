"""Strain: closed forms of beams, and the elastic energy that belongs to it."""

import numpy as np
import pytest
from hypothesis import given, settings

import flexman_gym as fm
from flexman_gym.kernels import layout, outputs
from flexman_gym.model.instant import stiffness_matrix

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
    outputs.observe(model.constants, layout.make_work(model.constants), x, v, row)
    assert energy == pytest.approx(row[layout.LINK_ENERGY], rel=1e-7)


@pytest.mark.parametrize("flexibility", [{"flexible_links": False}, {"modes": 0}])
def test_a_rigid_link_has_no_strain(flexibility):
    model = fm.build_model(fm.catalog.one_link(), **flexibility)
    assert fm.curvature(model, [0.3, 0.4], 0, 1.0).tolist() == [0.0, 0.0, 0.0]
    assert fm.strain(model, [0.3, 0.4], 0, 1.0, 0.01, 0.01) == 0.0


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        (([0.0], 0, 1.0), "state"),
        (([0.0, np.nan], 0, 1.0), "state[1]"),
        (([0.0, 0.0], 1, 1.0), "link"),
        (([0.0, 0.0], -1, 1.0), "link"),
        (([0.0, 0.0], 0.0, 1.0), "link"),
        (([0.0, 0.0], 0, -0.1), "position"),
        (([0.0, 0.0], 0, 2.1), "position"),
        (([0.0, 0.0], 0, None), "position"),
        (([0.0, 0.0], 0, 1.0, "top"), "y"),
        (([0.0, 0.0], 0, 1.0, 0.0, np.inf), "z"),
    ],
)
def test_bad_input_is_refused_in_one_line(arguments, field):
    model = fm.build_model(fm.catalog.one_link(), flexible_links=False)
    with pytest.raises(ValueError) as error:
        fm.strain(model, *arguments)
    line = str(error.value)
    assert line.startswith(f"{field}: ") and " is not allowed; give " in line and "\n" not in line
