"""Sections: strips, tubes and rods have the areas and moments of their sizes, and say which way they are thin."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import flexman_gym as fm
from flexman_gym.scene.link import Outline
from flexman_gym.scene.material import MATERIALS
from flexman_gym.scene.serialization import find_arm, to_plain

from oracles.assertions import refusal

Z = (0.0, 0.0, 1.0)
STRIP = fm.Link.strip(0.5, 0.04, 0.003)
JOINTS = [fm.Joint(Z)]
sizes = st.floats(1e-3, 0.3)


@given(sizes, st.floats(0.01, 1.0), st.sampled_from("yz"))
def test_a_strip_has_the_integrals_of_its_rectangle(width, part, thin):
    """Gauss points over the rectangle give int dA, int z^2 dA and int y^2 dA."""
    link = fm.Link.strip(1.0, width, part * width, thin)
    across = {"y": width, "z": width} | {thin: part * width}
    points, weights = np.polynomial.legendre.leggauss(2)
    y, z = np.meshgrid(across["y"] / 2 * points, across["z"] / 2 * points, indexing="ij")
    pieces = np.outer(weights, weights) * across["y"] * across["z"] / 4
    expected = [pieces.sum(), (pieces * z**2).sum(), (pieces * y**2).sum()]
    assert [link.area, link.second_moment_y, link.second_moment_z] == pytest.approx(expected, rel=1e-12)
    assert (link.outline.y, link.outline.z) == (across["y"], across["z"])


@pytest.mark.parametrize(
    ("ratio", "factor"), [(1.0, 0.1406), (1.5, 0.1958), (2.0, 0.2287), (4.0, 0.2808), (10.0, 0.3123)]
)
def test_the_torsion_constant_of_a_rectangle_is_that_of_the_tables(ratio, factor):
    """J = k b t^3 with k of the table in Timoshenko and Goodier, Theory of Elasticity."""
    link = fm.Link.strip(1.0, 0.01 * ratio, 0.01)
    assert link.torsion_constant / (ratio * 0.01**4) == pytest.approx(factor, abs=1.5e-4 if ratio < 2 else 6e-4)


@given(sizes, st.floats(0.001, 0.499))
def test_a_tube_is_a_rod_without_its_core(diameter, part):
    outer, core = fm.Link.rod(1.0, diameter), fm.Link.rod(1.0, diameter * (1.0 - 2.0 * part))
    tube = fm.Link.tube(1.0, diameter, part * diameter)
    for name in ("area", "second_moment_y", "second_moment_z", "torsion_constant"):
        value = getattr(outer, name) - getattr(core, name)
        assert getattr(tube, name) == pytest.approx(value, rel=1e-9, abs=1e-12 * getattr(outer, name)), name
    assert outer.area == pytest.approx(math.pi * diameter**2 / 4)
    assert outer.second_moment_y == outer.second_moment_z == pytest.approx(math.pi * diameter**4 / 64)
    assert tube.torsion_constant == pytest.approx(tube.second_moment_y + tube.second_moment_z)


def test_a_strip_bends_where_it_is_thin():
    """A cantilever under its weight across the thin size sags more than across the wide one, by (width / t)^2."""
    sags = []
    for thin in "yz":
        arm = fm.Arm([fm.Link.strip(0.5, 0.04, 0.003, thin)], JOINTS, gravity=(0.0, 0.0, -9.81))
        model = fm.build_model(arm)
        state = fm.rest_state(model, [0.0])
        sags.append(state[1 : model.n_dof][-4])  # w of the tip
    assert sags[1] / sags[0] == pytest.approx((0.04 / 0.003) ** 2, rel=1e-3)


def test_words_say_which_way_a_strip_is_thin():
    assert "0.003 m along y, 0.04 m along z: thin along y, it bends easily in its x-y plane" in repr(STRIP)
    assert "thin along z" in repr(fm.Link.strip(0.5, 0.04, 0.003, "z"))
    assert "tube" in repr(fm.Link.tube(0.5, 0.04, 0.003)) and "wall 0.003 m" in repr(fm.Link.tube(0.5, 0.04, 0.003))
    plain_link = replace(STRIP, outline=None)
    assert eval(repr(plain_link), {"Link": fm.Link}) == plain_link


@pytest.mark.parametrize(
    "link", [STRIP, fm.Link.tube(0.5, 0.04, 0.003, "steel"), fm.Link.rod(0.5, 0.01, (1e9, 4e8, 900.0))]
)
def test_a_link_with_an_outline_comes_back_from_its_mapping(link):
    stepped = fm.NonUniformLink([link, link])
    arm = fm.Arm([link, stepped], JOINTS * 2)
    again = find_arm(to_plain(arm))
    assert again == arm and again.links[0].outline == link.outline is not None
    assert again.links[1].sections[1].outline == link.outline


def test_a_file_may_give_sizes():
    data = to_plain(fm.Arm([STRIP], JOINTS))
    data["links"] = [{"shape": "strip", "length": 0.5, "width": 0.04, "thickness": 0.003}]
    assert find_arm(data).links[0] == STRIP
    data["links"][0] |= {"material": {"youngs_modulus": 1e9, "shear_modulus": 4e8, "density": 900.0}, "thin": "z"}
    assert find_arm(data).links[0] == fm.Link.strip(0.5, 0.04, 0.003, "z", (1e9, 4e8, 900.0))
    for change, line in (
        ({"thickness": 0.05}, "arm.links[0].thickness: 0.05 is not allowed; give at most the width 0.04"),
        ({"diameter": 0.05}, "arm.links[0]: 'diameter' is not allowed; give one of length, width"),
        ({"shape": "beam"}, "arm.links[0].shape: 'beam' is not allowed; give one of strip, tube, rod"),
    ):
        assert refusal(lambda change=change: find_arm(data | {"links": [data["links"][0] | change]})).startswith(line)
    del data["links"][0]["width"]
    assert "missing 1 required" in refusal(lambda: find_arm(data))


@pytest.mark.parametrize(
    ("make", "line"),
    [
        (lambda: fm.Link.strip(0.5, 0.04, 0.003, "x"), "Link.thin: 'x' is not allowed; give one of y, z"),
        (lambda: fm.Link.strip(0.5, 0.003, 0.04), "Link.thickness: 0.04 is not allowed; give at most the width 0.003"),
        (lambda: fm.Link.tube(0.5, 0.04, 0.021), "Link.wall: 0.021 is not allowed; give at most half of the diameter"),
        (lambda: fm.Link.rod(0.5, 0.0), "Link.diameter: 0.0 is not allowed; give a finite number > 0"),
        (lambda: fm.Link.rod(0.5, 0.01, "wood"), "Link.material: 'wood' is not allowed; give one of aluminium"),
        (lambda: fm.Link.rod(0.5, 0.01, (1e9, 4e8)), "Link.material: (1000000000.0, 400000000.0) is not allowed; give"),
        (lambda: fm.Link.rod(0.5, 0.01, (1e9, 4e8, 0.0)), "Link.density: 0.0 is not allowed; give a finite number > 0"),
        (lambda: replace(STRIP, area=1e-3), "Link.area: 0.001 is not allowed; give 0.00012, the value of its outline"),
        (lambda: replace(STRIP, outline="strip"), "Link.outline: 'strip' is not allowed; give an Outline or None"),
        (lambda: Outline("tube", 0.1, 0.2, 0.01), "Outline.z: 0.2 is not allowed; give 0.1 (m), the diameter along y"),
        (lambda: Outline("rod", 0.1, 0.1, 0.01), "Outline.wall: 0.01 is not allowed; give None for a rod"),
    ],
)
def test_what_no_section_is(make, line):
    assert refusal(make).startswith(line)


@pytest.mark.parametrize("name", MATERIALS)
def test_moduli_of_a_material_belong_together(name):
    """Poisson's ratio E / (2 G) - 1 of these metals lies between 0.28 and 0.35; waves run at 4.9 to 5.2 km/s."""
    material = MATERIALS[name]
    assert 0.27 < material.youngs_modulus / (2.0 * material.shear_modulus) - 1.0 < 0.35
    assert 4.9e3 < math.sqrt(material.youngs_modulus / material.density) < 5.2e3
