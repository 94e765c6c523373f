"""Types: what a person may give is what type checkers accept, arrays too."""

import tomllib
from pathlib import Path

from mypy import api

ROOT = Path(__file__).parents[1]
GIVEN = """
import numpy as np
import flexman_gym as fm
two, three, turn = np.zeros(2), np.array([0.0, 0.0, 1.0]), np.eye(3)
link = fm.Link(1.0, 1e-4, 1e-9, 1e-9, 2e-9, 7e10, 2.6e10, 2700.0, orientation=turn)
arm = fm.Arm([link], [fm.Joint(three, 0.1, 20.0)], fm.Payload(1.0, turn, three), gravity=three)
scene = fm.Scene(arm, fm.ModelChoice(True, 1), fm.ConstantTorque(two), fm.Initial(two, two), 1.0, 0.1)
model = fm.build_model(fm.catalog.paper_rrr(gravity=three))
fm.frequencies(model, three), fm.rest_state(model, three), fm.linearize(model, three)
fm.Simulator(model).step(three)
limits = [float(each) for each in three]
fm.frequencies(model, limits), fm.Joint(limits)
"""


def test_arrays_and_lists_are_accepted_where_they_work(tmp_path):
    (tmp_path / "given.py").write_text(GIVEN)
    exec(compile(GIVEN.split("scene =")[0], "given.py", "exec"), {})
    said, errors, status = api.run(["--follow-imports=silent", str(tmp_path / "given.py")])
    assert status == 0, said + errors


def test_both_packages_say_that_they_are_typed():
    about = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    for name, files in about["package-data"].items():
        folder = ROOT / about["package-dir"][name]
        assert "py.typed" in files and (folder / "py.typed").is_file(), name
