"""Tests of the arms in other simulators against ours: mass, tip position, frequencies, motion."""

import importlib
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh

import flexman_gym as fm
from flexman_gym.toolbox.interchange.mjcf import to_mjcf
from flexman_gym.toolbox.precision.peers.peer_run import with_rigid_joints
from flexman_gym.toolbox.precision.runs import PrecisionRow
from studies.peers import measure
from studies.peers.measure import decay, decays
from studies.precision.measure import cost_at

from oracles.files import REFERENCE

ARM, SCENE = fm.catalog.paper_rrr(), fm.catalog.paper_scene("ff")
ROW = PrecisionRow("paper_ff", "2 elements a link", "ros2", 1e-3, None, 0.02, 0.02, 1e3, 2e-3, 3e-2, "ok")


@pytest.fixture(scope="module")
def exudyn_peer():
    """Return the module of the Exudyn models."""
    try:
        return importlib.import_module("flexman_gym.toolbox.precision.peers.exudyn")
    except ModuleNotFoundError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def pinocchio_peer():
    """Return the module of the Pinocchio models."""
    pytest.importorskip("pinocchio")
    return importlib.import_module("flexman_gym.toolbox.precision.peers.pinocchio")


def short(arm, duration=0.2):
    """Return the paper's scene with another arm and duration (s)."""
    n = len(arm.links)
    model = fm.ModelChoice((True,) * n, (2,) * n)
    initial = fm.Initial((0.0,) * n, (0.0,) * n)
    torque = fm.ConstantTorque((400.0,) * n)
    return replace(SCENE, arm=arm, model=model, initial=initial, torque=torque, duration=duration)


def ours(scene, step=1e-4, **choice):
    """Return the tip (T, 3) of our model in a scene."""
    return fm.simulate(scene, fm.build_model(scene.arm, **choice), "implicit_midpoint", step=step).tip


@pytest.mark.parametrize("pieces", [0, 1, 4])
def test_mujoco_has_mass_and_tip_of_the_arm(mujoco, mujoco_peer, pieces):
    model = mujoco.MjModel.from_xml_string(to_mjcf(ARM, pieces, "Euler", 1e-3))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert model.body_mass.sum() == pytest.approx(sum(link.mass for link in ARM.links), rel=1e-9)
    assert np.allclose(data.site("tip").xpos, (7.5, 0.0, 1.0), rtol=0.0, atol=1e-9)
    assert model.nv == 3 * (2 + 3 * pieces)


def test_lowest_frequencies_of_mujoco_are_those_of_our_model(mujoco, mujoco_peer):
    model = mujoco.MjModel.from_xml_string(to_mjcf(ARM, 16, "Euler", 1e-3))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    columns = np.eye(model.nv)
    mass = np.zeros((model.nv, model.nv))
    for column, out in zip(columns, mass, strict=True):
        mujoco.mj_mulM(model, data, out, column)
    stiffness = np.diag(np.reshape(model.jnt_stiffness, (model.njnt, -1))[:, 0])
    result = np.sqrt(np.abs(eigh(stiffness, mass, eigvals_only=True))) / (2 * np.pi)
    expected = fm.frequencies(fm.build_model(ARM, elements=3))
    assert np.all(result[:3] < 1e-3) and np.all(expected[:3] < 1e-3)
    assert np.allclose(result[3:12], expected[3:12], rtol=0.01)


def test_a_step_of_mujoco_that_is_too_long_is_seen(mujoco_peer):
    assert not mujoco_peer.run(SCENE, 4, "Euler", 1e-3).finite
    with pytest.raises(ValueError, match=r"step: 0.003 is not allowed"):
        mujoco_peer.run(SCENE, 4, "Euler", 3e-3)


def test_a_short_run_of_mujoco_is_near_ours(mujoco_peer):
    scene = short(ARM)
    result = mujoco_peer.run(scene, 4, "RK4", 1e-4)
    assert result.finite and result.cpu > 0.0
    assert result.distance(ours(scene, step=1e-3)) < 2e-3


@pytest.mark.parametrize("integrator", ["Euler", "implicit", "implicitfast", "RK4", "discrete"])
def test_integrators_of_mujoco_take_from_the_lowest_mode_what_their_formulas_say(mujoco_peer, integrator):
    step = 1e-3 if integrator == "discrete" else 5e-5
    rows = [replace(ROW, model="MuJoCo, 4 pieces", method=integrator, step=step)]
    *_, last = decays(ARM, rows)
    assert (last.integrator, last.step) == (f"MuJoCo, 4 pieces, {integrator}", step)
    omega = 2 * np.pi * 4.4945  # of four pieces
    expected = 1.0 - (1.0 + (omega * step) ** 2) ** (-0.5 / step) if integrator == "discrete" else 0.0
    assert last.loss == pytest.approx(expected, rel=1e-3, abs=1e-8)


def test_our_methods_take_nothing_from_the_lowest_mode():
    shares = {row.integrator: row.loss for row in decays(ARM, [])}
    assert list(shares) == ["ours, midpoint_2", "ours, gauss_3"]
    assert max(abs(share) for share in shares.values()) < 1e-8


def test_a_decay_is_that_of_all_steps_of_a_second():
    assert decay(0.99j, 0.01) == pytest.approx(1.0 - 0.99**100)


@pytest.mark.parametrize("pieces", [2, 4])
def test_arms_of_mujoco_abreast_move_as_one_alone(mujoco_peer, pieces):
    tips = mujoco_peer.batched_arms(SCENE, pieces, 1e-4 / 1.6, 3, 2)
    alone = mujoco_peer.run(short(ARM, 0.05), pieces, "Euler", 1e-4 / 1.6)
    assert np.array_equal([next(tips) for _ in range(5)], alone.tip[1:])


def test_our_arms_abreast_move_as_one_alone():
    scene, model = short(ARM, 0.05), fm.build_model(ARM, 2, stiffening=True)
    tips = measure.our_arms(scene, model, "midpoint_2")
    alone = fm.simulate(scene, model, "midpoint_2", step=measure.STEP)
    assert np.allclose([next(tips) for _ in range(5)], alone.tip[1:], rtol=0.0, atol=1e-12)


@pytest.mark.slow
def test_soromox_moves_nearly_as_we_do():
    pytest.importorskip("soromox")
    scene = short(ARM, 0.2)
    result = importlib.import_module("studies.peers.soromox").run(scene)
    assert result.distance(ours(scene, elements=3, stiffening=True, step=1e-3)) < 5e-4


def test_rigid_links_of_mujoco_move_as_ours(mujoco_peer):
    result = mujoco_peer.run(SCENE, 0, "RK4", 1e-3)
    expected = fm.simulate(SCENE, fm.build_model(ARM, flexible_links=False), "rk4", step=1e-3)
    assert result.distance(expected.tip) < 1e-9


@pytest.mark.parametrize("peer_name", ["mujoco_peer", "pinocchio_peer"])
def test_rigid_arms_move_as_ours(peer_name, request):
    peer = request.getfixturevalue(peer_name)
    rigid = with_rigid_joints(SCENE)
    result = peer.run(rigid, 0, "RK4", 1e-3) if peer_name == "mujoco_peer" else peer.run(rigid, 1e-3)
    model = fm.build_model(ARM, flexible_links=False, flexible_joints=False)
    assert result.distance(fm.simulate(SCENE, model, "rk4", step=1e-3).tip) < 1e-9


def test_exudyn_moves_in_a_plane_as_we_do(exudyn_peer):
    arm = fm.Arm(ARM.links[1:], ARM.joints[1:])
    scene = short(arm, 0.5)
    result = [exudyn_peer.run(scene, step, tolerance=1e-7).distance(ours(scene)) for step in (1e-3, 2.5e-4)]
    assert result[0] < 5e-4 and result[1] < 3e-5


def test_exudyn_moves_in_space_nearly_as_we_do(exudyn_peer):
    result = exudyn_peer.run(SCENE, 1e-3, tolerance=1e-6)
    tip = ours(SCENE, step=2.5e-4)
    assert result.distance(tip) < 5e-3
    assert np.linalg.norm(result.tip - tip, axis=1)[:51].max() < 5e-4
    assert np.allclose(result.tip[0], (7.5, 0.0, 1.0), rtol=0.0, atol=1e-9) and result.cpu > 0.0


def test_quick_settings_of_exudyn_cost_no_accuracy(exudyn_peer):
    scene = short(ARM, 0.5)
    quick, default = (exudyn_peer.run(scene, 1e-3, method) for method in exudyn_peer.STEPS)
    assert quick.evaluations < 0.7 * default.evaluations
    assert quick.distance(default.tip) < 0.2 * default.distance(exudyn_peer.run(scene, 2.5e-4).tip)


def test_exudyn_refuses_what_it_does_not_model(exudyn_peer):
    with pytest.raises(ValueError, match="payload"):
        exudyn_peer.System(fm.catalog.paper_rrr(payload=fm.Payload(1.0)), (0.0,) * 3)


def test_costs_between_runs_follow_a_power_law():
    rows = [replace(ROW, time_error=error, cpu=cpu) for error, cpu in ((1e-2, 0.1), (1e-4, 1.0), (1e-6, 10.0))]
    assert cost_at(rows, 1e-3) == pytest.approx(10**-0.5)
    assert cost_at(rows, 1e-5) == pytest.approx(10**0.5)
    assert cost_at(rows, 1e-1) is None and cost_at(rows, 1e-7) is None and cost_at([], 1e-3) is None


def test_models_of_peers_that_are_missing_are_named(monkeypatch, capsys):
    monkeypatch.setattr(measure, "peer_timers", lambda result: ([], ["MuJoCo is left out"]))
    monkeypatch.setattr(measure.importlib, "import_module", lambda name: __import__("no_such_peer"))
    assert measure.theirs(None, alone=False) == []
    assert capsys.readouterr().out == "MuJoCo is left out\n"


def test_the_scenes_of_the_comparison_are_four_and_that_of_the_paper_is_first():
    scenes = measure.scenes(REFERENCE)
    assert scenes[0].name == measure.PAPER and len({scene.name for scene in scenes}) == 4
    assert all(scene.tolerance > 0.0 for scene in scenes)
