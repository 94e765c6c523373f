"""Tests of arms in URDF files: masses and gravity of an independent chain, sidecars, export, and refusals."""

import ast
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

import flexman_gym as fm
from flexman_gym.__main__ import main
from flexman_gym.common.files import write_data
from flexman_gym.scene.serialization import find_arm, to_plain
from flexman_gym.toolbox.interchange.urdf_export import to_urdf

from oracles.assertions import refusal
from oracles.files import ROOT
from oracles.urdf_files import joint, link, robot

EXAMPLE = (ROOT / "docs" / "examples" / "two_links.urdf").read_text(encoding="utf-8")
GRAVITY = np.array([0.0, 0.0, -9.81])
HELD = {"wrist": 0.7, "slide": 0.2, "finger": -0.3}


def words(values):
    """Return numbers as the text of an attribute."""
    return " ".join(map(repr, map(float, values)))


def random_urdf(seed):
    """Return a URDF: three joints, of which two are at one place, a wrist, a fixed flange, a slide and a finger."""
    rng = np.random.default_rng(seed)
    kinds = {"shoulder": "revolute", "lift": "continuous", "elbow": "revolute", "wrist": "revolute", "flange": "fixed",
             "slide": "prismatic", "finger": "revolute"}  # fmt: skip
    parents = {"shoulder": "base", "lift": "a", "elbow": "b", "wrist": "c", "flange": "d", "slide": "b", "finger": "d"}
    children = dict(zip(kinds, ("a", "b", "c", "d", "tool", "e", "f"), strict=True))
    lines = ['<robot name="r"><link name="base"/>']
    for name, kind in kinds.items():
        place = np.zeros(3) if name == "lift" else rng.uniform(-0.5, 0.5, 3)
        origin = f'<origin xyz="{words(place)}" rpy="{words(rng.uniform(-2, 2, 3))}"/>'
        axis = f'<axis xyz="{words(rng.normal(size=3))}"/>'
        ends = f'<parent link="{parents[name]}"/><child link="{children[name]}"/>'
        lines.append(f'<joint name="{name}" type="{kind}">{ends}{origin}{axis}</joint>')
        moments = rng.uniform(1.0, 1.9, 3)  # none exceeds the sum of the other two
        pose = f'<origin xyz="{words(rng.uniform(-0.3, 0.3, 3))}" rpy="{words(rng.uniform(-2, 2, 3))}"/>'
        entries = dict(zip(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), [*moments, 0.04, -0.03, 0.02], strict=True))
        text = " ".join(f'{key}="{value / 50}"' for key, value in entries.items())
        lines.append(f'<link name="{children[name]}"><inertial>{pose}<mass value="{rng.uniform(0.5, 3)}"/>'
                     f"<inertia {text}/></inertial></link>")  # fmt: skip
    return "\n".join([*lines, "</robot>"])


def chain(text, angles):
    """Return mass matrix and gravity torques of a URDF by Jacobians of each body; angles of all joints by name."""
    root = ElementTree.fromstring(text)
    joints = {each.find("child").get("link"): each for each in root.findall("joint")}

    def numbers(element, attribute, default):
        return np.array((default if element is None else element.get(attribute, default)).split(), dtype=float)

    def pose(element):
        origin = element.find("origin")
        turn = Rotation.from_euler("xyz", numbers(origin, "rpy", "0 0 0")).as_matrix()  # lower case: fixed axes
        return turn, numbers(origin, "xyz", "0 0 0")

    def frame(link):
        """Return rotation and position of a link, and the axes and positions of the joints that carry it."""
        if link not in joints:
            return np.eye(3), np.zeros(3), {}
        joint = joints[link]
        turn, place, axes = frame(joint.find("parent").get("link"))
        own, offset = pose(joint)
        turn, place = turn @ own, place + turn @ offset
        axis = numbers(joint.find("axis"), "xyz", "1 0 0")
        axis, value = axis / np.linalg.norm(axis), angles.get(joint.get("name"), 0.0)
        if joint.get("type") == "prismatic":
            return turn, place + turn @ axis * value, axes
        if joint.get("type") == "fixed":
            return turn, place, axes
        axes = axes | {joint.get("name"): (turn @ axis, place)}
        return turn @ Rotation.from_rotvec(axis * value).as_matrix(), place, axes

    names = [name for name in angles if name not in HELD]
    mass, torques = np.zeros((len(names), len(names))), np.zeros(len(names))
    for element in root.findall("link"):
        inertial = element.find("inertial")
        turn, place, axes = frame(element.get("name"))
        if inertial is None or not axes:
            continue
        own, offset = pose(inertial)
        kilograms, centre = numbers(inertial.find("mass"), "value", "")[0], place + turn @ offset
        xx, yy, zz, xy, xz, yz = (numbers(inertial.find("inertia"), f"i{key}", "")[0]
                                  for key in ("xx", "yy", "zz", "xy", "xz", "yz"))  # fmt: skip
        tensor = turn @ own @ [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]] @ own.T @ turn.T
        spin, speed = np.zeros((2, 3, len(names)))
        for i, name in enumerate(names):
            if name in axes:
                spin[:, i], speed[:, i] = axes[name][0], np.cross(axes[name][0], centre - axes[name][1])
        mass += kilograms * speed.T @ speed + spin.T @ tensor @ spin
        torques -= kilograms * speed.T @ GRAVITY
    return mass, torques


def dynamics(arm, angles):
    """Return mass matrix and gravity torques of a rigid arm without rotors."""
    model = fm.build_model(arm, 1, flexible_links=False, flexible_joints=False)
    mass = fm.mass_matrix(model, np.append(angles, np.zeros_like(angles)))
    return mass - np.diag([joint.rotor_inertia for joint in arm.joints]), fm.holding_torques(model, angles)


def assert_same(first, second):
    """Assert equal mass matrices and gravity torques to rounding."""
    for one, other in zip(first, second, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-13 * max(np.abs(other).max(), 1e-3))


def read(folder, text=EXAMPLE, **given):
    """Return the arm of the text of a URDF."""
    path = folder / "arm.urdf"
    path.write_text(text, encoding="utf-8")
    return fm.Arm.from_urdf(path, **given)


@pytest.mark.parametrize("seed", range(3))
def test_masses_and_gravity_are_those_of_the_bodies(seed, tmp_path):
    text, angles = random_urdf(seed), np.random.default_rng(seed).uniform(-3.0, 3.0, 3)
    arm = read(tmp_path, text, tip="tool", held=HELD)
    expected = chain(text, dict(zip(("shoulder", "lift", "elbow"), angles, strict=True)) | HELD)
    assert arm.links[0].length == 0.0 and arm.payload is not None
    assert_same(dynamics(arm, angles), expected)


def test_what_a_joint_and_a_motor_have(tmp_path):
    motor = {"gear_ratio": 50.0, "torque_constant": 0.05, "rotor_inertia": 1e-5}
    arm = read(tmp_path, sidecar={"joints": {"elbow": {"motor": motor, "stiffness": 900.0, "damping": 0.2}}})
    shoulder, elbow = arm.joints
    assert (shoulder.viscous_friction, shoulder.coulomb_friction, shoulder.torque_limit) == (0.5, 1.0, 80.0)
    assert (elbow.stiffness, elbow.damping, elbow.torque_limit, elbow.rotor_inertia) == (900.0, 0.2, 40.0, 0.025)
    assert elbow.speed_limit == pytest.approx(3.0) and arm.gravity == (0.0, 0.0, -9.81)
    limited = read(tmp_path, sidecar={"joints": {"elbow": {"motor": motor | {"current_limit": 2.0}}}})
    assert limited.joints[1].torque_limit == 5.0


def test_ranges_and_speeds_of_joints_are_read_and_written(tmp_path):
    """A continuous joint, and a range of many turns, have no stops; the sidecar takes precedence."""
    limits = '<limit lower="0.5" upper="2.5" effort="80" velocity="2"/>'
    text = re.sub(r"<limit [^>]*/>", limits, EXAMPLE, count=1)
    found = read(tmp_path, text)
    shoulder, _ = found.joints
    assert (shoulder.angle_range, shoulder.speed_limit) == ((0.5, 2.5), 2.0) and found.home[0] == 1.5
    written, sidecar = to_urdf(found)
    again = read(tmp_path, written, sidecar=sidecar)
    assert [(each.angle_range, each.speed_limit, each.torque_limit) for each in again.joints] == [
        (each.angle_range, each.speed_limit, each.torque_limit) for each in found.joints
    ]
    del sidecar["joints"]  # the URDF alone has them too
    assert [each.angle_range for each in read(tmp_path, written).joints] == [each.angle_range for each in found.joints]
    assert ('type="revolute"' in written) == any(found.angle_ranges)
    many = read(tmp_path, text.replace('upper="2.5"', 'upper="62.8"')).joints[0]
    assert many.angle_range is None and many.speed_limit == 2.0
    endless = read(tmp_path, text.replace('type="revolute"', 'type="continuous"')).joints[0]
    assert endless.angle_range is None
    free = {"shoulder": {"angle_range": None, "speed_limit": 9.0}}
    assert read(tmp_path, text, sidecar={"joints": free}).joints[0].speed_limit == 9.0
    assert read(tmp_path, text, sidecar={"joints": free}).joints[0].angle_range is None
    passive = read(tmp_path, text, sidecar={"joints": {"shoulder": {"passive": True}}}).joints[0]
    assert passive.angle_range is passive.speed_limit is None


def test_a_section_replaces_the_body_of_its_link(tmp_path):
    """Bodies that are fixed to the link remain, at their place along the beam."""
    path = tmp_path / "sidecar.yaml"
    tube = {"shape": "tube", "diameter": 0.04, "wall": 0.002}
    path.write_text(yaml.safe_dump({"links": {"upper_arm": tube}, "modal_damping_ratio": 0.01}))
    text = EXAMPLE.replace('<parent link="forearm"/>', '<parent link="upper_arm"/>')
    arm = read(tmp_path, text, sidecar=path, tip="forearm")
    upper, forearm = arm.links
    (tool,) = upper.masses
    assert upper.flexible and not forearm.flexible and arm.modal_damping_ratio == 0.01
    assert upper.mass - tool.mass == pytest.approx(fm.Link.tube(0.4, diameter=0.04, wall=0.002).mass)
    np.testing.assert_allclose(np.array(upper.orientation)[:, 0], [1, 0, 0], atol=1e-12)
    bent = np.array([0.3 + 0.05 * np.sin(0.4), 0.0, 0.05 * np.cos(0.4)])  # in the link; its z points to -y of the base
    np.testing.assert_allclose(np.add(tool.offset, [tool.position, 0, 0]), bent[[0, 2, 1]] * [1, -1, 1], atol=1e-12)


@pytest.mark.parametrize("name", ["paper_rrr", "vertical_2r", "quanser_rotary"])
def test_an_exported_arm_is_read_as_it_was(name, tmp_path, capsys):
    arm, file, angles = find_arm(name), tmp_path / "arm.urdf", np.linspace(0.4, 1.1, find_arm(name).n_joints)
    assert main(["export", "urdf", name, str(file)]) == 0 and "springs and motors" in capsys.readouterr().out
    assert fm.Arm.from_urdf(file, file.with_suffix(".yaml")) == arm
    rigid = fm.Arm.from_urdf(file, {"gravity": arm.gravity})
    assert not any(link.flexible for link in rigid.links)
    assert_same(dynamics(rigid, angles), dynamics(arm, angles))


def test_an_exported_rigid_arm_keeps_its_dynamics(tmp_path):
    angles, file = np.array([0.4, -1.0, 2.0]), tmp_path / "arm.urdf"
    arm = read(tmp_path, random_urdf(9), tip="tool", held=HELD)
    write_data(tmp_path / "arm.json", to_plain(arm))
    assert main(["export", "urdf", str(tmp_path / "arm.json"), str(file)]) == 0
    assert_same(dynamics(fm.Arm.from_urdf(file, file.with_suffix(".yaml")), angles), dynamics(arm, angles))


ENTITY = '<!DOCTYPE robot [<!ENTITY a "1">]>\n<robot'
REFUSED = {  # what is wrong -> old and new text, and what the error names
    "entities": ("<robot", ENTITY, ("DTD", "<!DOCTYPE>")),
    "malformed": ("</robot>", "", ("valid XML", "line")),
    "macros": ("<robot", "<xacro:robot", ("valid XML", "xacro")),
    "another root": ("robot", "model", ("root element", "'model'", "robot")),
    "no inertia": ('<inertia ixx="0.002"', '<other ixx="0.002"', ("link 'forearm'.inertial", "<inertia> is missing")),
    "no mass": ('<mass value="1.5"/>', "", ("link 'forearm'.inertial", "<mass> is missing")),
    "negative mass": ('value="1.5"', 'value="-1.5"', ("link 'forearm'.inertial.mass", "-1.5", ">= 0")),
    "impossible inertia": ('izz="0.021"', 'izz="0.051"', ("link 'forearm'.inertial: ixx=0.002 ", "izz=0.051")),
    "no number": ('iyz="0.0002"', 'iyz="${i}"', ("link 'forearm'.inertial.iyz", "'${i}'", "a finite number", "xacro")),
    "two numbers": ('xyz="0.4 0 0"', 'xyz="0.4 0"', ("joint 'elbow'.origin.xyz", "3 finite numbers")),
    "type": ("continuous", "planar", ("joint 'elbow' (type 'planar')", "revolute", "held={'elbow': 0.0}")),
    "prismatic": ("continuous", "prismatic", ("joint 'elbow' (type 'prismatic')", "held={'elbow': 0.0}")),
    "mimic": ('<limit effort="40"', '<mimic joint="shoulder"/><limit effort="40"',
              ("joint 'elbow' (mimic of 'shoulder')", "held={'elbow': 0.0}")),
    "axis": ('1"/>\n    <limit effort', '0"/>\n    <limit effort', ("joint 'elbow'.axis", "length > 0")),
    "parent": ('<parent link="forearm"/>', '<parent link="hand"/>', ("joint 'mount'.parent", "'hand'")),
    "no parent": ('<parent link="forearm"/>', "", ("joint 'mount': <parent> is missing",)),
    "two parents": ('<child link="tool"/>', '<child link="upper_arm"/>', ("joint 'mount'.child", "'upper_arm'")),
    "loop": ('<parent link="base"/>', '<parent link="tool"/>', ("the links", "without a loop")),
    "two roots": ('<link name="base"/>', '<link name="base"/><link name="box"/>', ("['base', 'box']", "one root")),
    "two names": ('name="elbow"', 'name="shoulder"', ("joint.name", "'shoulder'", "no other <joint>")),
    "line break": ('name="elbow"', 'name="el&#10;bow"', ("joint.name", "printable")),
    "line break in a type": ("continuous", "a&#10;b", ("joint 'elbow' (type 'a\\nb')",)),
    "two links": ('<link name="base"/>', '<link name="base"/><link name="base"/>', ("link.name", "'base'")),
    "ends": ('<parent link="forearm"/>', '<parent link="upper_arm"/>', ("tip", "forearm (2 joints), tool (1 joint)")),
    "branch": ('type="fixed">\n    <parent link="forearm"/>', 'type="revolute">\n    <parent link="upper_arm"/>',
               ("tip", "forearm (2 joints), tool (2 joints)")),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_an_invalid_file_is_refused_by_its_element(name, tmp_path):
    old, new, parts = REFUSED[name]
    assert old in EXAMPLE
    line = refusal(lambda: read(tmp_path, EXAMPLE.replace(old, new)))
    assert all(part in line for part in parts) and "arm.urdf: " in line, line


HANDS = [  # a gripper at link b, a second arm on the base, and a lift below link b
    joint("grip", "b", "finger", "prismatic", '<axis xyz="0 1 0"/><limit lower="0.01" upper="0.05" effort="-1"/>'),
    link("finger", 0.1), joint("copy", "b", "thumb", "prismatic", '<mimic joint="grip"/>'), link("thumb", 0.1),
    joint("knee", "base", "leg", rest='<limit lower="-2" upper="-0.5"/>'), link("leg"),
    joint("wheel", "leg", "rim", "continuous", '<limit lower="1" upper="2"/>'), link("rim"),
    joint("j'3", "b", "c"), link("c"),
]  # fmt: skip
RESTS = {"grip": 0.01, "copy": 0.0, "knee": -0.5, "wheel": 0.0}


def test_all_joints_off_the_chain_are_named_in_one_message_to_paste(tmp_path):
    text = robot(*HANDS)
    line = refusal(lambda: read(tmp_path, text, tip="c"))
    assert "joints 'grip' (type 'prismatic'), 'copy' (type 'prismatic'), 'knee' (off the chain) and 1 more: " in line
    assert 'give held="rest", or held=' in line and ast.literal_eval(line.partition(" or held=")[2]) == RESTS
    pasted = ast.literal_eval(refusal(lambda: read(tmp_path, text, tip="a")).partition(" or held=")[2])
    assert pasted == RESTS | {"j2": 0.0, "j'3": 0.0} and read(tmp_path, text, tip="a", held=pasted).n_joints == 1
    line = refusal(lambda: read(tmp_path, text, tip="c", held={"copy": 0.02, "knee": -1.0}))
    assert ast.literal_eval(line.partition(" or held=")[2]) == RESTS | {"copy": 0.02, "knee": -1.0}
    assert "mimic" in refusal(lambda: read(tmp_path, text.replace('"prismatic"', '"revolute"'), tip="c"))


def test_held_rest_is_the_dictionary_of_the_message(tmp_path):
    """Each joint off the chain stands at zero, or at the nearest value within its limits; only those are told."""
    text = robot(*HANDS)
    with pytest.warns(UserWarning) as issued:
        arm = read(tmp_path, text, tip="c", held="rest")
    assert arm == read(tmp_path, text, tip="c", held=RESTS) and arm.n_joints == 3
    (message,) = [str(each.message) for each in issued]
    assert message.endswith("off zero (rad or m): 'grip' (type 'prismatic') at 0.01, 'knee' (revolute) at -0.5")
    assert read(tmp_path, EXAMPLE, held="rest") == read(tmp_path, EXAMPLE)


@pytest.mark.parametrize("kind", ["prismatic", "floating", "mimic"])
def test_held_rest_warns_of_a_joint_between_base_and_tip(kind, tmp_path):
    """Such as the lift of a mobile robot, or a free base; without it the joint is refused."""
    rest = '<axis xyz="0 0 1"/><limit lower="0.1" upper="0.4"/>' + '<mimic joint="j2"/>' * (kind == "mimic")
    lift = joint("lift", "ground", "base", "revolute" if kind == "mimic" else kind, rest)
    text = robot('<link name="ground"/>', lift)
    value = 0.0 if kind == "floating" else 0.1
    with pytest.warns(UserWarning, match=rf"between base and tip \(rad or m\): 'lift' \([ \w']+\) at {value:g}$"):
        arm = read(tmp_path, text, held="rest")
    assert arm == read(tmp_path, text, held={"lift": value}) and arm.n_joints == 2
    assert f"held={{'lift': {value}}}" in refusal(lambda: read(tmp_path, text))


def test_a_tip_between_the_ends_carries_what_is_behind_it(tmp_path):
    """With the joint behind it held at zero, the arm is the first two links of the whole chain."""
    text = robot(joint("j3", "b", "c"), link("c"), joint("j4", "c", "d"), link("d"))
    whole, part = read(tmp_path, text), read(tmp_path, text, tip="b", held="rest")
    angles = np.array([0.3, -0.7])
    mass, torques = dynamics(whole, np.append(angles, [0.0, 0.0]))
    assert_same(dynamics(part, angles), (mass[:2, :2], torques[:2]))


def test_other_arguments_are_refused_by_name(tmp_path):
    cases = {
        "tip": {"tip": "hand"},
        "held": {"held": {"mount": 0.0}},
        "held['elbow']": {"held": {"elbow": "0"}},
        "sidecar": {"sidecar": {"link": {}}},
        "sidecar.links": {"sidecar": {"links": {"base": {}}}},
        "sidecar.joints.elbow": {"sidecar": {"joints": {"elbow": 3.0}}},
        "joint 'elbow'.stifness": {"sidecar": {"joints": {"elbow": {"stifness": 3.0}}}},
        "link 'forearm'": {"sidecar": {"links": {"forearm": {"shape": "rod", "width": 0.1}}}},
        "link 'upper_arm'": {"sidecar": {"links": {"upper_arm": {"shape": "rod", "diameter": 0.01, "length": 0.31}}}},
    }
    tool = EXAMPLE.replace('<parent link="forearm"/>', '<parent link="upper_arm"/>')  # a body merged with a section
    for field, value in (("orientation", "x"), ("masses", 3.0)):
        section = {"upper_arm": {"shape": "rod", "diameter": 0.01, field: value}}
        line = refusal(lambda section=section: read(tmp_path, tool, tip="forearm", sidecar={"links": section}))
        assert f"link 'upper_arm'.{field}: " in line
    (tmp_path / "bad.yaml").write_text("links: [")
    assert "bad.yaml: line" in refusal(lambda: read(tmp_path, sidecar=tmp_path / "bad.yaml"))
    assert "no joint moves" in refusal(lambda: read(tmp_path, held={"shoulder": 0.0, "elbow": 0.0}))
    passive = read(tmp_path, sidecar={"joints": {"elbow": {"passive": True, "stiffness": 3.0}}})
    assert passive.joints[1].passive and passive.joints[1].torque_limit is None
    for value in ([1], "all", True):
        assert f'held: {value!r} is not allowed; give "rest", or' in refusal(
            lambda value=value: read(tmp_path, held=value)
        )
    assert "no joint turns 'upper_arm'" in refusal(
        lambda: read(tmp_path, EXAMPLE.replace("revolute", "prismatic"), tip="upper_arm")
    )
    for field, given in cases.items():
        assert f"{field}: " in refusal(lambda given=given: read(tmp_path, **given)), field
    with pytest.raises(FileNotFoundError, match=r"none\.urdf"):
        fm.Arm.from_urdf(Path("none.urdf"))


def test_a_rigid_link_has_any_centre_and_may_have_no_length():
    """A link divided into two at one place, with the outer joint at zero, is the link itself."""
    tensor = np.diag([0.02, 0.03, 0.04])
    whole = fm.Arm([fm.Link.rigid(0.3, 2.0, (-0.1, 0.2, 0.4), tensor)], [fm.Joint((0, 0, 1))], gravity=(0, -9.81, 0))
    parts = fm.Arm([fm.Link.rigid(0.0, 0.7, (0.0, 0.0, 0.0)), *whole.links], [fm.Joint((0, 0, 1))] * 2,
                   gravity=(0, -9.81, 0))  # fmt: skip
    inertia = 0.04 + 2.0 * (0.1**2 + 0.2**2)
    for arm in (whole, parts):
        mass, torques = dynamics(arm, np.zeros(arm.n_joints))
        np.testing.assert_allclose(mass, np.full_like(mass, inertia), rtol=1e-13)
        np.testing.assert_allclose(torques, -0.1 * 2.0 * 9.81, rtol=1e-13)
