"""Internal model: measurement model and Jacobians of the discrete dynamics."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.view import View
from flexman_gym.kernels.layout import LARGEST_STATE
from flexman_gym.model.state_space import discretize
from flexman_gym.model.statics import rest_state
from flexman_gym.simulation.batch import Batch
from flexman_gym.toolbox.controllers.internal_model import DiscreteJacobians
from flexman_gym.toolbox.controllers.observers.observer import MIN_DEVIATION, MeasurementModel

from oracles.observed_arms import ALL, POSTURES, plant


def test_instruments_read_what_the_view_shows():
    given = plant()
    batch, random = Batch(given.model, arms=4), np.random.default_rng(0)
    batch.reset(np.arange(4), 0.1 * random.normal(size=batch.state.shape))
    view, read = View(batch), MeasurementModel(given, ("strain", "motor_encoders", "joint_encoders"))
    view.read()
    values = batch.state @ read.matrix.T
    assert list(read.places) == ["root_strains", "motor_angles", "motor_rates", "joint_twists", "joint_twist_rates"]
    for name, place in read.places.items():
        assert values[:, place] == pytest.approx(getattr(view, name), abs=1e-15)
        assert np.array_equal(read.ranges[place], given.measured()[name][0])
    assert np.array_equal(read.deviations, MIN_DEVIATION * read.ranges), "perfect ones"
    noisy = MeasurementModel(plant("FlexPlanar-v0", measured=lambda: {
        name: np.array([span, 0.01 * span]) for name, (span, *_) in given.measured().items()}), ALL)  # fmt: skip
    assert noisy.deviations == pytest.approx(0.01 * noisy.ranges)


def test_slopes_at_rest_are_the_exact_hold():
    given = plant(integration=("gauss_3", 0.00005))
    held = np.array([fm.holding_torques(given.model, posture) for posture in POSTURES])
    slopes, good = DiscreteJacobians(given)(rest_state(given.model, POSTURES), held)
    size = 2 * given.model.n_dof
    for each, posture, torques in zip(slopes, POSTURES, held, strict=True):
        state = fm.rest_state(given.model, posture)
        linear = fm.linearize(given.model, state=state, torque=torques)
        transition, inputs = discretize(linear.A, linear.B, given.period)
        assert np.abs(each[:, :size] - transition).max() <= 2e-3 * np.abs(transition).max()
        assert np.abs(each[:, size:-3] - inputs).max() <= 2e-3 * np.abs(inputs).max()
    assert good.all()


def test_slopes_of_moving_arms_are_those_to_both_sides():
    """Of many arms, by a small change of states, torques and a force on the tip at once."""
    given, count, random = plant(), 20, np.random.default_rng(0)
    size = 2 * given.model.n_dof
    batch, arms = Batch(given.model, *given.integration, given.period, arms=count), np.arange(count)
    states, torques = 1e-3 * random.normal(size=(count, size)), random.normal(size=(count, 2))
    states[:, :4] *= 500.0
    slopes, good = DiscreteJacobians(given)(states, torques)
    change, ends = 1e-5 * random.normal(size=(count, size + 5)), []
    for sign in (1.0, -1.0):
        drive = np.zeros((count, 8))
        drive[:, :2], drive[:, 2:5] = torques + sign * change[:, size : size + 2], sign * change[:, size + 2 :]
        batch.place(arms, states + sign * change[:, :size])
        batch.step(drive)
        ends.append(batch.state.copy())
    expected = (ends[0] - ends[1]) / 2.0
    assert good.all() and np.abs((slopes @ change[..., None])[..., 0] - expected).max() < 1e-3 * np.abs(expected).max()


def test_where_an_arm_does_not_go_on_slopes_are_not_good():
    given = plant()
    states = np.zeros((2, 2 * given.model.n_dof))
    states[1] = 0.9 * LARGEST_STATE
    assert DiscreteJacobians(given)(states, np.zeros((2, 2)))[1].tolist() == [True, False]


def test_motors_with_coulomb_friction_slide():
    """At a rate far above the smoothing friction is a constant torque, so that the slopes are those of the true arm."""
    given = plant()
    joints = [replace(joint, coulomb_friction=0.2, coulomb_rate=0.001) for joint in given.model.arm.joints]
    rubbing = given._replace(model=fm.build_model(replace(given.model.arm, joints=joints), **vars(given.model.choice)))
    states, torques = rest_state(given.model, POSTURES), np.zeros((len(POSTURES), 2))
    still = [DiscreteJacobians(each)(states, torques)[0] for each in (given, rubbing)]
    assert np.array_equal(*still), "at rest there is no slope, as without friction"
    states[:, given.model.n_dof + np.arange(4)] = 1.0, -2.0, 1.0, -2.0
    sliding, batch = (
        DiscreteJacobians(rubbing)(states, torques)[0],
        Batch(rubbing.model, *given.integration, given.period, arms=3),
    )
    size, ends = 2 * given.model.n_dof, []
    for change in (0.0, 1e-3):
        drive = np.zeros((3, 8))
        drive[:, :2] = torques + change
        batch.place(np.arange(3), states)
        batch.step(drive)
        ends.append(batch.state.copy())
    found, expected = (ends[1] - ends[0]) / 1e-3, sliding[..., size : size + 2].sum(axis=-1)
    assert found == pytest.approx(expected, abs=1e-3 * np.abs(expected).max())
