"""Simulator: scenes end where the reference says, conserved quantities are conserved, and failures are said."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings

import flexman_gym as fm
from flexman_gym.kernels import layout

from oracles.chains import QUICK, samples
from oracles.dense import Chain
from oracles.files import REFERENCE

pytestmark = pytest.mark.slow

SCENES = ("paper_rr", "paper_fr", "paper_ff", "gravity_payload_ff", "pendulum_1")
TOLERANCE = 1e-6  # m at the tip, rad at joints, of the largest energy; the references are within 3e-8 m
# The reference scenes hold the printed area of link 1 and that of `one_link`, which no section can have.
pytestmark = pytest.mark.filterwarnings("ignore:Link.second_moment_y:UserWarning")


@cache
def scene(name):
    """A reference scene."""
    return fm.Scene.load(REFERENCE / f"{name}.json")


@cache
def reference(name):
    """Rows of time, tip, joint angles, motor angles, energy of the independent model."""
    return np.loadtxt(REFERENCE / f"{name}.csv", delimiter=",", skiprows=1)


@cache
def solution(name):
    """The scene by the reference method, its own error far below TOLERANCE."""
    return fm.simulate(scene(name), method="dop853", rtol=1e-6, atol=1e-8)


def short(name="paper_ff", duration=0.1, **changes):
    """A scene cut short or changed."""
    return replace(scene(name), duration=duration, **changes)


def rigid():
    """A model with little to compute: the paper's arm without any flexibility."""
    return fm.build_model(fm.catalog.paper_rrr(), flexible_links=False, flexible_joints=False)


@pytest.mark.parametrize("name", SCENES)
def test_a_reference_scene_is_met(name):
    result, expected, n = solution(name), reference(name), scene(name).arm.n_joints
    assert result.status == "ok"
    assert result.time == pytest.approx(expected[:, 0], abs=1e-12)
    assert np.abs(result.tip - expected[:, 1:4]).max() < TOLERANCE
    assert np.abs(result.joint_angles - expected[:, 4 : 4 + n]).max() < TOLERANCE
    assert np.abs(result.motor_angles - expected[:, 4 + n : 4 + 2 * n]).max() < TOLERANCE
    assert np.abs(result.energy - expected[:, -1]).max() < TOLERANCE * np.abs(expected[:, -1]).max()


@pytest.mark.parametrize("name", SCENES)
def test_work_is_change_of_energy_and_dissipation(name):
    result = solution(name)
    assert np.abs(result.energy_residual).max() < TOLERANCE * np.abs(result.energy).max()
    assert (np.diff(result.dissipation) >= 0.0).all()
    if name != "gravity_payload_ff":
        assert (result.dissipation == 0.0).all()


def test_the_rigid_paper_arm_without_rotors_is_where_three_codes_put_it():
    """verification.md, t = 2 s, rotary inertia of the sections included."""
    arm = fm.catalog.paper_rrr(rotor_inertia=0.0, joint_stiffness=None)
    result = fm.simulate(replace(scene("paper_rr"), arm=arm), rtol=1e-9)
    assert result.tip[-1] == pytest.approx((1.041793, 2.982679, -0.804536), abs=2e-6)


def test_angular_momentum_about_the_first_axis_is_the_integral_of_its_torque():
    """400 t: links as mass points of the oracle, and the first rotor; the other rotors take none (Eq. 23)."""
    result, chain = solution("paper_ff"), Chain(scene("paper_ff").arm)
    d, rotor = chain.n_dof, chain.arm.joints[0].rotor_inertia
    momentum = []
    for x, v in zip(result.states[:, :d], result.states[:, d:], strict=True):
        momentum.append(chain.angular_momentum(x, v)[2] + rotor * v[chain.motor[0]])
    assert momentum == pytest.approx(400.0 * result.time, abs=1e-6 * 800.0)


def test_the_oracle_agrees_with_tip_and_energy_along_a_trajectory():
    result, chain = solution("gravity_payload_ff"), Chain(scene("gravity_payload_ff").arm)
    d = chain.n_dof
    for row in range(0, len(result.time), 25):
        x, v = result.states[row, :d], result.states[row, d:]
        assert result.tip[row] == pytest.approx(chain.tip(x), abs=1e-12)
        assert result.tip_velocity[row] == pytest.approx(chain.tip_velocity(x, v), abs=1e-11)
        assert result.energy[row] == pytest.approx(sum(chain.energy(x, v)), rel=1e-10)


def test_the_w_method_is_of_second_order_on_the_paper_scene():
    """At steps of 0.5, 0.25 and 0.125 ms, which are far longer than the periods of its stiffest modes, 4 kHz."""
    errors = []
    for step in (5e-4, 2.5e-4, 1.25e-4):
        tip = fm.simulate(short(duration=1.0), method="ros2", step=step).tip
        errors.append(np.linalg.norm(tip[-1] - reference("paper_ff")[100, 1:4]))
    assert errors[0] < 1e-3
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx(2.0, abs=0.15)


@pytest.mark.parametrize("step", [0.02, 0.01, 0.005])
@pytest.mark.parametrize("name", ["paper_ff", "gravity_payload_ff"])
def test_the_w_method_stays_finite_at_long_steps(name, step):
    duration = 2.0 if name == "paper_ff" else 1.4
    result = fm.simulate(short(name, duration), method="ros2", step=step)
    assert result.status == "ok" and np.isfinite(result.states).all()
    assert result.time[-1] == pytest.approx(duration)
    assert result.evaluations == 2 * round(duration / step)


def test_a_diverging_run_ends_at_once_and_holds_only_what_is_finite():
    """Modes up to 4.4 kHz need RK4 steps below 2.8 / (2 pi 4400 Hz) = 0.1 ms."""
    result = fm.simulate(scene("paper_ff"), method="rk4", step=2e-3)
    assert result.status == "diverged"
    assert result.evaluations < 1000 < 4 * scene("paper_ff").duration / 2e-3
    for name in ("tip", "tip_velocity", "joint_angles", "energy", "states", "work", "dissipation", "deflection"):
        values = getattr(result, name)
        assert len(values) == len(result.time) and np.isfinite(values).all()
    assert fm.simulate(short(duration=0.02), method="rk4", step=5e-5).status == "ok"


def test_a_failed_adaptive_run_has_a_status():
    """An acceleration that overflows is no motion of an arm, whatever the step."""
    result = fm.simulate(short("paper_rr", torque=fm.ConstantTorque((1e300, 0.0, 0.0))))
    assert result.status in ("diverged", "not converged")
    assert len(result.time) == 1 and np.isfinite(result.states).all()


@pytest.mark.parametrize(("method", "step"), [("ros2", 0.005), ("rk4", 5e-5), ("dopri5", None), ("dop853", None)])
def test_a_control_period_is_one_output_step_of_simulate_bit_for_bit(method, step):
    long = short(duration=0.04, output_step=0.02)
    expected = fm.simulate(long, method=method, step=step)
    model = fm.build_model(long.arm)
    simulator = fm.Simulator(model, method, step)
    for row in (1, 2):  # an adaptive method begins the second period with the step of the first
        assert simulator.step((400.0, 400.0, 400.0)) == "ok"
        assert simulator.time == expected.time[row]
        assert (simulator.state == expected.states[row]).all()
        assert (simulator.tip == expected.tip[row]).all()
        assert (simulator.tip_velocity == expected.tip_velocity[row]).all()
        assert (simulator.deflection == expected.deflection[row]).all()
        assert simulator.energy == expected.energy[row]
        assert simulator.energy_residual == pytest.approx(expected.energy_residual[row], abs=1e-12)


@pytest.mark.parametrize("method", ["ros2", "dop853"])
def test_a_reset_reproduces_every_bit(method):
    simulator = fm.Simulator(fm.build_model(fm.catalog.planar_2r(joint_stiffness=20.0), elements=1), method)
    torques = np.random.default_rng(1).uniform(-1.0, 1.0, (5, 2))

    def episode():
        simulator.reset((0.1, -0.2), (0.3, 0.0))
        for torque in torques:
            simulator.step(torque)
        return np.r_[simulator.state, simulator.tip, simulator.energy, simulator.energy_residual, simulator.time]

    assert (episode() == episode()).all()


def test_a_reset_takes_angles_and_rates_or_a_state():
    simulator = fm.Simulator(rigid())
    assert simulator.tip == pytest.approx((7.5, 0.0, 1.0)) and simulator.time == 0.0
    simulator.reset((0.1, 0.2, 0.3), (1.0, 2.0, 3.0))
    assert simulator.state.tolist() == [0.1, 0.2, 0.3, 1.0, 2.0, 3.0]
    tip, energy = simulator.tip.copy(), simulator.energy
    simulator.step((1.0, 1.0, 1.0))
    assert simulator.time == simulator.control_period and simulator.energy != energy
    simulator.reset(state=(0.1, 0.2, 0.3, 1.0, 2.0, 3.0))
    assert (simulator.tip == tip).all() and simulator.energy == energy and simulator.energy_residual == 0.0
    simulator.reset()
    assert (simulator.state == 0.0).all() and simulator.time == 0.0


def test_the_state_is_one_view_for_ever():
    simulator = fm.Simulator(rigid())
    state = simulator.state
    simulator.step((1.0, 0.0, 0.0))
    simulator.reset((0.5, 0.0, 0.0))
    assert state is simulator.state and state[0] == 0.5


@pytest.mark.parametrize("good_periods", [0, 1, 3])
@pytest.mark.parametrize("method", ["rk4", "ros2"])
def test_a_failed_step_keeps_the_last_good_period_until_a_reset(method, good_periods):
    model = fm.build_model(fm.catalog.one_link(rotor_inertia=1.0), flexible_links=False)
    simulator = fm.Simulator(model, method, step=0.005, control_period=0.02)
    for _ in range(good_periods):
        assert simulator.step([1.0]) == "ok"
    before = [np.array(each) for each in (simulator.state, simulator.tip, simulator.energy, simulator.time)]
    # A speed of 4e5 1/s after the first sub-step, 8e5 after the second, out of bounds (1e6) in the third.
    assert simulator.step([8e7 * fm.mass_matrix(model, [0.0, 0.0])[0, 0]]) == simulator.status == "diverged"
    after = [np.array(each) for each in (simulator.state, simulator.tip, simulator.energy, simulator.time)]
    for old, new in zip(before, after, strict=True):
        assert (old == new).all()
    with pytest.raises(RuntimeError, match="reset"):
        simulator.step([0.0])
    simulator.reset()
    assert simulator.step([0.0]) == "ok" and (simulator.state == 0.0).all()


def test_deflection_is_seen_from_the_motors():
    """Constant torque from rest, in the limit of small time: the motors run ahead, the tip stays behind."""
    simulator = fm.Simulator(fm.build_model(fm.catalog.paper_rrr()), step=0.001)
    simulator.step((0.0, 400.0, 0.0))
    turned = 400.0 / 1.0 * 0.02**2 / 2  # rotor of 1 kg m^2
    assert simulator.deflection[2] == pytest.approx(-7.5 * turned, rel=0.25)
    assert simulator.elastic_energy > 0.0


PRECISION = 1e-8  # of the energy that is there or that gravity gives
PERIODS, LONGEST = 50, 0.2  # of the fastest mode, which rules the steps of an explicit method; s
ROWS = 11


def moving(sample, **damping):
    """The chain bent and with gravity, so that energy has where to go; without any damping but what is given."""
    rng = np.random.default_rng(sample.seed)
    damping = {"stiffness_proportional_damping": 0.0, "modal_damping_ratio": 0.0} | damping
    arm = replace(sample.arm, gravity=rng.uniform(3.0, 10.0, 3), **damping)
    return replace(sample, arm=arm, amplitude=min(max(sample.amplitude, 0.05), 0.3))


def energies(sample, torque):
    """Kinetic, elastic and gravitational energy (ROWS, 3), J, from the sample's state on, under torques that stay.

    Then the work of the motors less the loss and the change of energy (ROWS,), J. The times cover some periods of the
    fastest mode, so that every chain takes about as many steps.
    """
    duration = min(LONGEST, PERIODS / max(fm.frequencies(sample.model).max(), 1.0))
    period = duration / (ROWS - 1)
    # Below this the rounding of accelerations, machine precision times the condition number, would rule the steps.
    simulator = fm.Simulator(sample.model, "dop853", None, period, rtol=1e-10, atol=1e-12)
    simulator.reset(state=np.concatenate(sample.state()))
    parts, residual = [], []
    for row in range(ROWS):
        assert row == 0 or simulator.step(torque) == "ok"
        out = simulator.outputs
        parts.append((out[layout.KINETIC], simulator.elastic_energy, out[layout.GRAVITATIONAL]))
        residual.append(simulator.energy_residual)
    return np.array(parts), np.array(residual)


@pytest.mark.slow
@settings(QUICK, max_examples=20)
@given(samples(stiffening=None))
def test_energy_is_kept_without_damping_and_torque(sample):
    sample = moving(sample)
    joints = [replace(joint, damping=0.0) for joint in sample.arm.joints]
    sample = replace(sample, arm=replace(sample.arm, joints=joints))
    parts, _ = energies(sample, np.zeros(sample.model.n_joints))
    size = parts[0, :2].sum() + np.ptp(parts[:, 2])
    assert np.ptp(parts, axis=0).max() > 1e-3 * size
    assert np.abs(parts.sum(axis=1) - parts[0].sum()).max() <= PRECISION * size


@pytest.mark.slow
@settings(QUICK, max_examples=20)
@given(samples(stiffening=None))
def test_work_is_what_energy_and_dampers_take(sample):
    sample = moving(sample, stiffness_proportional_damping=1e-6, modal_damping_ratio=sample.arm.modal_damping_ratio)
    parts, residual = energies(sample, sample.torque())
    size = parts[0, :2].sum() + np.ptp(parts[:, 2])
    assert np.abs(parts.sum(axis=1) - parts[0].sum()).max() > 1e-3 * size
    assert np.abs(residual).max() <= PRECISION * size
