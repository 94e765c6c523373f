"""Arm: links, joints, payload and arm hold what was given, and refuse what is not an arm in one clear line."""

import math
import warnings
from dataclasses import FrozenInstanceError, fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

import flexman_gym as fm
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.joint import Joint
from flexman_gym.scene.link import MAX_SECTIONS, Link, NonUniformLink
from flexman_gym.scene.rigid_body import Payload

from oracles.assertions import offenders, refusal

pytestmark = pytest.mark.filterwarnings("ignore:.*wrong unit")  # of any numbers
LINK = Link(1.0, 0.002, 6e-7, 5e-7, 1e-6, 206e9, 79e9, 8253.0)
JOINT = Joint((0.0, 0.0, 1.0))
LINK_NUMBERS = [
    field.name for field in fields(Link) if field.name not in ("orientation", "masses", "outline", "flexible")
]
NOT_NUMBERS = [math.nan, math.inf, -math.inf, 10**400, 10**5000, True, np.True_, "1.0", None, 1j, [1.0], np.ones(2)]
STEPPED = NonUniformLink([LINK, LINK])
PARTS = {"Link": LINK, "NonUniformLink": STEPPED, "Joint": JOINT, "Payload": Payload(1.0), "Arm": Arm([LINK], [JOINT])}

LENGTHS = 0.0, 1.0 - 1e-6, 1.0 + 1e-6, 2.0
NOT_NEGATIVE = "Joint.rotor_inertia", "Joint.damping", "Payload.mass"
quaternions = arrays(float, 4, elements=st.floats(-1.0, 1.0)).filter(lambda q: np.linalg.norm(q) > 0.1)


def refused(field: str, *values: object, allowed: str = "") -> None:
    """Assert that `field` ("Link.length") refuses each value in one line that names it and says what is allowed."""
    kind, name = field.partition("[")[0].split(".")

    def good(line: str) -> bool:
        return line.startswith(field) and "give " in line and allowed in line and "\n" not in line and len(line) < 250

    wrong = offenders(lambda value: replace(PARTS[kind], **{name: value}), values, good)
    assert not wrong, "\n".join([f"{field}, where {allowed or 'something else'} is allowed:", *wrong])


TABLES = np.eye(2), np.zeros((3, 3)), np.full((3, 3), math.nan), np.full((3, 3), 1e300), [[1.0]] * 3
MANY_LINKS = [LINK, 1.0], [STEPPED], [LINK] * (MAX_SECTIONS + 1)
NO_CHAIN = [(), None, "arm", LINK, JOINT, [LINK, 1.0], [JOINT, None]]
INERTIAS = [[1, 2, 0], [0, 1, 0], [0, 0, 1]], np.diag([1.0, 1.0, 3.0]), np.diag([-1.0, 1.0, 1.0]), np.eye(2)
REFUSED = [  # field, values, and what the message allows
    *((f"Link.{name}", [0.0, -1.0, *NOT_NUMBERS], "a finite number > 0") for name in LINK_NUMBERS),
    ("Link.orientation", [None, 1.0, "identity", [], *TABLES], ""),
    ("NonUniformLink.sections", [None, (), LINK, "link", *MANY_LINKS], ""),
    ("Joint.axis", [None, 1.0, "z", [], (1.0, 0.0), (0.0, 0.0, math.nan), (0.0, 0.0, True)], ""),
    *(("Joint.axis", [(0.0, -length, 0.0)], f"the length of this one is {length:.12g}") for length in LENGTHS),
    *((name, [-1.0, *NOT_NUMBERS], "a finite number >= 0") for name in NOT_NEGATIVE),
    ("Joint.stiffness", [0.0, -1.0, math.inf, "rigid"], "None for a rigid joint"),
    ("Joint.damping", [1.0], "the damper is parallel to the spring"),
    ("Arm.links", NO_CHAIN, ""),
    ("Arm.joints", NO_CHAIN, ""),
    ("Arm.payload", [5.0], ""),
    ("Arm.gravity", [-9.81, (0.0, -9.81), (0.0, 0.0, math.nan)], ""),
    ("Arm.stiffness_proportional_damping", [-1e-4], ""),
    ("Arm.modal_damping_ratio", [-0.01, 1.0], ""),
    ("Payload.inertia", INERTIAS, ""),
    ("Payload.offset[1]: nan", [(0.1, math.nan, 0.0)], ""),
]


@pytest.mark.parametrize(("field", "values", "allowed"), REFUSED, ids=[row[0] for row in REFUSED])
def test_a_field_refuses_what_it_is_not(field, values, allowed):
    refused(field, *values, allowed=allowed)


@pytest.mark.parametrize(
    ("make", "line"),
    [
        (lambda: replace(LINK, length=-1.0), "Link.length: -1.0 is not allowed; give a finite number > 0 (m)"),
        (lambda: Joint((0, 0, 1), stiffness=100.0), "Joint.rotor_inertia: 0.0 is not allowed; give a number > 0"),
        (lambda: Arm([LINK] * 3, [JOINT] * 2), "Arm.joints: 2 joints are not allowed; give 3, one for each link"),
        (
            lambda: Payload(0.0, None, (0.1, 0.0, 0.0)),
            "Payload.mass: 0.0 is not allowed; give a number > 0 (kg) where ",
        ),
    ],
)
def test_an_error_names_the_field_the_value_and_what_is_allowed(make, line):
    assert refusal(make).startswith(line)


def test_a_damper_beside_its_spring_and_a_joint_for_each_link_are_taken():
    assert Joint((0, 0, 1), rotor_inertia=1.0, stiffness=100.0, damping=2.0).damping == 2.0
    assert Arm([LINK] * 3, [JOINT] * 3).n_joints == 3


@given(*[st.floats(1e-3, 1e3)] * 3)
def test_mass_is_density_times_volume(length, area, density):
    link = replace(LINK, length=length, area=area, second_moment_y=area**2, density=density)
    assert link.mass == pytest.approx(density * area * length)


@given(st.floats(1e-3, 1.0), st.floats(1e-3, 1.0))
def test_a_section_with_less_polar_moment_than_a_disc_is_warned_of(radius, height):
    """A disc of radius r has I = pi r^4 / 4 in each plane, a rectangle b h^3 / 12 and h b^3 / 12."""
    disc = {"area": math.pi * radius**2, **dict.fromkeys(LINK_NUMBERS[2:5], math.pi * radius**4 / 4)}
    rectangle = {
        "area": radius * height,
        "second_moment_y": radius * height**3 / 12,
        "second_moment_z": height * radius**3 / 12,
        "torsion_constant": min(radius, height) ** 4 / 10,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        replace(LINK, **disc), replace(LINK, **rectangle)
    with pytest.warns(UserWarning, match=r"^Link\.second_moment_y \+ second_moment_z: ") as caught:
        link = replace(LINK, **disc | {"area": 1.001 * disc["area"]})
    line = str(caught[0].message)
    assert len(caught) == 1 and "\n" not in line
    for value in (link.second_moment_y + link.second_moment_z, link.area, link.area**2 / (2 * math.pi)):
        assert f"{value:.6g}" in line


def test_the_warning_points_at_who_makes_the_link():
    with pytest.warns(UserWarning) as caught:
        Link(1.0, 0.028, 8.33e-7, 8.33e-7, 1.66e-6, 206e9, 79.3e9, 8253.0)
    assert caught[0].filename == __file__


@given(quaternions)
def test_every_rotation_is_an_orientation_and_no_reflection_is(quaternion):
    matrix = Rotation.from_quat(quaternion).as_matrix()
    assert np.array_equal(replace(LINK, orientation=matrix).orientation, matrix)
    refused("Link.orientation", -matrix, 1.00001 * matrix, allowed="a rotation matrix")


def test_a_non_uniform_link_is_as_long_and_heavy_as_its_sections():
    half, other = replace(LINK, length=0.3), replace(LINK, length=0.5, density=1000.0)
    link = NonUniformLink([half, other])
    assert link.sections == (half, other) and LINK.sections == (LINK,)
    assert link.length == pytest.approx(0.8) and link.mass == pytest.approx(half.mass + other.mass)
    assert Arm([LINK, link], [JOINT] * 2).links == (LINK, link)


@given(quaternions)
def test_a_section_has_no_orientation_of_its_own_but_the_link_has(quaternion):
    matrix = Rotation.from_quat(quaternion).as_matrix()
    turned = replace(STEPPED, orientation=matrix)
    assert np.array_equal(turned.orientation, matrix)
    refused("NonUniformLink.orientation", -matrix, allowed="a rotation matrix")
    if not np.array_equal(matrix, np.eye(3)):
        with pytest.raises(ValueError, match=r"^NonUniformLink\.sections\[1\]\.orientation: .* give the identity"):
            NonUniformLink([LINK, replace(LINK, orientation=matrix)])


@given(quaternions)
def test_an_axis_of_length_one_is_kept_as_it_is(quaternion):
    axis = Rotation.from_quat(quaternion).as_matrix()[0]
    assert Joint(axis).axis == tuple(axis)


def test_lists_arrays_and_tuples_describe_the_same_arm():
    arms = [
        Arm(kind([LINK, LINK]), kind([Joint(kind([0, 0, 1]))] * 2), Payload(2), kind([0, 0, -9.81]))
        for kind in (list, tuple, np.array)
    ]
    assert len(set(arms)) == 1
    assert arms[0] != replace(arms[0], payload=Payload(3.0))
    with pytest.raises(FrozenInstanceError):
        arms[0].gravity = (0.0, 0.0, 0.0)


def test_a_payload_of_no_mass_is_no_payload():
    assert Arm([LINK], [JOINT], Payload(0.0)) == Arm([LINK], [JOINT])


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


@pytest.mark.slow
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


@pytest.mark.filterwarnings("ignore:Link.second_moment_y:UserWarning")  # of the printed area of link 1, in the file
def test_a_payload_survives_the_file(tmp_path):
    scene = fm.catalog.paper_scene("ff")
    arm = fm.Arm(scene.arm.links, scene.arm.joints, fm.Payload(BODY.mass, bar_inertia(), CENTRE))
    scene = fm.Scene(arm, scene.model, scene.torque, scene.initial, scene.duration, scene.output_step)
    for name in ("scene.json", "scene.yaml"):
        scene.save(tmp_path / name)
        assert fm.Scene.load(tmp_path / name) == scene
