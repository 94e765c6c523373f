"""Static equilibrium: zero accelerations at rest, and the sag of beams against published formulas."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

import flexman_gym as fm
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.kernels import layout
from flexman_gym.kernels.inverse import EQUILIBRIUM_ITERATIONS, EQUILIBRIUM_TOLERANCE
from flexman_gym.model.statics import rest_tips, rigid_holding_torques

from oracles.assertions import refusal
from oracles.chains import QUICK, Sample, observed, samples

WEIGHT = 9.81


def cantilever(load, elements=3, gravity=(0.0, -WEIGHT, 0.0), stiffness=None):
    """A beam along +X on a locked motor, with a point mass (kg) at its end, that sags in its plane."""
    link = fm.Link(1.5, 4e-4, 1e-7, 5e-9, 2e-8, youngs_modulus=70e9, shear_modulus=26e9, density=2700.0)
    joint = fm.Joint((0.0, 0.0, 1.0), 0.1, stiffness)
    return fm.build_model(fm.Arm([link], [joint], fm.Payload(load) if load else None, gravity), elements)


@pytest.mark.slow
@settings(QUICK, max_examples=25)
@given(samples(most_links=3, stiffening=None), st.integers(0, 100))
def test_nothing_accelerates_at_rest_under_the_holding_torques(sample, seed):
    """By the dense equations of the oracle; a fifth of the earth's gravity, small enough for all of these springs."""
    rng = np.random.default_rng(seed)
    sample = Sample(replace(sample.arm, gravity=rng.uniform(-2.0, 2.0, 3)), *list(vars(sample).values())[1:8])
    model, n = sample.model, len(sample.arm.links)
    angles = rng.uniform(-3.0, 3.0, n)
    state, torques = fm.rest_state(model, angles), fm.holding_torques(model, angles)
    x, v = np.split(state, 2)
    assert np.array_equal(state[model.motor_columns], angles) and not v.any()
    mass = sample.chain.mass_matrix(x)
    scale = np.sqrt(np.diag(mass))
    result = mass @ sample.chain.acceleration(x, v, torques) / scale
    falling = mass @ sample.chain.acceleration(model.initial_state(angles)[: model.n_dof], v, np.zeros(n)) / scale
    assert np.abs(result).max() <= 1e-8 * np.abs(falling).max()


@pytest.mark.parametrize(("load", "elements"), [(0.0, 1), (0.3, 1), (0.1, 2), (0.4, 4)])
def test_a_cantilever_sags_by_the_formulas_of_its_load_and_of_its_own_weight(load, elements):
    """P L^3 / 3 EI + w L^4 / 8 EI, exact at the nodes of beam elements; its clamp holds P L + w L^2 / 2."""
    model = cantilever(load, elements)
    link = model.arm.links[0]
    length, rigidity = link.length, link.youngs_modulus * link.second_moment_z
    weight, spread = load * WEIGHT, link.density * link.area * WEIGHT
    sag = weight * length**3 / (3 * rigidity) + spread * length**4 / (8 * rigidity)
    tip = observed(model, *np.split(fm.rest_state(model, [0.0]), 2))[layout.TIP]
    assert tip == pytest.approx([length, -sag, 0.0], rel=1e-3, abs=1e-9)
    moment = weight * length + spread * length**2 / 2
    assert fm.holding_torques(model, [0.0]) == pytest.approx([moment], rel=1e-3)


def test_a_small_sag_is_the_formula_to_nine_digits():
    """With a millionth of the weight, so that second-order terms vanish."""
    model = cantilever(0.3, gravity=(0.0, -1e-6 * WEIGHT, 0.0))
    link = model.arm.links[0]
    rigidity, length = link.youngs_modulus * link.second_moment_z, link.length
    sag = 0.3 * length**3 / (3 * rigidity) + link.density * link.area * length**4 / (8 * rigidity)
    expected = -1e-6 * WEIGHT * sag
    assert observed(model, *np.split(fm.rest_state(model, [0.0]), 2))[layout.TIP][1] == pytest.approx(
        expected, rel=1e-9
    )


@pytest.mark.slow
@settings(deadline=None)
@given(st.floats(-3.0, 3.0), st.floats(50.0, 5000.0))
def test_a_spring_gives_way_until_it_holds_the_weight(angle, stiffness):
    """A rigid link on a spring: stiffness (motor - joint) = m g l / 2 cos(joint); the motor holds the same moment."""
    model = fm.build_model(cantilever(0.0, stiffness=stiffness).arm, 1, flexible_links=False)
    joint = fm.rest_state(model, [angle])[0]
    link = model.arm.links[0]
    moment = link.mass * WEIGHT * link.length / 2 * np.cos(joint)
    assert stiffness * (angle - joint) == pytest.approx(moment, abs=1e-9)
    assert fm.holding_torques(model, [angle]) == pytest.approx([moment], abs=1e-9)


@pytest.mark.slow
@settings(QUICK, max_examples=15)
@given(samples(most_links=4), st.integers(0, 100))
def test_without_gravity_an_arm_rests_undeformed_and_needs_no_torques(sample, seed):
    model = Sample(replace(sample.arm, gravity=(0.0,) * 3), *list(vars(sample).values())[1:8]).model
    angles = np.random.default_rng(seed).uniform(-3.0, 3.0, model.n_joints)
    state = fm.rest_state(model, angles)
    assert np.array_equal(state, model.initial_state(angles))
    assert not state[model.n_joints + model.n_motors :].any()
    assert np.abs(fm.holding_torques(model, angles)).max() <= 1e-10  # springs of 1e4 N m/rad between equal angles


def test_a_vertical_column_bends_nowhere():
    model = cantilever(0.3, gravity=(0.0, -WEIGHT, 0.0))
    tip = observed(model, *np.split(fm.rest_state(model, [np.pi / 2]), 2))[layout.TIP]
    assert tip[0] == pytest.approx(0.0, abs=1e-9) and tip[1] == pytest.approx(1.5, abs=1e-5)
    assert fm.holding_torques(model, [np.pi / 2]) == pytest.approx([0.0], abs=1e-9)


def test_tips_at_rest_are_those_of_the_states_at_rest():
    model = cantilever(0.2, stiffness=500.0)
    postures = np.array([[-1.0], [0.0], [0.7]])
    expected = [observed(model, *np.split(fm.rest_state(model, posture), 2))[layout.TIP] for posture in postures]
    assert np.array_equal(rest_tips(model, postures), expected)


def test_the_vertical_arm_sags_by_some_seven_centimetres():
    """Sag stated in the docstring of `catalog.vertical_2r`."""
    model = fm.build_model(fm.catalog.vertical_2r())
    assert rest_tips(model, np.zeros((1, 2)))[0][2] == pytest.approx(-0.07, abs=0.015)
    limits = Configuration.from_keywords({"name": "FlexPlanar-v0"}).torque_limit
    assert (np.abs(fm.holding_torques(model, [0.0, 0.0])) < 0.7 * np.array(limits)).all()


@pytest.mark.slow
@settings(QUICK, max_examples=25)
@given(samples(most_links=3, stiffening=None), st.integers(0, 100))
def test_holding_torques_of_the_rigid_arm_are_the_gradient_of_its_gravitational_energy(sample, seed):
    """By central differences of the energy along the joint angles, without deflections."""
    rng = np.random.default_rng(seed)
    model = fm.build_model(replace(sample.arm, gravity=rng.uniform(-10.0, 10.0, 3)))
    n, zero = model.n_joints, np.zeros(model.n_dof)
    angles, step = rng.uniform(-3.0, 3.0, n), 1e-4

    def energy(posture):
        return observed(model, model.at_rest(posture[None])[0, : model.n_dof], zero)[layout.GRAVITATIONAL]

    change = [(energy(angles + each) - energy(angles - each)) / (2.0 * step) for each in step * np.eye(n)]
    scale = max(np.abs(change).max(), abs(energy(angles)))
    assert np.abs(rigid_holding_torques(model, angles) - change).max() <= 1e-6 * scale


NEEDED = re.compile(r"joint (\d) needs a stiffness of about (\S+) N m/rad, not (\S+?)(?:;|$)")


def vertical(stiffness):
    """Return an arm of rigid rods of 0.5 m and 1 kg in a vertical plane, with springs (N m/rad) at its joints."""
    link = fm.Link.rigid(0.5, 1.0, (0.25, 0.0, 0.0), np.diag([1e-4, 0.02, 0.02]))
    joints = [fm.Joint((0.0, 0.0, 1.0), stiffness=each, rotor_inertia=0.1) for each in stiffness]
    return fm.build_model(fm.Arm([link] * len(joints), joints, gravity=(0.0, -9.81, 0.0)))


def test_needed_stiffness_of_a_pendulum_is_that_of_the_closed_form():
    """The iteration contracts errors by x tan x at the sag x, the slope of the weight over the stiffness."""
    contraction = EQUILIBRIUM_TOLERANCE ** (1.0 / EQUILIBRIUM_ITERATIONS)
    sag = brentq(lambda x: x * np.tan(x) - contraction, 0.1, 1.2)
    line = refusal(fm.rest_state, vertical([0.5]), [0.0])
    (joint, needed, present), *others = NEEDED.findall(line)
    assert (joint, present, others) == ("1", "0.5", [])
    assert float(needed) == pytest.approx(9.81 * 0.25 * np.cos(sag) / sag, rel=0.02)
    assert line.startswith(
        "motor_angles: [0.0] is not allowed; give an arm stiff enough to hold its own weight in this"
    )


@pytest.mark.parametrize("stiffness", [(0.5, 50.0), (50.0, 0.1), (0.5, 0.1)])
@pytest.mark.parametrize("posture", [(0.0, 0.0), (0.7, -0.4)])
def test_arm_with_the_needed_stiffness_holds_its_weight_and_a_softer_one_does_not(stiffness, posture):
    needed, soft = list(stiffness), [i for i, each in enumerate(stiffness) if each < 1.0]
    found = NEEDED.findall(refusal(fm.rest_state, vertical(stiffness), posture))
    assert [int(joint) - 1 for joint, *_ in found] == soft
    for joint, value, present in found:
        assert float(present) == stiffness[int(joint) - 1]
        needed[int(joint) - 1] = float(value)
    stiffer, softer = (tuple(np.where(np.isin([0, 1], soft), factor, 1.0) * needed) for factor in (1.02, 0.95))
    assert np.isfinite(fm.rest_state(vertical(stiffer), posture)).all()
    refusal(fm.rest_state, vertical(softer), posture)


def test_arm_whose_links_are_too_soft_for_its_weight_is_refused_as_such():
    link = fm.Link.strip(2.0, 0.03, 0.001, material="aluminium", thin="y")
    arm = fm.Arm(
        [link] * 2, [fm.Joint((0.0, 0.0, 1.0), stiffness=1e4, rotor_inertia=0.1)] * 2, gravity=(0.0, -9.81, 0.0)
    )
    line = refusal(fm.rest_state, fm.build_model(arm, 2), [0.0, 0.0])
    assert line.endswith("stiffer joints do not suffice, its links bend")
