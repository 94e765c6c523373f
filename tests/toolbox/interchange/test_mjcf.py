"""MJCF export: mass, frequencies and decay of an arm of rigid pieces; MuJoCo reads the file where it is installed."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eig, eigh
from scipy.spatial.transform import Rotation

import flexman_gym as fm
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.toolbox.interchange.mjcf import rigid_pieces, to_mjcf

from oracles.assertions import refusal

TURN = tuple(map(tuple, Rotation.from_rotvec((0.3, -0.8, 0.4)).as_matrix()))
THIN = fm.Link(0.4, 1e-4, 3e-10, 5e-9, 1e-9, 7e10, 2.6e10, 2700.0)
STEPPED = fm.NonUniformLink((replace(THIN, length=0.3, area=1.5e-4, second_moment_y=9e-10), THIN), TURN)
PAYLOAD = fm.Payload(0.2, ((3e-3, 2e-4, 0.0), (2e-4, 2e-3, 1e-4), (0.0, 1e-4, 4e-3)), (0.03, -0.02, 0.05))
JOINTS = (
    fm.Joint((0.0, 0.0, 1.0), 0.02, 60.0, 0.01, viscous_friction=0.3, coulomb_friction=0.2, torque_limit=8.0),
    fm.Joint((0.0, 1.0, 0.0), 0.01, 40.0),
)
ELBOW = fm.LumpedMass(0.15, 0.31, ((2e-3, 0.0, 1e-4), (0.0, 1e-3, 0.0), (1e-4, 0.0, 2e-3)), (0.01, -0.02, 0.03))
CLAMP = fm.LumpedMass(0.05, 0.02, offset=(0.0, 0.04, 0.0))  # on the piece that is fixed to the joint
LADEN = replace(STEPPED, masses=(ELBOW, CLAMP))
ODD = fm.Arm((LADEN, replace(THIN, orientation=TURN, masses=(replace(ELBOW, mass=0.02),))), JOINTS, PAYLOAD)


@pytest.fixture(scope="module")
def mujoco():
    return pytest.importorskip("mujoco", minversion="4")


def read(mujoco, arm, *given, angles=None):
    """MuJoCo's model of an arm, and its data at motor angles (rad)."""
    model = mujoco.MjModel.from_xml_string(to_mjcf(arm, *given))
    data = mujoco.MjData(model)
    for i, angle in enumerate(angles or ()):
        data.qpos[model.joint(f"motor {i}").qposadr] = angle
    mujoco.mj_forward(model, data)
    return model, data


def matrices(mujoco, model, data, motors=True):
    """Mass, stiffness and damping of small motions, with or without the motors."""
    mass = np.zeros((model.nv, model.nv))
    for column, out in zip(np.eye(model.nv), mass, strict=True):
        mujoco.mj_mulM(model, data, out, column)
    moved = np.zeros((model.ntendon, model.nv))
    for i in range(model.ntendon):
        first, count = model.tendon_adr[i], model.tendon_num[i]
        joints = model.wrap_objid[first : first + count]
        moved[i, model.jnt_dofadr[joints]] = model.wrap_prm[first : first + count]
    damping = np.diag(np.reshape(model.dof_damping, (model.nv, -1))[:, 0])
    damping = damping + (moved.T * model.tendon_damping) @ moved
    kept = [i for i in range(model.nv) if motors or not model.joint(model.dof_jntid[i]).name.startswith("motor")]
    stiffness = np.diag(np.reshape(model.jnt_stiffness, (model.njnt, -1))[:, 0])
    return [each[np.ix_(kept, kept)] for each in (mass, stiffness, damping)]


def test_pieces_weigh_and_turn_as_the_link():
    """About its joint; a beam of sections is the sum of them."""
    for link in (THIN, STEPPED):
        for count in (0, 1, 3):
            pieces = rigid_pieces(link, count)
            assert len(pieces) == 1 + count * len(link.sections)
            assert sum(piece.mass for piece in pieces) == pytest.approx(link.mass, rel=1e-12)
            found = sum(piece.inertia + np.array([0.0, 1.0, 1.0]) * piece.mass * piece.centre**2 for piece in pieces)
            expected, start = np.zeros(3), 0.0
            for each in link.sections:
                y, z = each.second_moment_y / each.area, each.second_moment_z / each.area
                cubes = (start + each.length) ** 3 - start**3
                expected += each.mass * (np.array([y + z, y, z]) + np.array([0, 1, 1]) * cubes / (3 * each.length))
                start += each.length
            assert found == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("name", ["FlexRRR-v0", "FlexPlanar-v0", "FlexOne-v0", "odd"])
def test_frequencies_are_ours(mujoco, name):
    arm = replace(ODD if name == "odd" else NAMED_ENVIRONMENTS[name].arm, gravity=(0.0, 0.0, 0.0))
    model = fm.build_model(arm, elements=4)
    for angles in (None, [0.5, -0.7, 0.9][: arm.n_joints]):
        for motors in (True, False):
            mass, stiffness, _ = matrices(mujoco, *read(mujoco, arm, angles=angles), motors)
            found = np.sqrt(np.abs(eigh(stiffness, mass, eigvals_only=True))) / (2.0 * np.pi)
            expected = fm.frequencies(model, angles, lock_joints=not motors)
            first = arm.n_joints if motors else 0
            assert np.allclose(found[first:][:6], expected[first:][:6], rtol=0.03), (angles, motors)
            assert motors or np.allclose(found[:2], expected[:2], rtol=0.01)


@pytest.mark.parametrize("pieces", [0, 2])
def test_the_site_is_the_tip_and_the_masses_are_there(mujoco, pieces):
    model, data = read(mujoco, ODD, pieces)
    assert model.body_mass.sum() == pytest.approx(sum(link.mass for link in ODD.links) + PAYLOAD.mass, rel=1e-12)
    ours = fm.Simulator(fm.build_model(ODD, flexible_links=False)).tip
    assert np.allclose(data.site("tip").xpos, ours, rtol=0.0, atol=1e-12)


def test_motors_hold_the_same_weight(mujoco):
    """Including a payload with an offset from the tip, and an angle of the second joint."""
    heavy, angles = replace(ODD, gravity=(0.5, -2.0, -9.81)), [0.0, 0.8]
    model, data = read(mujoco, heavy, 3, angles=angles)
    places = [model.joint(f"motor {i}").dofadr[0] for i in range(2)]
    rigid = fm.build_model(heavy, flexible_links=False, flexible_joints=False)
    assert np.allclose(data.qfrc_bias[places], fm.holding_torques(rigid, angles), rtol=1e-9)


@pytest.mark.parametrize("payload", [None, PAYLOAD])
def test_modes_of_a_link_are_damped_as_they_should(mujoco, payload):
    """For one link behind a held motor, all modes are those of a link, in both models."""
    arm = fm.Arm((LADEN,), (fm.Joint((0.0, 0.0, 1.0), 0.02),), payload, modal_damping_ratio=0.03)
    mass, stiffness, damping = matrices(mujoco, *read(mujoco, arm, 3), motors=False)
    zero, one = np.zeros_like(mass), np.eye(len(mass))
    roots = eig(np.block([[zero, one], [-stiffness, -damping]]), np.block([[one, zero], [zero, mass]]))[0]
    assert np.allclose(-roots.real / np.abs(roots), 0.03, rtol=1e-6)
    proportional = replace(arm, modal_damping_ratio=0.0, stiffness_proportional_damping=1e-3)
    _, stiffness, damping = matrices(mujoco, *read(mujoco, proportional, 3), motors=False)
    assert np.allclose(damping, 1e-3 * stiffness, rtol=1e-12)


def test_joints_have_their_friction_and_limit(mujoco):
    model, _ = read(mujoco, ODD, 2)
    first = model.joint("motor 0")
    assert first.damping[0] == 0.3 and first.frictionloss[0] == 0.2 and first.armature[0] == 0.02
    assert model.joint("spring 0").stiffness[0] == 60.0 and model.joint("spring 0").damping[0] == 0.01
    assert model.actuator_ctrlrange[0].tolist() == [-8.0, 8.0] and not model.actuator_ctrllimited[1]
    assert not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONSTRAINT, "dry friction is a constraint"


@pytest.mark.parametrize("name", ["FlexRRR-v0", "FlexPlanar-v0", "FlexOne-v0"])
def test_the_usual_step_is_stable_and_no_shorter_than_it_must_be(mujoco, name):
    model, data = read(mujoco, NAMED_ENVIRONMENTS[name].arm, 4)
    mass, stiffness, _ = matrices(mujoco, model, data)
    assert 0.7 < model.opt.timestep * np.sqrt(eigh(stiffness, mass, eigvals_only=True)[-1]) < 1.6
    data.qvel[0] = 0.3
    mujoco.mj_step(model, data, 200)
    assert data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number == 0


def test_a_rigid_link_stays_one_body_among_flexible_links(mujoco):
    """Also one without length. The mass matrix of the motors, with straight links, is that of the rigid arm."""
    hub = fm.Link.rigid(0.0, 0.5, (0.02, 0.0, -0.03), np.diag([1e-3, 2e-3, 2e-3]))
    arm = fm.Arm((hub, THIN), tuple(fm.Joint(joint.axis) for joint in JOINTS), PAYLOAD, modal_damping_ratio=0.01)
    model, data = read(mujoco, arm, 4, angles=(0.0, 0.6))
    motors = [model.joint(f"motor {i}").dofadr[0] for i in range(2)]
    own = fm.mass_matrix(fm.build_model(arm, 1, flexible_links=False), [0.0, 0.6, 0.0, 0.0])
    assert model.nv == 2 + 3 * 4
    assert matrices(mujoco, model, data)[0][np.ix_(motors, motors)] == pytest.approx(own, rel=1e-12)


HUB, TWO = fm.Joint((0.0, 0.0, 1.0)), fm.catalog.planar_2r()
STICKY = replace(HUB, coulomb_friction=1.0, static_friction=2.0)
LOOSE = replace(TWO.joints[1], stiffness=50.0, backlash=1e-3)
RIPPLED = replace(HUB, motor=fm.Motor(9.0, 0.1, 1e-4, ripple_cycles=1.0))


@pytest.mark.parametrize(("arm", "pieces", "line"), [
    (replace(TWO, joints=[LOOSE] * 2), 0, "arm.joints[0]: "),
    (replace(TWO, joints=[RIPPLED] * 2), 0, "arm.joints[0]: "),
    (replace(TWO, joints=[STICKY] * 2), 0, "arm.joints[0]"),
    ("paper_rrr", 0, "arm: 'paper_rrr' is not allowed; give an Arm"),
    (TWO, 65, "pieces: 65 is not allowed; give a whole number from 0 to 64"),
])  # fmt: skip
def test_arm_that_mujoco_cannot_express_is_refused_in_one_line(arm, pieces, line):
    said = refusal(to_mjcf, arm, pieces)
    assert said.startswith(line) and " is not allowed; give " in said, said
