"""Tip accelerations: of the arms of a batch, against the simulated tip, closed forms, and what a batch remembers."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.common.snapshot import get_state, set_state
from flexman_gym.kernels import layout
from flexman_gym.kernels.layout import SPECIFIC_FORCE, TIP, TIP_ACCELERATION
from flexman_gym.model.statics import holding_torques, rest_state
from flexman_gym.simulation.batch import Batch

from oracles.chains import laden_rrr
from oracles.random_inputs import drives, states_of

G = 9.81
ARM = laden_rrr(G)
METHODS = ("midpoint_3", "ros2", "generalised_alpha", "rk4", "dop853")


def begun(arms, method="midpoint_3", periods=3, modes=2):
    """A batch that has moved, and its drives (steps, b, n + 6)."""
    model = fm.build_model(ARM, modes=modes)
    batch, drive = Batch(model, method, 1e-4 if method == "rk4" else 0.005, 0.01, arms=arms), drives(arms, periods)
    batch.reset(np.arange(arms), states_of(model, arms))
    for each in drive:
        batch.step(each)
    return batch, drive


@pytest.mark.parametrize("arms", [1, 17])
@pytest.mark.parametrize("method", METHODS)
def test_the_acceleration_is_that_of_each_arm_at_its_state_under_its_last_torques(method, arms):
    batch = begun(arms, method, periods=0)[0]
    for each in [np.zeros((arms, 9)), *drives(arms, 2) * ([1.0] * 3 + [0.0] * 6)]:
        if each.any():
            batch.step(each)
        result = batch.tip_accelerations()[:, TIP_ACCELERATION]
        for arm in range(arms):
            expected = fm.tip_acceleration(batch.model, batch.state[arm], each[arm, :3])
            np.testing.assert_allclose(result[arm], expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


def test_the_acceleration_is_the_second_difference_of_the_simulated_tip():
    """Under torques, a force on the tip and an acceleration of the base, of arms of different masses; to order six."""
    h, model = 2e-4, fm.build_model(ARM, modes=2)
    batch = Batch(model, "dop853", None, h, rtol=1e-13, atol=1e-15, arms=3)
    batch.vary(np.arange(3), payload_mass=np.array([0.0, 3.0, 9.0]))
    batch.reset(np.arange(3), states_of(model, 3))
    drive, tips, result = drives(3, 1)[0], [], []
    for _ in range(7):
        batch.step(drive)
        tips.append(batch.outputs[:, TIP].copy())
        result.append(batch.tip_accelerations()[:, TIP_ACCELERATION].copy())
    weights = np.array([1 / 90, -3 / 20, 3 / 2, -49 / 18, 3 / 2, -3 / 20, 1 / 90]) / h**2
    expected = np.tensordot(weights, tips, 1)
    assert np.abs(result[3] - expected).max() < 1e-6 * np.abs(expected).max()
    assert np.abs(result[2] - expected).max() > 1e-3 * np.abs(expected).max(), "each moment has its own"


@pytest.mark.parametrize("stiffening", [False, True])
@pytest.mark.parametrize("method", ["midpoint_3", "gauss_2", "dop853"])
def test_an_arm_at_rest_under_its_weight_feels_9_81_and_is_not_accelerated(method, stiffening):
    """It shows no acceleration, and all that its accelerometer shows has the size of the weight."""
    model, angles = fm.build_model(ARM, modes=2, stiffening=stiffening), (0.3, 0.5, -0.9)
    batch, drive = Batch(model, method, 0.005, 0.01, arms=2), np.zeros((2, 9))
    drive[:, :3] = holding_torques(model, angles)
    batch.reset(np.arange(2), rest_state(model, angles)[None].repeat(2, axis=0))
    batch.step(drive)
    acceleration, felt = batch.tip_accelerations()[:, TIP_ACCELERATION], batch.tip_accelerations()[:, SPECIFIC_FORCE]
    assert np.abs(acceleration).max() < 1e-6 * G
    assert np.linalg.norm(felt, axis=1) == pytest.approx([G, G], rel=1e-7)
    assert np.array_equal(felt[0], felt[1])


def test_a_bent_link_turns_what_its_tip_feels_by_its_slope():
    """A planar cantilever that droops: gravity along its end is that of the angle at which it ends."""
    arm = fm.catalog.one_link((0.0, -1.0, 0.0), gravity=(0.0, 0.0, -G))
    model, angle = fm.build_model(arm, elements=2), 0.4
    batch, drive = Batch(model, "ros2", 0.001, 0.001), np.zeros((1, 7))
    drive[0, 0] = holding_torques(model, [angle])[0]
    batch.reset(np.arange(1), rest_state(model, [angle])[None])
    batch.step(drive)
    link, constants = arm.links[0], model.constants
    slope = batch.state[0, model.elastic_columns(0)] @ constants.tip_rotation
    droop = link.density * link.area * G * np.cos(angle) * link.length**3
    assert slope[1] == pytest.approx(droop / (6 * link.youngs_modulus * link.second_moment_y), rel=1e-2)
    up = np.array([np.sin(angle), 0.0, np.cos(angle)])  # in the frame of the link, about whose axis y both turn
    turned = np.array([[np.cos(slope[1]), 0.0, -np.sin(slope[1])], [0, 1, 0], [np.sin(slope[1]), 0, np.cos(slope[1])]])
    assert batch.tip_accelerations()[0, SPECIFIC_FORCE] == pytest.approx(G * turned @ up, abs=1e-6 * G)


def test_an_arm_that_falls_freely_with_its_base_feels_nothing():
    model = fm.build_model(ARM, modes=2)
    batch, drive = Batch(model, "ros2", 0.005, 0.01, arms=2), np.zeros((2, 9))
    drive[:, -3:] = ARM.gravity
    batch.reset(np.arange(2), np.array([model.initial_state([0.3, 0.5, -0.9])] * 2))
    batch.step(drive)
    assert np.abs(batch.tip_accelerations()).max() < 1e-10


def test_a_base_that_is_lifted_is_felt_like_weight():
    """Accelerated upward by g without gravity: the same specific force as at rest in gravity, and the same motion."""
    heavy = fm.build_model(ARM, modes=2)
    weightless = fm.build_model(replace(ARM, gravity=(0.0, 0.0, 0.0)), modes=2)
    result, states = [], states_of(heavy, 3)
    for model, lift in ((heavy, 0.0), (weightless, G)):
        batch, drive = Batch(model, arms=3), drives(3, 1)[0]
        drive[:, -3:] = (0.0, 0.0, lift)
        batch.reset(np.arange(3), states)
        batch.step(drive)
        result.append(batch.tip_accelerations().copy())
    np.testing.assert_allclose(result[0], result[1], rtol=0.0, atol=1e-9 * np.abs(result[0]).max())


def test_a_force_on_the_tip_of_a_rigid_link_turns_it():
    """At rest: its acceleration is F L^2 / J across the link; the base, which moves too, is felt and not counted."""
    arm, angle, force = fm.catalog.one_link(), 0.7, 3.0
    model = fm.build_model(arm, flexible_links=False)
    batch, drive = Batch(model, "ros2", 1e-6, 1e-6), np.zeros((1, 7))
    across = np.array([-np.sin(angle), np.cos(angle), 0.0])
    drive[0, 1:4] = force * across
    drive[0, 4:] = (0.0, 0.0, 0.25)
    batch.reset(np.arange(1), model.initial_state([angle])[None])
    batch.step(drive)
    inertia = fm.mass_matrix(model, batch.state[0])[0, 0]
    size = force * arm.links[0].length ** 2 / inertia
    assert batch.tip_accelerations()[0] == pytest.approx(np.r_[size * across, 0.0, size, 0.25], abs=1e-5 * size)


@pytest.mark.parametrize("method", ["midpoint_3", "gauss_2", "dop853"])
def test_what_is_varied_is_felt_at_once(method):
    """An arm with another payload is accelerated like a model with that payload; its neighbour stays as it was."""
    payload = replace(ARM.payload, mass=6.0, inertia=(2.0 * np.array(ARM.payload.inertia)).tolist())
    model, heavier = fm.build_model(ARM), fm.build_model(replace(ARM, payload=payload))
    batch, states = Batch(model, method, 0.005, 0.01, arms=2), states_of(model, 1).repeat(2, axis=0)
    batch.reset(np.arange(2), states)
    before = batch.tip_accelerations().copy()
    batch.vary(np.array([1]), payload_mass=np.array([6.0]))
    result = batch.tip_accelerations()
    assert np.array_equal(result[0], before[0])
    rest = np.zeros(3)
    expected = [fm.tip_acceleration(each, states[0], rest) for each in (model, heavier)]
    np.testing.assert_allclose(result[:, TIP_ACCELERATION], expected, rtol=1e-9)
    assert np.abs(result[1] - result[0]).max() > 1e-3


@pytest.mark.parametrize("method", ["midpoint_3", "gauss_2", "dop853"])
def test_an_arm_that_failed_keeps_those_of_its_last_good_period(method):
    batch, _ = begun(3, method)
    before = batch.tip_accelerations().copy()
    wild = drives(3, 1)[0]
    wild[1, 0] = 1e12 if method == "midpoint_3" else np.nan
    for _ in range(2):
        batch.step(wild)
        result = batch.tip_accelerations()
        assert batch.status[1] != layout.OK and (batch.status[[0, 2]] == layout.OK).all()
        assert np.isfinite(result).all() and np.array_equal(result[1], before[1])
        assert (result[[0, 2]] != before[[0, 2]]).all()


def test_an_arm_that_rests_keeps_its_drive_and_one_that_is_reset_has_none():
    batch, drive = begun(3)
    before = batch.tip_accelerations().copy()
    batch.step(2.0 * drive[-1], moving=np.array([True, False, True]))
    assert np.array_equal(batch.tip_accelerations()[1], before[1])
    state = states_of(batch.model, 1)
    batch.reset(np.array([2]), state)
    result = batch.tip_accelerations()
    assert result[2, TIP_ACCELERATION] == pytest.approx(fm.tip_acceleration(batch.model, state[0], np.zeros(3)))
    assert np.array_equal(result[1], before[1])


def test_they_are_calculated_once_in_a_period_and_only_when_asked_for(monkeypatch):
    batch, drive = begun(2)
    calls, compute = [], batch._mover.compute_tip_accelerations
    monkeypatch.setattr(batch._mover, "compute_tip_accelerations", lambda *each: calls.append(compute(*each)))
    for count in (1, 2, 3):
        batch.step(drive[0])
        assert len(calls) == count - 1
        for _ in range(3):
            batch.tip_accelerations()
            assert len(calls) == count


@pytest.mark.parametrize("asked", [False, True])
def test_a_batch_that_takes_over_a_snapshot_feels_the_same(asked):
    """Whether the one that gave it had calculated them or not, and whatever the other one had."""
    batch, drive = begun(3)
    batch.vary(np.array([1]), payload_mass=np.array([8.0]))
    batch.step(-drive[0])
    if asked:
        batch.tip_accelerations()
    other, snapshot = begun(3, periods=1)[0], get_state(batch)
    other.tip_accelerations()
    set_state("batch", other, snapshot)
    for each in drive:
        assert np.array_equal(other.tip_accelerations(), batch.tip_accelerations())
        batch.step(each)
        other.step(each)


def test_asking_changes_nothing_of_the_motion():
    for method in METHODS:
        quiet, asked = begun(2, method)[0], begun(2, method, periods=0)[0]
        for each in drives(2, 3):
            asked.tip_accelerations()
            asked.step(each)
            asked.tip_accelerations()
        assert np.array_equal(asked.rows, quiet.rows) and np.array_equal(asked.outputs, quiet.outputs), method
