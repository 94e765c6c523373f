"""Shooting: as quick as a motor can be, within its limits, and what the environment then does to the last bit."""

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.control.lqr import LQR
from flexman_gym.control.optimised import Optimised
from flexman_gym.control.shooting import INSIDE, STAY, TAIL, Shooting, Slew, followed, spread
from flexman_gym.envs.description import Description
from flexman_gym.envs.setup import build, setup_of
from flexman_gym.evaluation.optimising import empty_table, optimise
from flexman_gym.model.instant import mass_matrix
from flexman_gym.simulation.batch import Batch

PERIOD = 0.02


def shooting(model, limits, band, start, goal, rate=1e3, **moved):
    """A search for an arm."""
    moved = {"method": "midpoint_3_sweeps", "step": PERIOD, "control_period": PERIOD} | moved
    regulator = LQR(model, limits, moved["control_period"])
    return Shooting(
        regulator, lambda arms: Batch(model, arms=arms, **moved), band, rate, np.array(start), np.array(goal)
    )


def test_torques_of_periods_are_those_in_their_middles():
    """Of a line through the knots, and the mean of two neighbours where a period lies between them."""
    line = spread(np.array([[3.0, 0.0], [5.0, 1.0], [7.0, 2.0]]), 10)
    middles = (np.arange(10) + 0.5) / 10
    assert line == pytest.approx(np.array([3.0 + 4.0 * middles, 2.0 * middles]).T)
    assert spread(np.array([[1.0], [5.0], [2.0]]), 2).tolist() == [[3.0], [3.5]]


def test_torques_of_slews_side_by_side_are_those_of_each_alone():
    knots = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 7, 2))
    both = spread(knots, 25)
    assert both.shape == (3, 25, 2) and all(
        np.array_equal(spread(one, 25), each) for one, each in zip(knots, both, strict=True)
    )


@pytest.mark.parametrize(("start", "way", "seconds"), [(0.2, 1.0, 2.0), (0.5, -0.7, 1.5)])
def test_a_rigid_link_is_as_quick_as_full_torque_forth_and_back(start, way, seconds):
    """From rest it speeds up all the time, then brakes, and only just does not leave the band on its other side.

    With the acceleration a, the way s and the band b it is within the band after 2 sqrt((s + b) / a) - 2 sqrt(b / a).
    """
    model = fm.build_model(fm.catalog.one_joint(), flexible_links=False, flexible_joints=False)
    inertia, reach = float(mass_matrix(model, np.zeros(2))[0, 0]), float(model.constants.length.sum())
    band, acceleration = 0.02, 4.0 * abs(way) / seconds**2
    search = shooting(model, acceleration * inertia, band * reach, [start], [start + way])
    slew = search.search()
    least = 2.0 * (np.sqrt((abs(way) + band) / acceleration) - np.sqrt(band / acceleration))
    assert least <= slew.arrival * PERIOD <= least + 2.0 * PERIOD
    assert np.abs(slew.knots).max() <= acceleration * inertia
    ways = np.linalg.norm(search.errors(slew.knots[None], slew.periods)[0, :, :3], axis=1)
    assert len(ways) == slew.periods + round(STAY / PERIOD)
    assert ways[slew.arrival - 1 :].max() <= INSIDE * band * reach < ways[slew.arrival - 2]


def test_a_rigid_link_that_may_not_be_as_quick_goes_on_at_its_largest_rate():
    """With the rate v it is within the band after (s + b) / v + v / a - 2 sqrt(b / a), see above."""
    model = fm.build_model(fm.catalog.one_joint(), flexible_links=False, flexible_joints=False)
    inertia, reach = float(mass_matrix(model, np.zeros(2))[0, 0]), float(model.constants.length.sum())
    band, acceleration, rate = 0.02, 1.0, 0.6
    search = shooting(model, acceleration * inertia, band * reach, [-0.3], [0.7], rate)
    slew = search.search()
    least = (1.0 + band) / rate + rate / acceleration - 2.0 * np.sqrt(band / acceleration)
    assert least <= slew.arrival * PERIOD <= 1.05 * least
    rates = search.errors(slew.knots[None], slew.periods)[0, :, 3]
    assert 0.95 < np.abs(rates).max() < 1.0


def test_slopes_are_those_of_errors():
    """Of a rigid link about its place at rest, whose tip goes across the link as linearly as it turns."""
    model = fm.build_model(fm.catalog.one_joint(), flexible_links=False, flexible_joints=False)
    search = shooting(model, 1.0, 0.01, [0.0], [0.05])
    knots = np.zeros((6, 1))
    errors, slopes = search._slopes(knots, 25)
    moved = 0.01 * np.array([1.0, -2.0, 0.5, 0.0, 1.0, -1.0])[:, None]
    expected = (errors + np.tensordot(moved.ravel(), slopes, 1))[:, 1]
    assert search.errors(moved[None], 25)[0, :, 1] == pytest.approx(expected, rel=1e-3, abs=1e-3 * np.abs(moved).max())
    assert np.ptp(expected) > 0.01


def test_slopes_that_follow_a_move_map_it_to_the_change_and_others_as_before():
    random = np.random.default_rng(2)
    slopes, move, change = random.normal(size=(4, 5, 3)), random.normal(size=4), random.normal(size=(5, 3))
    result, across = followed(slopes, move, change), np.array([move[1], -move[0], 0.0, 0.0])
    assert np.tensordot(move, result, 1) == pytest.approx(change)
    assert np.tensordot(across, result, 1) == pytest.approx(np.tensordot(across, slopes, 1))


def test_a_stretched_slew_holds_as_before_and_moves_with_the_square_of_its_speed():
    """An arm under its weight: what holds it stays, what moves it grows fourfold in half of the time."""
    model, start, goal = fm.build_model(fm.catalog.vertical_2r(), 1), [0.1, -0.2], [0.3, 0.1]
    search, parts = shooting(model, 1e3, 0.1, start, goal), np.linspace(0.0, 1.0, 51)[:, None]
    tail, ends = round(TAIL / PERIOD), [fm.holding_torques(model, posture) for posture in (start, goal)]
    held = ends[0] + parts * (ends[1] - ends[0])
    moving = np.concatenate([held + np.sin(2.0 * np.pi * parts), np.repeat(ends[1:], 2 * tail, axis=0)])
    known = Slew(moving, len(moving) - 1, 50)
    for arrival, factor in ((50, 1.0), (25, 4.0), (100, 0.25)):
        knots = search._stretched(known, arrival)
        come = np.minimum(np.linspace(0.0, arrival + tail, len(knots)) / arrival, 1.0)[:, None]
        expected = ends[0] + come * (ends[1] - ends[0]) + factor * np.sin(2.0 * np.pi * come)
        assert knots == pytest.approx(expected, abs=1e-2 * factor)


def test_errors_in_the_inner_band_weigh_nothing_and_others_what_is_beyond_it():
    search = shooting(fm.build_model(fm.catalog.one_joint(), 1), 1.0, 0.1, [0.0], [0.1])
    errors = np.zeros((1, 8, 4))
    errors[0, :, 1] = [9.0, 9.0, 9.0, 0.06, 9.0, -0.16, 9.0, 0.0]
    errors[0, :, 3] = [0.0, 0.97, -0.98, 0.0, 0.0, 0.0, 0.0, 0.99]
    ways = [[0, 0, 0], [0, pytest.approx(-1.0), 0], [0, 0, 0]]
    rates = [0, 0, pytest.approx(-0.5), 0, 0, 0, 0, pytest.approx(1.0)]
    assert search._beyond(errors, 4)[0].tolist() == [*ways[0], *ways[1], *ways[2], *rates]


@pytest.mark.parametrize("name", ["FlexOne-v0", "FlexPlanar-v0"])
def test_an_arm_is_quicker_than_with_the_tracking_lqr(name):
    """Replayed in the environment, where it settles, also under its weight; and within the limits."""
    environment = Description(name, {"horizon": 3.0})
    table = empty_table(environment)
    (found,) = optimise(environment, [5000], table)
    slew = table.found[5000][1]
    assert found.time == pytest.approx(slew.arrival * environment.setup().control_period) == table.settling_time(5000)
    assert found.time < 0.8 * found.tracking < np.inf
    assert (np.abs(slew.knots) <= np.array(environment.setup().torque_limit)).all()


def test_a_replay_is_the_search_s_own_simulation_to_the_bit():
    """Open loop and regulator, in the single environment and among three arms."""
    setup = setup_of({"name": "FlexPlanar-v0"})
    model, method, step, _ = build(setup)
    random, period = np.random.default_rng(1), setup.control_period
    environment = Description("FlexPlanar-v0", {"horizon": 2.0})
    table, ends = empty_table(environment), random.uniform(-0.2, 0.2, (3, 2, 2))
    search = [
        shooting(model, setup.torque_limit, 0.01, *pair, method=method, step=step, control_period=period)
        for pair in ends
    ]
    expected = []
    for seed, (each, pair) in enumerate(zip(search, ends, strict=True)):
        knots = fm.holding_torques(model, pair[0]) + 0.02 * random.uniform(-1.0, 1.0, (5, 2)) * setup.torque_limit
        table.found[seed] = pair, Slew(knots, 20 + seed, 1), 1.0
        expected.append(each.errors(knots[None], 20 + seed)[0])
    base = Optimised(table, model, setup.torque_limit, period)
    venv = gym.make_vec("FlexPlanar-v0", 3, "vector_entry_point", base=base, horizon=2.0).unwrapped
    venv.reset(seed=0, options={"start": ends[:, 0], "goal_angles": ends[:, 1]})
    env = gym.make("FlexPlanar-v0", base=Optimised(table, model, setup.torque_limit, period), horizon=2.0).unwrapped
    env.reset(seed=0, options={"start": ends[2, 0], "goal_angles": ends[2, 1]})
    for row in range(120):
        venv.step(np.zeros((3, 2), dtype=np.float32))
        env.step(np.zeros(2, dtype=np.float32))
        view = venv.episodes.view
        for arm in range(3):
            assert np.array_equal(view.tip[arm] - view.target[arm], expected[arm][row, :3]), (arm, row)
        assert np.array_equal(env.episodes.view.tip[0], view.tip[2])
