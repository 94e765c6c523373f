"""State-space models: named inputs and outputs, scaling, sampling and reduction."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

import flexman_gym as fm
from flexman_gym.kernels import dynamics, layout
from flexman_gym.model.linearization import INPUT_UNITS, OUTPUT_UNITS

from oracles.assertions import refusal

STRIP = fm.Link.strip(0.5, 0.04, 0.003)
ARM = fm.Arm(
    [STRIP, fm.Link.tube(0.4, 0.02, 0.001)],
    [fm.Joint((0.0, 0.0, 1.0), 0.02, 60.0, 0.01), fm.Joint((0.0, -1.0, 0.0), 0.01)],
    fm.Payload(0.1), gravity=(0.0, 0.0, -9.81), modal_damping_ratio=0.01,
)  # fmt: skip
MODEL = fm.build_model(ARM)
REST = fm.rest_state(MODEL, [0.3, 0.5])
HELD = fm.holding_torques(MODEL, [0.3, 0.5])
LINEAR = fm.linearize(MODEL, state=REST, torque=HELD, outputs=tuple(OUTPUT_UNITS), inputs=tuple(INPUT_UNITS))
D, N = MODEL.n_dof, MODEL.n_joints
FREQUENCIES = [0.0, 0.7, 3.0, 11.0, 60.0]


def test_every_number_has_a_name_and_a_unit():
    assert len(LINEAR.states) == len(LINEAR.A) == 2 * D and len({*LINEAR.states}) == 2 * D
    assert len(LINEAR.outputs) == len(LINEAR.C) == len({*LINEAR.outputs})
    assert LINEAR.inputs[:3] == ("motor_torque_1 (N m)", "motor_torque_2 (N m)", "tip_force_x (N)")
    trajectory = fm.simulate(
        fm.Scene(ARM, MODEL.choice, fm.ConstantTorque([0.0, 0.0]), fm.Initial([0.0, 0.0], [0.0, 0.0]), 0.02, 0.01)
    )
    shared = [name for name in LINEAR.outputs if not name.startswith(("joint_rate", "tip_acceleration"))]
    assert {*shared} <= {*trajectory.columns()}
    assert len(repr(LINEAR).splitlines()) == 3


def test_inputs_accelerate_the_arm_as_the_drive_of_a_simulation_does():
    x, v, work = REST[:D], REST[D:], layout.make_work(MODEL.constants)
    columns = []
    for unit in np.eye(N + 6):
        both = np.zeros((2, D))
        for sign, out in zip((1.0, -1.0), both, strict=True):
            dynamics.accelerations(MODEL.constants, work, x, v, np.r_[HELD, np.zeros(6)] + sign * unit, out)
        columns.append((both[0] - both[1]) / 2)
    assert LINEAR.B[D:] == pytest.approx(np.transpose(columns), rel=1e-6, abs=1e-6 * np.abs(LINEAR.B).max())


def test_outputs_are_slopes_of_what_the_arm_reads():
    """Differences of the tip and its acceleration, and readings of a simulation, along random directions."""
    rng = np.random.default_rng(1)
    rows = {name: [i for i, head in enumerate(LINEAR.outputs) if head.startswith(name)] for name in OUTPUT_UNITS}
    direction = rng.standard_normal(2 * D) * np.sqrt(np.r_[np.full(D, 1e-8), np.full(D, 1e-6)])
    direction[N + 1 : D] *= 1e-2
    read = [fm.tip_acceleration(MODEL, REST + sign * direction, HELD) for sign in (1.0, -1.0)]
    felt = LINEAR.C[rows["tip_acceleration"]] @ direction
    assert (read[0] - read[1]) / 2 == pytest.approx(felt, rel=1e-4, abs=1e-6 * np.abs(felt).max())
    at = [i for i, head in enumerate(LINEAR.outputs) if head.startswith("tip_velocity")]
    tip = [i for i, head in enumerate(LINEAR.outputs) if head in ("tip_x (m)", "tip_y (m)", "tip_z (m)")]
    assert LINEAR.C[at][:, D:] == pytest.approx(LINEAR.C[tip][:, :D], abs=1e-12)
    torque = rng.standard_normal(N)
    change = [fm.tip_acceleration(MODEL, REST, HELD + sign * torque) for sign in (1.0, -1.0)]
    direct = LINEAR.D[rows["tip_acceleration"], :N] @ torque
    assert (change[0] - change[1]) / 2 == pytest.approx(direct, rel=1e-8, abs=1e-9)


def test_about_a_moving_state_the_velocity_of_the_tip_has_its_slope():
    rng = np.random.default_rng(4)
    state = REST + np.r_[np.zeros(D), rng.uniform(-1.0, 1.0, N), np.zeros(D - N)]
    rows = fm.linearize(MODEL, state=state, torque=HELD, outputs=["tip_velocity"]).C
    change = np.r_[1e-6 * rng.standard_normal(N), np.zeros(2 * D - N)]

    def velocity(at):
        jacobian = fm.linearize(MODEL, state=at).C[:, :D]
        return jacobian @ at[D:]

    assert (velocity(state + change) - velocity(state - change)) / 2 == pytest.approx(rows @ change, rel=1e-6)
    line = refusal(lambda: fm.linearize(MODEL, state=state, outputs=["tip_acceleration"]))
    assert line.startswith("outputs: 'tip_acceleration' is not allowed; give outputs without")


def test_the_scaled_form_is_the_same_model():
    """Including models whose unscaled form is inaccurate: gains agree with A, B, C and D to their accuracy."""
    scaled = LINEAR.scaled()
    plain = [LINEAR.C @ np.linalg.solve(2j * np.pi * f * np.eye(2 * D) - LINEAR.A, LINEAR.B) + LINEAR.D
             for f in FREQUENCIES[1:]]  # fmt: skip
    gains = LINEAR.frequency_response(FREQUENCIES[1:])
    assert gains == pytest.approx(np.array(plain), rel=1e-4, abs=1e-6 * np.abs(plain).max())
    assert np.abs(scaled.A).max() < 10.0 * np.sqrt(np.abs(LINEAR.A).max())
    rings = fm.modes(MODEL, [0.3, 0.5], "free")
    poles = LINEAR.poles
    for value in rings.eigenvalues:
        assert np.abs(poles - value).min() < 1e-8 * abs(value)


def test_a_clamped_strip_bends_by_its_compliance():
    """A heavy hub holds the root; far below the first mode, f L^3 / (3 E I) at the tip."""
    model = fm.build_model(fm.Arm([STRIP], [fm.Joint((0.0, 0.0, 1.0), 1e9)]))
    gain = fm.linearize(model, inputs=["tip_force"]).frequency_response([1e-2])[0, 1, 1]
    assert gain.real == pytest.approx(0.5**3 / (3 * STRIP.youngs_modulus * STRIP.second_moment_z), rel=1e-4)


@pytest.mark.parametrize("steps", [0, 3, 10, 23, 40])
def test_a_sampled_model_is_the_flow_under_inputs_that_come_late(steps):
    """Stepped in tenths of a period, with each input constant from its own time on; `steps` tenths of delay."""
    whole = fm.build_model(ARM, modes=1)
    linear, period = fm.linearize(whole, outputs=["tip", "tip_acceleration"]), 0.02
    sampled = linear.discrete(period, steps * period / 10)
    size, m = linear.B.shape
    block = expm(period / 10 * np.vstack([np.hstack([linear.A, linear.B]), np.zeros((m, size + m))]))
    rng = np.random.default_rng(steps)
    inputs = rng.standard_normal((8, m))
    state, fine = np.zeros(len(sampled.A)), np.zeros(size)
    for k, given in enumerate(inputs):
        shown = sampled.C @ state + sampled.D @ given
        active = k * 10 - steps
        late = inputs[active // 10] if active >= 0 else np.zeros(m)
        assert shown == pytest.approx(linear.C @ fine + linear.D @ late, rel=1e-9, abs=1e-11)
        state = sampled.A @ state + sampled.B @ given
        for tenth in range(10):
            active = k * 10 + tenth - steps
            acting = inputs[active // 10] if active >= 0 else np.zeros(m)
            fine = (block @ np.r_[fine, acting])[:size]
        assert state[:size] == pytest.approx(fine, rel=1e-9, abs=1e-12)
    assert len(sampled.states) == len(sampled.A) == size + m * -(-steps // 10) and sampled.period == period


def test_a_reduced_model_keeps_what_is_slow_and_every_static_gain():
    linear = fm.linearize(MODEL, state=REST, torque=HELD, outputs=["tip", "root_strains"], inputs=["tip_force"])
    small = linear.reduced(200.0)
    assert len(small.A) < len(linear.A) / 2 and small.outputs == linear.outputs
    gains, less = linear.frequency_response([1e-3, 1.0, 5.0, 20.0]), small.frequency_response([1e-3, 1.0, 5.0, 20.0])
    gap, size = np.abs(less - gains).max(axis=2), np.abs(gains).max(axis=2)
    assert (gap[:, :-1] <= 0.01 * size[:, :-1]).all()  # the last is a twist that only its own weight winds
    assert less[0] == pytest.approx(gains[0], rel=1e-6, abs=1e-6 * np.abs(gains[0]).max())


@pytest.fixture
def control(monkeypatch):
    """The library python-control; a script of this project has the same name."""
    monkeypatch.setattr(sys, "path", [path for path in sys.path if Path(path).name != "scripts"])
    ours = sys.modules.pop("control", None)
    yield pytest.importorskip("control", reason="the extra control is not installed")
    sys.modules.pop("control", None)
    if ours:
        sys.modules["control"] = ours


@pytest.mark.slow
def test_solvers_of_python_control_work_on_the_scaled_form(control):
    linear = fm.linearize(MODEL, state=REST, torque=HELD, outputs=["tip", "motor_angles"])
    scaled = linear.scaled()
    plant = scaled.to_control()
    assert plant.input_labels == list(linear.inputs) and plant.output_labels == list(linear.outputs)
    given = control.frequency_response(plant, 2.0 * np.pi * np.array([0.7, 11.0])).frdata
    assert np.moveaxis(given, -1, 0) == pytest.approx(linear.frequency_response([0.7, 11.0]), rel=1e-8)
    weight, cost = scaled.C.T @ scaled.C + 1e-9 * np.eye(2 * D), 1e-2 * np.eye(N)
    gain, solution, _ = control.lqr(plant, weight, cost)
    left = (
        scaled.A.T @ solution + solution @ scaled.A - solution @ scaled.B @ np.linalg.solve(cost, scaled.B.T @ solution)
    )
    assert np.abs(left + weight).max() < 1e-6 * np.abs(weight).max() * np.abs(scaled.A).max()
    assert np.linalg.eigvals(scaled.A - scaled.B @ gain).real.max() < 0.0
    sampled = scaled.discrete(0.01, 0.005).to_control()
    assert sampled.dt == 0.01 and control.dlqr(sampled, np.eye(2 * D + N), np.eye(N))[2].size == 2 * D + N
