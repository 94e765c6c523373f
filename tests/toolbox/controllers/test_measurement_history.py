"""Measurement history of an estimator: weights, lost samples and torques of delays."""

import numpy as np
import pytest

from flexman_gym.toolbox.controllers.observers.measurement_history import MeasurementHistory
from flexman_gym.toolbox.controllers.observers.observer import MeasurementModel

from oracles.assertions import refusal
from oracles.observed_arms import small_plant

SENSORS, COUNT = ("motor_encoders", "strain"), 6


@pytest.fixture
def history():
    """Return a history of two arms with delays of torques from 0 to 2 periods, and the measurement model."""
    plant = small_plant(randomisation={"delay": (0, 2)})
    instruments = MeasurementModel(plant, SENSORS)
    result = MeasurementHistory(instruments, plant, COUNT, instruments.places["motor_angles"])
    result.allocate(2)
    result.reset(np.arange(2))
    result.begin(np.arange(2), np.zeros((2, len(instruments.matrix))))
    return result, instruments


def test_weights_are_reciprocal_variances_but_for_the_first_angles(history):
    found, instruments = history
    assert len(found) == COUNT and found.weights[1:] == pytest.approx(np.tile(instruments.deviations**-2.0, (5, 1)))
    first = instruments.deviations**-2.0
    first[instruments.places["motor_angles"]] = 0.0
    assert found.weights[0] == pytest.approx(first)


def test_torques_are_those_of_the_delay_and_zero_before_the_start(history):
    found, _ = history
    arms, torques = np.arange(2), np.arange(1.0, 13.0).reshape(6, 2, 1)
    for age in range(1, COUNT):
        found.store_torques(arms, np.full(2, age), torques[age - 1])
    given = found.data(arms, 4, np.array([0, 2]))[0]
    assert np.array_equal(given[0, :, 0], torques[:4, 0, 0]) and np.array_equal(
        given[1, :, 0], [0.0, 0.0, *torques[:2, 1, 0]]
    )
    recent = found.recent_torques(arms, 3)
    assert np.array_equal(recent[0, :, 0], torques[2::-1, 0, 0])


def test_a_repeated_sample_of_a_moving_arm_has_no_weight_and_a_late_one_is_not_stored(history):
    found, instruments = history
    arms, still = np.arange(2), np.zeros((2, len(instruments.matrix)))
    motion = np.linalg.lstsq(instruments.matrix, 5.0 * instruments.deviations)[0] * np.ones((2, 1))
    assert found.store(arms, np.full(2, 1), still, motion).all()
    moved = still + 1.0
    assert not found.store(arms, np.full(2, 2), moved, motion).any()
    _, readings, weights = found.data(arms, 2, np.zeros(2, dtype=np.int64))
    assert not weights[:, 1].any() and weights[:, 2].all() and np.array_equal(readings[:, 2], moved)
    assert np.array_equal(found.count(arms, 2), [2 * moved.shape[1]] * 2)
    found.store(arms, np.full(2, COUNT), moved, motion)
    assert found.readings.shape[1] == COUNT


@pytest.mark.parametrize("sensors", ["motor_encoders", ["strain"], ["motor_encoders", {"kind": "strain"}]])
def test_sensors_of_an_observer_are_names_of_linear_sensors_with_the_motor_encoders(sensors):
    line = refusal(lambda: MeasurementModel(small_plant(), sensors))
    assert line.startswith("sensors: ") and "motor_encoders, and any of" in line
