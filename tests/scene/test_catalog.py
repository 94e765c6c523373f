"""Catalog: the named arms and scenes are those of their sources."""

import ast
import inspect
import math
import pickle
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.scene.catalog import one_link, paper_rrr, paper_scene, planar_2r
from flexman_gym.scene.rigid_body import Payload
from flexman_gym.scene.scene import Scene
from flexman_gym.scene.serialization import ARM_FOLDER, ARMS, find_arm

from oracles.assertions import refusal
from oracles.files import REFERENCE, ROOT

PAPER_SCENE = ROOT / "docs" / "examples" / "paper_ff.yaml"

# The reference scenes hold the printed area of link 1 and that of `one_link`, which no section can have.
pytestmark = pytest.mark.filterwarnings("ignore:Link.second_moment_y:UserWarning")


@pytest.mark.parametrize("case", ["rr", "fr", "ff"])
def test_a_paper_scene_is_the_reference_scene(case):
    assert paper_scene(case) == replace(Scene.load(REFERENCE / f"paper_{case}.json"), note=paper_scene(case).note)


def test_the_paper_arm_carries_what_the_gravity_scene_adds():
    arm = paper_rrr(
        rotor_inertia=2.0,
        joint_stiffness=60000.0,
        joint_damping=150.0,
        payload=Payload(5.0),
        gravity=(0, 0, -9.81),
        stiffness_proportional_damping=2e-4,
    )
    assert arm == Scene.load(REFERENCE / "gravity_payload_ff.json").arm


def test_one_link_is_the_reference_pendulum():
    arm = one_link(axis=(0.6, 0.8, 0.0), payload=Payload(0.5), gravity=(0, 0, -9.81))
    assert arm == Scene.load(REFERENCE / "pendulum_1.json").arm


@pytest.mark.filterwarnings("error")
def test_the_catalogue_warns_of_nothing():
    for area in ("printed", "corrected"):
        paper_rrr(area)
    one_link(), planar_2r()
    for case in ("rr", "fr", "ff"):
        assert paper_scene(case).arm == paper_rrr()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("suffix", ["json", "yaml"])
def test_a_saved_arm_of_the_catalogue_loads_without_a_warning(suffix, tmp_path):
    scenes = [paper_scene(), Scene.load(REFERENCE / "pendulum_1.json"), Scene.load(PAPER_SCENE)]
    for scene in scenes:
        scene.save(tmp_path / f"scene.{suffix}")
        assert Scene.load(tmp_path / f"scene.{suffix}") == scene
    assert scenes[2] == scenes[0], "docs/examples has another scene than the catalogue"


def test_a_section_in_a_file_that_is_nearly_the_catalogues_is_warned_of(tmp_path):
    data = paper_scene().to_dict()
    data["arm"]["links"][0]["area"] = 0.029
    with pytest.warns(UserWarning, match=r"^Link\.second_moment_y \+ second_moment_z: "):
        Scene.from_dict(data)


def test_only_the_corrected_area_of_link_1_fits_its_polar_moment():
    """Of all sections of one area a solid disc has the least polar moment, A^2 / (2 pi)."""
    for area, fits in (("printed", False), ("corrected", True)):
        link = paper_rrr(area).links[0]
        assert (link.area**2 / (2.0 * math.pi) <= link.torsion_constant) is fits


def test_the_paper_arm_reaches_7_5_m_out_and_1_m_up():
    """At zero angles link 1 stands up and the others lie along +X; the reference trajectories start there."""
    tip = sum(link.length * np.array(link.orientation)[:, 0] for link in paper_rrr().links)
    assert np.allclose(tip, (7.5, 0.0, 1.0), rtol=0.0, atol=1e-15)


def test_the_planar_arm_bends_most_easily_in_its_plane():
    arm = planar_2r(joint_stiffness=100.0, modal_damping_ratio=0.01)
    assert arm.n_joints == 2
    assert all(joint.axis == (0.0, 0.0, 1.0) for joint in arm.joints)
    assert all(link.second_moment_z < 0.01 * link.second_moment_y for link in arm.links)


def test_a_wrong_name_is_refused_with_the_right_ones():
    with pytest.raises(ValueError, match=r"^link1_area: 0.0028 is not allowed; give one of printed, corrected$"):
        paper_rrr(link1_area=0.0028)
    with pytest.raises(ValueError, match=r"^case: 'rf' is not allowed; give one of rr, fr, ff$"):
        paper_scene("rf")


def test_the_quanser_has_the_numbers_of_its_data_file():
    """The table of scripts/studies/machine/data: EI, torque per current, inertia at the joints, and masses."""
    arm = fm.catalog.quanser_2dsfl()
    strips = [link.sections[0] for link in arm.links]
    assert [each.youngs_modulus * each.second_moment_z for each in strips] == pytest.approx([2.690, 0.4614], rel=3e-4)
    motors = [joint.motor for joint in arm.joints]
    assert [motor.torque_per_ampere for motor in motors] == pytest.approx([8.925, 0.870])
    assert [joint.rotor_inertia for joint in arm.joints] == pytest.approx([0.06354, 0.00302])
    assert [motor.joint_resolution for motor in motors] == pytest.approx([1.534e-5, 3.068e-5])
    assert [joint.torque_limit for joint in arm.joints] == pytest.approx([0.94 * 8.925, 0.94 * 0.870])
    carried = arm.links[0].sections[1].mass + arm.links[1].mass + arm.payload.mass
    assert carried == pytest.approx(1.578, abs=5e-4)
    model = fm.build_model(arm, 1, flexible_links=False)
    inertia = fm.mass_matrix(model, np.zeros(4))
    strip = strips[0].mass * strips[0].length ** 2 / 3.0
    assert inertia[0, 0] - arm.joints[0].rotor_inertia - strip == pytest.approx(0.17043, rel=0.01)
    assert inertia[1, 1] - arm.joints[1].rotor_inertia == pytest.approx(
        0.00644 + strips[1].mass * 0.20185**2 / 3.0, rel=1e-3
    )


def test_one_stage_is_both_with_the_second_locked():
    one, both = fm.catalog.quanser_2dsfl(1), fm.catalog.quanser_2dsfl()
    expected = fm.frequencies(fm.build_model(both, 1, flexible_links=(True, False)), lock_joints=True)
    result = fm.frequencies(fm.build_model(one, 1), lock_joints=True)
    assert result[0] == pytest.approx(expected[0], rel=1e-6)  # in the plane; across it the strip has other inertia
    assert "1 to 2" in refusal(fm.catalog.quanser_2dsfl, 3)


def test_one_stage_carries_the_second_as_one_rigid_body():
    """The payload of the file with one stage, from strip 2 and its payload: mass, centre and inertia about it."""
    both, payload = fm.catalog.quanser_2dsfl(), fm.catalog.quanser_2dsfl(1).payload
    strip, tool = both.links[1], both.payload
    mass = strip.mass + tool.mass
    centre = (strip.mass / 2.0 + tool.mass) * strip.length / mass
    about = strip.mass * strip.length**2 / 3.0 + 0.00644 - mass * centre**2  # 0.00644 kg m^2, of the tool about joint 2
    assert (payload.mass, *payload.offset) == pytest.approx((mass, centre, 0.0, 0.0), rel=1e-12)
    assert payload.inertia == pytest.approx(about * np.eye(3), rel=1e-12)
    assert tool.inertia == pytest.approx((0.00644 - 0.157 * 0.20185**2) * np.eye(3), rel=1e-12)
    block = fm.Link.strip(0.155, 0.0762, 1.3673 / (0.155 * 0.0762 * 2700.0), "y", (70e9, 26e9, 2700.0))
    given, computed = vars(both.links[0].sections[1]), vars(block)
    sizes = [name for name, value in computed.items() if isinstance(value, float)]
    assert [given[name] for name in sizes] == pytest.approx([computed[name] for name in sizes], rel=1e-12)
    assert given["outline"] == computed["outline"]


@pytest.mark.parametrize(
    ("name", "width", "thickness"),
    [("planar_2r", 0.040, 0.003), ("vertical_2r", 0.040, 0.005), ("one_joint", 0.030, 0.002)],
)
def test_strips_of_the_examples_have_the_section_of_their_sizes(name, width, thickness):
    for link in getattr(fm.catalog, name)().links:
        stiff, soft = thickness * width**3 / 12.0, width * thickness**3 / 12.0
        torsion = width * thickness**3 * (1.0 - 0.63 * thickness / width) / 3.0
        across = (soft, stiff) if name == "vertical_2r" else (stiff, soft)
        given = link.area, link.second_moment_y, link.second_moment_z, link.torsion_constant
        assert given == pytest.approx((width * thickness, *across, torsion), rel=1e-12, abs=0.0)


def test_published_arms_have_the_published_mass_and_stiffness():
    """kg/m and N m^2 in the plane, and what follows from them."""
    rome, beam = fm.catalog.flexarm_rome(), fm.catalog.nasa_beam()
    density = 3.0 * (0.303 - 6.35e-4) / 0.7**3  # of link 2, whose inertia about its joint is published with the hub's
    slender = [(each, 0.2, 1.0) for each in fm.catalog.de_luca_siciliano().links]
    for link, mass, rigidity in [*slender, (beam.links[0], 2.82, 100.642), (rome.links[1], density, 2.29)]:
        assert link.density * link.area == pytest.approx(mass, rel=1e-12)
        assert link.youngs_modulus * link.second_moment_z == pytest.approx(rigidity, rel=1e-12)
        assert link.second_moment_y == link.torsion_constant == pytest.approx(1e4 * link.second_moment_z, rel=1e-12)
    assert beam.payload.mass == pytest.approx(5.18 * 2.82 * 3.372, rel=1e-12)
    first = rome.links[0]
    assert rome.joints[0].rotor_inertia + first.mass * first.length**2 / 3.0 == pytest.approx(0.447, rel=1e-12)
    rotors = [joint.rotor_inertia for joint in fm.catalog.gifu_2link().joints]
    assert rotors == pytest.approx([100.0**2 * each for each in (6e-4, 3.7e-5, 8.4e-6)], rel=1e-12)


def test_options_of_a_named_arm_change_what_they_name():
    arm, joint = paper_rrr(), paper_rrr().joints[1]
    changed = paper_rrr("corrected", joint_damping=2.0, torque_limit=40.0, gravity=(0, 0, -1), modal_damping_ratio=0.01)
    assert changed.joints[1] == replace(joint, damping=2.0, torque_limit=40.0)
    assert changed.links == (replace(arm.links[0], area=0.0028), *arm.links[1:])
    assert changed == replace(
        arm, links=changed.links, joints=changed.joints, gravity=(0, 0, -1), modal_damping_ratio=0.01
    )
    assert one_link((0, 1, 0)).joints[0].axis == (0.0, 1.0, 0.0)
    assert fm.catalog.vertical_2r().payload == fm.catalog.TOOL and fm.catalog.vertical_2r(None).payload is None
    assert fm.catalog.one_joint().payload == fm.catalog.LIGHT_TOOL
    assert refusal(lambda: planar_2r(rotor_inertia=-1.0)).startswith("Joint.rotor_inertia: -1.0 is not allowed; ")


def test_a_wrong_option_is_answered_with_those_of_the_arm():
    line = (
        r"^vertical_2r\(\) .*'stiffness'; give payload, gravity, stiffness_proportional_damping, modal_damping_ratio$"
    )
    with pytest.raises(TypeError, match=line):
        fm.catalog.vertical_2r(stiffness=3.0)
    with pytest.raises(TypeError, match=r"^nasa_beam\(\) .*'gravity'; give no arguments$"):
        fm.catalog.nasa_beam(gravity=(0, 0, -9.81))


def test_named_arms_are_those_of_their_files():
    """As functions with a docstring and options that are explained, by name, and as a file; a copy is the same."""
    tree = ast.parse(inspect.getsource(fm.catalog)).body
    said = {
        node.targets[0].id: text.value.value for node, text in pairwise(tree)
        if isinstance(node, ast.Assign) and isinstance(text, ast.Expr)
    }  # fmt: skip
    assert {"LIGHT_TOOL", "TOOL", *ARMS} == said.keys() and len(ARMS) >= 10
    for name in ARMS:
        make = getattr(fm.catalog, name)
        assert make.__name__ == name and make.__doc__.splitlines()[0] == said[name] and "\nSource: " in make.__doc__
        assert all(f"    {option}: " in make.__doc__ for option in inspect.signature(make).parameters)
        defaults = {key: each.default for key, each in inspect.signature(make).parameters.items()}
        assert make(**defaults) == make() == find_arm(name) == find_arm(f"{name}.yaml", ARM_FOLDER)
        assert pickle.loads(pickle.dumps(make)) is make
