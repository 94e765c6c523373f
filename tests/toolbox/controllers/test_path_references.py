"""Path references adapted to estimated parameters."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.simulation.physical_parameters import varied_model
from flexman_gym.toolbox.controllers.references.adaptive_references import PathReferences
from flexman_gym.toolbox.controllers.references.trajectories import TIMINGS, plan_path

PERIOD, PAYLOADS, T = 0.01, (0.0, 0.1, 0.2), 80
PLACES = TIMINGS["quintic"].at(np.linspace(0.0, 1.0, T + 1))[0]
PATHS = PLACES[:, None] * np.array([[[0.4, -0.8]], [[-0.3, 0.5]]])


def model(**joint):
    whole = fm.catalog.vertical_2r()
    return fm.build_model(replace(whole, joints=[replace(each, **joint) for each in whole.joints]), 1, 1)


def begun(own, parameters, arms=(0, 1)):
    result = PathReferences(own, PERIOD, PAYLOADS)
    for arm in arms:
        result.begin(arm, PATHS[arm])
    result.adapt(np.array(arms), parameters)
    return result


def along(following, arm):
    """States and torques of all periods of an arm."""
    parts = [following.at(np.array([PERIOD * period]), np.array([arm])) for period in range(T + 1)]
    return tuple(np.array([each[i][0] for each in parts]) for i in range(2))


@pytest.mark.parametrize("payload", PAYLOADS)
def test_with_a_payload_of_the_table_it_is_the_plan_for_that_arm(payload):
    own = model()
    following = begun(own, {"payload_mass": np.array([0.07, payload])})
    plan = plan_path(varied_model(own, payload_mass=payload), PATHS[1], PERIOD)
    states, torques = along(following, 1)
    assert states == pytest.approx(plan.states, abs=1e-9)
    assert torques[:-1] == pytest.approx(plan.torques, abs=1e-9)
    assert np.array_equal(torques[-1], torques[-2]), "after the last period as in it"


def test_between_it_is_nearly_that_plan_and_after_the_end_it_stays():
    own = model()
    following = begun(own, {"payload_mass": np.array([0.06, 0.0])})
    plan = plan_path(varied_model(own, payload_mass=0.06), PATHS[0], PERIOD)
    states, torques = along(following, 0)
    span = np.ptp(plan.torques, axis=0).max()
    assert np.abs(torques[:-1] - plan.torques).max() < 0.01 * span
    late = following.at(np.array([50.0]), np.array([0]))
    assert np.array_equal(late[0][0], states[-1]) and np.array_equal(late[1][0], torques[-1])


def test_an_arm_with_softer_springs_winds_them_up_further():
    own = model()
    stiff = np.tile(own.constants.joint_stiffness, (2, 1))
    states = [along(begun(own, {"joint_stiffness": stiff * factor}), 0)[0] for factor in (1.0, 0.8)]
    twists = [each[:, own.motor_columns] - each[:, :2] for each in states]
    assert twists[1] == pytest.approx(twists[0] / 0.8, abs=1e-9) and np.abs(twists[0]).max() > 1e-3


def test_arms_do_not_touch_each_other():
    own, parameters = model(), {"payload_mass": np.array([0.03, 0.17])}
    both, now = begun(own, parameters), np.full(2, 0.3)
    together = both.at(now, np.arange(2))
    for arm in range(2):
        alone = begun(own, parameters, (arm,)).at(now[:1], np.array([arm]))
        assert all(np.array_equal(one[arm], other[0]) for one, other in zip(together, alone, strict=True))
