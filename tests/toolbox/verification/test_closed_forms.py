"""Closed forms: roots of the characteristic equations against the Rayleigh-Ritz method and known limits."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flexman_gym.toolbox.verification.closed_forms import (
    bar_frequencies,
    cantilever_frequencies,
    flexible_joint_frequencies,
    hub_beam_frequencies,
    stepped_cantilever_frequencies,
)
from studies.verification.arms import rayleigh_frequencies

from oracles import ritz

QUICK = settings(deadline=None, derandomize=True, max_examples=25)
RATIOS = st.floats(0.05, 20.0)


@pytest.mark.slow
@QUICK
@given(RATIOS)
def test_a_mass_at_the_tip(ratio):
    assert cantilever_frequencies(4, ratio) == pytest.approx(ritz.beam_eigenvalues(4, ratio), rel=1e-8)


@pytest.mark.slow
@QUICK
@given(RATIOS)
def test_a_free_hub(ratio):
    assert hub_beam_frequencies(3, ratio) == pytest.approx(ritz.beam_eigenvalues(3, hub_inertia_ratio=ratio), rel=1e-8)


@pytest.mark.slow
@QUICK
@given(RATIOS, RATIOS | st.none(), st.floats(0.0, 5.0))
def test_a_spring_with_a_rotor_or_without(stiffness, rotor, tip):
    expected = ritz.beam_eigenvalues(3, tip, spring=(stiffness, rotor))
    assert flexible_joint_frequencies(3, stiffness, rotor, tip) == pytest.approx(expected, rel=1e-7)


@pytest.mark.slow
@QUICK
@given(st.floats(0.2, 0.8), st.floats(0.2, 3.0), st.floats(0.2, 3.0))
def test_a_step(place, rigidity, mass):
    expected = ritz.beam_eigenvalues(3, segments=((place, 1.0, 1.0), (1.0 - place, rigidity, mass)))
    assert stepped_cantilever_frequencies(3, place, rigidity, mass) == pytest.approx(expected, rel=1e-7)


@pytest.mark.slow
@QUICK
@given(st.floats(1e-5, 2e-3))
def test_sections_that_resist_rotation(gyration):
    expected = ritz.beam_eigenvalues(3, gyration_ratio=gyration)
    assert rayleigh_frequencies(3, gyration) == pytest.approx(expected, rel=1e-7)


def test_a_bar():
    assert bar_frequencies(4) == pytest.approx(ritz.bar_eigenvalues(4), rel=1e-9)


@pytest.mark.parametrize("place", [0.01, 0.4, 0.99])
def test_a_step_of_nothing_is_no_step(place):
    assert stepped_cantilever_frequencies(5, place, 1.0, 1.0) == pytest.approx(cantilever_frequencies(5), rel=1e-11)


def test_limits_of_the_stepped_cantilever():
    """A weightless outboard or a stiff heavy inboard segment leaves the cantilever of the remaining segment."""
    place = 0.6
    weightless = stepped_cantilever_frequencies(1, place, 1.0, 1e-9)
    assert weightless == pytest.approx(cantilever_frequencies(1) / place**2, rel=1e-6)
    rigid = 1e-9  # EI and rho A of the end over those of the root: their ratio, and so its lambda, stays
    assert stepped_cantilever_frequencies(1, 0.05, rigid, rigid) == pytest.approx(
        cantilever_frequencies(1) / 0.95**2, rel=1e-6
    )
