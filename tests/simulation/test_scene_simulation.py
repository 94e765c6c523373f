"""Several scenes side by side: each moves as it does by itself, to the bit."""

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.scene.signals import PiecewiseSignals
from flexman_gym.simulation import scene_simulation
from flexman_gym.simulation.batch_integrators import LaneIntegrator
from flexman_gym.simulation.integrator import Integrator

from oracles.assertions import refusal

FIELDS = ("time", "states", "tip", "tip_velocity", "energy", "work", "dissipation", "evaluations", "status")
COUNT = 11  # more than one group, and one that is not full


def scenes(stiffening=False, held=False):
    """The paper's arm from different states, under different torques, pushes and accelerations of its base."""
    random, result = np.random.default_rng(3), []
    choice = fm.ModelChoice(True, 1, 3, stiffening=stiffening)
    for i in range(COUNT):
        amplitude = random.uniform(-100.0, 100.0, 3) * (1.0, 0.0 if held else 1.0, 1.0)
        torque = fm.SineTorque(amplitude, random.uniform(0.5, 3.0, 3), random.uniform(-1.0, 1.0, 3))
        start = fm.Initial(random.uniform(-1.0, 1.0, 3), random.uniform(-1.0, 1.0, 3))
        push = [fm.Signal(), fm.Signal(10.0 * i, start=0.01 * i, stop=0.013 * i + 0.01), fm.Signal()]
        base = [fm.Signal(amplitude=0.1 * i, frequency_hz=2.0), fm.Signal(), fm.Signal()]
        motion = [None, fm.Signal(amplitude=1.0, frequency_hz=1.0 + i), None] if held else None
        scene = fm.Scene(fm.catalog.paper_rrr(payload=fm.Payload(2.0)), choice, torque, start, 0.2, 0.02)
        result.append(replace(scene, prescribed=motion, tip_force=push, base_acceleration=base))
    return result


def same(result, expected):
    """Whether two trajectories are equal, to the bit."""
    return all(np.array_equal(getattr(result, name), getattr(expected, name)) for name in FIELDS)


@pytest.mark.parametrize("method", ["ros2", "extrapolated_euler_5", "gauss_2", "generalised_alpha", "rk4"])
@pytest.mark.parametrize(("stiffening", "held"), [(False, False), (True, True)])
@pytest.mark.parametrize("step", [0.005, 0.04])
def test_each_scene_moves_as_by_itself(method, stiffening, held, step):
    if method == "rk4":
        step = 2e-4
    given = scenes(stiffening, held)
    result = fm.simulate_all(given, method=method, step=step)
    assert len(result) == COUNT and len({run.tip[-1, 0] for run in result}) == COUNT
    for run, scene in zip(result, given, strict=True):
        assert run.status == "ok" and same(run, fm.simulate(scene, method=method, step=step))


@pytest.mark.parametrize("method", ["ros2", "midpoint_2", "gauss_2", "rk4"])
def test_parameters_are_those_of_a_model_built_with_them(method):
    """A payload without inertia of its own only has a mass; joint stiffness leaves the modes as they are."""
    scene, masses = scenes()[0], np.array([1.0, 2.0, 4.0])
    scene = replace(scene, model=replace(scene.model, modes=None))
    stiffness = np.array([[1e4, 2e4, 1e4], [2e4, 2e4, 2e4], [3e4, 1e4, 2e4]])
    step = 1e-4 if method == "rk4" else 0.01
    result = fm.simulate_all([scene] * 3, method=method, step=step, payload_mass=masses, joint_stiffness=stiffness)
    for run, mass, springs in zip(result, masses, stiffness, strict=True):
        joints = [replace(joint, stiffness=spring) for joint, spring in zip(scene.arm.joints, springs, strict=True)]
        arm = replace(scene.arm, payload=fm.Payload(mass), joints=joints)
        alone = fm.simulate(replace(scene, arm=arm), method=method, step=step)
        assert np.abs(run.tip - alone.tip).max() < 1e-9
    assert np.abs(result[0].tip - result[2].tip).max() > 1e-4


@pytest.mark.parametrize("method", ["ros2", "midpoint_3"])
def test_a_scene_that_diverges_ends_alone(method):
    given = scenes()
    for i, rate in ((2, 9e5), (9, 3e5)):
        given[i] = replace(given[i], initial=fm.Initial((0.0,) * 3, (rate, 0.0, -rate)))
    result = fm.simulate_all(given, method=method, step=0.01)
    assert [run.status for run in result].count("diverged") >= 1 and result[2].status == "diverged"
    for run, scene in zip(result, given, strict=True):
        assert same(run, fm.simulate(scene, method=method, step=0.01))


def test_methods_that_choose_their_steps_and_single_scenes_are_simulated_too():
    given = scenes()[:2]
    for run, scene in zip(fm.simulate_all(given, rtol=1e-4), given, strict=True):
        assert same(run, fm.simulate(scene, rtol=1e-4))
    (run,) = fm.simulate_all(given[:1], step=0.01)
    assert same(run, fm.simulate(given[0], step=0.01))


def test_threads_share_the_scenes(monkeypatch):
    given = (scenes() * 13)[:137]
    expected = fm.simulate_all(given, step=0.02)
    used, real = [], LaneIntegrator._run_in_threads

    def counted(self, task):
        used.append(len(self._thread_groups))
        real(self, task)

    monkeypatch.setattr(LaneIntegrator, "_run_in_threads", counted)
    assert all(map(same, fm.simulate_all(given, step=0.02, threads=3), expected)) and {*used} == {3}


def test_scenes_that_cannot_stand_beside_each_other_are_refused_in_one_line():
    one = scenes()[0]
    for other, field in (
        (replace(one, duration=0.4), r"scenes\[1\].duration"),
        (replace(one, output_step=0.01), r"scenes\[1\].output_step"),
        (replace(one, arm=fm.catalog.paper_rrr()), r"scenes\[1\].arm"),
        (replace(one, model=fm.ModelChoice(True, 2)), r"scenes\[1\].model"),
        (scenes(held=True)[0], r"scenes\[1\]"),
        ("a scene", r"scenes\[1\]"),
    ):
        assert re.match(field, refusal(lambda other=other: fm.simulate_all([one, other], step=0.01)))
    assert refusal(lambda: fm.simulate_all([], step=0.01)).startswith("scenes")
    for field, options in {
        "payload_mass": {"payload_mass": [-1.0]}, "parameters": {"weight": [1.0]}, "threads": {"threads": 0},
    }.items():  # fmt: skip
        assert refusal(lambda options=options: fm.simulate_all([one], step=0.01, **options)).startswith(field)


ARM = fm.catalog.planar_2r()
CHOICE = fm.ModelChoice(True, 1, 2)
MODEL = fm.build_model(ARM, 1, 2)
SINE = fm.SineTorque([0.3, 0.1], [1.5, 2.0], [0.4, -0.3])
SCENE = fm.Scene(ARM, CHOICE, SINE, fm.Initial([0.3, -0.4], [0.0, 0.0]), 0.4, 0.02)
ROTOR = fm.Arm([fm.Link(0.1, 1e-6, 1e-13, 1e-13, 1e-13, 7e10, 2.6e10, 1e-3)], [fm.Joint((0.0, 0.0, 1.0), 2.0)])
UNEVEN = np.array([0.0, 0.013, 0.1, 0.1004, 0.277, 0.5])
PUSHES = np.array([3.0, -8.0, 5.0, 40.0, -1.0, 2.0])


def sampled(hold, period, duration=0.4):
    return fm.SampledTorque.from_function(SINE.at, duration, period, hold)


@pytest.mark.parametrize(("hold", "order"), [("zero", 1), ("linear", 2)])
def test_a_scene_driven_by_samples_of_a_sine_is_that_of_the_sine_to_the_order_of_the_interpolation(hold, order):
    truth = fm.simulate(SCENE, MODEL, rtol=1e-9, atol=1e-12).states
    errors = []
    for period in (0.02, 0.01, 0.005):
        scene = replace(SCENE, torque=sampled(hold, period))
        errors.append(np.abs(fm.simulate(scene, MODEL, rtol=1e-9, atol=1e-12).states - truth).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.25)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(order, abs=0.25) and errors[2] < 0.1


@pytest.mark.parametrize("method", fm.METHODS)
@pytest.mark.parametrize("hold", ["zero", "linear"])
def test_every_method_sees_jumps_and_bends_when_they_are(method, hold):
    """The rate of a free rotor is the integral of its torque over its inertia, whatever the steps are."""
    torque = fm.SampledTorque(UNEVEN, PUSHES[:, None], hold)
    scene = fm.Scene(ROTOR, fm.ModelChoice(False, 1), torque, fm.Initial([0.0], [0.0]), 0.5, 0.05)
    kind = fm.METHODS[method]
    result = fm.simulate(scene, method=method, step=None if kind.kind == "reference" else 0.01, rtol=1e-8, atol=1e-10)
    moments = np.unique(np.concatenate([UNEVEN, result.time]))
    ends = np.interp(moments, UNEVEN, PUSHES)
    held = PUSHES[np.searchsorted(UNEVEN, moments, "right")[:-1] - 1]
    means = held if hold == "zero" else 0.5 * (ends[1:] + ends[:-1])
    given = np.append(0.0, np.cumsum(means * np.diff(moments)))
    inertia = fm.mass_matrix(result.model, np.zeros(2))[0, 0]
    expected = np.interp(result.time, moments, given) / inertia
    # a rule of order 1 is off by half its steps; generalised-alpha keeps an acceleration of before the bend
    first = 0.5 * 0.01 * np.abs(np.diff(PUSHES)).sum() / inertia
    exact = first if kind.order == 1 else 0.01 * first if method == "generalised_alpha" else 1e-9
    np.testing.assert_allclose(result.states[:, 1], expected, atol=1e-9 if hold == "zero" else exact)


@pytest.mark.parametrize("method", ["midpoint_3", "ros2", "rk4", "generalised_alpha"])
def test_held_samples_move_an_arm_as_a_simulator_does_period_by_period(method):
    """To the bit, and the simulator's trajectory is the same one."""
    step = 2e-5 if method == "rk4" else 0.0025
    scene = replace(SCENE, duration=0.04, torque=sampled("zero", 0.01, 0.04), output_step=0.01)
    result = fm.simulate(scene, MODEL, method, step)
    simulator = fm.Simulator(MODEL, method, step, 0.01)
    simulator.record()
    simulator.step([1.0, 1.0])
    simulator.reset([0.3, -0.4])
    for torque in scene.torque.values[:4]:
        assert simulator.step(torque) == "ok"
    kept = simulator.trajectory()
    assert kept.status == "ok" and kept.time.tolist() == pytest.approx(result.time.tolist())
    for name in ("states", "tip", "work", "dissipation", "energy", "deflection"):
        assert np.array_equal(getattr(kept, name), getattr(result, name)), name


def test_a_trajectory_is_kept_on_request_alone_and_counts_from_there():
    simulator = fm.Simulator(MODEL)
    simulator.step([0.1, 0.0])
    with pytest.raises(RuntimeError, match="call record"):
        simulator.trajectory()
    simulator.record()
    simulator.step([0.1, 0.0])
    kept = simulator.trajectory()
    assert len(kept.time) == 2 and kept.work[0] == 0.0 < kept.work[1]
    assert np.abs(kept.energy_residual).max() < 1e-6 * simulator.energy_turnover
    assert np.array_equal(kept.states[-1], simulator.state)


@pytest.mark.parametrize("method", ["midpoint_3", "gauss_2", "ros2"])
def test_scenes_with_samples_of_equal_moments_move_side_by_side_as_alone(method):
    times, random = np.array([0.0, 0.004, 0.0071, 0.02, 0.05]), np.random.default_rng(2)
    given = [
        replace(
            SCENE, torque=fm.SampledTorque(times, random.normal(size=(5, 2)), "linear"), duration=0.05, output_step=0.01
        )
        for _ in range(3)
    ]
    for scenes in (given, [*given[:2], replace(given[2], torque=SINE)]):
        for run, scene in zip(fm.simulate_all(scenes, MODEL, method, 0.0025), scenes, strict=True):
            alone = fm.simulate(scene, MODEL, method, 0.0025)
            assert run.status == "ok" and run.evaluations == alone.evaluations
            assert all(np.array_equal(getattr(run, name), getattr(alone, name)) for name in ("states", "tip", "energy"))


@pytest.mark.parametrize("calm_samples, end", [(3, 0.02), (1, 0.0)])
def test_a_scene_that_fails_beside_others_ends_where_it_does_alone(calm_samples, end):
    """Other scenes go on, over several pieces of the drive."""
    times = np.array([0.0, 0.004, 0.0071, 0.02, 0.05])
    calm = replace(SCENE, torque=fm.SampledTorque(times, np.zeros((5, 2))), duration=0.05, output_step=0.01)
    wild = replace(
        calm, torque=fm.SampledTorque(times, [[0.0, 0.0]] * calm_samples + [[1e12, 1e12]] * (5 - calm_samples))
    )
    for run, scene in zip(fm.simulate_all([wild, calm], MODEL, "ros2", 0.0025), (wild, calm), strict=True):
        alone = fm.simulate(scene, MODEL, "ros2", 0.0025)
        assert run.status == alone.status and np.array_equal(run.states, alone.states)
    failed = fm.simulate(wild, MODEL, "ros2", 0.0025)
    assert failed.status == "diverged" and failed.time[-1] == pytest.approx(end)
    assert failed.explanation().startswith("the simulation diverged: ") and f"at {end:g}" in failed.explanation()


def test_a_joint_follows_the_angles_that_were_measured():
    times = np.linspace(0.0, 0.4, 41)
    angles = 0.2 * np.cos(8.0 * times)
    motion = fm.SampledAngles(times, angles)
    scene = replace(SCENE, torque=fm.ConstantTorque([0.0, 0.1]), prescribed=[motion, None])
    result = fm.simulate(scene, MODEL, rtol=1e-9, atol=1e-11)
    assert result.motor_angles[:, 0] == pytest.approx(angles[::2], abs=1e-7)
    assert np.abs(result.energy_residual).max() < 1e-7 * result.energy_turnover[-1]
    coarse = fm.simulate(scene, MODEL, "midpoint_3", 0.005)
    assert coarse.motor_angles[:, 0] == pytest.approx(angles[::2], abs=1e-4), "and does not drift away"


@pytest.mark.parametrize("name", ["tip_force", "base_acceleration"])
def test_sampled_pushes_are_the_pulses_that_they_sample(name):
    pulse, still = fm.Signal(0.5, start=0.1, stop=0.25), fm.Signal()
    steps = fm.SampledSignal([0.0, 0.1, 0.25, 0.5], [0.0, 0.5, 0.0, 0.0])
    runs = [
        fm.simulate(replace(SCENE, **{name: [still, one, still]}), MODEL, rtol=1e-9, atol=1e-12)
        for one in (pulse, steps)
    ]
    assert np.ptp(runs[0].tip[:, 1]) > 1e-3
    np.testing.assert_allclose(runs[1].states, runs[0].states, atol=1e-6 * np.abs(runs[0].states).max())


def test_intervals_fill_the_time_and_begin_anew_at_any_output():
    pieces = PiecewiseSignals([fm.SampledSignal(UNEVEN, PUSHES), fm.Signal()], 0.5)
    made = list(scene_simulation._integration_intervals(pieces, 0.05, 4, range(10)))
    ends = [call.grid[0] + call.grid[1] * call.grid[2] * max(call.rows, 1) for call in made]
    assert [call.grid[0] for call in made] == pytest.approx([0.0, *ends[:-1]]) and ends[-1] == pytest.approx(0.5)
    assert all(call.grid[1] <= 0.0125 * (1.0 + 1e-9) for call in made)
    for moment in UNEVEN:
        assert not any(start + 1e-9 < moment < end - 1e-9 for start, end in pairwise([0.0, *ends]))
    assert sum(call.rows for call in made) + sum(call.complete and not call.rows for call in made) == 10
    again = list(scene_simulation._integration_intervals(pieces, 0.05, 4, range(5, 6)))
    assert [call for call in made if call.row == 5 and call.rows < 2] == again or again[0].rows == 1


def test_calls_fill_the_time_and_none_goes_over_a_sample(monkeypatch):
    """Each call integrates from its start by its number of rows, steps between them and step."""
    calls, integrate = [], Integrator.__call__

    def watched(self, drive, moment, state, rows, outputs):
        calls.append((moment[0], moment[1], moment[0] + moment[1] * moment[2] * len(rows)))
        return integrate(self, drive, moment, state, rows, outputs)

    monkeypatch.setattr(Integrator, "__call__", watched)
    torque = fm.SampledTorque(UNEVEN, PUSHES[:, None])
    scene = fm.Scene(ROTOR, fm.ModelChoice(False, 1), torque, fm.Initial([0.0], [0.0]), 0.5, 0.05)
    assert len(fm.simulate(scene, method="midpoint_3", step=0.0125).time) == 11
    starts, steps, ends = (list(each) for each in zip(*calls, strict=True))
    assert starts == pytest.approx([0.0, *ends[:-1]]) and ends[-1] == pytest.approx(0.5)
    assert max(steps) <= 0.0125 * (1.0 + 1e-9)
    for moment in UNEVEN:
        assert not any(start + 1e-9 < moment < end - 1e-9 for start, end in pairwise([0.0, *ends]))
