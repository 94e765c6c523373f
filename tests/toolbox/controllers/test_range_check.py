"""Range check of readings: refused control periods, their torques, and what goes on in time."""

from copy import deepcopy

import gymnasium as gym
import numpy as np
import pytest

from flexman_gym.agent.controller import EpisodeInfo
from flexman_gym.agent.pd import PD
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.evaluation.rollouts import rollout
from flexman_gym.model.statics import rigid_holding_torques
from flexman_gym.toolbox.controllers.input_shaping.shaped_controller import InputShapedController
from flexman_gym.toolbox.controllers.range_check import (
    GOOD,
    NOT_FINITE,
    OUT_OF_RANGE,
    RangeCheckedController,
    compensated_model,
    holding_periods,
)

from oracles.assertions import refusal

LIMITS, PERIOD, GRAVITY = np.array([12.0, 4.0]), 0.01, 9.81  # N m, s, m/s^2
MODEL = resolve_fidelity(Configuration("FlexPlanar-v0")).model  # two links of 0.5 m under gravity
ONE, ACTIVE = np.zeros(1, dtype=np.int64), np.array([True])
RANGES = {"angle_errors": 8.0, "motor_rates": np.array([20.0, 10.0])}


class Recorder:
    """Controller that commands 0.1 and records its calls."""

    sensors = ("servo",)

    def __init__(self):
        self.applied, self.skipped = [], 0

    def reset(self, arms, episode, count):
        pass

    def act(self, readings, applied, active):
        self.applied.append(applied.tolist())
        return np.full((1, 2), 0.1)

    def skip(self, active):
        self.skipped += 1


def checked(inner, model=None, goal=(0.3, -0.2), path=None):
    """Return a range-checked controller at the start of a move."""
    controller = RangeCheckedController(inner, RANGES, LIMITS, model)
    controller.reset(ONE, EpisodeInfo(np.zeros((1, 2)), np.array([goal]), PERIOD, path), 1)
    return controller


def act(controller, error=0.1, rate=0.0, applied=0.0):
    """Return the action (2,) for the readings of a control period."""
    readings = {"angle_errors": np.full((1, 2), error), "motor_rates": np.array([[0.0, rate]])}
    return controller.act(readings, np.full((1, 2), applied), ACTIVE)[0]


@pytest.mark.parametrize(("rate", "status"), [
    (np.nan, NOT_FINITE), (np.inf, NOT_FINITE), (-np.inf, NOT_FINITE), (1e308, OUT_OF_RANGE),
    (np.nextafter(10.0, 11.0), OUT_OF_RANGE), (-np.nextafter(10.0, 11.0), OUT_OF_RANGE), (10.0, GOOD), (-10.0, GOOD),
])  # fmt: skip
def test_a_bad_reading_is_refused_with_its_status(rate, status):
    recorder = Recorder()
    controller = checked(recorder)
    action = act(controller, rate=rate)
    assert controller.status == status and controller.refused == (status != GOOD)
    assert len(recorder.applied) == (status == GOOD) and action.any() == (status == GOOD)


def test_the_worst_reading_decides_and_infinity_is_beyond_any_range():
    controller = RangeCheckedController(Recorder(), {"angle_errors": 8.0, "motor_rates": np.inf}, LIMITS)
    controller.reset(ONE, EpisodeInfo(np.zeros((1, 2)), np.zeros((1, 2)), PERIOD), 1)
    act(controller, error=9.0, rate=np.inf)
    assert controller.status == NOT_FINITE


def test_time_goes_on_in_refused_periods_and_the_next_good_one_gets_the_torques_of_the_last_good_one():
    recorder = Recorder()
    controller = checked(recorder)
    for error, applied in ((0.1, 0.0), (np.nan, 0.1), (np.nan, 0.0), (0.1, 0.0), (0.1, 0.3)):
        act(controller, error, applied=applied)
    assert recorder.applied == [[[0.0, 0.0]], [[0.1, 0.1]], [[0.3, 0.3]]] and recorder.skipped == 2


def test_a_refused_period_holds_the_weight_at_the_last_good_posture_for_the_time_of_a_short_fall():
    """The angles of the motors are goal minus error; a body falls by 5 % of the reach of 1 m in 0.10 s."""
    controller, goal = checked(Recorder(), MODEL), np.array([0.3, -0.2])
    assert not act(controller, error=np.nan).any()
    for error in (0.1, 0.4):
        act(controller, error)
    held = [act(controller, error=np.nan) for _ in range(12)]
    count = int(np.sqrt(2.0 * 0.05 / GRAVITY) / PERIOD)
    assert np.array_equal(held[:count], [rigid_holding_torques(MODEL, goal - 0.4) / LIMITS] * count)
    assert not np.any(held[count:]) and count == 10


def test_the_posture_of_a_moving_goal_is_relative_to_the_goal_of_its_time():
    path = np.array([[[0.0, 0.0], [0.5, 0.1], [1.0, 0.2], [1.5, 0.3]]])
    controller = checked(Recorder(), MODEL, path=lambda: path)
    for error in (0.1, np.nan, 0.2):
        act(controller, error)
    assert np.array_equal(act(controller, np.nan), rigid_holding_torques(MODEL, path[0, 2] - 0.2) / LIMITS)


@pytest.mark.parametrize("names", [("motor_angles", "angle_errors"), ("state",), ("angle_errors",), ("strain",)])
def test_the_posture_follows_from_motor_angles_states_or_errors(names):
    goal, angles = np.array([0.3, -0.2]), np.array([0.2, 0.5])
    readings = {"motor_angles": angles[None], "state": MODEL.at_rest(angles[None]),
                "angle_errors": (goal - angles)[None], "strain": np.zeros((1, 2))}  # fmt: skip
    readings = {name: readings[name] for name in names}
    controller = RangeCheckedController(Recorder(), dict.fromkeys(names, 1e6), LIMITS, MODEL)
    controller.reset(ONE, EpisodeInfo(np.zeros((1, 2)), goal[None], PERIOD), 1)
    controller.act(readings, np.zeros((1, 2)), ACTIVE)
    bad = {name: np.full_like(values, np.nan) for name, values in readings.items()}
    weight = rigid_holding_torques(MODEL, angles) / LIMITS * (names != ("strain",))
    assert controller.act(bad, np.zeros((1, 2)), ACTIVE)[0] == pytest.approx(weight, abs=1e-12)


def test_holding_periods_grow_with_the_root_of_the_reach_and_need_gravity():
    free = resolve_fidelity(Configuration("FlexOne-v0")).model
    assert holding_periods(None, PERIOD) == holding_periods(free, PERIOD) == 0
    assert holding_periods(MODEL, 1.0) == 1
    heavy = resolve_fidelity(Configuration("FlexRRR-Gravity-v0")).model  # 8.5 m
    ratio = holding_periods(heavy, 1e-5) / holding_periods(MODEL, 1e-5)
    assert ratio == pytest.approx(np.sqrt(8.5), rel=1e-3)


def test_the_compensated_weight_is_that_of_a_pd_with_its_model_and_of_an_lqr():
    gains = {"stiffness": [39.0, 5.56], "damping": [9.35, 1.33], "torque_limit": LIMITS}
    weighed = PD(**gains, gravity_model=MODEL)
    assert compensated_model(weighed) is compensated_model(InputShapedController(weighed, MODEL)) is MODEL
    free = PD(**gains, gravity_model=resolve_fidelity(Configuration("FlexOne-v0")).model)
    assert compensated_model(PD(**gains)) is compensated_model(free) is compensated_model(Recorder()) is None


@pytest.mark.slow
@pytest.mark.parametrize(("base", "environment", "periods"), [
    ("lqr-tracking", "FlexPlanar-v0", 5), ("pd-shaped", "FlexPlanar-v0", 60), ("pd-torque", "FlexRRR-v0", 5),
    ("optimised", "FlexRRR-v0", 5), ("hinf", "FlexOne-v0", 1),
])  # fmt: skip
def test_skipped_periods_advance_a_reference_in_time(base, environment, periods):
    """At rest at the start of a move, these periods leave all else of these controllers as it was."""
    venv = gym.make_vec(environment, 1, "vector_entry_point", base=base)
    venv.reset(seed=[9000])
    agent, measurements = venv.unwrapped.episodes.agent, venv.unwrapped.episodes.measurements
    other, readings, none = deepcopy(agent), measurements.readings, np.zeros((1, agent.mode.joints))
    actions = [np.array(agent.act(readings, none, ACTIVE)) for _ in range(periods + 1)]
    for _ in range(periods):
        other.skip(ACTIVE)
    assert np.array_equal(other.act(readings, none, ACTIVE), actions[-1])
    assert not np.array_equal(actions[0], actions[-1])


@pytest.mark.slow
def test_an_environment_with_a_range_checked_base_has_the_same_motion():
    configuration = Configuration("FlexPlanar-v0")
    gains = configuration.pd_gains
    pd = PD(**gains, torque_limit=LIMITS, gravity_model=MODEL)
    ranges = {"angle_errors": 8.0, "motor_rates": 20.0, "goal_rates": 20.0}
    plain, guarded = (
        rollout(each, "FlexPlanar-v0", [9000]).tips for each in (pd, RangeCheckedController(pd, ranges, LIMITS, MODEL))
    )
    assert np.array_equal(plain, guarded)


@pytest.mark.parametrize(("ranges", "count", "line"), [
    ({"angle_errors": 8.0}, 1, "the range of motor_rates, too"),
    ({"angle_errors": -1.0}, 1, "numbers >= 0"), ({"angle_errors": np.nan}, 1, "numbers >= 0"),
    (RANGES, 2, "one arm"),
])  # fmt: skip
def test_a_missing_range_a_negative_one_and_several_arms_are_refused(ranges, count, line):
    def run():
        controller = RangeCheckedController(Recorder(), ranges, LIMITS)
        controller.reset(ONE, EpisodeInfo(np.zeros((1, 2)), np.zeros((1, 2)), PERIOD), count)
        act(controller)

    assert line in refusal(run)
