"""Modes: frequencies, damping ratios and amplitudes against other ways to them."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.model.dynamics import damping_matrix, inertial_forces, mass_matrix, stiffness_matrix
from flexman_gym.model.statics import rest_tips
from flexman_gym.toolbox.controllers.excited_modes import excited_modes

from oracles.assertions import refusal

SPATIAL = fm.build_model(fm.catalog.paper_rrr(rotor_inertia=10.0), 2, 4)
PLANAR = fm.build_model(fm.catalog.planar_2r(joint_stiffness=60.0, payload=fm.Payload(0.2)), 2)
RIGID = fm.build_model(fm.catalog.planar_2r(), 2)
POSTURES = {RIGID: [0.4, -0.7], SPATIAL: [0.3, 0.5, -0.9], PLANAR: [0.4, -0.7]}


@pytest.mark.parametrize("model", [SPATIAL, PLANAR, RIGID])
def test_without_damping_they_are_among_the_natural_frequencies(model):
    """Those of locked joints and of free ones, less what turns as a whole and what no motor moves."""
    for held in (True, False):
        modes = excited_modes(model, POSTURES[model], held)
        known = fm.frequencies(model, POSTURES[model], lock_joints=held)
        nearest = known[np.abs(modes[:, :1] - known).argmin(axis=1)]
        assert modes[:, 0] == pytest.approx(nearest, rel=1e-6) and abs(modes[:, 1]).max() < 1e-6
        assert modes[0, 0] == pytest.approx(known[known > 1e-3][0], rel=1e-6), "the lowest is there"


def test_a_plane_arm_rings_in_its_plane_alone():
    """The strips bend and twist out of the plane of motion too, as `frequencies` tells."""
    modes, known = excited_modes(PLANAR, POSTURES[PLANAR]), fm.frequencies(PLANAR, POSTURES[PLANAR], lock_joints=True)
    assert len(modes) < np.count_nonzero(known <= modes[-1, 0])


def test_a_damping_ratio_is_that_of_the_rates():
    """Of small damping: c / (2 m w) of one coordinate; damping beta K makes beta w / 2 of every mode."""
    beta = 1e-4
    arm = fm.catalog.one_link(rotor_inertia=1.0, stiffness_proportional_damping=beta)
    modes = excited_modes(fm.build_model(arm, 4), [0.0])
    assert modes[:3, 1] == pytest.approx(0.5 * beta * 2.0 * np.pi * modes[:3, 0], rel=1e-6)
    model = fm.build_model(fm.catalog.one_joint(), 2, flexible_links=False)
    c, m = (matrix(model, *given)[0, 0] for matrix, given in ((damping_matrix, ()), (mass_matrix, (np.zeros(4),))))
    frequency, ratio, _ = excited_modes(model, [0.0])[0]
    assert ratio == pytest.approx(c / (2.0 * m * 2.0 * np.pi * frequency), rel=1e-6)


def test_a_raised_arm_swings_slower_by_its_weight():
    """A rigid link at the angle a on a spring k: w^2 = (k - m g l / 2 sin a) / I."""
    link, joint = fm.catalog.one_joint().links[0], fm.Joint((0.0, -1.0, 0.0), 0.1, 30.0)
    arm = fm.Arm([link], [joint], gravity=(0.0, 0.0, -9.81))
    model = fm.build_model(arm, 1, flexible_links=False)
    for angle in (-1.2, 0.9):
        turned = fm.rest_state(model, [angle])[0]
        inertia = mass_matrix(model, fm.rest_state(model, [angle]))[0, 0]
        square = (30.0 - link.mass * 9.81 * 0.4 * np.sin(turned)) / inertia
        assert excited_modes(model, [angle])[0, 0] == pytest.approx(np.sqrt(square) / (2.0 * np.pi), rel=1e-7)
        both = square + (30.0 / 0.1)
        rotor = both / 2.0 + np.sqrt(both**2 / 4.0 - (square * 300.0 - 30.0**2 / (0.1 * inertia)))
        assert excited_modes(model, [angle], False)[0, 0] == pytest.approx(np.sqrt(rotor) / (2.0 * np.pi), rel=1e-7)


def test_held_under_its_weight_an_arm_rings_by_its_static_stiffness():
    """The slope of the forces that rest takes, by differences, and the mass matrix: rigid joints carry no spring."""
    model = fm.build_model(fm.catalog.planar_2r(gravity=(0.0, -3.0, 0.0)), 1)
    rest = fm.rest_state(model, [0.9, -0.4])
    d, still, forces, free = model.n_dof, np.zeros(model.n_dof), inertial_forces(model), np.arange(2, model.n_dof)
    slopes = [
        (forces(rest[:d] + h, still, still) - forces(rest[:d] - h, still, still)) / 2e-5 for h in 1e-5 * np.eye(d)
    ]
    stiffness = stiffness_matrix(model) + np.transpose(slopes)
    pairs = np.linalg.eigvals(
        np.linalg.solve(mass_matrix(model, rest)[np.ix_(free, free)], stiffness[np.ix_(free, free)])
    )
    modes = excited_modes(model, [0.9, -0.4])
    known = np.sort(np.sqrt(pairs.real)) / (2.0 * np.pi)
    assert np.abs(modes[:3, :1] / known - 1.0).min(axis=1) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("stiffness", [None, 40.0])
def test_amplitudes_after_a_step_add_up_to_the_way_of_the_tip(stiffness):
    """At first the tip is where it was, far from its new place by the whole way: modes of one phase add up to it.

    Where the joint is rigid the step carries the root along, and modes differ in sign; their sum is no less.
    """
    model = fm.build_model(fm.catalog.one_link(rotor_inertia=1.0, joint_stiffness=stiffness), 2)
    modes = excited_modes(model, [0.0])
    way = np.linalg.norm(np.diff(rest_tips(model, np.array([[0.0], [1e-4]])), axis=0)) / 1e-4
    assert modes[0, 2] < 1.6 * way and modes[:, 2].sum() > 0.97 * way


def test_what_they_are_not_found_for_is_refused():
    assert refusal(lambda: excited_modes(SPATIAL, [0.0])).startswith("motor_angles: ")
    assert refusal(lambda: excited_modes(PLANAR, [0.0, 0.0], 1)).startswith("held: 1 ")
    rigid = fm.build_model(fm.catalog.planar_2r(), 1, flexible_links=False)
    assert len(excited_modes(rigid, [0.0, 0.0])) == len(excited_modes(rigid, [0.0, 0.0], False)) == 0
