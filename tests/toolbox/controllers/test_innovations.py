"""Innovations: change detection, and the estimator after a change or a push."""

import numpy as np
import pytest

from flexman_gym.agent.controller import EpisodeInfo
from flexman_gym.common.snapshot import get_state, set_state
from flexman_gym.toolbox.controllers.observers.estimator import RESIMULATION_TIMES, Estimator
from flexman_gym.toolbox.controllers.observers.innovations import (
    MAX_MISFIT,
    MEAN_FORGETTING,
    SQUARE_FORGETTING,
    ChangeDetector,
)

from oracles.observed_arms import Bench, small_plant

UNKNOWN = {"payload_mass": (0.0, 0.3), "sensor_noise": (1e-3, 1e-3)}
ON = np.ones(2, dtype=bool)


def resting(unit=1):
    """An observer of two arms, and the bench on which they rest."""
    plant = small_plant("FlexOne-v0", UNKNOWN)
    return Estimator(plant, unit=unit), Bench(plant, np.zeros((2, 1)), noise=1.0)


def test_an_arm_that_begins_forgets_its_errors_and_no_other_does():
    """All arms that begin do, and of all readings; the means of constant errors e are (1 - (1 - part)^k) of e."""
    detector, arms = ChangeDetector(3), np.arange(4)
    detector.reset(arms, len(arms))
    for _ in range(5):
        detector.update(arms, np.tile([3.0, -2.0, 1.0], (4, 1)))
    square, mean = 14.0 / 3.0, np.array([3.0, -2.0, 1.0])
    kept = square + (1.0 - square) * (1.0 - SQUARE_FORGETTING) ** 5, (1.0 - (1.0 - MEAN_FORGETTING) ** 5) * mean
    assert detector.misfit == pytest.approx(np.full(4, kept[0]))
    detector.reset(np.array([0, 2]), 4)
    assert detector.misfit == pytest.approx([1.0, kept[0], 1.0, kept[0]])
    assert detector._mean == pytest.approx(np.array([0.0 * mean, kept[1], 0.0 * mean, kept[1]]))
    assert detector.detect(arms).tolist() == [False, True, False, True]


def test_errors_of_the_last_episode_do_not_count_in_the_next():
    observer, bench = resting()
    bench.follow(observer, np.zeros((3, 2, 1)))
    observer._detector.update(np.arange(2), np.full((2, len(observer._instruments.ranges)), 1e3))
    assert (observer._detector.misfit > MAX_MISFIT).all()
    observer.reset(np.array([1]), EpisodeInfo(np.zeros((1, 1)), np.zeros((1, 1)), bench.plant.period), 2)
    assert (observer._detector.misfit > MAX_MISFIT).tolist() == [True, False]
    assert observer._detector.detect(np.arange(2)).tolist() == [True, False]


def test_a_change_that_was_found_is_not_found_again():
    observer, bench = resting()
    bench.follow(observer, np.zeros((3, 2, 1)))
    observer._detector.update(np.arange(2), np.full((2, len(observer._instruments.ranges)), 1e3))
    observer._restart_after_change(np.array([0]))
    assert observer._detector.detect(np.arange(2)).tolist() == [False, True]


def test_sensitivities_of_corrected_states_to_biases_equal_differences():
    """The states of two observers with biases that differ by a step, corrected by the same measurements."""
    plant = small_plant("FlexOne-v0", UNKNOWN)
    states, step, chosen = [], 1e-4, 0
    for change in (0.0, step):
        observer, bench = Estimator(plant, biased=True), Bench(plant, np.zeros((2, 1)), noise=1.0)
        bench.follow(observer, np.full((3, 2, 1), 0.2))
        observer._filtering[:] = observer._start_filter(np.arange(2))
        observer._information[:] = 1e30 * np.eye(observer.theta.shape[1])  # no entry of theta changes
        observer._change[:] = 0.0
        observer.theta[:, observer._models.dynamic + chosen] += change
        bench.follow(observer, np.full((2, 2, 1), -0.3), begin=False)
        states.append(observer._states[:, 0].copy())
    expected = (states[1] - states[0]) / step
    assert np.abs(expected).max() > 0.1, "a corrected state follows a biased measurement"
    tolerance = 0.03 * np.abs(expected).max()  # the dynamics are linearised once
    assert observer._error_sensitivity[..., chosen] == pytest.approx(expected, abs=tolerance)


@pytest.mark.parametrize("delay", [0, 2])
def test_a_repeated_estimation_reproduces_the_motion(delay):
    """Without process noise, of an arm whose parameters are found: torques and measurements of the same periods."""
    plant = small_plant("FlexOne-v0", {**UNKNOWN, "sensor_noise": (0.0, 0.0), "delay": (0, 2)})
    bench = Bench(plant, np.array([[0.3], [-0.5]]), {"payload_mass": np.array([0.1, 0.2])}, delays=delay)
    observer, random = Estimator(plant), np.random.default_rng(2)
    bench.follow(observer, random.uniform(-0.5, 0.5, (30, 2, 1)))
    begin, past = observer._start_filter, observer._prediction.past.copy()
    observer._start_filter = lambda arms: begin(arms, (1e-6, 1e-6))
    observer._ages -= 1  # those of the last measurements
    observer._filter_history(np.array([1]))
    assert observer._filtering.tolist() == [False, True] and observer._ages.tolist() == [30, 30]
    assert np.array_equal(observer._prediction.past, past)
    scale = np.abs(bench.batch.state).max()
    assert observer._current_states(np.array([1]))[0] == pytest.approx(bench.batch.state[1], abs=1e-5 * scale)


def test_simulations_that_grow_apart_are_corrected():
    """From then on by all measurements; the state has no error of its own so far: the motion has no process noise."""
    observer, bench = resting()
    bench.follow(observer, np.zeros((9, 2, 1)))
    observer._states[0, 1:, observer._plant.model.motor_columns] += 0.2
    observer._reduce_perturbations(np.arange(2))
    assert observer._filtering.tolist() == [True, False] and not observer._innovations.covariance[0].any()
    bench.follow(observer, np.zeros((1, 2, 1)), begin=False)
    assert observer._innovations.covariance[0].any()
    spread = observer._states[:, 1:] - observer._states[:, :1]
    assert np.abs(spread[0, :, observer._plant.model.motor_columns]).max() < 0.25


def test_torques_that_no_model_has_are_not_taken_for_biases():
    """The position of a motor whose encoder is biased, under a torque of 2 % of its limit that no model has."""
    plant = small_plant("FlexOne-v0", {**UNKNOWN, "sensor_bias": (-0.003, 0.003)})
    bias = {"motor_angles": np.array([0.002 * plant.measured()["motor_angles"][0][0]])}
    bench = Bench(plant, np.array([[0.3], [-0.5]]), noise=1.0, biases=bias)
    observer, random = Estimator(plant), np.random.default_rng(2)
    step = bench.step
    bench.step = lambda actions: (step(actions + 0.02), setattr(bench, "applied", np.array(actions)))
    estimates = bench.follow(observer, random.uniform(-0.5, 0.5, (25, 2, 1)).repeat(4, axis=0))
    assert observer._filtering.all()
    error = np.abs(estimates[-1].states - bench.batch.state)[:, plant.model.motor_columns]
    assert error.max() < 0.5 * bias["motor_angles"][0]


def test_an_arm_whose_simulation_is_lost_is_not_believed():
    """The estimation is repeated from the start, then starts anew; after a third loss no model explains readings."""
    observer, bench = resting()
    bench.follow(observer, np.zeros((2, 2, 1)))
    observer._ages[:] = 33  # at which changes are looked for, and no replay is due
    for wrong in (False, False, True):
        observer._states[0] = np.nan
        bench.follow(observer, np.zeros((1, 2, 1)), begin=False)
        assert observer._filtering.tolist() == [True, False]
        assert observer.inconsistent.tolist() == [wrong, False]
        assert np.isfinite(observer._states).all()


@pytest.mark.parametrize(
    ("kind", "unit"), [("began anew", 1), ("is pushed", 1), ("was drawn together", 1), ("is pushed", 3)]
)
def test_a_start_that_an_arm_has_left_is_never_replayed(monkeypatch, kind, unit):
    """At the ages of all replays, in time units; the other arm is replayed at each of them."""
    observer, bench = resting(unit)
    bench.follow(observer, np.zeros((2, 2, 1)))
    replayed = []
    if kind == "began anew":
        monkeypatch.setattr(observer, "_start_filter", lambda arms, sudden: np.zeros(len(arms), dtype=bool))
        observer._restart_after_change(np.array([0]))
    elif kind == "is pushed":
        observer._restart_after_change(np.array([0]))
        assert observer._filtering[0]
        observer._perturbations_reduced[0] = False
    else:
        observer._states[0, 1:, observer._plant.model.motor_columns] += 1.0
        observer._reduce_perturbations(np.arange(2))
    monkeypatch.setattr(observer, "_refit", lambda arms, age: replayed.append((age, arms.tolist())))
    for age in sorted({*RESIMULATION_TIMES, *(unit * time for time in RESIMULATION_TIMES)}):
        observer._ages[:] = age
        observer.estimate(bench.readings(), bench.applied, ON)
    assert replayed == [(unit * time, [1]) for time in RESIMULATION_TIMES]


def test_an_observer_of_a_pushed_arm_goes_on_from_what_it_kept():
    """Its gains and covariance with it, while the other observer follows arms that nothing pushes."""
    (observer, bench), (other, beside) = resting(), resting()
    bench.follow(observer, np.full((2, 2, 1), 0.3))
    observer._restart_after_change(np.array([0]))
    bench.follow(observer, np.full((3, 2, 1), -0.2), begin=False)
    beside.follow(other, np.full((8, 2, 1), 0.1))
    set_state("observer", other, get_state(observer))
    for _ in range(4):
        bench.step(np.full((2, 1), 0.4))
        readings = bench.readings()
        one, same = (each.estimate(readings, bench.applied, ON) for each in (observer, other))
        assert np.array_equal(one.states, same.states) and observer._filtering.tolist() == [True, False]


@pytest.mark.parametrize("unit", [1, 3])
def test_an_episode_is_simulated_again_in_time_units(unit, monkeypatch):
    """Changes are detected, and the models updated, in the same units."""
    plant, replayed, updated, noticed = small_plant("FlexOne-v0", UNKNOWN), [], [], []
    observer, bench = Estimator(plant, unit=unit), Bench(plant, np.zeros((2, 1)), noise=1.0)
    bench.follow(observer, np.zeros((2, 2, 1)))
    monkeypatch.setattr(observer, "_refit", lambda arms, age: replayed.append(age))
    monkeypatch.setattr(observer, "_apply_change", lambda arms: updated.append(int(observer._ages[0])))
    monkeypatch.setattr(observer._detector, "detect", lambda arms: np.ones(len(arms), dtype=bool))
    monkeypatch.setattr(observer, "_answer_changes", lambda arms: noticed.extend([int(observer._ages[0])] * len(arms)))
    for age in range(3, 30 * unit + 1):
        observer._ages[:] = age
        observer.estimate(bench.readings(), bench.applied, ON)
    assert replayed == [unit * time for time in RESIMULATION_TIMES if time <= 30]
    assert updated == [age for age in range(5 * unit, 30 * unit + 1, 5 * unit) if age not in replayed]
    assert noticed[0] == 25 * unit + 1 and len(observer._weights) == RESIMULATION_TIMES[-1] * unit + 1
