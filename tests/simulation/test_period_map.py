"""Tests of the map of a control period: bits of the batch, and derivatives against extrapolated differences."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.period_map import PeriodMap, period_jacobian

PERIOD = (0.02, 3)


@pytest.fixture(scope="module")
def model():
    return fm.build_model(fm.catalog.paper_rrr(), modes=1)


def start(model):
    """Return a moving, deformed state and inputs."""
    state = model.initial_state([0.3, -0.5, 0.8])
    state += 0.01 * np.sin(1.0 + np.arange(len(state)))
    return state, np.array([40.0, -30.0, 20.0, 5.0, -4.0, 3.0, 0.1, -0.2, 0.3])


def batch_end(model, state, drive):
    batch = Batch(model, "midpoint_corrected_3", PERIOD[0] / PERIOD[1], PERIOD[0])
    batch.reset(np.zeros(1, dtype=np.int64), state[None])
    batch.step(drive[None])
    return batch.rows[0].copy(), batch.outputs[0].copy()


def test_values_have_the_bits_of_a_batch(model):
    state, drive = start(model)
    mapped = PeriodMap(model, fm.METHODS["midpoint_corrected_3"], PERIOD, [{}])
    d = model.n_dof
    end = mapped.advance(np.append(state, (0.0, 0.0)), drive, np.ones((1, 2 * d + 2)), np.zeros((1, 9)))
    row, outputs = batch_end(model, state, drive)
    assert np.array_equal(end.row, row)
    assert np.array_equal(end.outputs, outputs)
    assert not end.diverged


def test_the_jacobian_is_that_of_extrapolated_differences(model):
    state, drive = start(model)
    jacobian = period_jacobian(model, fm.METHODS["midpoint_corrected_3"], PERIOD, state, drive)
    given, size = np.append(state, drive), len(state)
    for column in (0, 4, size // 2, size - 1, size, size + 4, size + 8):
        results, largest = [], 4e-4 if column < size else 0.4  # rounding: a newton moves the arm by micrometres
        for step in (largest, largest / 2, largest / 4):
            moved = [given.copy(), given.copy()]
            moved[0][column] += step
            moved[1][column] -= step
            plus, minus = (batch_end(model, each[:size], each[size:])[0][:size] for each in moved)
            results.append((plus - minus) / (2.0 * step))
        first, second, third = results
        finer, coarser = (4.0 * third - second) / 3.0, (4.0 * second - first) / 3.0
        best = (16.0 * finer - coarser) / 15.0
        error = np.abs(best - finer).max() + 1e-14 * np.abs(plus).max() / step
        np.testing.assert_allclose(jacobian[:, column], best, atol=3.0 * error, rtol=1e-8)
