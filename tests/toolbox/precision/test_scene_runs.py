"""Runs of a scene: default of the environments, reference, models and steps."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.toolbox.precision import scene_runs
from flexman_gym.toolbox.precision.runs import PrecisionScene, ReferenceSolution
from flexman_gym.toolbox.precision.scene_runs import (
    COMPARED,
    DEFAULT,
    DEFAULT_METHOD,
    RIGID,
    default_run,
    finest_solution,
    our_rows,
    peer_timers,
    scene_models,
)

pytestmark = pytest.mark.filterwarnings("ignore:Link.second_moment_y:UserWarning")
PAPER = fm.catalog.paper_scene("ff")


@pytest.fixture(scope="module")
def short():
    """Return the paper's scene for 0.2 s with two models, measured against the second."""
    scene = replace(PAPER, duration=0.2)
    built = {RIGID: fm.build_model(scene.arm, flexible_links=False, flexible_joints=False)}
    built[DEFAULT] = default_run(scene).model
    tip = fm.simulate(scene, built[DEFAULT], "gauss_3", 1e-3).tip
    return PrecisionScene("short", scene, built, ReferenceSolution(tip, 1e-9, ""), {})


def test_the_default_is_that_of_the_environment():
    simulator = gym.make("FlexRRR-v0").unwrapped.simulator
    scene = replace(PAPER, arm=simulator.model.arm, output_step=simulator.control_period)
    run = default_run(scene)
    assert run.model.choice == simulator.model.choice
    assert (run.method, run.step) == (DEFAULT_METHOD, simulator.control_period / simulator.substeps)
    assert Configuration().method == DEFAULT_METHOD and COMPARED[0] == DEFAULT_METHOD


@pytest.mark.parametrize("output_step", [0.02, 0.01, 0.004, 1e-3])
def test_the_default_step_divides_the_output_step_or_is_a_multiple(output_step):
    step = default_run(replace(PAPER, output_step=output_step)).step
    parts = max(step, output_step) / min(step, output_step)
    assert step <= 0.02 / 3 + 1e-12 and abs(parts - round(parts)) < 1e-9


@pytest.mark.slow
def test_the_reference_is_the_motion_of_its_mesh():
    """Another method with a tight tolerance moves four elements alike, within a tenth of the error of the mesh."""
    scene = replace(PAPER, duration=0.3)
    reference = finest_solution(scene)
    other = fm.simulate(scene, fm.build_model(scene.arm, 4, stiffening=True), "dop853", rtol=1e-8)
    assert 0.0 < np.linalg.norm(reference.tip - other.tip, axis=1).max() < 0.2 * reference.floor


def test_a_reference_that_does_not_converge_is_refused(monkeypatch):
    monkeypatch.setattr(scene_runs, "CONVERGED", -1.0)
    monkeypatch.setattr(scene_runs, "MOST_PARTS", 20)
    scene = replace(fm.catalog.paper_scene("rr"), arm=fm.catalog.one_joint(), duration=0.02, prescribed=None,
                    torque=fm.ConstantTorque((0.1,)), initial=fm.Initial((0.0,), (0.0,)),
                    model=fm.ModelChoice((True,), (2,)))  # fmt: skip
    monkeypatch.setattr(scene_runs, "_mesh", lambda arm, count: fm.build_model(arm, 1 + (count == 4)))
    with pytest.raises(RuntimeError, match="the reference does not converge: ok, ok; shorten the motion"):
        finest_solution(replace(scene, torque=fm.ConstantTorque((100.0,))))


def test_rigid_arms_have_rigid_models_only():
    models = scene_models(fm.catalog.paper_scene("rr"))
    assert next(iter(models)) == RIGID and models[RIGID].n_dof == 3
    rods = fm.Arm((fm.Link.rigid(1.0, 2.0, (0.5, 0.0, 0.0)),), (fm.Joint((0.0, 0.0, 1.0), 0.1),))
    scene = replace(PAPER, arm=rods, torque=fm.ConstantTorque((1.0,)), initial=fm.Initial((0.0,), (0.0,)),
                    model=fm.ModelChoice((False,), (1,)))  # fmt: skip
    assert list(scene_models(scene)) == [RIGID, DEFAULT]


def test_the_first_row_is_the_default_and_no_row_is_repeated(short):
    rows = list(our_rows(short))
    assert (rows[0].model, rows[0].method, rows[0].step) == (DEFAULT, DEFAULT_METHOD, default_run(short.scene).step)
    assert len({(row.model, row.method, row.step) for row in rows}) == len(rows)
    assert {row.method for row in rows if row.model == DEFAULT} == set(COMPARED)
    assert max(row.step for row in rows) == 2 * short.scene.output_step


def test_chosen_methods_and_steps_run_with_all_models(short):
    rows = list(our_rows(short, ["rk4"], 0.01))[1:]
    assert {row.method for row in rows} == {"rk4"} and {row.model for row in rows} == {RIGID, DEFAULT}
    assert max(row.step for row in rows) == 0.01


def test_simulators_that_cannot_run_are_named(monkeypatch, short):
    def lacking(name):
        if name.endswith("exudyn"):
            raise ValueError("arm: no")
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(scene_runs.importlib, "import_module", lacking)
    timers, lines = peer_timers(short)
    assert timers == [] and lines[1] == "Exudyn is left out: arm: no"
    assert [line.split()[0] for line in lines] == ["MuJoCo", "Exudyn", "Pinocchio"]
    assert lines[0].endswith("is not installed, so it is left out: pip install 'flexman_gym[peers]'")
