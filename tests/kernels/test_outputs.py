"""Tip acceleration and specific force, against the dense oracle and for batches."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import flexman_gym as fm
from flexman_gym.kernels import dynamics, layout, outputs
from flexman_gym.kernels.layout import SPECIFIC_FORCE, TIP_ACCELERATION, TIP_ACCELERATIONS
from flexman_gym.simulation.batch_integrators import LaneIntegrator, SequentialIntegrator
from flexman_gym.simulation.integrator import Integrator
from flexman_gym.simulation.methods import METHODS

from oracles.chains import QUICK, affected

PERIOD = (2e-3, 2)


@pytest.mark.slow
@QUICK
@given(affected())
def test_both_equal_the_dense_equations_with_every_effect(case):
    """The oracle uses the accelerations of the coordinates from the recursion; other tests compare those."""
    (x, v), drive = case.sample.state(), case.drive()
    rates, result = np.zeros(case.model.n_dof), np.zeros(TIP_ACCELERATIONS)
    dynamics.accelerations(case.constants, layout.make_work(case.constants), x, v, drive, rates)
    outputs.tip_accelerations(case.constants, layout.make_work(case.constants), x, v, drive, result)
    expected, axes = case.chain.tip_acceleration(x, v, rates), case.chain.tip_axes(x)
    specific = axes.T @ (expected + drive[-3:] - case.chain.gravity)
    largest = np.abs(case.chain.tip_acceleration(x, 0.0 * v, np.abs(rates))).max() + np.abs(rates).max() + 10.0
    np.testing.assert_allclose(result[TIP_ACCELERATION], expected, rtol=0.0, atol=1e-11 * largest)
    np.testing.assert_allclose(result[SPECIFIC_FORCE], specific, rtol=0.0, atol=1e-11 * largest)


def tip_accelerations(integrator, states, drives):
    """Return the tip accelerations of arms at states (b, 2 d) under drives (b, n + 6)."""
    result = np.full((len(states), TIP_ACCELERATIONS), np.nan)
    integrator.compute_tip_accelerations(drives, np.hstack([states, np.zeros((len(states), 2))]), result)
    return result


@pytest.mark.slow
@QUICK
@given(affected(), st.sampled_from(["ros2", "midpoint_3", "midpoint_corrected_3"]))
def test_a_single_arm_has_the_bits_of_one_among_seventeen(case, method):
    """The neighbours include infinite numbers and NaN; without foreshortening all methods agree."""
    (x, v), method = case.sample.state(), METHODS[method]
    states = np.linspace(0.0, 1.0, 17)[:, None] * np.r_[x, v]
    drives = np.linspace(-1.0, 1.0, 17)[:, None] * case.drive()
    states[3], states[12], drives[5] = np.nan, 1e200, np.inf
    abreast = tip_accelerations(LaneIntegrator(case.constants, method, PERIOD, 17, 1), states, drives)
    for arm in (0, 1, 4, 7, 8, 11, 16):
        one = slice(arm, arm + 1)
        assert np.isfinite(abreast[arm]).all()
        alone = tip_accelerations(LaneIntegrator(case.constants, method, PERIOD, 1, 1), states[one], drives[one])[0]
        assert np.array_equal(alone, abreast[arm])
        single = tip_accelerations(
            SequentialIntegrator([Integrator(case.model, method, None, case.held)], PERIOD), states[one], drives[one]
        )[0]
        if case.sample.stiffening:  # sums over stations run in another order
            assert np.abs(single - abreast[arm]).max() <= 1e-6 * (1.0 + np.abs(single).max())
        else:
            assert np.array_equal(single, abreast[arm])


@pytest.mark.parametrize("threads", [2, 5])
def test_threads_share_the_groups(threads):
    model = fm.build_model(fm.catalog.paper_rrr(), modes=2)
    states = 1e-3 * np.random.default_rng(0).normal(size=(273, 2 * model.n_dof))
    drives = np.random.default_rng(1).uniform(-100.0, 100.0, (273, 9))
    alone, several = (LaneIntegrator(model.constants, METHODS["ros2"], PERIOD, 273, count) for count in (1, threads))
    assert np.array_equal(tip_accelerations(several, states, drives), tip_accelerations(alone, states, drives))
