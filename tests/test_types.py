"""Tests of types: both packages are typed, and type checkers accept the allowed arguments."""

import runpy
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_arrays_and_lists_work_where_make_lint_finds_their_types_accepted():
    given = "tests/oracles/given.py"
    runpy.run_path(str(ROOT / given))
    assert f"mypy flexman_gym scripts build/names/flexman_agents {given}" in (ROOT / "Makefile").read_text()


def test_both_packages_say_that_they_are_typed():
    about = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    for name, files in about["package-data"].items():
        if "." in name:  # typed with the package that holds it
            continue
        folder = ROOT / about["package-dir"][name]
        assert "py.typed" in files and (folder / "py.typed").is_file(), name
