"""Stations: the points of a centreline weigh what the link weighs, section by section."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from flexman_gym.model.element import beam_elements
from flexman_gym.model.stations import beam_stations
from flexman_gym.scene.link import IDENTITY, NonUniformLink

from oracles.chains import QUICK, random_link


@settings(QUICK)
@given(st.integers(0, 10**6), st.integers(1, 4), st.integers(1, 3))
def test_stations_have_the_moments_of_mass_of_a_stepped_link(seed, count, elements):
    """Sum of m x^p = sum of rho A (b^(p+1) - a^(p+1)) / (p + 1) over the sections, to the degree of a Gauss rule."""
    rng = np.random.default_rng(seed)
    link = NonUniformLink([replace(random_link(rng), orientation=IDENTITY) for _ in range(count)])
    pieces = beam_elements(link, elements)
    masses, places = beam_stations(pieces, 6 * (len(pieces) + 1))[1][:, :2].T
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
    pieces = beam_elements(link, elements)
    size = 6 * (len(pieces) + 1)
    _, stations, shapes = beam_stations(pieces, size)
    stretch = np.zeros(size)
    stretch[0::6] = [0.0, *(piece.start + piece.length for piece in pieces)]
    np.testing.assert_allclose(shapes[:, 0] @ stretch, stations[:, 1], rtol=1e-8)
