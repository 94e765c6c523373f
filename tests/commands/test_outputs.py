"""Outputs of commands: a path that cannot be written is refused before the work, finished work is no error."""

from types import SimpleNamespace

import numpy as np
import pytest

from flexman_gym.__main__ import main
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.toolbox.controllers.tuning import empty_slew_table

NOWHERE = "/proc/file.yaml"  # no file can be created there, by root neither


@pytest.mark.parametrize("words", [
    ["simulate", "missing.yaml", "--out"], ["verify", "--json"], ["replay", "missing.npz", "--out"],
    ["optimise", "arm", "FlexOne-v9", "--out"], ["optimise", "slews", "FlexOne-v9", "--out"],
    ["shape", "FlexOne-v9", "--csv"], ["shape", "FlexOne-v9", "missing.csv", "--out"],
    ["shape", "FlexOne-v9", "missing.csv", "--picture"], ["evaluate", "nobody", "--save"], ["league", "--folder"],
    ["export", "matlab", "nothing", "--out"], ["export", "c", "nobody", "--out"],
    ["export", "mujoco", "nothing", "--out"], ["export", "urdf", "nothing"], ["export", "onnx", "nobody"],
], ids=" ".join)  # fmt: skip
def test_an_output_that_cannot_be_written_is_refused_before_the_subject_is_read(words, capsys):
    with pytest.raises(SystemExit) as stop:
        main([*words, NOWHERE])
    line = capsys.readouterr().err.splitlines()[-1]
    assert stop.value.code == 2 and f"{NOWHERE} is not allowed; give a path at which a file can be written" in line


@pytest.mark.parametrize("words", [["replay", "missing.npz"], ["export", "mujoco", "nothing"]], ids=" ".join)
def test_a_default_output_is_checked_too(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name in ("replay.html", "arm.xml"):
        (tmp_path / name).mkdir()
    with pytest.raises(SystemExit) as stop:
        main(words)
    assert stop.value.code == 2 and "--out" in capsys.readouterr().err.splitlines()[-1]


def test_the_suffix_of_a_new_environment_is_checked_before_the_arm_is_optimised(tmp_path, capsys, monkeypatch):
    search = "flexman_gym.toolbox.sensitivity.arm_design.optimise_arm"
    monkeypatch.setattr(search, lambda *_, **__: pytest.fail("it began"))
    assert main(["optimise", "arm", "FlexOne-v0", "--out", str(tmp_path / "new.txt")]) == 2
    assert "'.txt' is not allowed; give one of .json, .yaml, .yml" in capsys.readouterr().err


@pytest.mark.slow
def test_a_finished_table_of_slews_has_nothing_left_to_do(tmp_path, capsys):
    table, path = empty_slew_table(Configuration.find("FlexOne-v0")), tmp_path / "slews.npz"
    slew = SimpleNamespace(knots=np.zeros((5, 1)), periods=20, arrival=10)
    table.found = {seed: (np.array([[0.0], [1.0]]), slew, 0.5) for seed in (9000, 9001)}
    table.save(path)
    before = path.read_bytes()
    assert main(["optimise", "slews", "FlexOne-v0", "--seeds", "9000", "2", "--out", str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "no slew is missing; nothing is left to do" and path.read_bytes() == before
    assert lines[1] == f"2 of 2 episodes have a slew in {path}, median settling time 0.50 s" and len(lines) == 2
    assert main(["optimise", "slews", "FlexPlanar-v0", "--seeds", "9000", "2", "--out", str(path)]) == 2
    assert "a table of this environment" in capsys.readouterr().err, "that of another arm is refused as before"
