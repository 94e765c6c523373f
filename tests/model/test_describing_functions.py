"""Describing functions of joint springs with play and with a progressive stiffness, against their closed forms."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.model.dynamics import elastic_forces

Z = (0.0, 0.0, 1.0)
PHASES = 2.0 * np.pi * (np.arange(4000) + 0.5) / 4000


def describing_function(joint, amplitude):
    """Return first harmonic of the torque / amplitude of a harmonic twist, N m/rad."""
    model = fm.build_model(fm.Arm([fm.Link.rod(0.5, 0.02)], [joint]), flexible_links=False)
    twists = amplitude * np.sin(PHASES)
    torques = [elastic_forces(model, np.array([0.0, twist]))[1] for twist in twists]
    return 2.0 * np.mean(torques * np.sin(PHASES)) / amplitude


def saturation(ratio):
    """Return the describing function of a saturation at 1 with unit slope, for the amplitude 1 / ratio."""
    return 2.0 / np.pi * (np.arcsin(ratio) + ratio * np.sqrt(1.0 - ratio**2)) if ratio < 1.0 else 1.0


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.1, 0.4, 0.9])
def test_play(ratio):
    """Gelb and Vander Velde (1968), Multiple-Input Describing Functions, appendix B: a dead zone of half the gap."""
    gap, stiffness = 0.02, 50.0
    joint = fm.Joint(Z, 0.1, stiffness=stiffness, backlash=gap, knee_width=1e-7)
    expected = stiffness * (1.0 - saturation(ratio))
    assert describing_function(joint, 0.5 * gap / ratio) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("ratio", [0.05, 0.5, 0.95])
def test_progressive_spring(ratio):
    """A soft piece up to a torque: the stiffness at large twists less the difference times a saturation."""
    soft, stiff, torque = 16.7, 100.0, 2.0
    joint = fm.Joint(Z, 0.1, stiffness=stiff, stiffness_pieces=((torque, soft / stiff),), knee_width=1e-7)
    expected = stiff - (stiff - soft) * saturation(ratio)
    assert describing_function(joint, torque / soft / ratio) == pytest.approx(expected, rel=1e-4)


@pytest.mark.slow
def test_linear_limits():
    """The progressive spring has its soft stiffness at small amplitudes, and tends to the stiff one at large ones."""
    joint = fm.Joint(Z, 0.1, stiffness=100.0, stiffness_pieces=((2.0, 0.167),), knee_width=1e-7)
    assert describing_function(joint, 0.1) == pytest.approx(16.7, rel=1e-9)
    assert describing_function(joint, 2000.0) == pytest.approx(100.0, rel=1e-4)
