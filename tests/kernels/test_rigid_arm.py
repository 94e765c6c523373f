"""Inverse kinematics of the rigid arm."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flexman_gym.envs.env import FlexManEnv

QUICK = settings(deadline=None, derandomize=True, max_examples=40)
VIEWS = {name: FlexManEnv(name=name).episodes.view for name in ("FlexRRR-v0", "FlexPlanar-v0")}


@QUICK
@given(name=st.sampled_from(sorted(VIEWS)), seed=st.integers(0, 10**6))
def test_the_posture_is_recovered_from_its_tip(name, seed):
    """Tips at postures near a bent one are reached from it, with an error below 1e-9 of the reach."""
    view, random = VIEWS[name], np.random.default_rng(seed)
    near = np.array([0.3, 0.4, 1.1])[-view.n_joints :] * random.choice([-1.0, 1.0])
    postures = near + random.uniform(-0.15, 0.15, (4, view.n_joints))
    tips = view.rigid_tips(postures)
    result, left = view.inverse_kinematics(tips, near)
    assert left <= 1e-9 * view.reach
    assert view.rigid_tips(result) == pytest.approx(tips, abs=2e-9 * view.reach)
    assert result == pytest.approx(postures, abs=1e-6)


def test_a_target_out_of_reach_leaves_its_distance():
    view = VIEWS["FlexRRR-v0"]
    _, left = view.inverse_kinematics(np.array([[20.0, 0.0, 0.0]]), np.array([0.0, 0.3, 0.4]))
    assert left > 11.0


@pytest.mark.parametrize("bent", [0.01, 0.03, 0.05])
def test_from_a_nearly_straight_posture_the_nearest_solution_is_found(bent):
    """The elbow barely moves the tip along the arm, so a full Newton step would turn the joints around."""
    view, posture = VIEWS["FlexPlanar-v0"], np.array([[0.2, 1.0]])
    result, left = view.inverse_kinematics(view.rigid_tips(posture), np.array([0.2 + 0.5 * (1.0 - bent), bent]))
    assert left <= 1e-9 * view.reach and result == pytest.approx(posture, abs=1e-6)
