"""Movers: arms abreast, an arm alone and one after the other are moved by the same physics."""

import gc
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import flexman_gym as fm
from flexman_gym.kernels import layout
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.batch_integrators import LaneIntegrator, SequentialIntegrator
from flexman_gym.simulation.integrator import Integrator
from flexman_gym.simulation.methods import METHODS
from flexman_gym.simulation.worker_thread import WorkerThread

from oracles.chains import QUICK, affected

PERIOD, PARTS, ARMS = 2e-3, 2, 11  # s; short, as these arms may be as stiff as they like


def moved(mover, states, drives):
    """Rows, outputs and status of arms (b, 2 d) after a period."""
    rows, outputs = np.hstack([states, np.zeros((len(states), 2))]), np.zeros((len(states), layout.OUTPUTS))
    status = np.zeros(len(states), dtype=np.int64)
    mover.integrate(drives, np.zeros(len(states)), rows, outputs, status)
    return rows, outputs, status


def states_of(sample, model):
    """Arms that bend from nothing to beyond the series of the tangent operator, side by side."""
    result = [np.concatenate(sample.state(arm)) for arm in range(ARMS)]
    return np.array([state * scale for state, scale in zip(result, np.linspace(0.0, 1.0, ARMS), strict=True)])


def drives_for(model, held, seed):
    """Torques, tip forces and accelerations of the base; moderate accelerations of joints that are held."""
    drives = np.random.default_rng(seed).uniform(-20.0, 20.0, (ARMS, model.n_joints + 6))
    drives[:, list(held)] *= 0.05
    return drives


@pytest.mark.slow
@QUICK
@given(
    affected(),
    st.sampled_from(["rk4", "ros2", "extrapolated_euler_3", "extrapolated_euler_7", "midpoint_2", "gauss_2"]),
)
def test_lanes_hold_the_bits_of_an_arm_alone(case, method):
    """With rotors that spin, friction, disturbances, prescribed joints and foreshortening."""
    sample, method = case.sample, METHODS[method]
    states, drives = states_of(sample, case.model), drives_for(case.model, case.held, sample.seed)
    abreast = moved(LaneIntegrator(case.constants, method, (PERIOD, PARTS), ARMS, 1), states, drives)
    lane = LaneIntegrator(case.constants, method, (PERIOD, PARTS), 1, 1)
    sequential = SequentialIntegrator([Integrator(case.model, method, None, case.held)], (PERIOD, PARTS))
    for arm in range(ARMS):
        one = slice(arm, arm + 1)
        alone, single = (moved(mover, states[one], drives[one]) for mover in (lane, sequential))
        for result, expected, other in zip(abreast, alone, single, strict=True):
            assert np.array_equal(result[arm], expected[0], equal_nan=True)
            assert np.array_equal(result[arm], other[0], equal_nan=True)


@pytest.mark.parametrize("method", ["ros2", "midpoint_3", "midpoint_corrected_3", "gauss_2"])
@pytest.mark.parametrize("threads", [1, 2, 5])
def test_threads_share_the_groups(threads, method):
    model = fm.build_model(fm.catalog.paper_rrr(), modes=2)
    states = 1e-3 * np.random.default_rng(0).normal(size=(273, 2 * model.n_dof))
    drives = np.random.default_rng(1).uniform(-100.0, 100.0, (273, 9))
    method = METHODS[method]
    expected = moved(LaneIntegrator(model.constants, method, (0.02, 4), 273, 1), states, drives)
    for result, wanted in zip(
        moved(LaneIntegrator(model.constants, method, (0.02, 4), 273, threads), states, drives), expected, strict=True
    ):
        assert np.array_equal(result, wanted)


@pytest.mark.parametrize("method", ["semi_implicit_euler", "ros2", "midpoint_3", "midpoint_corrected_3", "gauss_2"])
def test_a_lane_that_diverges_disturbs_no_other(method):
    model = fm.build_model(fm.catalog.paper_rrr(), modes=2)
    states = 1e-3 * np.random.default_rng(0).normal(size=(9, 2 * model.n_dof))
    drives = np.zeros((9, 9))
    calm = moved(LaneIntegrator(model.constants, METHODS[method], (0.02, 4), 9, 1), states, drives)
    wild = states.copy()
    wild[3, -1], wild[5, 0] = 1e200, np.nan
    rows, outputs, status = moved(LaneIntegrator(model.constants, METHODS[method], (0.02, 4), 9, 1), wild, drives)
    others = np.isin(np.arange(9), (3, 5), invert=True)
    assert status.tolist() == [layout.DIVERGED if arm in (3, 5) else layout.OK for arm in range(9)]
    assert np.array_equal(rows[others], calm[0][others]) and np.array_equal(outputs[others], calm[1][others])
    assert np.array_equal(rows[3, :-2], wild[3])  # it stays where it was


@pytest.mark.parametrize("method", ["rk4", "ros2", "midpoint_3", "midpoint_corrected_3"])
@pytest.mark.parametrize("arms", [1, 9])
def test_a_mass_matrix_that_is_not_positive_is_a_divergence(method, arms):
    """Of no arm that there is: its elastic masses are turned round. The numbers would be finite."""
    model = fm.build_model(fm.catalog.planar_2r(), 1, 2)
    turned = replace(model, constants=model.constants._replace(elastic_mass=-model.constants.elastic_mass))
    for each, status in ((model, "ok"), (turned, "diverged")):
        batch = Batch(each, method, 1e-5, 1e-4, arms=arms)
        batch.step(np.full((arms, 8), 1e-3))
        assert {layout.STATUS[number] for number in batch.status} == {status}


def test_tasks_are_done_in_another_thread_one_after_the_other():
    helper, result = WorkerThread(), []
    for number in range(100):
        helper.begin(lambda number=number: result.append((number, threading.get_ident())))
        helper.finish()
        assert result[-1][0] == number
    assert {thread for _, thread in result} != {threading.get_ident()}
    assert len({thread for _, thread in result}) == 1


def test_what_a_task_raises_is_raised_and_the_next_task_is_done():
    helper, result = WorkerThread(), []
    helper.begin(lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        helper.finish()
    helper.begin(lambda: result.append(1))
    helper.finish()
    assert result == [1]


def test_a_task_that_nobody_waited_for_is_done_before_the_next():
    helper, result = WorkerThread(), []
    helper.begin(lambda: (time.sleep(0.05), result.append(1)))
    helper.begin(lambda: result.append(2))
    helper.finish()
    assert result == [1, 2]


@pytest.mark.slow
def test_the_thread_ends_with_its_owner():
    before = set(threading.enumerate())
    helper = WorkerThread()
    (thread,) = set(threading.enumerate()) - before
    del helper
    gc.collect()
    thread.join(10.0)
    assert not thread.is_alive()
