"""Innovations: change detection, and the estimator after a change or a push."""

import numpy as np
import pytest

from flexman_gym.common.snapshot import get_state, set_state
from flexman_gym.control.controller import EpisodeInfo
from flexman_gym.control.observers.estimator import RESIMULATION_PERIODS, Estimator
from flexman_gym.control.observers.innovations import MAX_MISFIT, MEAN_FORGETTING, SQUARE_FORGETTING, ChangeDetector

from oracles.observed_arms import Bench, small_plant

UNKNOWN = {"payload_mass": (0.0, 0.3), "sensor_noise": (1e-3, 1e-3)}
ON = np.ones(2, dtype=bool)


def resting():
    """An observer of two arms, and the bench on which they rest."""
    plant = small_plant("FlexOne-v0", UNKNOWN)
    return Estimator(plant), Bench(plant, np.zeros((2, 1)), noise=1.0)


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


def test_an_arm_whose_simulation_is_lost_is_not_believed():
    """It begins anew, and where that is lost too it is wrong; it rests at its start, so that no reading says either."""
    observer, bench = resting()
    bench.follow(observer, np.zeros((2, 2, 1)))
    observer._ages[:] = 33  # at which changes are looked for, and no replay is due
    for wrong in (False, True):
        observer._states[0] = np.nan
        bench.follow(observer, np.zeros((1, 2, 1)), begin=False)
        assert observer._filtering.tolist() == [True, False]
        assert observer.inconsistent.tolist() == [wrong, False]
        assert np.isfinite(observer._states).all()


@pytest.mark.parametrize("kind", ["began anew", "is pushed", "was drawn together"])
def test_a_start_that_an_arm_has_left_is_never_replayed(monkeypatch, kind):
    """At the ages of all replays; the other arm is replayed at each of them."""
    observer, bench = resting()
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
    for age in RESIMULATION_PERIODS:
        observer._ages[:] = age
        observer.estimate(bench.readings(), bench.applied, ON)
    assert replayed == [(age, [1]) for age in RESIMULATION_PERIODS]


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
