"""Tests of masses and inertias of URDF files: parts without mass, impossible inertias, and their correction."""

import json
import re
import warnings

import numpy as np
import pytest

import flexman_gym as fm

from oracles.assertions import refusal
from oracles.urdf_files import BODY, joint, link, robot

FLAT = 'ixx="0.002" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"'  # impossible
NEAREST = 'ixx="0.002" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"'
PLANAR = 'ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0.01"'  # impossible; the moment about z is kept
ONES = " ".join(f'{name}="1e-8"' for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
STRICT = {"inertias": "strict"}


def fixed(text, name="c"):
    """Return the element of a link that is fixed to link b, and of its joint."""
    return text + joint(f"{name}_mount", "b", name, "fixed")


def read(folder, text, **given):
    """Return the arm of a URDF and the messages of the warnings."""
    path = folder / "arm.urdf"
    path.write_text(text)
    with warnings.catch_warnings(record=True) as issued:
        warnings.simplefilter("always")
        arm = fm.Arm.from_urdf(path, **given)
    return arm, [str(each.message) for each in issued]


UNUSED = {
    "massless base": robot().replace('<link name="base"/>', link("base", 0.0)),
    "base with a negative mass": robot().replace('<link name="base"/>', link("base", -3.0)),
    "base with an impossible inertia": robot().replace('<link name="base"/>', link("base", 3.0, FLAT)),
    "base without numbers": robot().replace('<link name="base"/>', link("base", "x", 'ixx="y"')),
    "branch of the base": robot(link("c", -1.0, FLAT), joint("j3", "base", "c", rest='<limit effort="-1"/>')),
    "origin of a branch of the base": robot(link("c"), joint("j3", "base", "c").replace('xyz="0 0 0.3"', 'xyz="x"')),
    "massless part on a fixed joint": robot(fixed(link("c", 0.0, BODY.replace("0.02", "0").replace("0.004", "0")))),
    "part without <inertial>": robot(fixed('<link name="c"/>')),
    "massless part without <inertia>": robot(
        fixed('<link name="c"><inertial><mass value="0"/></inertial></link>')),
}  # fmt: skip


@pytest.mark.parametrize("name", UNUSED)
def test_data_of_parts_that_do_not_move_or_weigh_are_not_checked(name, tmp_path):
    arm, messages = read(tmp_path, UNUSED[name], tip="b", held="rest", **STRICT)
    assert arm == read(tmp_path, robot())[0] and not messages


def test_an_inertia_without_mass_is_left_out_with_a_warning(tmp_path):
    text = robot(fixed(link("sensor", 0.0), "sensor"))
    arm, (message,) = read(tmp_path, text, tip="b")
    assert arm == read(tmp_path, robot())[0]
    assert "arm.urdf: link 'sensor'.inertial: ixx=0.02 " in message and "no mass and no inertia" in message
    line = refusal(lambda: read(tmp_path, text, tip="b", **STRICT))
    assert "link 'sensor'.inertial" in line and "with mass 0.0 (kg) is not allowed; give a mass > 0" in line


ACCEPTED = {  # elements with an impossible inertia -> the same with the nearest one, and the link in the warning
    "light": (fixed(link("c", 0.06, FLAT)), fixed(link("c", 0.06, NEAREST)), "c"),
    "light with products of inertia": (
        fixed(link("c", 1e-8, ONES)),
        fixed(link("c", 1e-8, 'ixx="2e-8" ixy="5e-9" ixz="5e-9" iyy="2e-8" iyz="5e-9" izz="2e-8"')), "c"),
    "rounded": (fixed(link("c", 3.0, BODY.replace('izz="0.004"', 'izz="0.0403"'))),
                fixed(link("c", 3.0, BODY.replace('xx="0.02"', 'xx="0.02015"').replace('yy="0.02"', 'yy="0.02015"')
                           .replace('izz="0.004"', 'izz="0.0403"'))), "c"),
    "small": (fixed(link("c", 3.0, PLANAR.replace("0.01", "2e-7"))),
              fixed(link("c", 3.0, 'ixx="1e-7" ixy="0" ixz="0" iyy="1e-7" iyz="0" izz="2e-7"')), "c"),
}  # fmt: skip


@pytest.mark.parametrize("name", ACCEPTED)
def test_a_minor_impossible_inertia_is_read_as_the_nearest_with_a_warning(name, tmp_path):
    given, nearest, part = ACCEPTED[name]
    arm, (message,) = read(tmp_path, robot(given), tip="b")
    expected, none = read(tmp_path, robot(nearest), tip="b", **STRICT)
    assert not none
    np.testing.assert_allclose(arm.links[1].masses[0].inertia, expected.links[1].masses[0].inertia, rtol=0, atol=1e-16)
    assert f"arm.urdf: link {part!r}.inertial: " in message and "is impossible and read as ixx=" in message
    written = re.search(r'ixx="([^"]+)"', given)[1]
    assert f"ixx={written} " in message and 'inertias="strict" refuses it' in message
    assert f"link {part!r}.inertial: ixx={written} " in refusal(lambda: read(tmp_path, robot(given), tip="b", **STRICT))


def test_an_impossible_inertia_of_a_heavy_link_is_refused_with_the_numbers_of_the_file(tmp_path):
    """Also where it is merged with other links and turned: the message is that of the link in its own axes."""
    turned = fixed(link("c", 0.5, FLAT)).replace('<origin xyz="0 0 0.15"/>', '<origin xyz="0 0 1" rpy="0.3 1 2"/>')
    line = refusal(lambda: read(tmp_path, robot(turned, fixed('<link name="d"/>', "d")), tip="d"))
    assert "arm.urdf: link 'c'.inertial: ixx=0.002 ixy=0 ixz=0 iyy=0 iyz=0 izz=0 (kg m^2) with mass 0.5 (kg)" in line
    assert "the nearest are ixx=0.002 ixy=0 ixz=0 iyy=0.001 iyz=0 izz=0.001" in line
    line = refusal(lambda: read(tmp_path, robot(fixed(link("tool", 0.5, FLAT), "tool"))))
    assert "arm.urdf: link 'tool'.inertial: ixx=0.002 " in line and "payload" not in line
    negative = robot(fixed(link("c", 3.0, BODY.replace('izz="0.004"', 'izz="-0.004"'))))
    assert "link 'c'.inertial: " in refusal(lambda: read(tmp_path, negative, tip="b"))


def test_a_link_is_light_relative_to_the_mass_that_moves(tmp_path):
    """Two links of 1 kg move, or a tube of the sidecar of 0.19 kg and a link of 1 kg; the base does not count."""
    text = robot(fixed(link("c", 0.1, FLAT))).replace('<link name="base"/>', link("base", 100.0))
    assert len(read(tmp_path, text, tip="b")[1]) == 1
    tube = {"links": {"a": {"shape": "tube", "diameter": 0.04, "wall": 0.002}}}
    assert "with mass 0.1 (kg) is not allowed" in refusal(lambda: read(tmp_path, text, tip="b", sidecar=tube))


def test_moments_that_parallel_joints_do_not_use_are_corrected_without_effect(tmp_path):
    flat = robot().replace('xyz="0 1 0"', 'xyz="0 0 1"').replace('xyz="0 0 0.3"', 'xyz="0.3 0 0"')
    arm, messages = read(tmp_path, flat.replace(BODY, PLANAR))
    assert len(messages) == 2
    model = fm.build_model(arm, 1, flexible_links=False, flexible_joints=False)
    inertia = 0.01 + np.array([[0.01 + 0.09, 0.0], [0.0, 0.0]])  # the centres are on the axes of the joints
    for angle in (0.3, -2.0):
        mass = fm.mass_matrix(model, [0.2, angle, 0.0, 0.0])
        np.testing.assert_allclose(mass, np.array([[inertia[0, 0], 0.01], [0.01, 0.01]]), rtol=1e-12)
    about_x = PLANAR.replace('izz="0.01"', 'izz="0"').replace('ixx="0"', 'ixx="0.01"')
    assert "link 'a'.inertial" in refusal(lambda: read(tmp_path, flat.replace(BODY, about_x)))
    assert "link 'b'.inertial" in refusal(lambda: read(tmp_path, robot().replace(BODY, PLANAR)))


def test_inertias_has_two_values(tmp_path):
    assert "inertias: 'repair' is not allowed; give one of project, strict" in refusal(
        lambda: read(tmp_path, robot(), inertias="repair")
    )


def test_links_without_mass_are_named_with_the_sidecar_that_supplies_them(tmp_path):
    """The entry, with numbers in place of its zeros, gives the arm of the same links with <inertial>."""
    text = robot()
    for name in ("a", "b"):
        text = text.replace(link(name), f'<link name="{name}"/>')
    with pytest.raises(ValueError, match=r"arm\.urdf: links 'a', 'b'\.inertial: missing; give <inertial>") as error:
        read(tmp_path, text)
    assert "\n" not in str(error.value)
    sidecar = json.loads(str(error.value).partition("sidecar=")[2])
    assert list(sidecar["links"]) == ["a", "b"]
    assert "link 'a'.mass: 0.0" in refusal(lambda: read(tmp_path, text, sidecar=sidecar))
    for entry in sidecar["links"].values():
        assert entry["shape"] == "rigid"
        entry |= {"mass": 1.0, "centre": [0.15, 0.0, 0.0], "inertia": np.diag([0.004, 0.02, 0.02]).tolist()}
    longer = robot(fixed('<link name="tip"/>', "tip"))
    bare = text.replace("</robot>", fixed('<link name="tip"/>', "tip") + "</robot>")
    given, expected = read(tmp_path, bare, sidecar=sidecar)[0], read(tmp_path, longer)[0]
    for one, other in zip(given.links, expected.links, strict=True):
        np.testing.assert_allclose(one.masses[0].inertia, other.masses[0].inertia, rtol=0, atol=1e-16)
        assert (one.mass, one.length) == (other.mass, other.length)


def test_a_massless_link_moves_with_the_mass_of_a_link_that_is_fixed_to_it(tmp_path):
    """Without such a mass it is refused; the tip is then at the joint and a tube of no length is refused, too."""
    bare = robot(fixed(link("c"))).replace(link("b"), '<link name="b"/>')
    assert read(tmp_path, bare, tip="b")[0].links[1].mass == 1.0
    assert read(tmp_path, bare, tip="c")[0].links[1].mass == 1.0
    massless = robot().replace(link("b"), link("b", 0.0, 'ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"'))
    line = refusal(lambda: read(tmp_path, massless))
    assert "link 'b'.inertial: no mass is not allowed; give <inertial>" in line
    tube = {"links": {"b": {"shape": "tube", "diameter": 0.04, "wall": 0.002}}}
    assert "sidecar.links.b.shape: 'tube' is not allowed; give {'shape': 'rigid'" in refusal(
        lambda: read(tmp_path, robot(), sidecar=tube)
    )
