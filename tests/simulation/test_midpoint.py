"""Sweeps: what they keep under vibration, exact balances of the midpoint rule, and that nothing outlives a step."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.kernels import layout
from flexman_gym.model.instant import stiffness_matrix
from flexman_gym.simulation.amplification import amplitude_kept, largest_growth, spectral_radius
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.methods import METHODS

SWEPT = ["midpoint_2_sweeps", "midpoint_3_sweeps"]
PAIRS = ["gauss_2_sweeps", "gauss_3_sweeps"]
PERIOD = 0.02  # s


@cache
def default_model():
    """The model of FlexRRR-v0."""
    return FlexManEnv().simulator.model


def released(model, count, size, seed=0):
    """States (count, 2 d) in random postures with the tips of all links `size` (m) off, bent by a force on the tip."""
    random, stiffness = np.random.default_rng(seed), stiffness_matrix(model)
    states = np.array([model.initial_state(random.uniform(-1.5, 1.5, model.n_joints)) for _ in range(count)])
    for link in range(model.n_joints):
        columns = model.elastic_columns(link)
        start, stop = model.constants.elastic_start[link : link + 2]
        across = model.constants.tip_translation[start:stop, 1:]
        yielding = np.linalg.solve(stiffness[columns, columns], across)
        angle = random.uniform(0.0, 2.0 * np.pi, count)
        tips = size * np.array([np.cos(angle), np.sin(angle)])
        states[:, columns] = (yielding @ np.linalg.solve(across.T @ yielding, tips)).T
    return states


def rung_down(model, method, step, states, seconds):
    """The Batch of these arms after some seconds without torque, and their energies at the start."""
    batch = Batch(model, method, step, PERIOD, rtol=1e-8, atol=1e-10, arms=len(states))
    batch.reset(np.arange(len(states)), states)
    before = batch.outputs[:, layout.KINETIC :].sum(axis=1)
    for _ in range(round(seconds / PERIOD)):
        batch.step(np.zeros((len(states), model.n_joints + 6)))
    assert (batch.status == layout.OK).all()
    return batch, before


def test_a_released_vibration_keeps_its_energy_and_its_tip():
    """3 s after 2.5 cm at the tip of every link; ros2 at 5 ms, which costs as much, misses both."""
    model, seconds = default_model(), 3.0
    states = released(model, 4, 0.025)
    truth, start = rung_down(model, "dop853", None, states, seconds)
    true = truth.outputs[:, layout.KINETIC :].sum(axis=1)

    def errors(method, step):
        """Largest errors of energy (a part) and tip (m)."""
        batch, _ = rung_down(model, method, step, states, seconds)
        energy = abs(batch.outputs[:, layout.KINETIC :].sum(axis=1) - true) / np.maximum(true, 0.02 * start)
        return energy.max(), np.linalg.norm(batch.outputs[:, layout.TIP] - truth.outputs[:, layout.TIP], axis=1).max()

    for method, step in (("midpoint_3_sweeps", PERIOD / 3), ("midpoint_2_sweeps", 0.005)):
        energy, tip = errors(method, step)
        assert energy < 0.1 and tip < 0.1
    energy, tip = errors("ros2", 0.005)
    assert energy > 0.2 and tip > 0.5


@pytest.mark.parametrize("method", SWEPT)
def test_a_linear_vibration_keeps_all_of_its_amplitude_however_stiff(method):
    for angle in (0.01, 1.0, 100.0, 1e6):
        assert spectral_radius(METHODS[method], angle) == pytest.approx(1.0, abs=1e-14)
    assert amplitude_kept(METHODS[method], 0.005, 20.0) == pytest.approx(1.0, abs=1e-10)


@pytest.mark.parametrize("method", ["implicit_midpoint", *SWEPT])
@pytest.mark.parametrize("held", [(), (0,)])
def test_the_energy_of_a_linear_arm_balances_to_rounding(method, held):
    """A rigid link on a spring and a damper: the rule keeps what is quadratic, with a held motor's work and friction.

    Coulomb friction is no linear force, therefore viscous friction alone.
    """
    arm = fm.catalog.one_link(rotor_inertia=0.3, joint_stiffness=50.0)
    arm = replace(arm, joints=[replace(arm.joints[0], damping=0.3, viscous_friction=0.2)])
    simulator = fm.Simulator(fm.build_model(arm, flexible_links=False), method, 0.01, PERIOD, prescribed=held)
    simulator.reset([0.1], [2.0])
    for period in range(50):
        push = np.sin(0.3 * period)
        assert simulator.step([0.0 if held else push], [push] if held else None) == "ok"
    assert abs(simulator.batch.rows[0, -2]) > 0.01, "the motor works"
    assert abs(simulator.energy_residual) < 1e-12 * simulator.energy_turnover + 1e-14


@pytest.mark.parametrize("method", PAIRS)
def test_two_stages_let_no_vibration_grow_by_more_than_a_ten_thousandth(method):
    growth, angle = largest_growth(METHODS[method])
    assert 1.0 < growth < 1.0001 and angle > 4.0
    assert spectral_radius(METHODS[method], 1e6) == pytest.approx(1.0, abs=1e-9)


def test_two_stages_follow_a_slew_ten_times_closer_at_the_cost_of_the_default():
    """Steps of 20 ms with three sweeps, seven evaluations; the default takes nine. Random torques, from rest."""
    model, random = default_model(), np.random.default_rng(1)
    torques = np.repeat(random.uniform(-300.0, 300.0, (4, 4, model.n_joints)), 10, axis=0)
    states = model.at_rest(random.uniform(-1.5, 1.5, (4, model.n_joints)))

    def tips(method, step):
        batch = Batch(model, method, step, PERIOD, rtol=1e-8, atol=1e-10, arms=4)
        batch.reset(np.arange(4), states)
        for torque in torques:
            batch.step(np.hstack([torque, np.zeros((4, 6))]))
        return batch.outputs[:, layout.TIP]

    truth = tips("dop853", None)
    ours, default = tips("gauss_3_sweeps", PERIOD), tips("midpoint_3_sweeps", PERIOD / 3)
    assert np.abs(ours - truth).max() < 0.1 * np.abs(default - truth).max() < 1e-3


@pytest.mark.parametrize("method", [*SWEPT, *PAIRS])
def test_an_arm_does_not_remember_an_episode(method):
    """One that is reset among arms that move on has the bits of one that never did anything else."""
    model, random = default_model(), np.random.default_rng(0)
    states = released(model, 9, 0.02)
    drives = random.uniform(-300.0, 300.0, (6, 9, model.n_joints + 6))
    batch = Batch(model, method, 0.005, PERIOD, arms=9)
    batch.reset(np.arange(9), states)
    for drive in drives[:3]:
        batch.step(drive)
    batch.reset(np.array([4]), states[[4]])
    fresh = Batch(model, method, 0.005, PERIOD)
    fresh.reset(np.array([0]), states[[4]])
    for drive in drives[3:]:
        batch.step(drive)
        fresh.step(drive[[4]])
        assert np.array_equal(batch.rows[4], fresh.rows[0]) and np.array_equal(batch.outputs[4], fresh.outputs[0])


@pytest.mark.parametrize("method", [*SWEPT, *PAIRS])
def test_control_periods_add_up_to_a_scene(method):
    scene = replace(fm.catalog.paper_scene("ff"), torque=fm.ConstantTorque([5.0, -3.0, 2.0]), duration=0.2)
    scene = replace(scene, output_step=0.1)
    model = fm.build_model(scene.arm, 2, 3)
    run = fm.simulate(scene, model, method, 0.005)
    simulator = fm.Simulator(model, method, 0.005, PERIOD)
    simulator.reset(scene.initial.joint_angles, scene.initial.joint_rates)
    for _ in range(10):
        assert simulator.step([5.0, -3.0, 2.0]) == "ok"
    assert run.status == "ok" and np.array_equal(run.states[-1], simulator.state)
    assert run.evaluations == 40 * METHODS[method].evaluations


@pytest.mark.parametrize("method", ["implicit_midpoint", "midpoint_2_sweeps", "midpoint_3_sweeps"])
def test_the_ledger_of_a_held_motor_on_a_spring_is_exact_whatever_the_step(method):
    """One rigid link on a damped spring is linear: the rule keeps its quadratic energy, so that work balances it."""
    arm = fm.catalog.one_link(rotor_inertia=1.0, joint_stiffness=50.0)
    arm = replace(arm, joints=[replace(arm.joints[0], damping=0.5)])
    choice = fm.ModelChoice(False, 1)
    scene = fm.Scene(
        arm, choice, fm.ConstantTorque([0.0]), fm.Initial([0.0], [0.3]), 2.0, 0.1,
        prescribed=[fm.Signal(1.0, 5.0, 0.7, 0.2)],
    )  # fmt: skip
    result = fm.simulate(scene, method=method, step=0.1)
    assert np.abs(result.states[:, 1] - result.states[:, 0]).max() > 1e-3, "the spring is wound"
    assert np.abs(result.energy_residual).max() < 1e-9 * result.energy_turnover[-1]
