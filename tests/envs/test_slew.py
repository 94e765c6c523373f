"""Tasks: a step is worth the sum of bounded terms, and more for a closer and calmer tip and for less effort."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flexman_gym import Slew
from flexman_gym.envs.postures import PostureRanges

from oracles.assertions import refusal

RANGES = {"tip_error": (0.0, 0.7), "tip_vibration": (0.0, 0.2), "effort": (0.0, 0.1)}  # as the docstring of Slew says
QUICK = settings(deadline=None, derandomize=True)
LENGTHS = st.floats(0.0, 100.0)
ACTIONS = st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3)


def arm_view(joints):
    """View of an arm whose joints turn without stops."""
    free = np.full(joints, np.inf)
    return SimpleNamespace(n_joints=joints, postures=PostureRanges(np.zeros(joints), -free, free))


def terms(tip_error=0.0, tip_vibration=0.0, action=(0.0, 0.0, 0.0), failed=False, task=Slew(), scale=(8.5, 3.2)):  # noqa: B008
    """Terms of one step of an arm of that reach (m) and slew time (s)."""
    effort = np.mean(np.square(action), axis=-1)
    seen = {"tip_error": tip_error, "tip_vibration": tip_vibration, "effort": effort, "failed": failed}
    return task.reward_terms(SimpleNamespace(**seen, reach=scale[0], slew_time=scale[1]))


def worth(*arguments, **named):
    """Reward of one step."""
    return sum(terms(*arguments, **named).values())


@pytest.mark.slow
@QUICK
@given(LENGTHS, LENGTHS, ACTIONS)
def test_every_term_lies_in_its_range(tip_error, tip_vibration, action):
    result = terms(tip_error, tip_vibration, action)
    assert result.keys() == RANGES.keys() | {"failure"}
    for name, (low, high) in RANGES.items():
        assert low <= result[name] <= high + 1e-15
    assert result["failure"] == 0.0
    assert 0.0 <= sum(result.values()) <= 1.0 + 1e-15


@QUICK
@given(LENGTHS, LENGTHS, ACTIONS, st.floats(0.0, 1e3))
def test_a_failure_costs_its_penalty_and_nothing_else(tip_error, tip_vibration, action, penalty):
    task = Slew(failure_penalty=penalty)
    good, bad = (terms(tip_error, tip_vibration, action, failed, task) for failed in (False, True))
    assert bad == good | {"failure": -penalty}


def test_rest_on_the_target_without_effort_is_worth_one():
    assert worth() == pytest.approx(1.0, abs=1e-15)


@QUICK
@given(LENGTHS, LENGTHS, ACTIONS, st.floats(1e-3, 1.0))
def test_closer_calmer_and_less_effort_are_worth_more(tip_error, tip_vibration, action, more):
    here = worth(tip_error, tip_vibration, action)
    assert worth(tip_error + more, tip_vibration, action) < here
    assert worth(tip_error, tip_vibration + more, action) < here
    assert worth(tip_error, tip_vibration, (1.0 - more / 2) * np.array(action)) >= here


def test_every_scale_rewards_half_the_way():
    """Half the way is worth a good part of the reward at each of the three scales, metres to centimetres away."""
    for far in (4.0, 0.5, 0.1):
        assert worth(far / 2) - worth(far) > 0.05


def test_a_batch_is_worth_what_its_rows_are():
    rng = np.random.default_rng(0)
    errors, vibrations, actions = rng.uniform(0, 3, 8), rng.uniform(0, 2, 8), rng.uniform(-1, 1, (8, 3))
    failed = rng.random(8) < 0.5
    batch = terms(errors, vibrations, actions, failed)
    for i in range(8):
        alone = terms(errors[i], vibrations[i], actions[i], failed[i])
        assert {name: float(value[i]) for name, value in batch.items()} == alone


def test_start_and_posture_are_drawn_uniformly_from_what_the_task_says():
    task, rng = Slew(start=0.5, slew=0.25), np.random.default_rng(0)
    plans = [task.draw(rng, arm_view(4)) for _ in range(2000)]
    starts, postures = (np.array([plan[name] for plan in plans]) for name in ("start", "goal_angles"))
    for drawn, width in ((starts, 0.5), (postures - starts, 0.25)):
        assert drawn.shape == (2000, 4)
        assert width * 0.99 < np.abs(drawn).max() <= width + 1e-15
        # Mean and variance of a uniform distribution, each within five standard errors of 8000 numbers.
        assert abs(drawn.mean()) < 5 * width / np.sqrt(3 * drawn.size)
        assert abs((drawn**2).mean() - width**2 / 3) < 5 * width**2 * np.sqrt(4 / 45 / drawn.size)


def test_a_task_may_start_from_the_same_place_every_time():
    plan = Slew(start=0.0).draw(np.random.default_rng(0), arm_view(3))
    assert (plan["start"] == 0.0).all() and plan["goal_angles"].any()


@QUICK
@given(LENGTHS, LENGTHS, st.floats(0.1, 100.0))
def test_an_arm_of_another_size_is_judged_by_parts_of_its_reach(tip_error, tip_vibration, size):
    """Lengths and speeds that grow with the arm are worth the same."""
    result = terms(size * tip_error, size * tip_vibration, scale=(size * 8.5, 3.2))
    assert result == pytest.approx(terms(tip_error, tip_vibration), rel=1e-9)


@pytest.mark.parametrize("slew_time", [3.2, 0.2])
def test_the_distance_adds_the_velocity_times_a_32nd_of_the_slew_time(slew_time):
    """1 - ln(1 + (e^2 + (T v / 32)^2) / n^2) / ln(1 + (f / n)^2), n = R / 425 and f = R / 1.7, as the class says."""
    task, reach = Slew(reward="distance"), 3.4
    for error, velocity in (
        (0.0, (0.0, 0.0, 0.0)),
        (0.2, (0.0, 0.0, 0.0)),
        (0.0, (1.0, -2.0, 2.0)),
        (0.3, (0.0, 4.0, 3.0)),
    ):
        view = SimpleNamespace(
            tip_error=np.array([error]), tip_velocity=np.array([velocity]), reach=reach, failed=np.array([False]),
            slew_time=slew_time,
        )  # fmt: skip
        square = error**2 + (slew_time / 32 * np.linalg.norm(velocity)) ** 2
        expected = 1 - np.log(1 + square * (425 / reach) ** 2) / np.log(1 + (425 / 1.7) ** 2)
        assert task.reward_terms(view)["distance"] == pytest.approx(expected, abs=1e-12)


def test_exponential_closeness_has_the_terms_that_the_docstring_says():
    """0.1, 0.25 and 0.65 by 1/e at 0.6, 0.15 and 0.03 m of 8.5 m; in parts of the reach of another arm."""
    task = Slew(reward="exponential")
    for reach in (8.5, 1.0):
        errors = np.array([0.0, 0.03, 0.15, 0.6, 50.0]) * reach / 8.5
        near = errors * 8.5 / reach
        given = terms(errors, task=task, scale=(reach, 3.2))
        for name, weight, length in (("far", 0.1, 0.6), ("near", 0.25, 0.15), ("at_goal", 0.65, 0.03)):
            assert given[name] == pytest.approx(weight * np.exp(-near / length))
    assert terms(task=task, failed=True)["failure"] == -10.0


def test_episodes_keep_to_pairs_of_start_and_goal():
    """As many as were asked for, the same for all generators, none of them twice."""
    view, task = arm_view(3), Slew(pairs=5)
    drawn = [task.draw(np.random.default_rng(seed), view) for seed in range(60)]
    pairs = {(each["start"].tobytes(), each["goal_angles"].tobytes()) for each in drawn}
    assert len(pairs) == 5 == len({start for start, _ in pairs})
    free = [Slew().draw(np.random.default_rng(seed), view)["start"].tobytes() for seed in range(60)]
    assert len(set(free)) == 60
    assert refusal(lambda: Slew(pairs=-1)).startswith("Slew.pairs: -1 is not allowed")
