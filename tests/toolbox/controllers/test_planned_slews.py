"""Slews optimised in an episode: regression of known slews, shooting from a motion, budget, and tracking of a plan."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.agent.base_controllers import make_base
from flexman_gym.agent.controller import EpisodeInfo
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.evaluation.rollouts import SELECTION_SEEDS, TEST_SEEDS
from flexman_gym.metrics.signals import BAND
from flexman_gym.toolbox.controllers.references.optimised_slews import SHIPPED_TABLE, SlewTable
from flexman_gym.toolbox.controllers.references.planned_slews import (
    JACOBIAN_TIME,
    LEARNED_TABLE,
    PLANNED,
    PREDICTED,
    TRACKED,
    PlannedLQR,
)
from flexman_gym.toolbox.controllers.references.single_shooting import SingleShooting, SlewTorques, interpolate_torques
from flexman_gym.toolbox.controllers.references.slew_regression import KNOTS, SlewRegression

from oracles.assertions import refusal

RRR, ONE = "FlexRRR-v0", "FlexOne-v0"
HERE = np.zeros(1, dtype=np.int64)


def plant(name):
    configuration = Configuration(name)
    return make_plant(configuration, resolve_fidelity(configuration).model)


@pytest.fixture(scope="module")
def learned():
    return SlewTable.load(LEARNED_TABLE)


def part(table, count):
    """Return a table with the first slews of a table."""
    return replace(table, found=dict(list(table.found.items())[:count]))


def test_errors_of_the_regression_are_those_of_slews_left_out(learned):
    """The closed form against a regression without the slew, with the same width and ridge parameter."""
    few, limits = part(learned, 12), np.array([400.0, 400.0, 200.0])
    full = SlewRegression(few, limits)
    squares = []
    for seed, (ends, slew, _) in few.found.items():
        others = replace(few, found={each: row for each, row in few.found.items() if each != seed})
        known = full._features(np.array([row[0] for row in others.found.values()]))
        values = np.array([full._values(row[1]) for row in others.found.values()])
        ridge = full.ridge * np.eye(len(known))
        differences = np.square(known[:, None] - known).sum(axis=2)
        weights = np.linalg.solve(np.exp(-differences / (2.0 * full.scale**2)) + ridge, values - full.mean)
        near = np.square(full._features(ends[None]) - known).sum(axis=1)
        predicted = full.mean + np.exp(-near / (2.0 * full.scale**2)) @ weights
        squares.append((predicted - full._values(slew))[: KNOTS * 3] ** 2)
    assert np.sqrt(np.mean(squares)) == pytest.approx(full.error, rel=1e-9)


def test_the_mirror_image_of_a_slew_is_predicted_as_its_mirror_image(learned):
    model = plant(RRR).model
    regression = SlewRegression.of_model(part(learned, 20), model, np.array([400.0, 400.0, 200.0]))
    start, goal, opposite = np.array([0.2, -0.3, 0.4]), np.array([-0.5, 0.1, 0.6]), np.array([-1.0, 1.0, 1.0])
    one, other = regression.predict(start, goal), regression.predict(start * opposite, goal * opposite)
    np.testing.assert_allclose(other.knots, one.knots * opposite, atol=1e-9)
    turn = np.array([0.7, 0.0, 0.0])
    turned = regression.predict(start + turn, goal + turn)
    np.testing.assert_allclose(turned.knots, one.knots, atol=1e-9)


def test_the_rest_of_a_slew_is_found_from_the_state_within_it(learned):
    """Shooting from the motion of a known slew after a third of it, with its own remaining torques: no step needed."""
    known, (ends, slew, _) = plant(RRR), next(iter(learned.found.values()))
    controller = PlannedLQR(known)
    torques, first = interpolate_torques(slew.knots, slew.periods), slew.periods // 3
    state = controller.roll(fm.rest_state(known.model, ends[0]), torques[:first])[-1]
    shooting = SingleShooting(
        controller, lambda count: controller._models("plans", count), BAND * 8.5, known.rate_limit, (state, ends[1]),
        budget=1,
    )  # fmt: skip
    rest = SlewTorques(torques[first:], slew.periods - first, slew.arrival - first)
    errors = shooting.errors(rest.knots[None], rest.periods)[0]
    whole = SingleShooting(
        controller, lambda count: controller._models("plans", count), BAND * 8.5, known.rate_limit, tuple(ends)
    )
    expected = whole.errors(slew.knots[None], slew.periods)[0, first:]
    middle = slice(0, rest.periods // 2)
    assert np.abs(errors[middle, :3] - expected[middle, :3]).max() < 0.05  # knots at the periods shift torques by half
    assert errors.shape == expected.shape


@pytest.mark.slow
@pytest.mark.parametrize("settings", [{}, {"thinking": 0.0}])
def test_the_arm_moves_as_planned_and_settles_in_the_time_planned(settings):
    """The nominal arm: states of the episode are those of the plan, to rounding; the estimate of the arrival is met."""
    arms = gym.make_vec(RRR, 3, "vector_entry_point", base={"kind": "planned", **settings}, autoreset_mode="Disabled")
    arms.reset(seed=[3_000_001, 3_000_002, 3_000_003])
    episodes = arms.unwrapped.episodes
    base, errors = episodes.base, []
    expected = {PREDICTED} if settings.get("thinking") == 0.0 else {PLANNED, PREDICTED}
    assert {*base.status.tolist()} <= expected and (PLANNED in base.status) == (PLANNED in expected)
    for period in range(1, 300):
        _, _, failed, _, info = arms.step(np.zeros((3, 3), dtype=np.float32))
        assert not failed.any()
        errors.append(info["tip_error"])
        for arm, schedule in enumerate(base._schedules):
            if period < len(schedule.states) - 1:
                difference = episodes.view.state[arm] - schedule.states[period]
                assert np.abs(difference).max() < 1e-9 * max(1.0, np.abs(schedule.states[period]).max())
    late = np.array(errors) > BAND * episodes.view.reach
    settled = arms.unwrapped.configuration.control_period * (
        1.0 + np.array([np.flatnonzero(each)[-1] for each in late.T])
    )
    planned = base.status == PLANNED
    np.testing.assert_allclose(settled[planned], base.arrivals[planned], atol=0.05)
    assert np.isinf(base.arrivals[~planned]).all()
    np.testing.assert_array_equal(base.estimates["planning_time"], JACOBIAN_TIME * base.jacobians)
    assert errors[-1].max() < 1e-3


@pytest.mark.slow
def test_an_arm_alone_has_the_plan_that_it_has_among_others():
    ends = np.random.default_rng(4).uniform(-0.7, 0.7, (2, 3, 3))
    together, alone = (make_base("planned", plant(RRR)) for _ in range(2))
    together.reset(np.arange(3), EpisodeInfo(*ends, period=0.02), 3)
    alone.reset(HERE, EpisodeInfo(ends[0, 2:], ends[1, 2:], period=0.02), 1)
    for one, other in zip(alone._schedules[0], together._schedules[2], strict=True):
        assert np.array_equal(one, other)


@pytest.mark.slow
def test_without_a_table_of_the_arm_a_plan_begins_with_the_slew_of_the_lqr():
    """FlexOne-v0: quicker than the tracked slew, and not without planning time."""
    start, goal = np.array([[0.1]]), np.array([[0.7]])
    controller, none = (make_base({"kind": "planned", "thinking": each}, plant(ONE)) for each in (1.0, 0.0))
    for each in (controller, none):
        each.reset(HERE, EpisodeInfo(start, goal, plant(ONE).period), 1)
    assert controller.status.tolist() == [PLANNED] and none.status.tolist() == [TRACKED]
    assert controller.arrivals[0] < len(none._schedules[0].states) * plant(ONE).period
    assert np.isinf(none.arrivals[0])


@pytest.mark.parametrize("budget", [1, 4])
def test_the_planning_time_bounds_the_jacobians(budget):
    controller = make_base({"kind": "planned", "thinking": (budget + 0.1) * JACOBIAN_TIME}, plant(RRR))
    start, goal = np.array([[0.6, -0.5, 0.3]]), np.array([[-0.6, 0.5, -0.3]])
    controller.reset(HERE, EpisodeInfo(start, goal, 0.02), 1)
    assert 1 <= controller.jacobians[0] <= budget


def test_an_arm_at_its_goal_and_a_path_are_tracked_as_by_the_tracking_lqr():
    held = make_base("planned", plant(RRR))
    posture = np.array([[0.2, 0.1, -0.3]])
    held.reset(HERE, EpisodeInfo(posture, posture, 0.02), 1)
    assert held.status.tolist() == [TRACKED] and len(held._schedules[0].states) == 1
    env = gym.make("FlexRRR-Track-v0", base="planned").unwrapped
    env.reset(seed=0)
    assert env.episodes.base.status.tolist() == [TRACKED]


def test_the_learned_table_is_made_of_training_seeds(learned):
    """No slew of the test and selection episodes, and none of the table of the test episodes."""
    assert min(learned.found) >= 1_000_000 and len(learned.found) >= 350
    assert not {*learned.found} & {*TEST_SEEDS, *SELECTION_SEEDS}
    known = np.array([row[0] for row in learned.found.values()])
    for ends, _, _ in SlewTable.load(SHIPPED_TABLE).found.values():
        assert np.abs(known - ends).max(axis=(1, 2)).min() > 1e-3
    assert learned.about["command"].endswith("--learn")


def test_a_table_of_another_arm_and_a_wrong_planning_time_are_refused():
    assert "table" in refusal(make_base, {"kind": "planned", "table": str(SHIPPED_TABLE)}, plant(ONE))
    assert "base.thinking: -1" in refusal(make_base, {"kind": "planned", "thinking": -1.0}, plant(RRR))


def shooting_of(controller, ends, budget):
    return SingleShooting(
        controller, lambda count: controller._models("plans", count), BAND * 8.5, plant(RRR).rate_limit, ends, budget
    )


ENDS = np.array([0.2, -0.3, 0.4]), np.array([-0.5, 0.1, 0.6])


@pytest.mark.slow
def test_a_prediction_of_no_use_gives_way_to_the_torques_of_a_planned_slew():
    """Zero torques over half a second: the slew found is about as quick as that of a good prediction."""
    known = plant(RRR)
    controller, useless = PlannedLQR(known), SlewTorques(np.zeros((6, 3)), 35, 25)
    predicted = SlewRegression.of_model(SlewTable.load(LEARNED_TABLE), known.model, controller.limits).predict(*ENDS)
    found, expected = (shooting_of(controller, ENDS, 12).first(each) for each in (useless, predicted))
    assert found.arrival < 1.2 * expected.arrival


@pytest.mark.slow
def test_a_slew_found_is_shortened_without_a_further_jacobian():
    """A slew that is known to settle, a tenth too long: steps with its own Jacobian shorten it by periods."""
    controller = PlannedLQR(plant(RRR))
    first = shooting_of(controller, ENDS, 12)
    found = first.search()
    late, shooting = round(1.1 * found.arrival), shooting_of(controller, ENDS, 2)
    slow = shooting._solve(shooting.rescale(found, late), late)
    count = shooting.jacobians
    shorter = shooting._shortened(slow)
    errors = shooting.errors(shorter.knots[None], shorter.periods)[0, :, :3]
    assert shorter.arrival < slow.arrival and shooting.jacobians == count > 0
    assert np.linalg.norm(errors[shorter.arrival - 1 :], axis=1).max() < BAND * 8.5
