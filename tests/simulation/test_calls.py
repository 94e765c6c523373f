"""Calls: a long run is made in several calls of its kernel, between which Ctrl-C is heard, to the same bits."""

import select
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.simulation import movers
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.run import Run

DURATION = 0.5  # s


def scene():
    """A rigid 2R arm on damped springs, swung by sine torques."""
    arm = fm.catalog.planar_2r(joint_stiffness=50.0, payload=fm.Payload(0.2), gravity=(0.0, -9.81, 0.0))
    torque = fm.SineTorque((2.0, 1.0), (1.0, 2.0), (0.3, 0.0))
    choice = fm.ModelChoice(flexible_links=False, elements=1)
    return fm.Scene(arm, choice, torque, fm.Initial((0.4, -0.6), (1.0, 0.5)), DURATION, DURATION / 10)


PARTED = [
    ("rk4", 1e-3), ("ros2", 1e-3), ("midpoint_3_sweeps", 1e-3), ("gauss_2_sweeps", 1e-3), ("implicit_midpoint", 1e-3),
    ("generalised_alpha", 1e-3), ("extrapolated_euler_5", 2e-3), ("extrapolated_euler_5", None), ("ros2", None),
    ("dopri5", None), ("dop853", None),
]  # fmt: skip


@pytest.mark.parametrize(("name", "step"), PARTED)
def test_a_run_in_many_calls_has_the_bits_of_the_run_in_one(name, step, monkeypatch):
    """Between calls Ctrl-C is heard. The torque changes with time, outputs fall between and within calls."""
    whole = fm.simulate(scene(), method=name, step=step)
    assert whole.status == "ok" and whole.evaluations > 100
    for most in (1, 7, whole.evaluations // 2):
        monkeypatch.setattr("flexman_gym.simulation.run.evaluations_of_a_call", lambda constants, most=most: most)
        parted = fm.simulate(scene(), method=name, step=step)
        assert np.array_equal(parted.states, whole.states) and parted.evaluations == whole.evaluations
        assert np.array_equal(parted.work, whole.work)


def test_a_run_in_many_calls_ends_where_it_diverges(monkeypatch):
    wild = replace(scene(), torque=fm.ConstantTorque([1e6, 0.0]), output_step=DURATION / 500)
    for name, step, most in (("rk4", 1e-3, 7), ("dop853", None, 1001)):
        whole = fm.simulate(wild, method=name, step=step)
        with monkeypatch.context() as patch:
            patch.setattr("flexman_gym.simulation.run.evaluations_of_a_call", lambda constants, most=most: most)
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
    monkeypatch.setattr("flexman_gym.simulation.movers.evaluations_of_a_call", lambda constants: 8 * most)
    parted = Batch(model, "ros2", 0.001, 0.01, arms=arms, threads=threads)
    for _ in range(2):
        for batch in (whole, parted):
            batch.step(drive)
        assert np.array_equal(whole.rows, parted.rows) and np.array_equal(whole.outputs, parted.outputs)
        assert np.array_equal(whole.status, parted.status) and whole.status.any()


@pytest.mark.parametrize("most", [1, 3, 10, 40])
@pytest.mark.parametrize("method", ["ros2", "midpoint_3_sweeps", "gauss_2_sweeps", "extrapolated_euler_3"])
def test_scenes_side_by_side_in_many_calls_have_the_bits_of_one(method, most, monkeypatch):
    """Ten steps a row; the torques of a scene are too large, and end it in the middle."""
    torques = [fm.SineTorque((size, 1.0), (1.0, 2.0), (0.3, 0.0)) for size in (*range(9), 1e8)]
    scenes = [replace(scene(), torque=torque) for torque in torques]
    whole = fm.simulate_all(scenes, method=method, step=0.005)
    stages = {"ros2": 2, "midpoint_3_sweeps": 3, "gauss_2_sweeps": 5, "extrapolated_euler_3": 6}[method]
    monkeypatch.setattr("flexman_gym.simulation.movers.evaluations_of_a_call", lambda constants: 4 * stages * most)
    parted = fm.simulate_all(scenes, method=method, step=0.005)
    assert whole[-1].status == "diverged" and whole[0].status == "ok"
    for one, other, given in zip(whole, parted, scenes, strict=True):
        assert one.status == other.status and np.array_equal(one.states, other.states)
        assert np.array_equal(one.tip, other.tip) and one.evaluations == other.evaluations
        assert np.array_equal(one.states, fm.simulate(given, method=method, step=0.005).states)


@pytest.mark.parametrize(("arms", "threads"), SHARES)
def test_a_control_period_that_is_broken_off_has_not_been(arms, threads, monkeypatch):
    """As by Ctrl-C between two calls; no other thread goes on with the arms."""
    model, calls = fm.build_model(scene().arm, 1), []
    monkeypatch.setattr("flexman_gym.simulation.movers.evaluations_of_a_call", lambda constants: 1)
    batch, other = (Batch(model, "ros2", 0.001, 0.01, arms=arms, threads=threads) for _ in range(2))
    pressed = threading.Event()
    name = "advance_one" if arms == 1 else "advance_arms"
    kernel, main = getattr(movers.kernels, name), threading.get_ident()

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
        patch.setattr(movers.kernels, name, broken)
        batch.step(np.ones((arms, 8)))
    assert np.array_equal(batch.rows, before) and len(calls) < 50  # of 190
    for each in (batch, other):
        each.step(np.ones((arms, 8)))
    assert np.array_equal(batch.rows, other.rows)


@pytest.mark.parametrize("name", ["dopri5", "generalised_alpha", "implicit_midpoint"])
def test_a_run_that_was_broken_off_leaves_no_pause_behind(name, monkeypatch):
    """As by Ctrl-C between two calls of the kernel: the next run begins at its own beginning."""
    model = fm.build_model(scene().arm, 1)
    simulators = [fm.Simulator(model, name, None if name == "dopri5" else 0.001) for _ in range(2)]
    run, called = simulators[0].batch._mover._runs[0], Run._called
    run._most = 30

    def broken(*arguments):
        called(*arguments)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Run, "_called", broken)
        simulators[0].step([1.0, 0.0])
    assert run.work.progress[0] == 1.0
    if name == "implicit_midpoint":  # of which only a guess is left
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
