"""A base with prescribed rotation: closed forms, the independent Lagrangian, energy, derivatives and files."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import flexman_gym as fm
from flexman_gym.kernels import layout
from flexman_gym.kernels.outputs import compute_outputs
from flexman_gym.kernels.outputs import tip_accelerations as kernel_accelerations
from flexman_gym.simulation.foundation import FoundationRotation, base_rotation, rotation_matrix
from flexman_gym.simulation.scene_simulation import tip_accelerations

from oracles.assertions import refusal
from oracles.chains import Affected, samples
from oracles.dense import Base, Chain, LinkModel

X, Y, Z = np.eye(3).tolist()
HANGING = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
QUIET, STILL = fm.Signal(), [fm.Signal()] * 3
SEA = [fm.Signal(0.05, 0.9, 0.7), fm.Signal(-0.02, 0.6, 0.5, 0.2), fm.Signal(0.1, 0.4, 1.1, 1.0)]
TILT, TURN = Rotation.from_rotvec([0.3, -0.2, 0.5]), np.array([0.3, -0.4, 0.6])  # at the start


def quaternion(rotation):
    """Return a rotation as a unit quaternion, scalar first."""
    return tuple(np.roll(rotation.as_quat(), 1))


def rate_of(signals, start, time):
    """Return the angular velocity (3,) at a time from that at the start, by the integrals of sines."""
    turns = [2.0 * np.pi * each.frequency_hz for each in signals]
    return start + np.array([
        each.offset * time + each.amplitude * (np.cos(each.phase) - np.cos(turn * time + each.phase)) / turn
        for each, turn in zip(signals, turns, strict=True)
    ])  # fmt: skip


def value_of(signals, time):
    return np.array([s.offset + s.amplitude * np.sin(2.0 * np.pi * s.frequency_hz * time + s.phase) for s in signals])


def base_at(quat, time):
    """Return the `Base` of the oracle for a quaternion (4,), scalar first, that has been integrated to a time."""
    attitude = Rotation.from_quat(np.roll(quat, -1)).as_matrix()
    return Base(attitude, attitude @ rate_of(SEA, TURN, time), attitude @ value_of(SEA, time))


def quaternion_rate(quat, rate):
    """Return p (0, w) / 2 for a quaternion p (4,), scalar first, and an angular velocity w (3,) in the body frame."""
    return 0.5 * np.r_[-quat[1:] @ rate, quat[0] * rate + np.cross(quat[1:], rate)]


def moving(scene, **changes):
    """Return the scene on a base that rolls, pitches and yaws from a tilt."""
    motion = {"base_angular_acceleration": SEA, "base_attitude": quaternion(TILT),
              "base_angular_velocity": tuple(TURN)}  # fmt: skip
    return replace(scene, **motion | changes)


@pytest.fixture(scope="module")
def boom():
    """A load that hangs on two passive joints from a flexible boom with an elastic drive, and its oracle."""
    beam = fm.Link.rod(2.0, 0.05)
    hook, rope = fm.Link.rod(0.05, 0.02), fm.Link.rod(1.0, 0.008, "steel", orientation=HANGING)
    drive = fm.Joint((0.0, -1.0, 0.0), rotor_inertia=3.0, stiffness=8000.0, damping=20.0, torque_limit=1e3)
    joints = [drive, *(fm.Joint(axis, passive=True, viscous_friction=0.3) for axis in (Y, X))]
    arm = fm.Arm([beam, hook, rope], joints, fm.Payload(8.0), gravity=(0.0, 0.0, -9.81),
                 stiffness_proportional_damping=1e-4)  # fmt: skip
    flexible = (True, False, False)
    model = fm.build_model(arm, 2, 2, flexible_links=flexible)
    chain = Chain(arm, 2, flexible, True, [LinkModel(model.bases[0]), LinkModel(), LinkModel()])
    scene = fm.Scene(arm, fm.ModelChoice(flexible, 2), fm.ConstantTorque((230.0, 0.0, 0.0)),
                     fm.Initial((0.4, 0.6, -0.1), (0.0,) * 3), duration=2.0, output_step=0.25,
                     tip_force=[fm.Signal(4.0), fm.Signal(-3.0), fm.Signal(2.0)],
                     base_acceleration=[fm.Signal(0.0, 1.5, 0.6), QUIET, fm.Signal(0.2)])  # fmt: skip
    return moving(scene), model, chain


@pytest.fixture(scope="module")
def exact(boom):
    """States (T, 2 d) and quaternions (T, 4) of the oracle."""
    scene, model, chain = boom
    d, torque, force = model.n_dof, np.array([230.0, 0.0, 0.0]), np.array([4.0, -3.0, 2.0])

    def rates(time, state):
        x, v, quat = state[:d], state[d : 2 * d], state[2 * d :]
        shake = np.array([1.5 * np.sin(1.2 * np.pi * time), 0.0, 0.2])
        acceleration = chain.acceleration(x, v, torque, force, shake, base_at(quat, time))
        return np.concatenate([v, acceleration, quaternion_rate(quat, rate_of(SEA, TURN, time))])

    start = np.r_[model.initial_state(np.array([0.4, 0.6, -0.1])), quaternion(TILT)]
    found = solve_ivp(rates, (0.0, 2.0), start, "DOP853", scene.output_times, rtol=1e-10, atol=1e-12).y.T
    return found[:, : 2 * d], found[:, 2 * d :]


@pytest.mark.slow
@pytest.mark.parametrize("method", ["dop853", "radau"])
def test_a_hanging_load_on_a_rotating_base_moves_as_in_the_independent_lagrangian(boom, exact, method):
    scene, model, chain = boom
    run = fm.simulate(scene, model, method=method, rtol=1e-10, atol=1e-12)
    d = model.n_dof
    tips = np.array([chain.tip(state[:d]) for state in exact[0]])  # in the base frame
    np.testing.assert_allclose(run.tip, tips, atol=1e-8)
    assert np.ptp(run.tip, axis=0).max() > 0.5
    attitudes, rates = base_rotation(scene).at(scene.output_times)
    np.testing.assert_allclose(attitudes, exact[1], atol=1e-10)
    np.testing.assert_allclose(rates, [rate_of(SEA, TURN, time) for time in scene.output_times], atol=1e-12)


@pytest.mark.slow
def test_outputs_on_a_rotating_base_are_those_of_the_independent_lagrangian(boom, exact):
    """Energies are relative to axes of the world at the base origin; tip motion is relative to the base."""
    scene, model, chain = boom
    d = model.n_dof
    run = fm.simulate(scene, model, method="dop853", rtol=1e-10, atol=1e-12)
    for i, (state, quat) in enumerate(zip(*exact, strict=True)):
        time, x, v = scene.output_times[i], state[:d], state[d:]
        base = base_at(quat, time)
        assert run.energy[i] == pytest.approx(sum(chain.energy(x, v, base)), abs=1e-6)
        np.testing.assert_allclose(run.tip_velocity[i], chain.tip_velocity(x, v), atol=1e-7)
        parts = run.energies()
        assert sum(part[i].sum() for part in parts.values()) == pytest.approx(run.energy[i], abs=1e-7)


@pytest.mark.slow
def test_accelerometer_on_a_rotating_base_measures_the_force_of_the_independent_lagrangian(boom):
    scene, model, chain = boom
    shake, d = (0.7, -0.3, 0.2), model.n_dof
    scene = replace(scene, base_acceleration=[fm.Signal(each) for each in shake])
    run = fm.simulate(scene, model, step=0.005)
    measured = tip_accelerations(scene, [run], model, {})[0]
    for i, time in enumerate(scene.output_times.tolist()):
        (x, v), quat = np.split(run.states[i], [d]), base_rotation(scene).at(np.array([time]))[0][0]
        base = base_at(quat, time)
        applied = np.array([230.0, 0.0, 0.0]), np.array([4.0, -3.0, 2.0]), np.array(shake), base
        acceleration = chain.acceleration(x, v, *applied)
        np.testing.assert_allclose(measured[i, :3], chain.tip_acceleration(x, v, acceleration), atol=1e-7)
        absolute = chain.tip_acceleration(x, v, acceleration, base) - chain.gravity
        specific = base.attitude.T @ absolute + shake
        np.testing.assert_allclose(measured[i, 3:], chain.tip_axes(x).T @ specific, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("method, step, tolerance", [
    ("dop853", None, 1e-10), ("radau", None, 1e-6), ("rk4", 1e-4, 1e-8), ("midpoint_corrected_3", 5e-4, 2e-5),
    ("gauss_3", 5e-4, 1e-8), ("generalised_alpha", 5e-4, 1e-4), ("ros2", 5e-4, 1e-3),
    ("extrapolated_euler_4", 1e-3, 1e-5),
])  # fmt: skip
def test_the_ledger_of_every_family_counts_the_power_of_the_foundation(boom, method, step, tolerance):
    scene, model, _ = boom
    run = fm.simulate(scene, model, method=method, step=step, rtol=1e-11, atol=1e-13)
    assert run.status == "ok"
    assert np.abs(run.energy_residual).max() < tolerance * run.energy_turnover[-1]
    plain = replace(scene, base_angular_acceleration=None, base_attitude=None, base_angular_velocity=None)
    assert np.abs(run.work - fm.simulate(plain, model, step=1e-3).work).max() > 0.1 * run.energy_turnover[-1]


@pytest.mark.slow
@settings(deadline=None, max_examples=25, derandomize=True)
@given(samples())
def test_outputs_and_loads_of_random_chains_on_a_rotating_base(sample):
    case = Affected(sample, True, (), True)
    (x, v), work = sample.state(), layout.make_work(case.constants)
    work.drive[:] = case.drive()
    row, felt = np.zeros(layout.OUTPUTS), np.zeros(layout.TIP_ACCELERATIONS)
    compute_outputs(case.constants, work, x, v, row)
    kinetic, _, gravitational = case.chain.energy(x, v, case.base)
    assert row[layout.KINETIC] == pytest.approx(kinetic, rel=1e-9)
    assert row[layout.GRAVITATIONAL] == pytest.approx(gravitational, rel=1e-9, abs=1e-9)
    size = 1.0 + np.abs(row[layout.TIP_VELOCITY]).max()
    np.testing.assert_allclose(row[layout.TIP_VELOCITY], case.chain.tip_velocity(x, v), atol=1e-9 * size)
    kernel_accelerations(case.constants, work, x, v, case.drive(), felt)
    acceleration, _ = case.expected(x, v)
    relative = case.chain.tip_acceleration(x, v, acceleration)
    np.testing.assert_allclose(felt[:3], relative, atol=1e-7 * (1.0 + np.abs(acceleration).max()))


def turntable(rate, stiffness=200.0):
    """Return the scene of a point mass on a massless rod with a spring, at 0.3 m from the axis of a turntable."""
    thin = np.eye(3) * 1e-12
    arm = fm.Arm(
        [fm.Link.rigid(0.3, 1e-9, (0.0, 0.0, 0.0), thin), fm.Link.rigid(0.5, 2.0, (0.5, 0.0, 0.0), thin)],
        [fm.Joint(Z, rotor_inertia=1.0, torque_limit=1.0), fm.Joint(Z, passive=True, stiffness=stiffness)],
    )  # fmt: skip
    return fm.Scene(arm, fm.ModelChoice(False, 1, rotary_inertia=False), fm.ConstantTorque((0.0, 0.0)),
                    fm.Initial((0.0, 1e-4), (0.0, 0.0)), duration=2.0, output_step=0.01, prescribed=(QUIET, None),
                    base_angular_velocity=(0.0, 0.0, rate))  # fmt: skip


@pytest.mark.parametrize("rate", [0.0, 3.0, 12.0])
def test_a_pendulum_on_a_turntable_is_stiffened_by_the_centrifugal_force(rate):
    """w^2 = k / (m L^2) + rate^2 R / L for a hinge at the radius R: the lead-lag motion of a rotor blade."""
    run = fm.simulate(turntable(rate), method="dop853", rtol=1e-11, atol=1e-14)
    frequency = np.sqrt(200.0 / (2.0 * 0.25) + rate**2 * 0.3 / 0.5)
    np.testing.assert_allclose(run.joint_angles[:, 1], 1e-4 * np.cos(frequency * run.time), atol=1e-10)


def test_a_tilted_base_is_an_arm_under_turned_gravity():
    scene = fm.catalog.paper_scene("ff")
    scene = replace(scene, arm=replace(scene.arm, gravity=(0.0, 0.0, -9.81)), duration=0.3)
    tilted = fm.simulate(replace(scene, base_attitude=quaternion(TILT)), step=0.005)
    turned = replace(scene.arm, gravity=tuple(TILT.as_matrix().T @ [0.0, 0.0, -9.81]))
    np.testing.assert_allclose(tilted.states, fm.simulate(replace(scene, arm=turned), step=0.005).states, atol=1e-10)


def test_a_base_that_turns_as_the_first_joint_equals_this_joint():
    """A base that turns about the vertical, and a motor with the same prescribed motion: equal motion of the rest."""
    arm = fm.catalog.paper_rrr()
    arm = replace(arm, gravity=(0.0, 0.0, -9.81))
    start, spin = fm.Initial((0.2, 0.3, -0.5), (0.0, 0.0, 0.0)), fm.Signal(0.4, 2.0, 0.8)
    choice = fm.ModelChoice((False, True, True), 1, flexible_joints=False)
    common = {"duration": 1.0, "output_step": 0.1}
    torque = fm.ConstantTorque((0.0, 100.0, 50.0))
    joint = fm.Scene(arm, choice, torque, start, prescribed=(spin, None, None), **common)
    base = fm.Scene(arm, choice, torque, start, prescribed=(QUIET, None, None),
                    base_angular_acceleration=(QUIET, QUIET, spin), **common)  # fmt: skip
    one, other = (fm.simulate(each, method="dop853", rtol=1e-10, atol=1e-12) for each in (joint, base))
    np.testing.assert_allclose(one.joint_angles[:, 1:], other.joint_angles[:, 1:], atol=1e-9)
    attitudes, rates = base_rotation(base).at(base.output_times)
    rotor = arm.joints[0].rotor_inertia * rates[:, 2] ** 2 / 2.0  # energy of the rotor, which rests on the base
    np.testing.assert_allclose(one.work, other.work + rotor, atol=1e-6)
    world = np.einsum("tij,tj->ti", rotation_matrix(attitudes), other.tip)
    np.testing.assert_allclose(one.tip, world, atol=1e-9)


def test_a_constant_angular_velocity_turns_the_attitude_uniformly():
    rate = np.array([1.0, -2.0, 7.0])
    rotation = FoundationRotation(STILL, quaternion(TILT), rate, (0.0, 0.0, -9.81), 5.0, 0.1)
    times = np.linspace(0.0, 5.0, 23)
    expected = (TILT * Rotation.from_rotvec(np.outer(times, rate))).as_matrix()
    np.testing.assert_allclose(rotation_matrix(rotation.at(times)[0]), expected, atol=1e-11)
    gravity = np.einsum("tji,j->ti", expected, [0.0, 0.0, -9.81])
    np.testing.assert_allclose(rotation.motion(times)[:, :3], gravity, atol=1e-9)


def test_sampled_and_stepwise_angular_accelerations_are_integrated_between_their_jumps():
    times = np.array([0.0, 0.13, 0.5, 1.0])
    ramp = fm.SampledSignal(times, [0.0, 1.0, -2.0, 0.5], hold="linear")
    step = fm.Signal(3.0, start=0.21, stop=0.4)
    rotation = FoundationRotation(
        [QUIET, ramp, step], (1.0, 0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.0, -9.81), 1.0, 0.05
    )
    assert {0.13, 0.21, 0.4, 0.5} <= {round(each, 12) for each in rotation.times}
    at = np.linspace(0.0, 1.0, 8)

    def rates(time, quat):
        area = np.interp(time, times, [0.0, 1.0, -2.0, 0.5])
        past = times[times < time]
        values = np.interp(past, times, [0.0, 1.0, -2.0, 0.5])
        ramp_rate = np.trapezoid(np.r_[values, area], np.r_[past, time])
        return quaternion_rate(quat, np.array([0.1, ramp_rate, 3.0 * np.clip(time - 0.21, 0.0, 0.19)]))

    exact = solve_ivp(rates, (0.0, 1.0), (1.0, 0.0, 0.0, 0.0), "DOP853", at, rtol=1e-11, atol=1e-13, max_step=0.01).y.T
    np.testing.assert_allclose(rotation.at(at)[0], exact, atol=1e-8)


@pytest.mark.slow
def test_scenes_on_rotating_bases_together_equal_each_alone(boom):
    scene, model, _ = boom
    scenes = [scene, replace(scene, torque=fm.ConstantTorque((200.0, 0.0, 0.0)))]
    both = fm.simulate_all(scenes, model, step=0.005)
    for together, each in zip(both, scenes, strict=True):
        assert np.array_equal(together.states, fm.simulate(each, model, step=0.005).states)
    fixed = replace(scene, base_angular_acceleration=None, base_attitude=None, base_angular_velocity=None)
    assert "scenes[1].rotates" in refusal(lambda: fm.simulate_all([scene, fixed], model, step=0.005))


@pytest.mark.feature
@pytest.mark.slow
def test_derivatives_on_a_rotating_base_are_those_of_differences(boom):
    scene, model, _ = boom
    scene = replace(scene, duration=0.5, output_step=0.125)
    names = "motor_torques", "base_acceleration[0]"
    found = fm.sensitivities(scene, model=model, to=names, step=0.0025)
    change = 1e-3
    for column, changed in enumerate([
        replace(scene, torque=fm.ConstantTorque((230.0 + change, 0.0, 0.0))),
        replace(scene, base_acceleration=[fm.Signal(change, 1.5, 0.6), QUIET, fm.Signal(0.2)]),
    ]):  # fmt: skip
        ahead, at = (fm.simulate(each, model, step=0.0025).tip for each in (changed, scene))
        np.testing.assert_allclose(found.jacobian[:, :3, column], (ahead - at) / change, atol=2e-5)


def test_files_keep_the_motion_of_the_base(tmp_path, boom):
    scene = boom[0]
    scene.save(tmp_path / "scene.yaml")
    assert fm.Scene.load(tmp_path / "scene.yaml") == scene


@pytest.mark.parametrize("field, value", [
    ("base_attitude", (1.0, 1.0, 0.0, 0.0)), ("base_attitude", (1.0, 0.0, 0.0)), ("base_angular_velocity", (1.0, 0.0)),
    ("base_angular_acceleration", [QUIET]), ("base_angular_acceleration", [1.0, 2.0, 3.0]),
])  # fmt: skip
def test_motions_of_the_base_that_are_not_allowed_are_refused(boom, field, value):
    assert f"Scene.{field}" in refusal(lambda: replace(boom[0], **{field: value}))
