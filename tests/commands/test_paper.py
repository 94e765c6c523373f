"""Command `flexman paper`: its figures are those of the simulated cases, and it says which area of link 1 it takes."""

from dataclasses import replace

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.__main__ import main
from flexman_gym.commands import paper
from flexman_gym.simulation.methods import DEFAULT_METHOD

pytest.importorskip("matplotlib")
CASES = ("rr", "fr", "ff")


def trajectories(area="printed", **method):
    """Return the trajectories of the three cases, by the functions that a user calls."""
    arm = fm.catalog.paper_rrr(area)
    return [fm.simulate(replace(fm.catalog.paper_scene(case), arm=arm), **method) for case in CASES]


def lines_of(capsys, *words):
    """Run the command, which must succeed, and return the lines that it prints."""
    assert main(["paper", *map(str, words)]) == 0
    return capsys.readouterr().out.splitlines()


@pytest.mark.slow
@pytest.mark.parametrize("area", ["printed", "corrected"])
def test_figures_are_those_of_the_simulated_cases(area, tmp_path, capsys):
    lines = lines_of(capsys, "--area", area, "--folder", tmp_path / "new", "--figure", 8, 11)
    rigid, *flexible = trajectories(area, method="dop853", rtol=1e-7)
    for number, line in zip((8, 11), lines[-3:-1], strict=True):
        kind, column, unit = ("tip", 2, "m") if number == 8 else ("joint_angles", 2, "rad")
        rows = np.loadtxt(tmp_path / "new" / f"figure_{number:02d}.csv", delimiter=",", skiprows=1)
        differences = [(getattr(each, kind) - getattr(rigid, kind))[:, column] for each in flexible]
        assert np.array_equal(rows.T, [rigid.time, *differences])
        assert line.startswith(f"Figure {number}: ")
        for difference in differences:
            most = max(difference, key=abs)
            assert f"{most:.3f} {unit} at {rigid.time[[*difference].index(most)]:.2f} s" in line
    assert {path.name for path in (tmp_path / "new").iterdir()} == {
        f"figure_{number}.{kind}" for number in ("08", "11") for kind in ("png", "csv")
    }
    taken, other = ("printed: 0.028 m^2", "corrected: 0.0028 m^2")[:: 1 if area == "printed" else -1]
    assert lines[0] == f"Arm of the paper, area of link 1 {taken} (the other reading is {other})"
    assert all(" ok " in line for line in lines[2:5])


@pytest.mark.slow
def test_a_case_that_diverges_ends_with_1_and_its_cause_without_figures(tmp_path, capsys):
    words = ["--method", "rk4", "--step", "0.005", "--figure", "6", "--folder", str(tmp_path)]
    assert main(["paper", *words]) == 1
    printed = capsys.readouterr()
    lines, causes = printed.out.splitlines(), printed.err.splitlines()
    assert " ok " in lines[2] and all(" diverged " in line for line in lines[3:5]) and not lines[5:]
    assert ["Try a step of" in line for line in causes] == [True, True, False]
    assert causes[-1].startswith(
        "no figures: the simulation of flexible links, rigid joints and of flexible links and "
    )
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_step_alone_is_that_of_the_default_method(tmp_path, capsys):
    assert main(["paper", "--step", "0.005", "--figure", "6", "--folder", str(tmp_path)]) == 0
    trajectory = fm.simulate(fm.catalog.paper_scene("ff"), method=DEFAULT_METHOD, step=0.005)
    residual = np.abs(trajectory.energy_residual).max()
    assert f"{residual:.1e} J" in capsys.readouterr().out.splitlines()[4]


@pytest.mark.parametrize(("words", "line"), [
    (["--figure", "5"], "argument --figure: invalid choice: 5 (choose from 6, 7, "),
    (["--figure"], "argument --figure: expected at least one argument"),
    (["--area", "0.0028"], "argument --area: invalid choice: '0.0028' (choose from "),
    (["--method", "rk5"], "method: 'rk5' is not allowed; give one of "),
    (["--method", "rk4"], "step: None is not allowed; give a number > 0 (s): rk4 has fixed steps only"),
    (["--folder", "/proc/paper"], "/proc/paper is not allowed; give a path at which a file can be written"),
])  # fmt: skip
def test_a_wrong_option_is_refused_in_one_line(words, line, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    try:
        status = main(["paper", *words])
    except SystemExit as stop:
        status = stop.code
    said = capsys.readouterr().err.splitlines()
    assert status == 2 and line in said[-1] and sum(not each.startswith(("usage", " ")) for each in said) == 1
    assert not list(tmp_path.iterdir())


def test_the_areas_are_those_of_the_catalog():
    assert {area: fm.catalog.paper_rrr(area).links[0].area for area in paper.AREAS} == paper.AREAS
    with pytest.raises(ValueError, match=f"give one of {', '.join(paper.AREAS)}$"):
        fm.catalog.paper_rrr("both")
