"""Page of the paper: each equation names its code, and numbers are those of the catalog and of the simulations."""

import ast
import re

import gymnasium as gym
import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.envs.config.configuration import Configuration

from oracles.files import ROOT

PAGE = (ROOT / "docs" / "the_paper.md").read_text(encoding="utf-8")
DENSE = ROOT / "tests" / "oracles" / "dense.py"
# A citation such as "Eq. 24-33", "Eqs. (13) and (14)" or "Eq. 4-14 and 22-46".
CITATION = re.compile(r"\bEqs?\.\s*((?:\(?\d+\)?(?:\s*(?:-|,|\bto\b|\band\b)\s*)?)+)")


def numbers(text):
    """Return the numbers of a list with ranges, such as "1, 3 to 5" or "(1) and 3-5"."""
    found = re.findall(r"(\d+)(?:\s*(?:-|to)\s*(\d+))?", text.replace("(", "").replace(")", ""))
    return {each for first, last in found for each in range(int(first), int(last or first) + 1)}


def cited(text):
    """Return the numbers of the equations that a text cites."""
    return {each for citation in CITATION.findall(text) for each in numbers(citation)}


def definition(tree, name):
    """Return the node of a function or class of a module, such as `Chain.points`."""
    for part in name.split("."):
        (tree,) = (node for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == part)
    return tree


def equations_named(path, name):
    """Return the equations that a function or class cites in docstrings and comments, or the docstring of its module.

    Those of the class count for a method, too.
    """
    source = path.read_text(encoding="utf-8")
    tree = ast.parse(source)
    docstrings = [ast.get_docstring(each) or "" for each in (tree, definition(tree, name.split(".")[0]))]
    return cited("\n".join([*docstrings, ast.get_source_segment(source, definition(tree, name))]))


def rows():
    """Return number text, code and dense form of each row of the tables of equations."""
    lines = re.findall(
        r"^\| (\d[\d, to]*) \|.*?\| (.*?) \| ?(.*?) ?\|$", PAGE.partition("## Equations 1 to 46")[2], re.M
    )
    assert len(lines) > 20
    return lines


def places(code, dense):
    """Return path and name of each function and class in a row."""
    result = [(DENSE, name) for name in re.findall(r"`([\w.]+)`", dense)]
    for file, names in re.findall(r"`([\w/]+\.py)`: ((?:`[\w.]+`(?:, )?)+)", code):
        result += [(ROOT / "flexman_gym" / file, name) for name in re.findall(r"`([\w.]+)`", names)]
    return result


def test_every_equation_of_the_paper_has_one_row():
    assert sorted(each for equation, *_ in rows() for each in numbers(equation)) == [*range(1, 47)]


@pytest.mark.parametrize(("equation", "code", "dense"), rows())
def test_code_of_an_equation_exists_and_names_it(equation, code, dense):
    known = [equations_named(*place) for place in places(code, dense)]
    assert all(each & numbers(equation) for each in known), "each names one of the row"
    assert code.startswith("not used: ") or places(code, "")
    if known:
        assert numbers(equation) <= set.union(*known), "together they name all of the row"


def test_citations_of_equations_are_read():
    assert cited("Eqs. (13) and (14), see 5") == {13, 14}
    assert cited("(Eq. 1-3, 18 and 22-24); 2 of them; Eq. 30") == {1, 2, 3, 18, 22, 23, 24, 30}
    assert numbers("1, 3 to 5") == {1, 3, 4, 5}


def test_table_1_is_that_of_the_arm_and_its_first_area_is_impossible():
    def row(head):
        (line,) = re.findall(rf"^\| {re.escape(head)} \| (.*) \|$", PAGE, re.MULTILINE)
        return [float(each) for each in line.split(" | ")]

    links = fm.catalog.paper_rrr().links
    assert row("length (m)") == [link.length for link in links]
    assert row("area of the cross-section (m^2)") == [link.area for link in links]
    for moments in zip(*((link.second_moment_y, link.second_moment_z) for link in links), strict=True):
        assert row("second moment of area (m^4)") == [*moments]
    assert row("polar moment (m^4)") == [link.torsion_constant for link in links]
    smallest = {}
    for area in ("printed", "corrected"):
        (link, *_) = fm.catalog.paper_rrr(area).links
        smallest[area] = link.area**2 / (2.0 * np.pi)
        assert f"{smallest[area]:.2e}".replace("e-0", "e-") + " m^4" in PAGE
        assert f"| {link.area * link.length * link.density:.3g} kg |" in PAGE
    assert smallest["printed"] > links[0].torsion_constant > smallest["corrected"]
    assert f"{smallest['printed'] / links[0].torsion_constant:.0f} times the printed one" in PAGE
    assert all(f"{value} of {text}" in PAGE for value, text in [("modulus", "206 GPa"), ("modulus", "79.3 GPa")])
    assert (links[0].youngs_modulus, links[0].shear_modulus, links[0].density) == (206e9, 79.3e9, 8253.0)


def test_values_beside_the_printed_figures_are_those_that_the_code_prints():
    """The code and its output run with all pages; the table has the rows of the printed area, here in columns."""
    table = re.findall(r"^\| Figure \d+ \|.*\| ([\d.]+) (m|rad) \| ([\d.]+) (m|rad) \|$", PAGE, re.MULTILINE)
    assert [unit for _, unit, _, _ in table] == [unit for *_, unit in table] == ["m"] * 3 + ["rad"] * 3
    for column, case in ((0, "fr"), (2, "ff")):
        (line,) = re.findall(rf"^printed area +{case} +(.*)$", PAGE, re.MULTILINE)
        assert [row[column] for row in table] == line.split()
    printed, corrected = (
        np.array([line.split() for line in re.findall(rf"^{area} area +f[rf] +(.*)$", PAGE, re.MULTILINE)], dtype=float)
        for area in ("printed", "corrected")
    )
    tip, joint = (abs(printed - corrected)[:, part].max() for part in (slice(3), slice(3, 6)))
    assert f"by up to {1e3 * tip:.0f} mm and {joint:.3f} rad" in PAGE
    springs = re.findall(r"joint springs move the tip by up to 0\.(\d+) m", PAGE)
    text = " ".join(PAGE.split())
    assert f"move the tip by no more than {int(springs[0])} mm" in text
    assert f"With rotors of 10 kg m^2 it is up to {int(springs[2])} mm" in text


@pytest.mark.slow
def test_sentences_about_the_simulations_hold():
    runs = {case: fm.simulate(fm.catalog.paper_scene(case)) for case in ("rr", "fr", "ff")}
    apart = max(np.linalg.norm(runs[case].tip - runs["rr"].tip, axis=1).max() for case in ("fr", "ff"))
    assert f"up to {apart:.2f} m apart" in " ".join(PAGE.split())
    for case, count in (("rr", 3), ("fr", 39), ("ff", 42)):
        assert runs[case].model.n_dof == count and re.search(rf"^\| `{case}` .*\| {count}: ", PAGE, re.MULTILINE)
    swings = {}
    for case in ("fr", "ff"):  # oscillation: what a mean over 0.3 s leaves
        angles = (runs[case].joint_angles - runs["rr"].joint_angles)[:135]
        smooth = np.array([np.convolve(each, np.ones(31) / 31, "valid") for each in angles.T]).T
        swings[case] = (angles[15:-15] - smooth).std(axis=0)
    ratios = swings["ff"] / swings["fr"]
    assert ratios.min() > 1.8 and ratios.max() < 3.2, "two to three times"
    rigid = fm.build_model(fm.catalog.paper_rrr(gravity=(0.0, 0.0, -9.81)), flexible_links=False, flexible_joints=False)
    assert f"{fm.holding_torques(rigid, (0.0, 0.0, 0.0))[1]:.0f} N m to hold" in PAGE


@pytest.mark.slow
def test_the_rigid_arm_is_the_same_with_both_areas():
    scene = fm.catalog.paper_scene("rr")
    tips = [fm.simulate(fm.Scene(fm.catalog.paper_rrr(area), scene.model, scene.torque, scene.initial, 2.0, 0.01)).tip
            for area in ("printed", "corrected")]  # fmt: skip
    assert tips[0] == pytest.approx(tips[1], abs=1e-6)


def test_changes_of_the_environment_are_those_of_its_configuration():
    settings, paper = Configuration("FlexRRR-v0"), fm.catalog.paper_rrr()
    rows = dict(
        re.findall(r"^\| (.*?) \| .*? \| (.*?) \| .*? \|$", PAGE.partition("## What FlexRRR-v0")[2], re.MULTILINE)
    )
    (joint, *_), model = settings.arm.joints, gym.make("FlexRRR-v0").unwrapped.simulator.model
    assert rows["rotor inertia"] == f"{joint.rotor_inertia:g} kg m^2" and paper.joints[0].rotor_inertia == 1.0
    assert rows["damping of the links"] == f"modal damping ratio {settings.arm.modal_damping_ratio:g}"
    period = 1e3 * settings.control_period
    assert rows["torque"] == f"up to {joint.torque_limit:g} N m, chosen by an agent every {period:g} ms"
    assert rows["integration"] == f"`{settings.method}`, {1e3 * settings.integration_step:.3g} ms"
    assert rows["elastic coordinates"].startswith(f"{model.n_elastic} ")
    assert [link.area for link in settings.arm.links] == [link.area for link in paper.links]
    assert [each.stiffness for each in settings.arm.joints] == [each.stiffness for each in paper.joints]


@pytest.mark.slow
@pytest.mark.parametrize(("damping", "period"), [(0.005, 5), (0.0, 0.2)])
def test_the_rotors_of_the_paper_need_the_control_periods_of_the_page(damping, period):
    arm = {"catalog": "paper_rrr", "torque_limit": 400.0, "modal_damping_ratio": damping}
    settings = Configuration("FlexRRR-v0", {"arm": arm, "control_period": 0.02})
    with pytest.raises(ValueError, match=rf"gain margin of 2 and a phase margin of 30 degrees.*; {period} ms works$"):
        _ = settings.pd_gains
    assert re.search(rf"needs (a control period of )?{period} ms \|$", PAGE, re.MULTILINE)
