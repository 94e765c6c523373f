"""Tests of bounds of the amplitude of vibrations; tests/studies/test_stability.py has those of stability limits."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.simulation.methods import METHODS
from flexman_gym.simulation.stability import amplitude_range


@pytest.mark.slow
@pytest.mark.parametrize("method", ["midpoint_3", "midpoint_corrected_3"])
@pytest.mark.parametrize("angle", [0.3, 1.2])
def test_the_amplitude_of_a_linear_vibration_oscillates_within_its_bounds_and_reaches_them(method, angle):
    """One rigid link on a spring is exactly linear; at the largest deflection the amplitude is the smallest."""
    stiffness, inertia = 5.0, 0.0155 + 0.2 * 0.15**2
    link = fm.Link.rigid(length=0.3, mass=0.2, centre=(0.15, 0.0, 0.0), inertia=np.diag([0.0, 0.0155, 0.0155]))
    arm = fm.Arm([link], [fm.Joint((0.0, 0.0, 1.0), passive=True, stiffness=stiffness)])
    omega = np.sqrt(stiffness / inertia)
    step = angle / omega
    choice, start = fm.ModelChoice(False, 1), fm.Initial([0.2], [0.0])
    scene = fm.Scene(arm, choice, fm.ConstantTorque([0.0]), start, 400 * step, step)
    states = fm.simulate(scene, method=method, step=step).states
    amplitude = np.hypot(states[:, 0], states[:, 1] / omega) / 0.2
    low, high = amplitude_range(METHODS[method], angle)
    assert (amplitude.min(), amplitude.max()) == pytest.approx((1.0, high), abs=1e-4)
    assert low * high == pytest.approx(1.0)


def test_the_amplitude_under_the_corrected_midpoint_rule_oscillates_by_a_twelfth_of_the_square_at_most():
    """The bound is reached for small omega h; a second stage has no such ellipse."""
    method = METHODS["midpoint_corrected_3"]
    largest = {angle: amplitude_range(method, angle)[1] - 1.0 for angle in (1e-2, 0.1, 0.3, 1.0, 3.0, 10.0, 100.0)}
    assert all(0.0 < value <= angle**2 / 12.0 for angle, value in largest.items())
    assert all(2.0 * value + value**2 <= angle**2 / 6.0 for angle, value in largest.items()), "energy"
    assert largest[1e-2] == pytest.approx(1e-4 / 12.0, rel=1e-3)
    with pytest.raises(ValueError, match="gauss_3 has 2 stages; give a midpoint rule"):
        amplitude_range(METHODS["gauss_3"], 1.0)
