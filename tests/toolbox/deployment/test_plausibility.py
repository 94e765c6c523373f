"""Innovations of observers: an arm within its ranges is plausible, and readings that lie are not."""

import numpy as np
import pytest

from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.model.linearization import LinearMeasurements
from flexman_gym.model.statics import rest_state
from flexman_gym.simulation.batch import Batch
from flexman_gym.toolbox.deployment.machine.plausibility import EXCESSES, REPEATS, SPAN, TORQUE_ERROR, InnovationTest

ENVIRONMENT = Configuration.find("FlexOne-v0")
MODEL = resolve_fidelity(ENVIRONMENT).model
PLANT = make_plant(ENVIRONMENT, MODEL)
NAMES = ("motor_angles", "motor_rates", "root_strains")
TORQUE = np.array([0.05])  # N m, a tenth of the limit


class Arm:
    """Simulated arm from rest, with factors of its parameters."""

    def __init__(self, **parameters):
        self.batch, self.torques = Batch(MODEL, *PLANT.integration, PLANT.period), np.zeros(1)
        if parameters:
            self.batch.vary(np.arange(1), **{name: np.array(value) for name, value in parameters.items()})
        self.batch.reset(np.arange(1), rest_state(MODEL, np.array([[0.3]])))

    def step(self, torques):
        self.torques = torques
        self.batch.step(np.concatenate([torques, np.zeros(6)])[None])

    def readings(self):
        measured = LinearMeasurements(MODEL).measure(self.batch.state)
        return {name: measured[name][0].copy() for name in NAMES} | {"torques": self.torques.copy()}


def contradiction(arm, lie=lambda now, k: now, periods=60, torques=lambda k: TORQUE, actual=None, plant=PLANT):
    """Return the period and the text of the first contradiction, by readings `lie(readings, k)`; None without one."""
    test = InnovationTest(plant, [arm.readings()] * 3)
    for k in range(periods):
        test.advance(torques(k))
        arm.step((actual or torques)(k))
        if text := test.check(lie(arm.readings(), k)):
            return k, text
    return None


def stiffness(factor):
    return {"joint_stiffness": [[factor * MODEL.constants.joint_stiffness[0]]]}


@pytest.mark.parametrize("factor", [0.5, 0.8, 1.0, 1.2, 1.5])
def test_an_arm_within_the_range_of_its_stiffness_is_plausible(factor):
    assert contradiction(Arm(**stiffness(factor)), torques=lambda k: 10.0 * TORQUE * np.sin(0.3 * k)) is None


@pytest.mark.parametrize("share", [1.0 - TORQUE_ERROR, 1.0 + TORQUE_ERROR])
def test_torques_that_are_wrong_within_their_error_are_plausible(share):
    assert contradiction(Arm(), actual=lambda k: share * TORQUE) is None


def test_an_arm_that_moves_the_other_way_is_not_plausible():
    k, text = contradiction(Arm(), actual=lambda k: -TORQUE, lie=lambda now, k: now | {"torques": TORQUE})
    assert k <= SPAN and text.startswith("reading motor_") and text.endswith("by the model")


@pytest.mark.parametrize("begin", [0, 10])
def test_frozen_values_are_named_after_the_fewest_repeats(begin):
    kept = {}

    def lie(now, k):
        return now if k < begin else kept.setdefault("now", now) | {"torques": now["torques"]}

    k, text = contradiction(Arm(), lie)
    assert k == begin + REPEATS and "stands still" in text


def test_a_lost_sample_is_no_contradiction():
    before = {}

    def lie(now, k):
        before[k] = before[k - 1] if k % 10 == 5 else now
        return before[k]

    assert contradiction(Arm(), lie, torques=lambda k: 10.0 * TORQUE * (-1.0) ** (k // 10)) is None


def test_an_arm_at_rest_repeats_its_readings_without_a_contradiction():
    assert contradiction(Arm(), torques=lambda k: 0.0 * TORQUE) is None


def test_an_arm_that_waits_for_late_torques_repeats_its_readings_without_a_contradiction():
    """Observers with shorter delays predict a motion before it begins."""
    late = REPEATS + 4
    arm, plant = Arm(), PLANT._replace(delay=(0, late))
    assert contradiction(arm, torques=lambda k: 10.0 * TORQUE, actual=lambda k: 10.0 * TORQUE * (k >= late),
                         plant=plant) is None  # fmt: skip


def test_a_coarse_encoder_is_no_contradiction():
    def lie(now, k):
        return {
            name: np.round(values / 2e-3) * 2e-3 if name == "motor_angles" else values for name, values in now.items()
        }

    assert contradiction(Arm(), lie) is None


def test_a_shifted_angle_is_named_after_the_fewest_innovations():
    k, text = contradiction(Arm(), lambda now, k: now | {"motor_angles": now["motor_angles"] + 0.2 * (k >= 20)})
    assert k == 20 + EXCESSES - 1 and text.startswith("reading motor_angles[0] is ")


def test_torques_that_were_not_commanded_are_named():
    k, text = contradiction(
        Arm(), lambda now, k: now | {"torques": now["torques"] + 1.01 * TORQUE_ERROR * 0.5 * (k >= 20)}
    )
    assert k == 20 + EXCESSES - 1 and text.startswith("reading torques[0] is ")
    assert contradiction(Arm(), lambda now, k: now | {"torques": now["torques"] + 0.99 * TORQUE_ERROR * 0.5}) is None
