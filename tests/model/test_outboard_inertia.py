"""Spatial inertia of the outboard arm, and rotations at zero joint angles."""

import numpy as np
import pytest
from hypothesis import given, settings

from flexman_gym.model.beam import build_beam
from flexman_gym.model.outboard_inertia import outboard_inertias, zero_pose_rotations

from oracles.chains import QUICK, samples
from oracles.dense import Chain, skew


@pytest.mark.slow
@settings(QUICK)
@given(samples())
def test_outboard_inertia_is_a_sum_over_mass_points(sample):
    arm = sample.arm
    chain = Chain(arm, sample.elements, flexible_links=False)
    masses, positions, _ = chain.points(np.zeros(chain.n_dof), np.zeros(chain.n_dof))
    ends = np.cumsum([len(beam.masses) for beam in chain.beams])
    beams = tuple(map(build_beam, arm.links, sample.elements, sample.flexible_links))
    inertias, tip = outboard_inertias(arm, beams), np.zeros(3)
    for link, result, end in zip(arm.links, inertias, ends, strict=True):
        frame = np.array(link.orientation)
        tip = tip + link.length * frame[:, 0]
        expected = np.zeros((6, 6))
        for mass, position in zip(masses[end:], positions[end:], strict=True):
            motion = np.hstack([np.eye(3), -skew(frame.T @ (position - tip))])
            expected += mass * motion.T @ motion
        assert np.allclose(result, expected, rtol=0.0, atol=1e-12 * max(1.0, np.abs(expected).max()))


@settings(QUICK)
@given(samples())
def test_zero_pose_rotations_lead_to_the_orientations(sample):
    frame = np.eye(3)
    for turn, link in zip(zero_pose_rotations(sample.arm), sample.arm.links, strict=True):
        frame = frame @ turn
        assert np.allclose(frame, link.orientation, rtol=0.0, atol=1e-12)
