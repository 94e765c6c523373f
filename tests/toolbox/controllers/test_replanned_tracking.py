"""Slews optimised while the arm moves: law below until a plan, states as planned, arrival, budget, restart, state."""

import gymnasium as gym
import numpy as np
import pytest

from flexman_gym.envs.vector_env import FlexManVectorEnv
from flexman_gym.metrics.signals import BAND
from flexman_gym.toolbox.controllers.references.planned_slews import JACOBIAN_TIME, PLANNED, TRACKED
from flexman_gym.toolbox.controllers.references.single_shooting import SingleShooting
from flexman_gym.toolbox.controllers.replanned_tracking import ESTIMATION_TIME, PLANNING_TIME, TORQUE_FRACTION

pytestmark = pytest.mark.slow
RRR, LAB = "FlexRRR-v0", {"payload_mass": (0.0, 20.0), "sensor_noise": (0.001, 0.001), "delay": (1, 1)}
SEEDS = [3_000_001, 3_000_002, 3_000_003]
KNOWN, UNKNOWN = {"base": "privileged-planned"}, {"base": "adaptive-planned", "randomisation": LAB}


def make(count=3, **settings):
    return FlexManVectorEnv(count, name=RRR, **settings)


def observed(arms, periods, seeds=SEEDS):
    """Return the observations (T, b, size) of episodes in which the base controller acts alone."""
    arms.reset(seed=seeds[: arms.num_envs])
    zero = np.zeros(arms.action_space.shape, dtype=np.float32)
    return np.array([arms.step(zero)[0].copy() for _ in range(periods)])


def law(arms):
    return arms.episodes.base.law


def test_before_the_first_plan_the_arm_tracks_the_slew_of_the_law_below():
    arms, others = (make(base=each, randomisation=LAB) for each in ("adaptive-planned", "adaptive-lqr"))
    first = ESTIMATION_TIME * law(arms).unit + round(PLANNING_TIME / law(arms)._period)
    one, other = observed(arms, first + 40), observed(others, first + 40)
    assert np.array_equal(one[:first], other[:first])
    assert (one[first:] != other[first:]).any()


def test_without_a_plan_that_settles_the_arm_tracks_the_slew_of_the_law_below(monkeypatch):
    monkeypatch.setattr(SingleShooting, "improve", lambda *_: None)
    one, other = (observed(make(**KNOWN | {"base": base}), 120) for base in ("privileged-planned", "privileged-lqr"))
    assert np.array_equal(one, other)


def test_the_known_arm_moves_as_planned_and_settles_in_the_time_planned():
    """States of an episode are those of the last plan, to rounding; the tip stays in the band from the arrival on."""
    arms = make(**KNOWN)
    arms.reset(seed=SEEDS)
    zero, errors, compared = np.zeros((3, 3), dtype=np.float32), [], 0
    for period in range(1, 260):
        before = law(arms).status == PLANNED, law(arms)._first.copy(), law(arms)._end.copy()
        errors.append(arms.step(zero)[4]["tip_error"])
        planned = before[0] & (period > before[1]) & (period < before[2]) & (period < law(arms)._end)
        for arm in np.flatnonzero(planned):
            state, expected = arms.episodes.view.state[arm], law(arms)._states[arm, period]
            assert np.abs(state - expected).max() < 1e-7 * max(1.0, np.abs(expected).max())
            compared += 1
    late = np.array(errors) > BAND * arms.episodes.view.reach
    settled = law(arms)._period * (1.0 + np.array([np.flatnonzero(each)[-1] for each in late.T]))
    assert (law(arms).status == PLANNED).all() and compared > 150
    np.testing.assert_allclose(settled, law(arms).arrivals, atol=0.045)
    share = np.abs(law(arms)._torques / law(arms).limits).max()
    assert share == pytest.approx(TORQUE_FRACTION, abs=1e-9), "a plan uses the torques that it may have, and no more"


def test_a_plan_has_the_jacobians_of_its_declared_time():
    for thinking in (0.15, 0.3, 0.6):
        arms = make(1, base={"kind": "privileged-planned", "thinking": thinking})
        counts, ahead = [0], round(thinking / law(arms)._period)
        arms.reset(seed=SEEDS[:1])
        for _ in range(90):
            arms.step(np.zeros((1, 3), dtype=np.float32))
            counts.append(law(arms).jacobians[0])
        assert law(arms).estimates["planning_time"][0] == JACOBIAN_TIME * counts[-1] > 0.0
        assert np.diff(counts).max() <= round(thinking / JACOBIAN_TIME)
        assert np.diff(np.flatnonzero(np.diff(counts))).min(initial=ahead) >= ahead


def test_an_arm_has_no_plan_in_a_planning_time_longer_than_its_slew():
    arms = make(base={"kind": "privileged-planned", "thinking": 9.0})
    observed(arms, 60)
    assert (law(arms).status == TRACKED).all() and np.isinf(law(arms).arrivals).all()


@pytest.mark.parametrize("settings", [KNOWN, UNKNOWN])
def test_one_arm_gets_the_same_bits_alone_and_among_others(settings):
    together = observed(make(**settings), 80)
    assert np.array_equal(observed(make(1, **settings), 80, SEEDS[2:]), together[:, 2:])


@pytest.mark.parametrize("settings", [KNOWN, UNKNOWN])
def test_an_environment_made_alike_goes_on_from_a_state(settings):
    env, other = (make(2, **settings) for _ in range(2))
    observed(env, 55)
    observed(other, 3, SEEDS[1:])
    other.set_state(env.get_state())
    zero = np.zeros(env.action_space.shape, dtype=np.float32)
    for period in range(30):
        assert np.array_equal(env.step(zero)[0], other.step(zero)[0]), period


def test_a_restarted_law_forgets_its_plan():
    arms = make(**KNOWN)
    observed(arms, 60)
    assert (law(arms).status == PLANNED).any()
    law(arms).restart(np.arange(3))
    assert (law(arms).status == TRACKED).all() and np.isinf(law(arms).arrivals).all()


def test_a_new_episode_begins_without_the_plan_of_the_last_one():
    arms = make(1, **KNOWN)
    first = observed(arms, 70)
    assert np.array_equal(observed(arms, 70), first)


def test_an_arm_at_its_goal_is_held():
    """Torque-free, without gravity: no plan is made."""
    arms = gym.make_vec("FlexRRR-Hold-v0", 1, "vector_entry_point", base="privileged-planned")
    arms.reset(seed=[1])
    for _ in range(30):
        arms.step(np.zeros((1, 3), dtype=np.float32))
    assert arms.unwrapped.episodes.base.law.jacobians.tolist() == [0]
    assert isinstance(arms.unwrapped.episodes.base.law.estimates["plan_status"], np.ndarray)
