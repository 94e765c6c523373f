"""Tests of the XML of URDF files: encodings, prefixes, declarations, macros and attributes without a use."""

import warnings

import pytest

import flexman_gym as fm

from oracles.assertions import refusal
from oracles.urdf_files import joint, link, robot


def read(folder, data, **given):
    """Return the arm of the bytes or the text of a URDF without warnings."""
    path = folder / "arm.urdf"
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return fm.Arm.from_urdf(path, **given)


CAMERA = '<gazebo reference="b"><sensor:camera name="c"><fov k:x="1">60</fov></sensor:camera></gazebo>'
UNUSED = {  # element after the links and joints, or text within link b
    "unknown prefix": (CAMERA, ""),
    "unknown prefix within a link": ("", '<drake:proximity a:b="1"/>'),
    "comment and transmission": ("<!-- <!DOCTYPE> --><transmission name='t'><joint name='none'/></transmission>", ""),
    "definition of a macro": ('<xacro:property name="a" value="1"/>', ""),
    "macro in gazebo": ("<gazebo><xacro:plugin/></gazebo>", ""),
    "text": ("hello", "&lt;"),
}


@pytest.mark.parametrize("name", UNUSED)
def test_elements_without_use_leave_the_arm_unchanged(name, tmp_path):
    outside, inside = UNUSED[name]
    assert read(tmp_path, robot(outside, inner=inside)) == read(tmp_path, robot())


DECLARATION = '<?xml version="1.0" encoding="{}"?>\n'
LATIN = DECLARATION.format("iso-8859-1")
FORMS = {
    "byte order mark": b"\xef\xbb\xbf" + robot().encode(),
    "byte order mark and declaration": b"\xef\xbb\xbf" + (DECLARATION.format("utf-8") + robot()).encode(),
    "Windows line ends": (DECLARATION.format("utf-8") + robot()).replace("\n", "\r\n").encode(),
    "blank lines before the declaration": ("\n \n" + DECLARATION.format("utf-8") + robot()).encode(),
    "comment before the declaration": ("<!-- licence -->\n" + DECLARATION.format("utf-8") + robot()).encode(),
    "Latin 1": (LATIN + robot("<!-- \u00e9 -->")).encode("latin-1"),
    "Latin 1 after a comment": ("<!---->" + LATIN + robot("<!-- \u00e9 -->")).encode("latin-1"),
    "UTF-16": (DECLARATION.format("utf-16") + robot()).encode("utf-16"),
    "namespace": robot().replace("<robot", '<robot xmlns="http://ros.org" xmlns:xacro="http://ros.org/xacro"').encode(),
}  # fmt: skip


@pytest.mark.parametrize("name", FORMS)
def test_forms_of_a_file_describe_one_arm(name, tmp_path):
    assert read(tmp_path, FORMS[name]) == read(tmp_path, robot())


ENTITIES = {
    "internal": '<!DOCTYPE robot [<!ENTITY a "1">]>',
    "external": '<!DOCTYPE robot SYSTEM "file:///etc/passwd">',
    "parameter": '<!DOCTYPE robot [<!ENTITY % a SYSTEM "x"> %a;]>',
    "nested": '<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>',
}


@pytest.mark.parametrize("name", ENTITIES)
def test_entities_are_refused_before_and_after_a_late_declaration(name, tmp_path):
    for head in ("", DECLARATION.format("utf-8"), "\n" + DECLARATION.format("utf-8")):
        line = refusal(read, tmp_path, head + ENTITIES[name] + robot(CAMERA).replace("made_up", "&b;"))
        assert "a document type (DTD) with its entities is not allowed" in line
    assert "undefined entity" in refusal(read, tmp_path, robot().replace("made_up", "&b;"))


def test_only_files_with_macros_are_advised_to_expand_them(tmp_path):
    leg = "<xacro:leg side='left'/>"
    path = tmp_path / "arm.urdf"
    path.write_text(robot(leg))
    with pytest.warns(UserWarning, match=r"arm\.urdf: macros that are not expanded are left out: xacro:leg") as issued:
        assert fm.Arm.from_urdf(path) == read(tmp_path, robot())
    assert len(issued) == 1 and issued[0].filename == __file__
    for text in (robot(leg).replace('mass value="1.0"', 'mass value="${m}"'), robot(leg).replace("</robot>", "")):
        assert "expand macros (xacro) first" in refusal(read, tmp_path, text)
    assert "expand macros (xacro) first: xacro:leg" in refusal(read, tmp_path, "<robot><xacro:leg/></robot>")
    for text in (robot("<a>"), robot(link("a")), robot(CAMERA, '<joint name="x" type="fixed"/>')):
        assert "xacro" not in refusal(read, tmp_path, text)


HELD = joint("j3", "b", "c", "prismatic", '<axis xyz="{axis}"/><limit effort="{effort}" lower="{low}" upper="x"/>')
USED = {"axis": "0 1 0", "effort": "-1", "low": "0"}


@pytest.mark.parametrize("changed", [{}, {"effort": "x"}, {"low": "y"}, {"axis": "0 0 0"}, {"axis": "a"}])
def test_a_joint_held_at_zero_needs_neither_axis_nor_limits(changed, tmp_path):
    text = robot(HELD.format(**USED | changed), link("c"))
    assert read(tmp_path, text, held={"j3": 0.0}) == read(tmp_path, robot(joint("j3", "b", "c", "fixed"), link("c")))


@pytest.mark.parametrize("kind", ["floating", "planar", "spherical", "screw", "Revolute", ""])
def test_a_joint_of_another_type_is_held_at_its_origin(kind, tmp_path):
    text = robot(joint("j3", "b", "c", kind), link("c"))
    fixed = read(tmp_path, robot(joint("j3", "b", "c", "fixed"), link("c")))
    assert read(tmp_path, text, held={"j3": 0.0}) == fixed
    assert f"joint 'j3' (type {kind!r})" in refusal(read, tmp_path, text)
    assert "held['j3']: 0.1 is not allowed; give 0.0: a joint of type" in refusal(
        lambda: read(tmp_path, text, held={"j3": 0.1})
    )


def test_numbers_that_the_sidecar_replaces_are_not_read(tmp_path):
    """Damping, friction and limits of a joint, and the <inertial> of a link with a section."""
    broken = robot().replace('effort="40"', 'effort="x"').replace('velocity="3"', 'velocity="y"')
    broken = broken.replace("</joint>", '<dynamics damping="a" friction="b"/></joint>', 1).replace('"1.0"', '"-1"', 1)
    joints = {"j1": {"torque_limit": 40.0, "speed_limit": 3.0, "viscous_friction": 0.0, "coulomb_friction": 0.0}}
    links = {"a": {"shape": "rod", "diameter": 0.02}}
    expected = read(tmp_path, robot(), sidecar={"links": links, "joints": joints})
    assert read(tmp_path, broken, sidecar={"links": links, "joints": joints}) == expected
    replaced = (
        ("torque_limit", "limit.effort"),
        ("speed_limit", "limit.velocity"),
        ("viscous_friction", "dynamics.damping"),
    )
    for entry, field in replaced:
        fewer = {"j1": {name: value for name, value in joints["j1"].items() if name != entry}}
        line = refusal(lambda fewer=fewer: read(tmp_path, broken, sidecar={"links": links, "joints": fewer}))
        assert f"joint 'j1'.{field}: " in line
    assert "link 'a'.inertial.mass: -1.0" in refusal(lambda: read(tmp_path, broken, sidecar={"joints": joints}))


@pytest.mark.parametrize("effort", ["-1", "-1.0", "0", "inf"])
def test_an_effort_that_is_no_positive_number_is_no_limit(effort, tmp_path):
    arm = read(tmp_path, robot().replace('effort="40"', f'effort="{effort}"'))
    assert [each.torque_limit for each in arm.joints] == [None, None]
    assert "joint 'j1'.limit.effort" in refusal(read, tmp_path, robot().replace('effort="40"', 'effort="nan"'))
