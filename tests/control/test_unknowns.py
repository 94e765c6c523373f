"""Unknowns: which numbers stand for which entries of the parameters, in which units, and what is known of them."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.control.unknowns import BEYOND, STEP, make_unknowns

from oracles.refusals import refusal

RANGES = {"payload_mass": (0.0, 4.0), "joint_stiffness": (0.7, 1.3), "joint_damping": (0.0, 2.0)}


def model(**changes):
    """The planar arm, whose second joint may be another one."""
    arm = fm.catalog.vertical_2r()
    return fm.build_model(replace(arm, joints=[arm.joints[0], replace(arm.joints[1], **changes)]), 1, 1)


def test_numbers_are_parameters_in_their_units():
    """Masses and dampings as they are, stiffness as parts of the nominal one of each joint."""
    own = model(stiffness=500.0)
    unknowns = make_unknowns(own, RANGES)
    assert unknowns.names == ("payload_mass", *["joint_stiffness"] * 2, *["joint_damping"] * 2)
    assert unknowns.joints.tolist() == [0, 0, 1, 0, 1]
    values = unknowns.values(own, np.array([[3.0, 0.8, 1.1, 0.2, 0.4], [1.0, 1.0, 1.0, 0.5, 0.6]]))
    springs = own.constants.joint_stiffness
    assert values["payload_mass"].tolist() == [3.0, 1.0]
    assert values["joint_stiffness"] == pytest.approx(np.array([[0.8, 1.1], [1.0, 1.0]]) * springs)
    assert values["joint_damping"].tolist() == [[0.2, 0.4], [0.5, 0.6]]


def test_what_the_model_has_no_coordinate_for_stays_as_it_is():
    own = model(stiffness=None, damping=0.0)
    unknowns = make_unknowns(own, RANGES)
    assert unknowns.names == ("payload_mass", "joint_stiffness", "joint_damping")
    values = unknowns.values(own, np.array([[1.0, 0.5, 0.3]]))
    assert values["joint_stiffness"][0] == pytest.approx([0.5, 1.0] * own.constants.joint_stiffness)
    assert values["joint_damping"][0].tolist() == [0.3, own.constants.joint_damping[1]]
    rubbing = model(viscous_friction=0.2)
    parts = make_unknowns(rubbing, {"viscous_friction": (0.5, 1.5)})
    assert parts.joints.tolist() == [1], "a factor on nothing says nothing"
    assert parts.values(rubbing, np.array([[1.5]]))["viscous_friction"] == pytest.approx(np.array([[0.0, 0.3]]))


def test_beforehand_all_of_a_range_is_as_likely():
    """Mean and deviation are those of numbers drawn from it; an estimate may leave it a little, not below 0."""
    unknowns = make_unknowns(model(), RANGES)
    drawn = np.random.default_rng(0).uniform(0.7, 1.3, 100_000)
    assert unknowns.mean[1] == pytest.approx(drawn.mean(), abs=3e-3)
    assert unknowns.deviation[1] == pytest.approx(drawn.std(), rel=5e-3)
    assert unknowns.step[[0, 1]] == pytest.approx([4.0 * STEP, 0.6 * STEP])
    assert unknowns.low[[0, 1]] == pytest.approx([0.0, 0.7 - 0.6 * BEYOND])
    assert unknowns.high[[0, 1]] == pytest.approx([4.0 + 4.0 * BEYOND, 1.3 + 0.6 * BEYOND])


def test_nothing_unknown_is_no_number():
    own = model()
    unknowns = make_unknowns(own, {})
    assert unknowns.values(own, np.zeros((3, 0))) == {} and unknowns.mean.shape == (0,)


@pytest.mark.parametrize("span", [(0.13, 0.13), (0.0, 0.0)])
def test_a_range_of_one_number_is_a_number_that_is_known(span):
    """To a thousandth, or to a gram."""
    unknowns = make_unknowns(model(), {"payload_mass": span})
    assert unknowns.mean == pytest.approx(span[:1]) and 0.0 < unknowns.deviation[0] < 1e-3
    assert 0.0 <= unknowns.low[0] <= span[0] < unknowns.high[0] and unknowns.step[0] > 0.0


@pytest.mark.parametrize(
    ("ranges", "line"),
    [
        ({"mass": (0.0, 1.0)}, "unknown: 'mass' is not allowed; give one of payload_mass, joint_stiffness"),
        ({"payload_mass": 3.0}, "unknown.payload_mass: 3.0 is not allowed; give a range (low, high)"),
        (
            {"payload_mass": (2.0, 1.0)},
            "unknown.payload_mass: (2.0, 1.0) is not allowed; give a range (low, high) with",
        ),
        ({"payload_mass": (-1.0, 1.0)}, "unknown.payload_mass: (-1.0, 1.0) is not allowed; give a range (low, high) w"),
        ({"joint_stiffness": (0.0, np.inf)}, "unknown.joint_stiffness: (0.0, inf) is not allowed"),
    ],
)
def test_what_is_no_range_is_refused_in_one_line(ranges, line):
    said = refusal(make_unknowns, model(), ranges)
    assert said.startswith(line), said
