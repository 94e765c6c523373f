"""Wheel: it holds the packages, the files that they read and the command, and nothing else of the repository."""

import shutil
import subprocess
import sys
import zipfile
from configparser import ConfigParser
from pathlib import Path

import pytest

from oracles.files import ROOT

pytestmark = pytest.mark.slow

# Folder of the repository: name of its package when it is installed.
INSTALLED = {"flexman_gym": "flexman_gym", "agents": "flexman_agents", "docs/examples": "flexman_gym/examples"}
LEFT = shutil.ignore_patterns(".*", "__pycache__", "build", "out", "runs", "*.egg-info")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel of a copy of the repository, as building leaves files behind that the next one would hold."""
    pytest.importorskip("setuptools", minversion="77")
    folder = tmp_path_factory.mktemp("wheel")
    shutil.copytree(ROOT, folder / "copy", symlinks=True, ignore=LEFT)
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*build, "--wheel-dir", folder, folder / "copy"], check=True)
    (path,) = folder.glob("flexman_gym-*-py3-none-any.whl")
    with zipfile.ZipFile(path) as file:
        yield file


def test_it_holds_every_file_of_the_packages_and_no_other(wheel):
    """Code, conditions, recipes, reference solutions and the marks of types."""
    held = {name for name in wheel.namelist() if ".dist-info/" not in name}
    expected = set()
    for folder, name in INSTALLED.items():
        files = [path.relative_to(ROOT / folder) for path in (ROOT / folder).rglob("*") if path.is_file()]
        kept = [path for path in files if not any(part.startswith((".", "__pycache__")) for part in path.parts)]
        expected |= {f"{name}/{path.as_posix()}" for path in kept if path.name != "ruff.toml"}  # lint of a checkout
    assert {path.rpartition(".")[2] for path in expected} >= {"py", "yaml", "json", "typed"}
    assert held == expected


def test_it_brings_the_command_and_the_extras(wheel):
    (entries,) = (name for name in wheel.namelist() if name.endswith("entry_points.txt"))
    parser = ConfigParser()
    parser.read_string(wheel.read(entries).decode())
    assert dict(parser["console_scripts"]) == {"flexman": "flexman_gym.__main__:main"}
    (metadata,) = (wheel.read(name).decode() for name in wheel.namelist() if name.endswith("dist-info/METADATA"))
    assert {f"Provides-Extra: {name}" for name in ("train", "render")} <= set(metadata.splitlines())


def test_the_examples_of_the_pages_are_found_where_it_is_unpacked(wheel, tmp_path):
    """A page's command takes the path that `flexman list examples` prints, without a checkout."""
    wheel.extractall(tmp_path)
    command = [sys.executable, "-m", "flexman_gym"]
    done = subprocess.run([*command, "list", "examples"], capture_output=True, text=True, cwd=tmp_path, check=True)
    paths = [Path(line.split()[0]) for line in done.stdout.splitlines()[1:] if line.startswith("  /")]
    assert {path.name for path in paths} == {path.name for path in (ROOT / "docs/examples").glob("*.*")}
    assert all(path.is_file() and path.is_relative_to(tmp_path) for path in paths)
