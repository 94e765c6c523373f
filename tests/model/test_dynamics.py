"""Dynamics against the dense equations of the paper, closed forms and another library."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.spatial.transform import Rotation

import flexman_gym as fm
from flexman_gym.kernels import inverse, layout

from oracles.chains import QUICK, Sample, observed, pinocchio_model, samples, slender_link
from oracles.ritz import beam_eigenvalues

PRECISION = 1e-9  # relative


def close(actual, expected, precision=PRECISION):
    """Return whether two arrays agree relative to the largest entry."""
    return np.abs(actual - expected).max(initial=0.0) <= precision * np.abs(expected).max(initial=0.0)


def slope(function, x, v):
    """Rate of change of a function of the coordinates at the speeds v: central differences, Richardson's order h^4."""
    h = 1e-3 / np.abs(v).max()

    def difference(step):
        return (function(x + step * v) - function(x - step * v)) / (2 * step)

    return (4 * difference(h) - difference(2 * h)) / 3


# Identities on random chains


@pytest.mark.slow
@settings(QUICK, max_examples=60)
@given(samples(stiffening=None))
def test_the_recursion_equals_the_dense_equations(sample):
    (x, v), torque = sample.state(), sample.torque()
    actual, expected = fm.acceleration(sample.model, np.r_[x, v], torque), sample.chain.acceleration(x, v, torque)
    mass = sample.chain.mass_matrix(x)
    scale = np.sqrt(np.diag(mass))  # so that metres and radians of fine elements weigh alike
    largest = np.abs(scale * expected).max()
    # The forces that the difference would take. The difference itself has the condition number of M on top.
    assert np.abs(mass @ (actual - expected) / scale).max() <= 1e-12 * largest
    rounding = np.finfo(float).eps * np.linalg.cond(mass / np.outer(scale, scale))
    assert np.abs(scale * (actual - expected)).max() <= max(PRECISION, rounding) * largest


@pytest.mark.slow
@settings(QUICK)
@given(samples(stiffening=None))
def test_the_mass_matrix_is_the_dense_one_and_positive_definite(sample):
    x, v = sample.state()
    mass = fm.mass_matrix(sample.model, np.r_[x, v])
    scale = np.sqrt(np.diag(mass))
    expected = sample.chain.mass_matrix(x)
    assert close(mass / np.outer(scale, scale), expected / np.outer(scale, scale))
    assert (mass == mass.T).all()
    assert np.linalg.eigvalsh(mass / np.outer(scale, scale)).min() > 0.0


@pytest.mark.slow
@settings(QUICK)
@given(samples(stiffening=None))
def test_forward_and_inverse_dynamics_undo_each_other(sample):
    (x, v), torque, constants = sample.state(), sample.torque(), sample.model.constants
    acceleration = fm.acceleration(sample.model, np.r_[x, v], torque)
    demanded = np.zeros(sample.model.n_dof)
    inverse.inertial_forces(constants, layout.make_work(constants), x, v, acceleration, demanded)
    given_forces = sample.applied(x, v, torque)
    scale = np.sqrt(np.diag(fm.mass_matrix(sample.model, np.r_[x, v])))
    inertial = np.abs(scale * acceleration).max()
    assert np.abs((demanded - given_forces) / scale).max() <= PRECISION * inertial


@pytest.mark.slow
@settings(QUICK)
@given(samples(stiffening=None))
def test_tip_and_energies_are_the_dense_ones(sample):
    x, v = sample.state()
    out = observed(sample.model, x, v)
    assert close(out[layout.TIP], sample.chain.tip(x))
    assert close(out[layout.TIP_VELOCITY], sample.chain.tip_velocity(x, v))
    kinetic, elastic, gravitational = sample.chain.energy(x, v)
    assert out[layout.KINETIC] == pytest.approx(kinetic, rel=PRECISION)
    assert out[layout.LINK_ENERGY] + out[layout.JOINT_ENERGY] == pytest.approx(elastic, rel=PRECISION)
    masses, positions, _ = sample.chain.points(x, v)
    size = masses @ np.abs(positions @ sample.arm.gravity)  # heights above and below the base cancel
    assert out[layout.GRAVITATIONAL] == pytest.approx(gravitational, rel=0.0, abs=PRECISION * size)


@pytest.mark.slow
@settings(QUICK)
@given(samples(stiffening=None))
def test_half_v_m_v_is_the_kinetic_energy(sample):
    x, v = sample.state()
    mass = fm.mass_matrix(sample.model, np.r_[x, v])
    assert v @ mass @ v / 2 == pytest.approx(observed(sample.model, x, v)[layout.KINETIC], rel=PRECISION)


@pytest.mark.slow
@settings(QUICK)
@given(samples(stiffening=None))
def test_tip_velocity_is_the_derivative_of_tip_position(sample):
    x, v = sample.state()
    slopes = slope(lambda position: observed(sample.model, position, v), x, v)
    out = observed(sample.model, x, v)
    reach = sum(link.length for link in sample.arm.links)
    speed = np.abs(out[layout.TIP_VELOCITY]).max() + reach * np.abs(v[: sample.model.n_joints]).max()
    assert np.abs(slopes[layout.TIP] - out[layout.TIP_VELOCITY]).max() < 1e-8 * speed
    assert np.abs(slopes[layout.DEFLECTION] - out[layout.DEFLECTION_RATE]).max() < 1e-8 * speed


@pytest.mark.slow
@settings(QUICK)
@given(samples(stiffening=None))
def test_forces_of_constant_speeds_have_the_power_that_energy_takes(sample):
    """v . h is the rate of kinetic and gravitational energy without acceleration: h neither makes nor loses energy."""
    (x, v), constants = sample.state(), sample.model.constants
    h = np.zeros(sample.model.n_dof)
    inverse.inertial_forces(constants, layout.make_work(constants), x, v, np.zeros(len(x)), h)
    rates = slope(lambda position: observed(sample.model, position, v), x, v)
    power = rates[layout.KINETIC] + rates[layout.GRAVITATIONAL]
    out = observed(sample.model, x, v)
    masses, positions, _ = sample.chain.points(x, v)
    size = out[layout.KINETIC] + masses @ np.abs(positions @ sample.arm.gravity)
    assert v @ h == pytest.approx(power, rel=0.0, abs=1e-7 * size * np.abs(v).max())


@pytest.mark.slow
@settings(QUICK)
@given(samples(flexible_joints=True))
def test_a_rigid_joint_is_a_spring_that_does_not_move(sample):
    """With motor angle = joint angle by a constraint torque, the model equals that without motor coordinates."""
    rigid = replace(sample, flexible_joints=False)
    n, d = sample.model.n_joints, rigid.model.n_dof
    joined = np.zeros((sample.model.n_dof, d))  # x = joined @ x of the model of rigid joints
    joined[:n, :n] = joined[n : 2 * n, :n] = np.eye(n)
    joined[2 * n :, n:] = np.eye(d - n)
    x, v = rigid.state()
    full = np.r_[joined @ x, joined @ v]
    mass = fm.mass_matrix(sample.model, full)
    expected = fm.mass_matrix(rigid.model, np.r_[x, v])
    scale = np.sqrt(np.diag(expected))
    assert close((joined.T @ mass @ joined) / np.outer(scale, scale), expected / np.outer(scale, scale))
    torque = sample.torque()
    forces = joined.T @ mass @ fm.acceleration(sample.model, full, torque)
    acceleration = fm.acceleration(rigid.model, np.r_[x, v], torque)
    assert np.abs((expected @ acceleration - forces) / scale).max() <= PRECISION * np.abs(scale * acceleration).max()


@pytest.mark.slow
@settings(QUICK)
@given(samples(reduced=False, stiffening=None))  # the sign of a mode may turn
def test_turning_the_whole_scene_changes_nothing(sample):
    turn = Rotation.random(random_state=sample.seed).as_matrix()
    arm, payload = sample.arm, sample.arm.payload
    if payload is not None and payload.offset is not None:
        payload = replace(payload, offset=turn @ payload.offset)
    if payload is not None and payload.inertia is not None:
        moments = turn @ payload.inertia @ turn.T
        payload = replace(payload, inertia=(moments + moments.T) / 2)
    turned = replace(
        arm,
        links=[replace(link, orientation=turn @ link.orientation) for link in arm.links],
        joints=[replace(joint, axis=turn @ joint.axis) for joint in arm.joints],
        payload=payload,
        gravity=turn @ arm.gravity,
    )
    (x, v), torque, model = sample.state(), sample.torque(), replace(sample, arm=turned).model
    scale = np.sqrt(np.diag(sample.chain.mass_matrix(x)))
    before, after = (fm.acceleration(each, np.r_[x, v], torque) for each in (sample.model, model))
    assert close(scale * after, scale * before)
    assert close(observed(model, x, v)[layout.TIP], turn @ observed(sample.model, x, v)[layout.TIP])


@pytest.mark.slow
@settings(QUICK)
@given(samples(flexible_links=False, flexible_joints=False))
def test_a_rigid_arm_has_no_deflection(sample):
    out = observed(sample.model, *sample.state())
    assert close(out[layout.DEFLECTION] + out[layout.TIP], out[layout.TIP])
    assert close(out[layout.DEFLECTION_RATE] + out[layout.TIP_VELOCITY], out[layout.TIP_VELOCITY])


@pytest.mark.slow
@settings(QUICK)
@given(samples(flexible_links=False, flexible_joints=False))
def test_the_rigid_limit_is_pinocchio(sample):
    pin = pytest.importorskip("pinocchio")
    model = pinocchio_model(pin, sample.arm)
    (x, v), torque = sample.state(), sample.torque()
    expected = pin.aba(model, model.createData(), x, v, torque)
    assert close(fm.acceleration(sample.model, np.r_[x, v], torque), expected)


def test_a_sample_is_what_it_says():
    """Check of the helper: the tip of a bent link turns by the amplitude."""
    sample = Sample(fm.catalog.one_link(), (2,), None, (True,), False, 0.05, 1)
    x, _ = sample.state()
    beam = sample.chain.beams[0]
    bend = np.linalg.norm(beam.S_r @ x[1:]), np.linalg.norm(beam.S_t @ x[1:]) / 2.0
    assert max(bend) == pytest.approx(0.05)


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.0, 0.1, 1.0])
def test_a_beam_on_a_free_hub_has_its_frequencies(ratio):
    link = slender_link(1.0, 1.0, 1.0)
    hub = fm.Joint((0.0, 0.0, 1.0), rotor_inertia=ratio)
    result = 2 * np.pi * fm.frequencies(fm.build_model(fm.Arm([link], [hub]), elements=32))
    assert result[0] == 0.0
    expected = beam_eigenvalues(3, hub_inertia_ratio=ratio)
    assert result[1:4] == pytest.approx(expected, rel=2e-5)  # (b h)^4 / 1440: 7e-6 at the third


@pytest.mark.slow
@pytest.mark.parametrize(
    ("tip", "clamped", "expected"),
    [  # Hz, verification.md: closed form of this arm
        (0.0, False, (0.521729, 2.741455, 7.643182, 14.97638)),
        (0.0, True, (0.434903, 2.726788, 7.638233)),
        (2.0, False, (0.340285, 2.065477, 6.349101)),
        (2.0, True, (0.220297, 2.046225, 6.343135)),
    ],
)
def test_a_flexible_link_on_an_elastic_joint_has_its_frequencies(tip, clamped, expected):
    joint = fm.Joint((0.0, 0.0, 1.0), rotor_inertia=1.0, stiffness=100.0)
    model = fm.build_model(fm.Arm([slender_link()], [joint], fm.Payload(tip)), elements=32)
    result = fm.frequencies(model, lock_joints=clamped)
    assert result[0 if clamped else 1 :][: len(expected)] == pytest.approx(expected, rel=2e-5)


@pytest.mark.slow
@settings(QUICK)
@given(samples(most_links=1, flexible_links=False, flexible_joints=True))
def test_two_masses_and_a_spring_have_their_frequency(sample):
    """Spong, Modeling and control of elastic joint robots, 1987."""
    joint, model = sample.arm.joints[0], sample.model
    link = fm.mass_matrix(model, np.zeros(4))[0, 0]
    free = np.sqrt(joint.stiffness * (1 / joint.rotor_inertia + 1 / link)) / (2 * np.pi)
    assert fm.frequencies(model) == pytest.approx([0.0, free])
    locked = np.sqrt(joint.stiffness / link) / (2 * np.pi)
    assert fm.frequencies(model, lock_joints=True) == pytest.approx([locked])
    rigid = fm.build_model(sample.arm, flexible_links=False, flexible_joints=False)
    assert fm.mass_matrix(rigid, np.zeros(2))[0, 0] == pytest.approx(link + joint.rotor_inertia)


def test_stiff_joints_approach_rigid_ones_as_one_over_stiffness():
    angles = (0.0, 0.3, -0.5)
    rigid = fm.frequencies(fm.build_model(fm.catalog.paper_rrr(joint_stiffness=None)), angles)[3:8]
    gap = []
    for stiffness in (1e8, 1e9):
        result = fm.frequencies(fm.build_model(fm.catalog.paper_rrr(joint_stiffness=stiffness)), angles)[3:8]
        gap.append(np.abs(result / rigid - 1).max())
    assert gap[0] < 1e-2
    assert gap[0] / gap[1] == pytest.approx(10.0, rel=0.1)


def test_the_paper_arm_has_its_first_elastic_frequencies():
    """4.5 and 9.5 Hz (verification.md) for motors that are free and weigh nothing, so that their springs do nothing."""
    result = fm.frequencies(fm.build_model(fm.catalog.paper_rrr(rotor_inertia=0.0, joint_stiffness=None)))
    assert (result[:3] == 0.0).all()
    assert np.round(result[3:5], 1).tolist() == [4.5, 9.5]


@pytest.mark.slow
@settings(QUICK, max_examples=15)
@given(samples(most_links=3))
def test_frequencies_are_those_of_the_dense_mass_matrix_and_stiffness(sample):
    """The eigenvalues of differences of the accelerations about rest are minus the squares of the frequencies."""
    sample = replace(sample, arm=replace(sample.arm, gravity=(0.0, 0.0, 0.0)))
    angles = sample.state()[0][: sample.model.n_joints]
    rest = sample.model.initial_state(angles)
    d, torque = sample.model.n_dof, np.zeros(sample.model.n_joints)
    mass = sample.chain.mass_matrix(rest[:d])
    scale = np.sqrt(np.diag(mass))
    h = 1e-6
    columns = [sample.chain.acceleration(rest[:d] + h * u, rest[d:], torque) / h for u in np.eye(d)]
    flexibility = -scale[:, None] * np.transpose(columns) / scale
    squares = np.sort(np.linalg.eigvals(flexibility).real)[sample.model.n_joints :]
    expected = np.sqrt(np.maximum(squares, 0.0)) / (2 * np.pi)
    result = fm.frequencies(sample.model, angles)
    assert (result[: sample.model.n_joints] == 0.0).all() and (np.diff(result) >= 0.0).all()
    assert np.allclose(result[sample.model.n_joints :], expected, rtol=1e-4, atol=1e-5 * expected.max(initial=0.0))


@pytest.mark.parametrize("lock_joints", [False, True])
def test_many_postures_have_the_frequencies_of_each(lock_joints):
    model = fm.build_model(fm.catalog.paper_rrr(), elements=1)
    postures = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 3))
    expected = [fm.frequencies(model, posture, lock_joints) for posture in postures]
    assert np.array_equal(fm.frequencies(model, postures, lock_joints), expected)
    with pytest.raises(ValueError, match=r"^joint_angles: .*; give numbers \(3,\) or \(k, 3\), rad$"):
        fm.frequencies(model, postures[:, :2], lock_joints)


def test_viscous_friction_damps_the_motors():
    """By the virtual work of the friction torques: the damping matrix changes by b at each motor angle alone."""
    arm, friction = fm.catalog.paper_rrr(), np.array([3.0, 0.5, 2.0])
    joints = [replace(joint, viscous_friction=b) for joint, b in zip(arm.joints, friction, strict=True)]
    plain = [replace(joint, viscous_friction=0.0) for joint in arm.joints]
    model, free = (fm.build_model(replace(arm, joints=each), modes=1) for each in (joints, plain))
    expected = np.zeros((model.n_dof, model.n_dof))
    expected[model.motor_columns, model.motor_columns] = friction
    assert np.array_equal(fm.damping_matrix(model) - fm.damping_matrix(free), expected)
