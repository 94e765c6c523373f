"""Payload: a rigid body at the tip, against a rigid link that is held there and against its own identities."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import flexman_gym as fm

BODY = fm.Link(0.8, 4e-3, 3e-6, 2e-6, 4e-6, 7e10, 2.6e10, 2700.0)  # a uniform bar, its tip link when it is a link
CENTRE = (0.4, 0.0, 0.0)
GRAVITY = (1.0, -2.0, -9.0)


def bar_inertia():
    """Inertia of the bar about its centre, along and across."""
    y, z, slender = BODY.second_moment_y, BODY.second_moment_z, BODY.area * BODY.length**2 / 12
    return BODY.density * BODY.length * np.diag([y + z, y + slender, z + slender])


def with_payload(arm, gravity=GRAVITY):
    """The arm with the bar as payload."""
    payload = fm.Payload(BODY.mass, bar_inertia(), CENTRE)
    return fm.Arm(arm.links, arm.joints, payload, gravity)


def test_a_payload_is_a_rigid_link_whose_joint_cannot_turn():
    arm = fm.catalog.paper_rrr()
    held = fm.Joint((0.0, 0.0, 1.0), rotor_inertia=1e14)
    longer = fm.Arm((*arm.links, BODY), (*arm.joints, held), None, GRAVITY)
    model = fm.build_model(with_payload(arm))
    chain = fm.build_model(longer, flexible_links=(True, True, True, False))
    random = np.random.default_rng(2)
    x, v = random.normal(0.0, 0.05, model.n_dof), random.normal(0.0, 0.5, model.n_dof)
    torque = random.normal(0.0, 100.0, 3)
    expected = fm.acceleration(chain, np.r_[np.insert(x, 3, 0.0), np.insert(v, 3, 0.0)], np.r_[torque, 0.0])
    actual = fm.acceleration(model, np.r_[x, v], torque)
    assert np.abs(actual - np.delete(expected, 3)).max() < 1e-9 * np.abs(actual).max()


def test_energy_is_kept_with_a_heavy_body_off_the_tip():
    arm = with_payload(fm.catalog.one_link(axis=(0.6, 0.8, 0.0)))
    scene = fm.Scene(
        arm, fm.ModelChoice(True, 2), fm.ConstantTorque([0.0]), fm.Initial([0.4], [0.0]), duration=0.5, output_step=0.05
    )
    trajectory = fm.simulate(scene, rtol=1e-9, atol=1e-11)
    kinetic_scale = np.ptp(trajectory.energy - trajectory.energy[0]) + 1.0
    assert trajectory.status == "ok"
    assert np.linalg.norm(trajectory.tip_velocity[-1]) > 0.5
    assert np.abs(trajectory.energy_residual).max() < 1e-7 * kinetic_scale


def test_a_payload_off_the_tip_weighs_where_its_centre_is():
    """Against the same mass at the tip of a rigid arm, in any posture."""
    arm, offset, mass = fm.catalog.paper_rrr(gravity=GRAVITY), np.array([0.3, -0.2, 0.1]), 4.0
    energies = []
    for payload in (fm.Payload(mass, None, offset), fm.Payload(mass)):
        simulator = fm.Simulator(fm.build_model(replace(arm, payload=payload), flexible_links=False))
        simulator.reset((0.4, -0.7, 1.1))
        energies.append(simulator.energy)
    turn = np.eye(3)
    for joint, angle in zip(arm.joints, (0.4, -0.7, 1.1), strict=True):
        turn = turn @ Rotation.from_rotvec(angle * np.array(joint.axis)).as_matrix()
    height = -np.array(GRAVITY) @ turn @ offset
    assert energies[0] - energies[1] == pytest.approx(mass * height, rel=1e-9) and abs(height) > 0.5


def test_a_point_payload_may_be_written_with_its_zeros():
    arm = fm.catalog.paper_rrr(payload=fm.Payload(5.0))
    same = fm.catalog.paper_rrr(payload=fm.Payload(5.0, np.zeros((3, 3)), (0.0, 0.0, 0.0)))
    state = np.random.default_rng(1).normal(0.0, 0.1, 2 * fm.build_model(arm, modes=3).n_dof)
    one, other = (fm.acceleration(fm.build_model(a, modes=3), state, np.ones(3)) for a in (arm, same))
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ((0.0, None, (0.1, 0.0, 0.0)), "Payload.mass: 0.0 is not allowed; give a number > 0 (kg) where inertia or"),
        ((1.0, [[1, 2, 0], [0, 1, 0], [0, 0, 1]]), "Payload.inertia: "),
        ((1.0, np.diag([1.0, 1.0, 3.0])), "Payload.inertia: "),
        ((1.0, np.diag([-1.0, 1.0, 1.0])), "Payload.inertia: "),
        ((1.0, np.eye(2)), "Payload.inertia: "),
        ((1.0, None, (0.1, float("nan"), 0.0)), "Payload.offset[1]: nan is not allowed"),
    ],
)
def test_an_impossible_payload_is_named(arguments, field):
    with pytest.raises(ValueError) as caught:
        fm.Payload(*arguments)
    assert str(caught.value).startswith(field)
    assert "\n" not in str(caught.value)


@pytest.mark.filterwarnings("ignore:Link.second_moment_y:UserWarning")  # of the printed area of link 1, in the file
def test_a_payload_survives_the_file(tmp_path):
    scene = fm.catalog.paper_scene("ff")
    arm = fm.Arm(scene.arm.links, scene.arm.joints, fm.Payload(BODY.mass, bar_inertia(), CENTRE))
    scene = fm.Scene(arm, scene.model, scene.torque, scene.initial, scene.duration, scene.output_step)
    for name in ("scene.json", "scene.yaml"):
        scene.save(tmp_path / name)
        assert fm.Scene.load(tmp_path / name) == scene
