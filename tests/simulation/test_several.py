"""Several scenes side by side: each moves as it does by itself, to the bit."""

import re
from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.simulation.movers import Abreast

from oracles.refusals import refusal

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


@pytest.mark.parametrize("method", ["ros2", "extrapolated_euler_5", "gauss_2_sweeps", "generalised_alpha", "rk4"])
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


@pytest.mark.parametrize("method", ["ros2", "midpoint_2_sweeps", "gauss_2_sweeps", "rk4"])
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


@pytest.mark.parametrize("method", ["ros2", "midpoint_3_sweeps"])
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
    used, real = [], Abreast._share
    monkeypatch.setattr(Abreast, "_share", lambda self, share: (used.append(len(self._shares)), real(self, share))[1])
    assert all(map(same, fm.simulate_all(given, step=0.02, threads=3), expected)) and used == [3]


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
