"""Energy: kept along the motion of random chains by the reference method, from random states."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings

import flexman_gym as fm
from flexman_gym.kernels import layout

from oracles.chains import QUICK, samples

PRECISION = 1e-8  # of the energy that is there or that gravity gives
PERIODS, LONGEST = 50, 0.2  # of the fastest mode, which rules the steps of an explicit method; s
ROWS = 11


def moving(sample, **damping):
    """The chain bent and with gravity, so that energy has where to go; without any damping but what is given."""
    rng = np.random.default_rng(sample.seed)
    damping = {"stiffness_proportional_damping": 0.0, "modal_damping_ratio": 0.0} | damping
    arm = replace(sample.arm, gravity=rng.uniform(3.0, 10.0, 3), **damping)
    return replace(sample, arm=arm, amplitude=min(max(sample.amplitude, 0.05), 0.3))


def energies(sample, torque):
    """Kinetic, elastic and gravitational energy (ROWS, 3), J, from the sample's state on, under torques that stay.

    Then the work of the motors less the loss and the change of energy (ROWS,), J. The times cover some periods of the
    fastest mode, so that every chain takes about as many steps.
    """
    duration = min(LONGEST, PERIODS / max(fm.frequencies(sample.model).max(), 1.0))
    period = duration / (ROWS - 1)
    # Below this the rounding of accelerations, machine precision times the condition number, would rule the steps.
    simulator = fm.Simulator(sample.model, "dop853", None, period, rtol=1e-10, atol=1e-12)
    simulator.reset(state=np.concatenate(sample.state()))
    parts, residual = [], []
    for row in range(ROWS):
        assert row == 0 or simulator.step(torque) == "ok"
        out = simulator.outputs
        parts.append((out[layout.KINETIC], simulator.elastic_energy, out[layout.GRAVITATIONAL]))
        residual.append(simulator.energy_residual)
    return np.array(parts), np.array(residual)


@settings(QUICK, max_examples=20)
@given(samples(stiffening=None))
def test_energy_is_kept_without_damping_and_torque(sample):
    sample = moving(sample)
    joints = [replace(joint, damping=0.0) for joint in sample.arm.joints]
    sample = replace(sample, arm=replace(sample.arm, joints=joints))
    parts, _ = energies(sample, np.zeros(sample.model.n_joints))
    size = parts[0, :2].sum() + np.ptp(parts[:, 2])
    assert np.ptp(parts, axis=0).max() > 1e-3 * size
    assert np.abs(parts.sum(axis=1) - parts[0].sum()).max() <= PRECISION * size


@settings(QUICK, max_examples=20)
@given(samples(stiffening=None))
def test_work_is_what_energy_and_dampers_take(sample):
    sample = moving(sample, stiffness_proportional_damping=1e-6, modal_damping_ratio=sample.arm.modal_damping_ratio)
    parts, residual = energies(sample, sample.torque())
    size = parts[0, :2].sum() + np.ptp(parts[:, 2])
    assert np.abs(parts.sum(axis=1) - parts[0].sum()).max() > 1e-3 * size
    assert np.abs(residual).max() <= PRECISION * size
