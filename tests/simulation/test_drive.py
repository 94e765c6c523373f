"""Drive: signals, prescribed motions and disturbances do what mechanics says, and impossible ones are refused."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import flexman_gym as fm
from flexman_gym.kernels import layout

pytestmark = pytest.mark.filterwarnings("ignore:Link.second_moment_y:UserWarning")  # of the printed area, in a file
SCENE = replace(fm.catalog.paper_scene("ff"), duration=0.5)
MODELS = {
    "flexible joints": fm.build_model(SCENE.arm, modes=5),
    "rigid joints": fm.build_model(SCENE.arm, modes=5, flexible_joints=False),
    "spinning rotors": fm.build_model(SCENE.arm, modes=5, spinning_rotors=True),
}
both = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
WOBBLE = fm.Signal(amplitude=3.0, frequency_hz=1.5)
REPLACED = {"torque": fm.ConstantTorque([0.0, 400.0, 400.0]), "prescribed": [WOBBLE, None, None]}
number = st.floats(-1e3, 1e3)


def truth(scene, model):
    """The solution by the reference method."""
    result = fm.simulate(scene, model, rtol=1e-9, atol=1e-11)
    assert result.status == "ok"
    return result


def assert_balanced(result, relative=1e-8):
    """Work less dissipation is the change of energy."""
    assert np.abs(result.energy_residual).max() < relative * result.energy_turnover[-1]


@given(number, number, st.floats(0.0, 10.0), number, st.floats(0.0, 5.0), st.floats(0.1, 5.0))
def test_a_signal_is_the_column_of_its_formula(offset, amplitude, frequency, phase, start, length):
    signal = fm.Signal(offset, amplitude, frequency, phase, start, start + length)
    expected = [offset, amplitude, frequency, phase, start, start + length]
    assert signal.column()[[layout.OFFSET, layout.AMPLITUDE, layout.FREQUENCY]] == pytest.approx(expected[:3])
    assert signal.column()[[layout.PHASE, layout.START, layout.STOP]] == pytest.approx(expected[3:])
    assert fm.Signal(offset).column()[layout.STOP] == np.inf


def test_tables_are_computed_once_a_scene_to_the_same_bits():
    torque = fm.SampledTorque([0.0, 0.123, 0.5], [[1.0, 2.0, 3.0], [-1.0, 0.0, 5.0], [0.0, 0.0, 1.0]], "linear")
    scene = replace(SCENE, torque=torque, tip_force=[WOBBLE, fm.Signal(1.0), fm.Signal()])
    first, second, other = (fm.simulate(each, method="ros2", step=0.01) for each in (scene, scene, replace(scene)))
    assert scene.pieces is scene.pieces is not replace(scene).pieces and hash(scene) == hash(replace(scene))
    assert first.states.tobytes() == second.states.tobytes() == other.states.tobytes()
    table = scene.pieces.table(1)
    assert (table[:, 3] == WOBBLE.column()).all() and (table[:, 5:] == fm.Signal().column()[:, None]).all()
    assert table.tobytes() == replace(scene).pieces.table(1).tobytes()
    table[:] = 0.0
    assert scene.pieces.table(1).tobytes() == replace(scene).pieces.table(1).tobytes()


@pytest.mark.parametrize("method", ["dop853", "rk4", "ros2", "implicit_midpoint", "gauss_3"])
def test_a_sine_keeps_the_phase_of_the_clock_whenever_it_starts(method):
    """The rate of a free rotor is the integral of amplitude sin(2 pi f t + phase) / inertia from start to stop."""
    link = fm.Link(0.1, 1e-6, 1e-13, 1e-13, 1e-13, 7e10, 2.6e10, 1e-3)
    arm, choice = fm.Arm([link], [fm.Joint((0.0, 0.0, 1.0), 2.0)]), fm.ModelChoice(False, 1)
    signal = fm.Signal(0.0, 3.0, 0.7, 0.4, start=0.3, stop=0.8)
    still = fm.ConstantTorque([0.0])
    scene = fm.Scene(arm, choice, still, fm.Initial([0.0], [0.0]), 1.0, 0.1, prescribed=[signal])
    result = fm.simulate(scene, method=method, step=1e-3, rtol=1e-9, atol=1e-11)
    turn, times = 2.0 * np.pi * 0.7, np.clip(result.time, 0.3, 0.8)
    expected = 3.0 / turn * (np.cos(turn * 0.3 + 0.4) - np.cos(turn * times + 0.4))
    np.testing.assert_allclose(result.states[:, 1], expected, atol=5e-3)


def test_a_signal_acts_from_its_start_on_and_no_longer_at_its_stop():
    """Euler steps of 1/64 s look at their starts alone: those from 16/64 to 31/64 gain 3 rad/s^2 / 64 each."""
    link = fm.Link(0.1, 1e-6, 1e-13, 1e-13, 1e-13, 7e10, 2.6e10, 1e-3)
    arm, choice = fm.Arm([link], [fm.Joint((0.0, 0.0, 1.0), 2.0)]), fm.ModelChoice(False, 1)
    still, signal = fm.ConstantTorque([0.0]), fm.Signal(3.0, start=0.25, stop=0.5)
    scene = fm.Scene(arm, choice, still, fm.Initial([0.0], [0.0]), 1.0, 1 / 64, prescribed=[signal])
    result = fm.simulate(scene, method="semi_implicit_euler", step=1 / 64)
    expected = 3.0 / 64 * np.clip(np.arange(65) - 16, 0, 16)
    np.testing.assert_allclose(result.states[:, 1], expected, rtol=1e-14)


@both
def test_a_prescribed_motion_is_followed_and_its_work_is_counted(model):
    result = truth(replace(SCENE, **REPLACED), model)
    turn = 2.0 * np.pi * WOBBLE.frequency_hz
    expected = WOBBLE.amplitude * (result.time / turn - np.sin(turn * result.time) / turn**2)
    np.testing.assert_allclose(result.motor_angles[:, 0], expected, atol=1e-9)
    assert abs(result.work[-1]) > 10.0
    assert_balanced(result)


@both
@pytest.mark.parametrize("scene", [{}, REPLACED, {"tip_force": [fm.Signal(50.0), fm.Signal(), WOBBLE]}])
def test_the_linearly_implicit_method_converges_to_the_same_motion(model, scene):
    scene = replace(SCENE, **scene)
    expected = truth(scene, model)
    runs = [fm.simulate(scene, model, method="ros2", step=step) for step in (1e-4, 2.5e-5)]
    errors = [np.linalg.norm(run.tip - expected.tip, axis=1).max() for run in runs]
    assert errors[1] < 5e-4
    assert np.log2(errors[0] / errors[1]) / 2.0 > 1.7
    residuals = [np.abs(run.energy_residual).max() for run in runs]
    assert residuals[1] < 2e-3 * expected.energy_turnover[-1]


@pytest.mark.parametrize("name", [name for name, method in fm.METHODS.items() if not method.adaptive])
def test_every_method_knows_every_part_of_the_drive(name):
    """Friction, spinning rotors, a driven joint and disturbances at once, against the reference method."""
    joints = [replace(joint, viscous_friction=5.0, coulomb_friction=20.0) for joint in SCENE.arm.joints]
    arm = replace(SCENE.arm, joints=joints)
    model = fm.build_model(arm, modes=2, spinning_rotors=True)
    forces = {"tip_force": [fm.Signal(50.0), fm.Signal(), WOBBLE], "base_acceleration": [WOBBLE, WOBBLE, fm.Signal()]}
    scene = replace(SCENE, arm=arm, **REPLACED, **forces)
    expected = truth(scene, model)
    result = fm.simulate(scene, model, method=name, step=1e-4)
    assert np.abs(result.tip - expected.tip).max() < (1e-3 if fm.METHODS[name].order == 1 else 2e-5)
    scale = expected.energy_turnover[-1]
    assert np.abs(result.energy_residual).max() < (1e-2 if fm.METHODS[name].order == 1 else 1e-4) * scale


@both
def test_a_prescribed_motion_is_the_limit_of_a_heavy_rotor(model):
    heavy = replace(SCENE.arm, joints=[replace(SCENE.arm.joints[0], rotor_inertia=1e9), *SCENE.arm.joints[1:]])
    choice = model.choice
    driven = fm.build_model(heavy, 2, 5, flexible_joints=choice.flexible_joints, spinning_rotors=choice.spinning_rotors)
    torque = fm.SineTorque([1e9 * WOBBLE.amplitude, 400.0, 400.0], [WOBBLE.frequency_hz] * 3, [0.0] * 3)
    free = truth(replace(SCENE, arm=heavy, torque=torque), driven)
    held = replace(SCENE, torque=replace(torque, amplitude=[0.0, 400.0, 400.0]), prescribed=REPLACED["prescribed"])
    np.testing.assert_allclose(truth(held, model).tip, free.tip, atol=1e-5)


@pytest.mark.slow
@both
def test_a_base_that_accelerates_upward_is_gravity(model):
    lifted = replace(SCENE, base_acceleration=[fm.Signal(), fm.Signal(), fm.Signal(9.81)])
    heavy = replace(SCENE.arm, gravity=(0.0, 0.0, -9.81))
    choice = model.choice
    weighed = fm.build_model(
        heavy, 2, 5, flexible_joints=choice.flexible_joints, spinning_rotors=choice.spinning_rotors
    )
    result = truth(lifted, model)
    np.testing.assert_allclose(result.tip, truth(replace(SCENE, arm=heavy), weighed).tip, atol=1e-7)
    assert_balanced(result)


def test_the_work_of_the_base_is_what_the_gravity_that_it_feels_like_gives():
    """A link that vibrates across on a heavy hub, whose momentum is that of its bending, with a base that speeds up."""
    arm = fm.catalog.one_link(rotor_inertia=1e4)
    model = fm.build_model(arm, 1)
    state = np.zeros(2 * model.n_dof)
    state[model.n_dof + model.elastic_columns(0).start + 1] = 2.0  # m/s of the tip along y
    start = fm.Initial([0.0], [0.0], state)
    scene = fm.Scene(arm, model.choice, fm.ConstantTorque([0.0]), start, 0.1, 0.01)
    moved = truth(replace(scene, base_acceleration=[fm.Signal(), fm.Signal(3.0), fm.Signal()]), model)
    pulled = replace(arm, gravity=(0.0, -3.0, 0.0))
    weighed = truth(replace(scene, arm=pulled), fm.build_model(pulled, 1))
    given = weighed.moving_energy - weighed.energy
    given -= given[0]
    assert np.abs(given).max() > 0.05
    np.testing.assert_allclose(moved.work, given, rtol=0.0, atol=1e-6 * np.abs(given).max())


@both
def test_a_force_on_the_tip_acts_through_the_tips_jacobian(model):
    state = model.initial_state([0.3, -0.4, 0.8])
    force = np.array([30.0, -20.0, 50.0])
    jacobian = fm.linearize(model, state=state).C[:, : model.n_dof]
    simulator = fm.Simulator(model, "rk4", step=1e-7, control_period=1e-7)
    simulator.reset(state=state)
    simulator.step(np.zeros(3), tip_force=force)
    gained = simulator.state[model.n_dof :] / 1e-7
    demanded = fm.mass_matrix(model, state) @ gained
    np.testing.assert_allclose(demanded, jacobian.T @ force, atol=1e-3 * np.abs(jacobian.T @ force).max())


def test_disturbances_end_when_they_are_said_to():
    pulse = [fm.Signal(100.0, start=0.1, stop=0.2), fm.Signal(), fm.Signal(amplitude=50.0, frequency_hz=5.0, stop=0.3)]
    quiet = replace(SCENE, torque=fm.ConstantTorque([0.0] * 3), tip_force=pulse, base_acceleration=pulse)
    result = truth(quiet, MODELS["flexible joints"])
    assert_balanced(result)
    ended = result.time >= 0.3
    assert np.ptp(result.work[ended]) < 1e-9 * result.energy_turnover[-1] < np.ptp(result.work)


@both
def test_the_simulator_takes_the_same_drive_period_by_period(model):
    simulator = fm.Simulator(model, step=0.002, control_period=0.02, prescribed=[0])
    pushed = {"tip_force": [fm.Signal(20.0), fm.Signal(), fm.Signal()]}
    scene = replace(SCENE, torque=REPLACED["torque"], prescribed=[fm.Signal(1.5), None, None], **pushed)
    scene = replace(scene, base_acceleration=[fm.Signal(), fm.Signal(0.5), fm.Signal()], output_step=0.02)
    expected = fm.simulate(scene, model, step=0.002)
    for row in range(1, 6):
        simulator.step([0.0, 400.0, 400.0], [1.5, 0.0, 0.0], [20.0, 0.0, 0.0], [0.0, 0.5, 0.0])
        np.testing.assert_allclose(simulator.state, expected.states[row], atol=1e-9)
        assert simulator.energy_residual == pytest.approx(expected.energy_residual[row], abs=1e-9)
    assert simulator.energy_turnover == pytest.approx(expected.energy_turnover[5], rel=0.1)


def test_a_scene_keeps_its_drive_in_a_file(tmp_path):
    scene = replace(SCENE, **REPLACED, tip_force=[fm.Signal(1.0, start=0.1, stop=0.2), fm.Signal(), WOBBLE])
    for suffix in ("json", "yaml"):
        scene.save(tmp_path / f"scene.{suffix}")
        assert fm.Scene.load(tmp_path / f"scene.{suffix}") == scene
    assert "prescribed" not in SCENE.to_dict()


def test_a_disturbance_lasts_its_control_period():
    """A period after it without one is that of an arm at the same state that never had any."""
    shaken, calm = (fm.Simulator(fm.build_model(fm.catalog.paper_rrr(), 1)) for _ in range(2))
    shaken.reset()
    shaken.step([10.0] * 3, tip_force=[5.0, 0.0, 3.0], base_acceleration=[1.0, 2.0, 3.0])
    calm.reset(state=shaken.state.copy())
    for simulator in (shaken, calm):
        simulator.step([10.0] * 3)
    assert np.array_equal(shaken.state, calm.state)
