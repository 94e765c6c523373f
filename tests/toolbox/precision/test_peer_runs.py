"""Other simulators in scenes with torques and initial motions of their own: rigid arms move as ours."""

import importlib
from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.toolbox.precision.peers.peer_run import check_modelled, output_count, with_rigid_joints
from flexman_gym.toolbox.precision.runs import PrecisionScene, ReferenceSolution

PACKAGE = "flexman_gym.toolbox.precision.peers"
pytestmark = pytest.mark.filterwarnings("ignore:Link.second_moment_y:UserWarning")


@pytest.fixture
def scene():
    """Return a short motion of the paper's arm with a payload, gravity, sine torques and initial rates."""
    arm = fm.catalog.paper_rrr(payload=fm.Payload(5.0), gravity=(0.0, 0.0, -9.81))
    return with_rigid_joints(
        replace(
            fm.catalog.paper_scene("ff"),
            arm=arm,
            torque=fm.SineTorque([300.0, 2500.0, 900.0], [0.7, 0.5, 0.9], [0.0, 1.2, 1.4]),
            initial=fm.Initial((0.3, 0.8, -1.2), (0.5, -0.2, 0.1)),
            duration=0.5,
        )
    )


@pytest.mark.parametrize("name", ["mujoco", "pinocchio"])
def test_rigid_arms_under_any_torques_move_as_ours(name, scene):
    pytest.importorskip(name)
    peer = importlib.import_module(f"{PACKAGE}.{name}")
    model = fm.build_model(scene.arm, flexible_links=False, flexible_joints=False)
    expected = fm.simulate(scene, model, "dop853", rtol=1e-10).tip
    runs = [peer.run(scene, *((0, "RK4") if name == "mujoco" else ()), step) for step in (1e-3, 5e-4)]
    errors = [run.distance(expected) for run in runs]
    assert errors[0] < 1e-5 and errors[1] < 0.3 * errors[0], "order two: torques of the middle of a step"


@pytest.mark.parametrize("name", ["loader_crane", "gantry"])
def test_mujoco_swings_passive_joints_as_we_do(name):
    pytest.importorskip("mujoco")
    arm = getattr(fm.catalog, name)()
    n, links = arm.n_joints, fm.ModelChoice(tuple(link.flexible for link in arm.links), (2,) * arm.n_joints)
    torque = fm.ConstantTorque([0.0 if joint.passive else 50.0 for joint in arm.joints])
    scene = fm.Scene(arm, links, torque, fm.Initial((0.1,) * n, (0.0,) * n), 0.5, 0.01)
    rigid = fm.build_model(arm, flexible_links=False, flexible_joints=False)
    expected = fm.simulate(scene, rigid, "dop853", rtol=1e-9).tip
    peer = importlib.import_module(f"{PACKAGE}.mujoco")
    assert any(joint.passive for joint in arm.joints)
    assert peer.run(with_rigid_joints(scene), 0, "RK4", 1e-3).distance(expected) < 1e-5


def test_pinocchio_refuses_an_arm_that_it_lacks_a_part_of(scene):
    pytest.importorskip("pinocchio")
    peer = importlib.import_module(f"{PACKAGE}.pinocchio")
    link = replace(scene.arm.links[2], masses=(fm.LumpedMass(1.0, 1.0),))
    arm = replace(scene.arm, links=(*scene.arm.links[:2], link))
    with pytest.raises(ValueError, match="give one of beams, rotors and a payload for Pinocchio"):
        peer.runs(PrecisionScene("", replace(scene, arm=arm), {}, ReferenceSolution(np.zeros((1, 3)), 0.0, ""), {}))


def test_motions_that_other_simulators_lack_are_refused(scene):
    check_modelled(scene)
    moving = replace(scene, base_acceleration=[fm.Signal(1.0)] * 3)
    with pytest.raises(ValueError, match=r"Scene.base_acceleration: .* give None"):
        check_modelled(moving)


def test_a_step_that_does_not_divide_the_output_step_is_refused(scene):
    assert output_count(scene, 1e-3) == (50, 10)
    with pytest.raises(ValueError, match=r"step: 0.003 is not allowed; give a number that divides 0.01 s"):
        output_count(scene, 3e-3)
