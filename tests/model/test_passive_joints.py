"""Tests of passive joints: eigenvalues of a chain of inertias, period of a pendulum, energy, equilibrium and orders."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh, expm

import flexman_gym as fm
from flexman_gym.model.state_space import natural_modes
from flexman_gym.model.statics import rest_tips
from flexman_gym.model.vibration import rotating_frequencies

from oracles.assertions import refusal
from oracles.dense import Chain, LinkModel

Y, Z = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
HANGING = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
CHOICE, FLEXIBLE = fm.ModelChoice(False, 1, rotary_inertia=False), fm.ModelChoice(True, 1)
REST = fm.Initial((0.0, 0.0), (0.0, 0.0))
pytestmark = pytest.mark.filterwarnings("ignore:.*radius of gyration")
SHORT = 1e-3  # m; links of the chain, whose own inertia is negligible


def rigid(arm):
    return fm.build_model(arm, flexible_links=False)


def chain(inertias, springs, dampers):
    """Return an arm of inertias about one axis, with a motor at the first and passive joints between them."""
    masses = [fm.LumpedMass(1e-9, 0.0, np.diag([each] * 3)) for each in inertias]
    links = [fm.Link.rod(SHORT, 1e-5, masses=[mass]) for mass in masses]
    passive = [fm.Joint(Z, passive=True, stiffness=k, damping=c) for k, c in zip(springs, dampers, strict=True)]
    return fm.Arm(links, [fm.Joint(Z), *passive])


def chain_matrices(inertias, springs):
    """Return mass and stiffness matrix of the absolute angles of a chain of inertias."""
    stiffness = np.zeros((len(inertias), len(inertias)))
    for i, k in enumerate(springs):
        stiffness[i : i + 2, i : i + 2] += k * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return np.diag(inertias), stiffness


# a method of each family of integration kernels
FAMILIES = ("rk4", "dop853", "ros2", "extrapolated_euler_4", "midpoint_corrected_3", "gauss_2", "generalised_alpha",
            "radau")  # fmt: skip
INERTIAS, SPRINGS, DAMPERS = (0.007, 0.02, 0.02), (110.0, 80.0), (0.02, 0.05)


def test_frequencies_of_a_chain_of_inertias():
    model = rigid(chain(INERTIAS, SPRINGS, DAMPERS))
    mass, stiffness = chain_matrices(INERTIAS, SPRINGS)
    free, locked = np.sqrt(np.abs(eigh(stiffness, mass)[0])), np.sqrt(eigh(stiffness[1:, 1:], mass[1:, 1:])[0])
    np.testing.assert_allclose(2.0 * np.pi * fm.frequencies(model)[1:], free[1:], rtol=1e-6)
    np.testing.assert_allclose(2.0 * np.pi * fm.frequencies(model, lock_joints=True), locked, rtol=1e-6)
    np.testing.assert_allclose(2.0 * np.pi * fm.modes(model).frequencies, locked, rtol=2e-3)  # damped


def test_linear_model_of_a_chain_has_the_poles_of_its_equations():
    model = rigid(chain(INERTIAS, SPRINGS, DAMPERS))
    linear = fm.linearize(model, outputs=("joint_angles",))
    assert linear.inputs == ("motor_torque_1 (N m)",)
    (mass, stiffness), (_, damping) = chain_matrices(INERTIAS, SPRINGS), chain_matrices(INERTIAS, DAMPERS)
    inverse = np.linalg.inv(mass)
    system = np.block([[np.zeros((3, 3)), np.eye(3)], [-inverse @ stiffness, -inverse @ damping]])
    for given in (linear.A, system):
        given[np.abs(given) < 1e-12] = 0.0
    poles = [np.sort_complex(np.linalg.eigvals(each)) for each in (linear.A, system)]
    np.testing.assert_allclose(poles[0], poles[1], rtol=1e-5, atol=2e-4)


@pytest.mark.parametrize("method", FAMILIES)
def test_free_vibration_of_a_chain_by_every_method(method):
    """All methods must integrate the linear equations whose solution is a matrix exponential."""
    model = rigid(chain(INERTIAS, SPRINGS, DAMPERS))
    start = np.array([0.0, 0.02, -0.03])
    scene = fm.Scene(model.arm, CHOICE, fm.ConstantTorque((0.0, 0.0, 0.0)),
                     fm.Initial(tuple(start), (0.0, 0.0, 0.0)), duration=0.1, output_step=0.01)  # fmt: skip
    run = fm.simulate(scene, method=method, step=None if method in ("dop853", "radau") else 5e-5)
    linear = fm.linearize(model, outputs=("joint_angles",))
    exact = expm(linear.A * 0.1) @ np.append(start, np.zeros(3))
    tolerance = 2e-2 if fm.METHODS[method].order == 1 else 2e-4
    np.testing.assert_allclose(run.joint_angles[-1], exact[:3], atol=tolerance * 0.03)


@pytest.fixture(scope="module")
def pendulum():
    """A bar with a motor, held, and a bar on a passive joint with spring and damper, under gravity."""
    bar = fm.Link.rod(0.8, 0.02)
    joints = [fm.Joint(Y, 0.1, torque_limit=10.0), fm.Joint(Y, passive=True, stiffness=12.0, damping=0.05)]
    return fm.Arm([bar, bar], joints, fm.Payload(0.2), gravity=(0.0, 0.0, -9.81))


def test_motion_of_a_pendulum_is_that_of_its_equation(pendulum):
    """The first motor is held by a prescribed motion; the passive bar obeys I a + c v + k q = m g l cos q."""
    bar, load = pendulum.links[0], 0.2
    inertia, moment = bar.mass * 0.8**2 / 3.0 + load * 0.8**2, (bar.mass * 0.4 + load * 0.8) * 9.81
    held = (fm.Signal(), None)
    scene = fm.Scene(pendulum, CHOICE, fm.ConstantTorque((0.0, 0.0)),
                     fm.Initial((0.0, 0.4), (0.0, 0.0)), duration=2.0, output_step=0.1, prescribed=held)  # fmt: skip
    run = fm.simulate(scene, method="dop853", rtol=1e-10, atol=1e-12)

    def rates(t, state):
        return state[1], (moment * np.cos(state[0]) - 12.0 * state[0] - 0.05 * state[1]) / inertia

    exact = solve_ivp(rates, (0.0, 2.0), (0.4, 0.0), "DOP853", run.time, rtol=1e-11, atol=1e-13).y[0]
    np.testing.assert_allclose(run.joint_angles[:, 1], exact, atol=2e-8)


@pytest.mark.slow
def test_energy_of_spring_and_damper_is_balanced(pendulum):
    scene = fm.Scene(pendulum, FLEXIBLE, fm.ConstantTorque((2.0, 0.0)), fm.Initial((0.1, 0.4), (0.0, 0.0)),
                     duration=1.0, output_step=0.1)  # fmt: skip
    run = fm.simulate(scene, method="dop853", rtol=1e-9, atol=1e-12)
    assert run.dissipation[-1] > 0.01
    residual = run.energy - run.energy[0] - run.work + run.dissipation
    assert np.abs(residual).max() < 1e-6 * np.abs(run.work).max()


def test_equilibrium_balances_weight_and_passive_springs(pendulum):
    model = rigid(pendulum)
    state = fm.rest_state(model, [0.3, 9.0])
    moment = (pendulum.links[0].mass * 0.4 + 0.2 * 0.8) * 9.81
    angle = state[1]
    assert abs(moment * np.cos(0.3 + angle) - 12.0 * angle) < 1e-9
    torque = fm.holding_torques(model, [0.3, 0.0])
    assert abs(torque[1]) < 1e-9
    np.testing.assert_allclose(fm.acceleration(model, state, torque), 0.0, atol=1e-8)


def test_a_joint_without_spring_is_a_hinge():
    """Its angle has a frequency of zero with the motors held: the matrices are singular, not wrong."""
    arm = fm.Arm([fm.Link.rod(0.5, 0.01)] * 2, [fm.Joint(Z), fm.Joint(Z, passive=True)])
    model = rigid(arm)
    mass, stiffness = fm.mass_matrix(model, np.zeros(4)), fm.stiffness_matrix(model)
    assert natural_modes(mass, stiffness)[0] == pytest.approx(0.0, abs=1e-9)


def test_files_keep_passive_joints(tmp_path, pendulum):
    scene = fm.Scene(pendulum, FLEXIBLE, fm.ConstantTorque((0.0, 0.0)), REST, duration=0.1, output_step=0.1)
    scene.save(tmp_path / "scene.yaml")
    assert fm.Scene.load(tmp_path / "scene.yaml") == scene


@pytest.mark.parametrize(
    "joint, field",
    [({"rotor_inertia": 0.1}, "Joint.rotor_inertia"), ({"torque_limit": 1.0}, "Joint.torque_limit"),
     ({"backlash": 0.01, "stiffness": 1.0}, "Joint.backlash"), ({"passive": 1}, "Joint.passive")],
)  # fmt: skip
def test_fields_of_motors_are_refused(joint, field):
    with pytest.raises(ValueError, match=field):
        fm.Joint(Z, **({"passive": True} | joint))


def test_torques_of_passive_joints_are_refused(pendulum):
    with pytest.raises(ValueError, match=r"Scene.torque of joint 1: 1.0 .*passive"):
        fm.Scene(pendulum, FLEXIBLE, fm.ConstantTorque((0.0, 1.0)), REST, duration=0.1, output_step=0.1)
    with pytest.raises(ValueError, match=r"Scene.prescribed\[1\].*passive"):
        fm.Scene(pendulum, FLEXIBLE, fm.ConstantTorque((0.0, 0.0)), REST, duration=0.1, output_step=0.1,
                 prescribed=(None, fm.Signal()))  # fmt: skip


@pytest.mark.feature
def test_a_passive_joint_has_no_torque_to_differentiate(pendulum):
    scene = fm.Scene(pendulum, FLEXIBLE, fm.ConstantTorque((0.0, 0.0)), REST, duration=0.1, output_step=0.1)
    assert fm.sensitivities(scene, to="motor_torques", step=0.01).parameters == ("motor_torques[0] (N m)",)
    with pytest.raises(ValueError, match=r"to: 'motor_torques\[1\]'"):
        fm.sensitivities(scene, to="motor_torques[1]", step=0.01)


def free_pendulum(gravity, flexible=True):
    """Return the model of an arm whose second joint is passive and has no spring."""
    link = fm.Link.rod(0.5, 0.01, material="steel")
    joints = [fm.Joint(Z, rotor_inertia=0.01, torque_limit=1.0), fm.Joint(Z, passive=True)]
    return fm.build_model(fm.Arm([link, link], joints, gravity=gravity), 1, flexible_links=flexible)


def hanging_load(mass, rope, flexible=False, spring=None, axes=((0.0, 1.0, 0.0), (1.0, 0.0, 0.0))):
    """Return the model of a boom on a motor, at whose tip a rope with a load hangs on two crossing passive joints.

    At zero angles the rope points down. Link frames are parallel to the base there, with gravity along -z.
    """
    hook, thin = fm.Link.rigid(1e-9, 1e-9, (0.0, 0.0, 0.0), np.eye(3) * 1e-12), np.eye(3) * 1e-9
    line = fm.Link.rigid(rope, 1e-9, (rope / 2.0, 0.0, 0.0), thin, orientation=HANGING)
    joints = [fm.Joint((0.0, -1.0, 0.0), rotor_inertia=10.0, stiffness=1e5, torque_limit=1e4),
              *(fm.Joint(axis, passive=True, stiffness=spring) for axis in axes)]  # fmt: skip
    boom = fm.Link.tube(2.0, 0.1, 0.004, "steel")
    arm = fm.Arm([boom, hook, line], joints, fm.Payload(mass), gravity=(0.0, 0.0, -9.81))
    return fm.build_model(arm, 2, flexible_links=flexible)


@pytest.mark.parametrize("posture", [0.0, 0.9, -1.8])
@pytest.mark.parametrize("flexible", [False, True])
def test_a_load_on_crossing_joints_hangs_vertically_below_the_tip_of_its_boom(posture, flexible):
    model = hanging_load(40.0, 1.5, flexible)
    state = fm.rest_state(model, [posture, 5.0, -3.0])  # angles of passive joints follow from the equilibrium
    torque = fm.holding_torques(model, [posture, 0.0, 0.0])
    np.testing.assert_allclose(fm.acceleration(model, state, torque), 0.0, atol=1e-7)
    tip, short = (
        rest_tips(each, np.array([[posture, 0.0, 0.0]]))[0] for each in (model, hanging_load(40.0, 0.5, flexible))
    )
    np.testing.assert_allclose(tip - short, [0.0, 0.0, -1.0], atol=1e-7)
    np.testing.assert_allclose(torque[1:], 0.0, atol=1e-7)
    lever, boom = tip[0], model.arm.links[0].mass
    if not flexible:
        assert torque[0] == pytest.approx(9.81 * (40.0 + boom / 2.0) * lever, rel=1e-6)


def test_small_swing_of_a_hanging_load_has_the_frequency_of_a_pendulum():
    """A boom that is held and 1e5 N m/rad stiff hardly moves with 1 g of load: sqrt(g / L) in both directions."""
    model = hanging_load(1e-3, 1.5)
    found = 2.0 * np.pi * fm.modes(model, [0.6, 0.0, 0.0]).frequencies[:2]
    np.testing.assert_allclose(found, np.sqrt(9.81 / 1.5), rtol=1e-6)


def test_small_swing_of_two_hanging_masses_has_the_frequencies_of_a_double_pendulum():
    """M = [[m1 + m2, m2 l2], ...] of point masses at the ends of massless rods; Landau and Lifshitz, section 23."""
    (m1, m2), (l1, l2), g = (2.0, 0.7), (0.8, 0.5), 9.81
    thin = np.eye(3) * 1e-12
    rods = [fm.Link.rigid(length, mass, (length, 0.0, 0.0), thin) for length, mass in ((l1, m1), (l2, m2))]
    base = fm.Link.rigid(1e-9, 1.0, (0.0, 0.0, 0.0), np.eye(3))
    joints = [fm.Joint(Z, rotor_inertia=1.0, torque_limit=1.0), *[fm.Joint(Z, passive=True)] * 2]
    model = fm.build_model(fm.Arm([base, *rods], joints, gravity=(0.0, -g, 0.0)))
    state = fm.rest_state(model, [0.0] * 3)
    np.testing.assert_allclose(state[:3], [0.0, -np.pi / 2.0, 0.0], atol=1e-9)
    mass = np.array([[(m1 + m2) * l1**2, m2 * l1 * l2], [m2 * l1 * l2, m2 * l2**2]])
    exact = np.sqrt(eigh(np.diag([(m1 + m2) * g * l1, m2 * g * l2]), mass)[0]) / (2.0 * np.pi)
    np.testing.assert_allclose(fm.modes(model).frequencies, exact, rtol=1e-6)


def pendulum_on_a_base(length):
    """Return the arm of a point mass on a massless rod that hangs at a zero angle, and the index of its joint."""
    block = fm.Link.rigid(1e-9, 1.0, (0.0, 0.0, 0.0), np.eye(3))
    rod = fm.Link.rigid(length, 2.0, (length, 0.0, 0.0), np.eye(3) * 1e-13, orientation=HANGING)
    joints = [fm.Joint((1.0, 0.0, 0.0), rotor_inertia=1.0, torque_limit=1.0), fm.Joint(Y, passive=True)]
    return fm.Arm([block, rod], joints, gravity=(0.0, 0.0, -9.81))


def swing(length, accelerations, duration, step=0.01):
    """Return times and angles of a pendulum, at rest at first, whose base has an acceleration (three signals)."""
    scene = fm.Scene(pendulum_on_a_base(length), CHOICE, fm.ConstantTorque((0.0, 0.0)), REST, duration=duration,
                     output_step=step, prescribed=(fm.Signal(), None), base_acceleration=accelerations)  # fmt: skip
    run = fm.simulate(scene, method="dop853", rtol=1e-10, atol=1e-13)
    return run.time, run.joint_angles[:, 1]


def test_a_pendulum_whose_pivot_accelerates_obeys_its_equation():
    """L q'' = -(g + a_z) sin q + s a_x cos q, with s = 1 or -1 of the axis: a pivot that falls swings more slowly."""
    length, (x, z) = 1.3, ((2.0, 0.4), (3.0, 0.7))  # amplitude (m/s^2) and frequency (Hz) along x and z
    signals = [fm.Signal(amplitude=x[0], frequency_hz=x[1]), fm.Signal(), fm.Signal(amplitude=z[0], frequency_hz=z[1])]
    time, found = swing(length, signals, 4.0, 0.1)

    def rates(t, state):
        ax, az = (amplitude * np.sin(2.0 * np.pi * frequency * t) for amplitude, frequency in (x, z))
        return state[1], (-(9.81 + az) * np.sin(state[0]) + ax * np.cos(state[0])) / length

    exact = solve_ivp(rates, (0.0, 4.0), (0.0, 0.0), "DOP853", time, rtol=1e-12, atol=1e-14).y[0]
    np.testing.assert_allclose(found, exact, atol=1e-8)
    assert np.abs(found).max() > 0.2


@pytest.mark.feature
def test_a_shaped_acceleration_of_the_pivot_leaves_the_swing_that_theory_predicts():
    """ZV shaping (Singer and Seering, 1990): no swing at the design length, |cos(pi w / 2 w_0)| beside it.

    The swing stays below 2 degrees; the residual of a pulse without shaping is the unit.
    """
    from flexman_gym.toolbox.controllers.input_shaping.shapers import design_shaper, shaper_residual

    length, push, pulse = 1.5, 0.2, 0.1  # m, m/s^2, s
    frequency = np.sqrt(9.81 / length) / (2.0 * np.pi)
    shaper = design_shaper("zv", frequency)

    def residual(own, impulses):
        """Return the amplitude of the free swing after the pulses, by energy, rad."""
        rate = np.sqrt(9.81 / own)
        total = np.zeros(3)
        for start, part in impulses:  # linear: the swings of single pulses add up
            signals = [fm.Signal(offset=part * push, start=start, stop=start + pulse), fm.Signal(), fm.Signal()]
            time, angle = swing(own, signals, 3.0)
            late = time > 2.0
            basis = np.column_stack([np.cos(rate * time[late]), np.sin(rate * time[late]), np.ones(late.sum())])
            total += np.linalg.lstsq(basis, angle[late], rcond=None)[0]
        return np.hypot(*total[:2])

    pairs = list(zip(shaper.times, shaper.amplitudes, strict=True))
    for factor in (1.0, 0.8, 1.25):
        plain = residual(factor * length, [(0.0, 1.0)])
        assert plain < np.radians(2.0)
        found = residual(factor * length, pairs) / plain
        expected = shaper_residual(shaper, frequency / np.sqrt(factor)) / 100.0  # from percent
        assert found == pytest.approx(expected, abs=1e-3)
        assert expected == pytest.approx(abs(np.cos(np.pi / 2.0 / np.sqrt(factor))), abs=1e-9)


def test_a_load_above_its_joint_falls_to_the_stable_equilibrium():
    link = fm.Link.rigid(0.5, 1.0, (0.25, 0.0, 0.0), np.eye(3) * 0.02)
    joints = [fm.Joint(Z, rotor_inertia=0.1, torque_limit=9.0), fm.Joint(Z, passive=True)]
    for direction in (1.0, -1.0):
        model = fm.build_model(fm.Arm([link, link], joints, gravity=(9.81 * direction, 0.0, 0.0)))
        angle = fm.rest_state(model, [0.0, 0.0])[1]
        assert np.cos(angle) == pytest.approx(direction, abs=1e-12)


def test_a_soft_passive_spring_and_the_weight_balance_near_the_hanging_position():
    link = fm.Link.rigid(0.5, 1.0, (0.25, 0.0, 0.0), np.eye(3) * 0.02)
    joints = [fm.Joint(Z, rotor_inertia=0.1, torque_limit=9.0), fm.Joint(Z, passive=True, stiffness=0.1)]
    model = fm.build_model(fm.Arm([link, link], joints, gravity=(0.0, -9.81, 0.0)))
    angle = fm.rest_state(model, [0.4, 0.0])[1]
    assert 9.81 * 0.25 * np.cos(0.4 + angle) + 0.1 * angle == pytest.approx(0.0, abs=1e-9) and angle < -1.5


@pytest.mark.parametrize("call", [
    lambda model: fm.modes(model), lambda model: fm.rest_state(model, np.zeros((3, 2))),
    lambda model: fm.holding_torques(model, [0.3, 0.0]), lambda model: rest_tips(model, np.zeros((1, 2))),
])  # fmt: skip
def test_equilibrium_of_a_joint_that_neither_spring_nor_gravity_restores_is_refused_in_one_line(call):
    line = refusal(call, free_pendulum((0.0, 0.0, -9.81), flexible=False))
    assert line.startswith(
        "arm.joints[1].stiffness: None is not allowed; give a number > 0 (N m/rad): gravity does not"
    )


def test_passive_joint_without_spring_moves_and_vibrates_where_no_equilibrium_is_needed():
    model = free_pendulum((0.0, 0.0, 0.0))
    assert fm.modes(model).frequencies[0] > 0.0 and not fm.rest_state(model, [0.0, 0.0]).any()
    assert not fm.holding_torques(model, [0.0, 0.0]).any() and np.isfinite(rest_tips(model, np.zeros((1, 2)))).all()
    hanging = free_pendulum((0.0, -9.81, 0.0))
    assert fm.linearize(hanging, state=np.zeros(2 * hanging.n_dof)).B.shape[1] == 1
    for each in (model, hanging):
        assert refusal(rotating_frequencies, each, [1.0]).startswith("arm.joints[1].stiffness: None")


@pytest.mark.feature
def test_swing_of_a_hanging_load_is_among_the_modes_that_a_motor_excites():
    from flexman_gym.toolbox.controllers.excited_modes import excited_modes

    model, posture = hanging_load(40.0, 1.5), [0.6, 0.0, 0.0]
    found = excited_modes(model, posture, held=True)
    assert found[0, 0] == pytest.approx(fm.modes(model, posture).frequencies[0])
    assert found[0, 2] > 0.1  # m, after a step of the motor by 1 rad


@pytest.mark.slow
def test_a_load_on_a_flexible_boom_moves_as_in_the_independent_lagrangian():
    """Two seconds on a base that accelerates, under a torque and a force on the load; rope and hook are rigid."""
    boom = fm.Link.rod(2.0, 0.05)
    hook, rope = fm.Link.rod(0.05, 0.02), fm.Link.rod(1.0, 0.008, "steel", orientation=HANGING)
    drive = fm.Joint((0.0, -1.0, 0.0), rotor_inertia=3.0, stiffness=8000.0, damping=20.0, torque_limit=1e3)
    joints = [drive, *(fm.Joint(axis, passive=True, viscous_friction=0.3) for axis in (Y, (1.0, 0.0, 0.0)))]
    arm = fm.Arm([boom, hook, rope], joints, fm.Payload(8.0), gravity=(0.0, 0.0, -9.81),
                 stiffness_proportional_damping=1e-4)  # fmt: skip
    flexible = (True, False, False)
    model = fm.build_model(arm, 2, 2, flexible_links=flexible)
    chain = Chain(arm, 2, flexible, True, [LinkModel(model.bases[0]), LinkModel(), LinkModel()])
    angles = (0.4, 0.6, -0.1)
    torque, force = fm.holding_torques(model, [0.4, 0.0, 0.0]) * (1.0, 0.0, 0.0) + (25.0, 0.0, 0.0), (4.0, -3.0, 2.0)
    sway, d = fm.Signal(amplitude=1.5, frequency_hz=0.6), model.n_dof
    times = np.linspace(0.0, 2.0, 9)

    def rates(time, state):
        shake = np.array([1.5 * np.sin(1.2 * np.pi * time), 0.0, 0.0])
        return np.concatenate([state[d:], chain.acceleration(state[:d], state[d:], torque, np.array(force), shake)])

    start = model.initial_state(np.array(angles))
    exact = solve_ivp(rates, (0.0, 2.0), start, "DOP853", times, rtol=1e-10, atol=1e-12).y.T
    scene = fm.Scene(arm, fm.ModelChoice(flexible, 2), fm.ConstantTorque(tuple(torque)),
                     fm.Initial(angles, (0.0,) * 3), duration=2.0, output_step=0.25,
                     tip_force=[fm.Signal(offset=each) for each in force],
                     base_acceleration=[sway, fm.Signal(), fm.Signal()])  # fmt: skip
    run = fm.simulate(scene, model, method="dop853", rtol=1e-10, atol=1e-12)
    tips = np.array([chain.tip(state[:d]) for state in exact])
    np.testing.assert_allclose(run.tip, tips, atol=1e-8)
    assert np.ptp(run.tip, axis=0).max() > 0.5
