"""Implicit steps: one step solves the dense linear system, with springs, dampers, friction and rotors in its matrix."""

import select
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import flexman_gym as fm
from flexman_gym.kernels import layout
from flexman_gym.simulation import batch_integrators, integrator
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.batch_integrators import SequentialIntegrator
from flexman_gym.simulation.integrator import Integrator
from flexman_gym.simulation.methods import LinearlyImplicit

from oracles.chains import QUICK, affected

ZERO, ONE = np.zeros((1, 1)), np.ones(1)
EULER = LinearlyImplicit("linearly_implicit_euler", 1, "Hairer and Wanner, Solving ODEs II, IV.9", ZERO, ONE, 1.0, ZERO)


def structure(case, v):
    """Stiffness and damping (d, d) of springs, links and friction, this with its secant at the rates v (d,)."""
    chain, d = case.chain, len(v)
    stiffness, damping = np.zeros((d, d)), np.zeros((d, d))
    for i, joint in enumerate(case.arm.joints):
        motor = chain.motor.get(i, i)
        if i in chain.motor:
            pair = np.ix_([i, motor], [i, motor])
            stiffness[pair] += joint.stiffness * np.array([[1.0, -1.0], [-1.0, 1.0]])
            damping[pair] += joint.damping * np.array([[1.0, -1.0], [-1.0, 1.0]])
        damping[motor, motor] += joint.viscous_friction
        if joint.coulomb_friction > 0.0:
            decay = 1.0 + joint.static_excess / (1.0 + (v[motor] / joint.stribeck_rate) ** 2)
            damping[motor, motor] += joint.coulomb_friction * np.tanh(v[motor] / joint.coulomb_rate) / v[motor] * decay
    for beam, drag, columns in zip(chain.beams, chain.damping, chain.elastic, strict=True):
        stiffness[columns, columns] += beam.K
        damping[columns, columns] += drag
    return stiffness, damping


@pytest.mark.slow
@settings(QUICK, max_examples=50)
@given(affected(), st.sampled_from([1e-4, 1e-3, 1e-2]))
def test_a_linearly_implicit_euler_step_solves_the_dense_linear_system(case, step):
    """(M + h D + h^2 K) w = F(x, v) - h K v, then v += h w and x += h v; held motors have the w that is given."""
    (x, v), drive, d = case.sample.state(), case.drive(), case.model.n_dof
    n, motors = case.model.n_joints, case.model.motor_columns
    mass, force = case.chain.equation(
        x, v, np.where(np.isin(range(n), case.held), 0.0, drive[:n]), *drive[n:].reshape(2, 3)
    )
    stiffness, damping = structure(case, v)
    matrix, right = mass + step * damping + step**2 * stiffness, force - step * stiffness @ v
    w, held = np.zeros(d), np.zeros(d, dtype=bool)
    held[motors[list(case.held)]], w[motors[list(case.held)]] = True, drive[list(case.held)]
    scale = np.sqrt(np.diag(matrix))  # metres and radians of fine elements weigh alike
    free = np.ix_(~held, ~held)
    weighed = matrix / np.outer(scale, scale)
    w[~held] = np.linalg.solve(weighed[free], ((right - matrix @ w) / scale)[~held]) / scale[~held]

    mover = SequentialIntegrator([Integrator(case.model, EULER, None, case.held)], (step, 1))
    rows, status = np.r_[x, v, 0.0, 0.0][None], np.zeros(1, dtype=np.int64)
    mover.integrate(drive[None], np.zeros(1), rows, np.zeros((1, layout.OUTPUTS)), status)
    assert status[0] == layout.OK
    result = (rows[0, d : 2 * d] - v) / step
    condition = np.linalg.cond(weighed[free]) if free[0].size else 1.0
    rounding = np.finfo(float).eps * np.abs(scale * v).max() / step
    largest = np.abs(scale * w).max()
    assert (
        np.abs(scale * (result - w)).max() <= (1e-10 + 100 * np.finfo(float).eps * condition) * largest + 10 * rounding
    )
    moved = x + step * rows[0, d : 2 * d]
    np.testing.assert_allclose(rows[0, :d], moved, rtol=1e-12, atol=1e-12 * np.abs(moved).max(initial=1.0))


NAMES = [name for name in fm.METHODS if name.startswith("extrapolated")]
FIELDS = ("states", "tip", "energy", "work", "dissipation", "evaluations", "status")


def driven(flexible=True, stiffening=False):
    """The paper's arm under gravity, torques that swing and a force on the tip that comes and goes within steps."""
    arm = fm.catalog.paper_rrr(gravity=(0.0, 0.0, -9.81), payload=fm.Payload(2.0))
    choice = fm.ModelChoice(flexible, 1, stiffening=stiffening)
    torque = fm.SineTorque((100.0, 50.0, 20.0), (1.0, 2.0, 3.0), (0.0, 0.5, 1.0))
    push = [fm.Signal(), fm.Signal(5.0, start=0.033, stop=0.071), fm.Signal(amplitude=2.0, frequency_hz=4.0)]
    start = fm.Initial((0.1, 0.2, 0.3), (0.5, 0.0, -0.5))
    return fm.Scene(arm, choice, torque, start, 0.2, 0.02, tip_force=push)


def both(monkeypatch, scene, **options):
    """The run with sequences in the lanes, and that of one after the other."""
    result = []
    for least in (1, 99):
        monkeypatch.setattr(integrator, "MIN_SEQUENCES", least)
        monkeypatch.setattr(integrator, "MIN_SEQUENCES_RIGID", least)
        result.append(fm.simulate(scene, **options))
    return result


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("flexible", "stiffening"), [(False, False), (True, False), (True, True)])
@pytest.mark.parametrize("step", [0.01, 0.04, None])
def test_lanes_hold_the_bits_of_one_sequence_after_the_other(monkeypatch, name, flexible, stiffening, step):
    together, alone = both(monkeypatch, driven(flexible, stiffening), method=name, step=step, rtol=1e-4, atol=1e-7)
    assert together.status == "ok"
    for field in FIELDS:
        assert np.array_equal(getattr(together, field), getattr(alone, field)), field


def test_a_run_that_diverges_does_so_in_lanes_too(monkeypatch):
    wild = replace(driven(), initial=fm.Initial((0.0, 0.0, 0.0), (9e5, 0.0, 0.0)))
    together, alone = both(monkeypatch, wild, method="extrapolated_euler_5", step=0.02)
    assert together.status == alone.status == "diverged" and len(together.time) == len(alone.time)


def test_constants_that_are_changed_between_two_calls_count(monkeypatch):
    """The lanes know constants by their addresses."""
    model, ends = fm.build_model(fm.catalog.paper_rrr(), 1), []
    for change in (True, False):
        other = fm.build_model(fm.catalog.paper_rrr(payload=fm.Payload(5.0)), 1)
        first = integrator.Integrator(model if change else other, fm.METHODS["extrapolated_euler_5"], None, [])
        state = np.append(model.initial_state([0.0] * 3, [1.0, 0.5, -0.5]), [0.0, 0.0])
        rows, outputs = np.zeros((1, len(state))), np.zeros((1, 16))
        first.start(state, rows[0], outputs[0])
        if change:
            first.constants = other.constants._replace(prescribed=first.constants.prescribed)
        first(driven().pieces.table(), (0.0, 0.01, 3), state, rows, outputs)
        ends.append(state)
    assert np.array_equal(*ends)


@pytest.mark.slow
@settings(QUICK, max_examples=30)
@given(st.sets(st.integers(1, 20), min_size=2, max_size=8))
def test_lanes_compute_every_substep_of_any_sequences(numbers):
    method = replace(EULER, order=len(numbers), sequence=tuple(sorted(numbers)))
    with pytest.MonkeyPatch.context() as patch:
        together, alone = both(patch, driven(flexible=False), method=method, step=0.02)
    for field in FIELDS:
        assert np.array_equal(getattr(together, field), getattr(alone, field)), field


DURATION = 0.5  # s


def scene():
    """A rigid 2R arm on damped springs, swung by sine torques."""
    arm = fm.catalog.planar_2r(joint_stiffness=50.0, payload=fm.Payload(0.2), gravity=(0.0, -9.81, 0.0))
    torque = fm.SineTorque((2.0, 1.0), (1.0, 2.0), (0.3, 0.0))
    choice = fm.ModelChoice(flexible_links=False, elements=1)
    return fm.Scene(arm, choice, torque, fm.Initial((0.4, -0.6), (1.0, 0.5)), DURATION, DURATION / 10)


PARTED = [
    ("rk4", 1e-3), ("ros2", 1e-3), ("midpoint_3", 1e-3), ("gauss_2", 1e-3), ("implicit_midpoint", 1e-3),
    ("generalised_alpha", 1e-3), ("extrapolated_euler_5", 2e-3), ("extrapolated_euler_5", None), ("ros2", None),
    ("dopri5", None), ("dop853", None),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("name", "step"), PARTED)
def test_a_run_in_many_calls_has_the_bits_of_the_run_in_one(name, step, monkeypatch):
    """Between calls Ctrl-C is heard. The torque changes with time, outputs fall between and within calls."""
    whole = fm.simulate(scene(), method=name, step=step)
    assert whole.status == "ok" and whole.evaluations > 100
    for most in (1, 7, whole.evaluations // 2):
        monkeypatch.setattr("flexman_gym.simulation.integrator.evaluations_per_call", lambda constants, most=most: most)
        parted = fm.simulate(scene(), method=name, step=step)
        assert np.array_equal(parted.states, whole.states) and parted.evaluations == whole.evaluations
        assert np.array_equal(parted.work, whole.work)


@pytest.mark.slow
def test_a_run_in_many_calls_ends_where_it_diverges(monkeypatch):
    wild = replace(scene(), torque=fm.ConstantTorque([1e6, 0.0]), output_step=DURATION / 500)
    for name, step, most in (("rk4", 1e-3, 7), ("dop853", None, 1001)):
        whole = fm.simulate(wild, method=name, step=step)
        with monkeypatch.context() as patch:
            patch.setattr("flexman_gym.simulation.integrator.evaluations_per_call", lambda constants, most=most: most)
            parted = fm.simulate(wild, method=name, step=step)
        assert whole.status == parted.status != "ok"
        assert np.array_equal(whole.states, parted.states) and 1 < len(whole.time) < 500


SHARES = [(1, 1), (11, 1), (150, 2)]  # an arm alone, groups of arms, and groups in two threads


@pytest.mark.parametrize("most", [1, 40, 10**6])
@pytest.mark.parametrize(("arms", "threads"), SHARES)
def test_a_long_control_period_has_the_bits_of_one_call(arms, threads, most, monkeypatch):
    """In calls of a step, of some steps or of some groups; arms that fail stay where they were before the period."""
    model = fm.build_model(scene().arm, 1)
    drive = np.random.default_rng(0).normal(size=(arms, 8))
    drive[arms // 2 :: 5, 0] = 1e9  # these fail within the period
    whole = Batch(model, "ros2", 0.001, 0.01, arms=arms, threads=threads)
    monkeypatch.setattr("flexman_gym.simulation.batch_integrators.evaluations_per_call", lambda constants: 8 * most)
    parted = Batch(model, "ros2", 0.001, 0.01, arms=arms, threads=threads)
    for _ in range(2):
        for batch in (whole, parted):
            batch.step(drive)
        assert np.array_equal(whole.rows, parted.rows) and np.array_equal(whole.outputs, parted.outputs)
        assert np.array_equal(whole.status, parted.status) and whole.status.any()


@pytest.mark.slow
@pytest.mark.parametrize("most", [1, 3, 10, 40])
@pytest.mark.parametrize("method", ["ros2", "midpoint_3", "gauss_2", "extrapolated_euler_3"])
def test_scenes_side_by_side_in_many_calls_have_the_bits_of_one(method, most, monkeypatch):
    """Ten steps a row; the torques of a scene are too large, and end it in the middle."""
    torques = [fm.SineTorque((size, 1.0), (1.0, 2.0), (0.3, 0.0)) for size in (*range(9), 1e8)]
    scenes = [replace(scene(), torque=torque) for torque in torques]
    whole = fm.simulate_all(scenes, method=method, step=0.005)
    stages = {"ros2": 2, "midpoint_3": 3, "gauss_2": 5, "extrapolated_euler_3": 6}[method]
    monkeypatch.setattr(
        "flexman_gym.simulation.batch_integrators.evaluations_per_call", lambda constants: 4 * stages * most
    )
    parted = fm.simulate_all(scenes, method=method, step=0.005)
    assert whole[-1].status == "diverged" and whole[0].status == "ok"
    for one, other, each in zip(whole, parted, scenes, strict=True):
        assert one.status == other.status and np.array_equal(one.states, other.states)
        assert np.array_equal(one.tip, other.tip) and one.evaluations == other.evaluations
        assert np.array_equal(one.states, fm.simulate(each, method=method, step=0.005).states)


@pytest.mark.parametrize(("arms", "threads"), SHARES)
def test_a_control_period_that_is_broken_off_has_not_been(arms, threads, monkeypatch):
    """As by Ctrl-C between two calls; no other thread goes on with the arms."""
    model, calls = fm.build_model(scene().arm, 1), []
    monkeypatch.setattr("flexman_gym.simulation.batch_integrators.evaluations_per_call", lambda constants: 1)
    batch, other = (Batch(model, "ros2", 0.001, 0.01, arms=arms, threads=threads) for _ in range(2))
    pressed = threading.Event()
    name = "advance_single" if arms == 1 else "advance_batch"
    kernel, main = getattr(batch_integrators.kernels, name), threading.get_ident()

    def broken(*arguments):
        kernel(*arguments)
        calls.append(threading.get_ident())
        if calls[-1] != main:
            pressed.wait(10.0)
        elif calls.count(main) == 3:
            pressed.set()
            raise KeyboardInterrupt

    before = batch.rows.copy()
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(batch_integrators.kernels, name, broken)
        batch.step(np.ones((arms, 8)))
    assert np.array_equal(batch.rows, before) and len(calls) < 50  # of 190
    for each in (batch, other):
        each.step(np.ones((arms, 8)))
    assert np.array_equal(batch.rows, other.rows)


def break_off(monkeypatch, simulator, module, name):
    """Break off a control period after the first call of a kernel, as by Ctrl-C; return the integrator."""
    run, called = simulator.batch._mover._integrators[0], getattr(module, name)
    run._max_evaluations = 30

    def broken(*arguments):
        called(*arguments)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(module, name, broken)
        simulator.step([1.0, 0.0])
    return run


def test_a_run_that_was_broken_off_leaves_no_pause_behind(monkeypatch):
    """As by Ctrl-C between two calls of the kernel: the next run begins at its own beginning."""
    model = fm.build_model(scene().arm, 1)
    simulators = [fm.Simulator(model, "dopri5", None) for _ in range(2)]
    run = break_off(monkeypatch, simulators[0], integrator.runge_kutta, "run_adaptive")
    assert run.work.progress[0] == 1.0
    for simulator in simulators:
        simulator.step([1.0, 0.0])
    np.testing.assert_allclose(simulators[0].state, simulators[1].state, rtol=0.0, atol=1e-6)
    for simulator in simulators:
        simulator.reset()
        simulator.step([1.0, 0.0])
    assert np.array_equal(simulators[0].state, simulators[1].state)


@pytest.mark.parametrize("name", ["generalised_alpha", "implicit_midpoint"])
def test_implicit_steps_that_were_broken_off_leave_a_guess_behind(name, monkeypatch):
    """As by Ctrl-C after some steps: the accelerations of the last step are the first guess of the next one."""
    model = fm.build_model(scene().arm, 1)
    simulators = [fm.Simulator(model, name, 0.001) for _ in range(2)]
    run = break_off(monkeypatch, simulators[0], integrator.batch, "run_steps")
    assert run.work.stages[1].any() and not simulators[0].state.any()
    if name == "implicit_midpoint":
        for simulator in simulators:
            simulator.step([1.0, 0.0])
        np.testing.assert_allclose(simulators[0].state, simulators[1].state, rtol=0.0, atol=1e-9)
    for simulator in simulators:
        simulator.reset()
        simulator.step([1.0, 0.0])
    assert np.array_equal(simulators[0].state, simulators[1].state)


LONG_RUNS = """
import signal, numpy as np, flexman_gym as fm
from dataclasses import replace
from flexman_gym.simulation.batch import Batch
signal.signal(signal.SIGINT, signal.default_int_handler)  # a child of a shell's background job ignores it
scene = fm.catalog.paper_scene("ff")
model = fm.build_model(scene.arm, 8, stiffening=True)
def run(method, step):
    def work(time): fm.simulate(replace(scene, duration=time, output_step=time), model, method, step)
    return work
def together(time): fm.simulate_all([replace(scene, duration=time, output_step=time)] * 16, model, "ros2", 1e-5)
def simulator(time): fm.Simulator(model, "ros2", 1e-5, time).step(np.zeros(3))
def batch(time): Batch(model, "ros2", 1e-5, time, arms=64, threads=2).step(np.zeros((64, 9)))
for work, little, much in (
    (run("dop853", None), 1e-6, 1e4), (run("rk4", 1e-6), 1e-6, 0.1),
    (together, 1e-5, 1.0), (simulator, 1e-5, 1.0), (batch, 1e-5, 1.0),
):
    work(little)  # loads the kernels
    try:
        print("begun", flush=True)
        work(much)
    except KeyboardInterrupt:
        print("interrupted", flush=True)
"""


@pytest.mark.slow
def test_ctrl_c_ends_a_long_run_soon():
    """Each of them would take minutes, a stiff one of an adaptive method hours."""
    child = subprocess.Popen([sys.executable, "-c", LONG_RUNS], stdout=subprocess.PIPE, text=True)
    try:
        for _ in range(5):
            assert child.stdout.readline() == "begun\n"
            time.sleep(0.3)  # it is in a kernel now
            child.send_signal(signal.SIGINT)
            assert select.select([child.stdout], [], [], 10.0)[0], "nobody heard Ctrl-C for 10 s"
            assert child.stdout.readline() == "interrupted\n"
        assert child.wait(10.0) == 0
    finally:
        child.kill()
        child.stdout.close()
