"""Tests of source files: sizes, private names, packages; rules beyond ruff and import-linter."""

import ast
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import flexman_gym

PACKAGE = Path(flexman_gym.__file__).parent
ROOT = PACKAGE.parent
MOST_LINES, MOST_FUNCTION_LINES = 500, 50
OURS = {"flexman_gym", "flexman_agents", "studies"}
HEAVY = {"torch", "stable_baselines3", "sb3_contrib", "matplotlib", "pyvista", "ray"}
FILES = sorted(path for folder in (PACKAGE, ROOT / "agents", ROOT / "scripts") for path in folder.rglob("*.py"))
TESTS = sorted(Path(__file__).parent.rglob("*.py"))


def docstring_lines(function):
    """Return the number of lines of a docstring, which has arguments and examples as far as users need them."""
    first = function.body[0]
    return first.end_lineno - first.lineno + 1 if ast.get_docstring(function) is not None else 0


def flaws(path):
    """Describe oversized parts of a file and private names that it imports from other files."""
    text = path.read_text(encoding="utf-8")
    lines = len(text.splitlines())
    result = [f"{lines} lines"] if lines > MOST_LINES else []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
            start = node.lineno if path in TESTS else first  # the table of a parametrised test is no code
            if (size := node.end_lineno - start + 1 - docstring_lines(node)) > MOST_FUNCTION_LINES:
                result.append(f"{node.name} has {size} lines")
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in OURS:
            names = [*node.module.split("."), *(alias.name for alias in node.names)]
            result += [f"imports {name}" for name in names if name.startswith("_") and not name.endswith("__")]
    return result


@pytest.mark.slow
def test_files_and_functions_are_small_and_import_no_private_name():
    assert {str(path.relative_to(ROOT)): found for path in FILES + TESTS if (found := flaws(path))} == {}


def test_large_files_and_functions_and_private_imports_are_found(tmp_path):
    for text, found in (
        ("x = 1\n" * 501, ["501 lines"]),
        ("def f():\n" + "    x = 1\n" * 50, ["f has 51 lines"]),
        ('def f():\n    """One\n    two."""\n' + "    x = 1\n" * 50, ["f has 51 lines"]),
        ('def f():\n    """One\n    two."""\n' + "    x = 1\n" * 49, []),
        ("from flexman_gym.model.model import _part\n", ["imports _part"]),
        ("from flexman_gym.__main__ import main\nfrom numba import _dynfunc\n", []),
    ):
        (tmp_path / "file.py").write_text(text)
        assert flaws(tmp_path / "file.py") == found


METHODS = {"write_text", "write_bytes"}  # of paths
WRITERS = {"savefig", "imsave", "savetxt", "savez", "savez_compressed", "savemat", "mkstemp"}
LIBRARIES = {"np", "onnx", "torch"}  # whose function `save` writes a file
IN_PLACE = {  # (file, call) -> reason why it does not write by `write_file` or `write_atomically`
    ("flexman_gym/common/files.py", "open('xb')"): "the temporary file of write_atomically",
    ("flexman_gym/common/files.py", "open('wb')"): "a device or a pipe",
    ("flexman_gym/common/run_folder.py", "fdopen('r+')"): "the lock of a folder, which has no content to lose",
    ("flexman_gym/kernels/first_use.py", "open('w')"): "the lock of the cache of kernels, an empty file",
    ("flexman_gym/toolbox/controllers/gain_table.py", "mkstemp"): "a cache that each process replaces by its own file",
    ("flexman_gym/toolbox/controllers/gain_table.py", "fdopen('wb')"): "the same",
}


def in_place(path):
    """Return the calls of a file that write a file in place; a call with the variable `file` opens none."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Call):
            continue
        name = getattr(node.func, "attr", getattr(node.func, "id", ""))
        owner = getattr(getattr(node.func, "value", None), "id", "")
        modes = [each.value for each in [*node.args, *(key.value for key in node.keywords)]
                 if isinstance(each, ast.Constant) and isinstance(each.value, str)]  # fmt: skip
        if node.args and getattr(node.args[0], "id", "") == "file":
            continue
        writing = [each for each in modes if set(each) & set("wax+") and len(each) < 4]
        if name in ("open", "fdopen") and writing:
            found.add(f"{name}({writing[0]!r})")
        elif (
            name in WRITERS
            or (isinstance(node.func, ast.Attribute) and name in METHODS)
            or (name == "save" and owner in LIBRARIES)
        ):
            found.add(name)
    return found


@pytest.mark.slow
def test_no_source_writes_a_file_in_place():
    """A full disk or a killed process leaves the file of before; the exceptions are listed with their reasons."""
    sources = [path for path in FILES if path.relative_to(ROOT).parts[0] != "scripts"]
    found = {(str(path.relative_to(ROOT)), call) for path in sources for call in in_place(path)}
    assert found == set(IN_PLACE)


def test_calls_that_write_in_place_are_found(tmp_path):
    for text, found in (
        ('Path(path).open("w")', {"open('w')"}), ('open(path, mode="ab")', {"open('ab')"}), ("open(path)", set()),
        ('path.write_text("x")', {"write_text"}), ("np.savez(path, a=1)", {"savez"}), ("np.savez(file, a=1)", set()),
        ("np.save(path, 1)", {"save"}), ("episode.save(path)", set()), ('open(path, "rb")', set()),
    ):  # fmt: skip
        (tmp_path / "file.py").write_text(text)
        assert in_place(tmp_path / "file.py") == found, text


def test_folders_of_tests_are_those_of_the_code():
    folders = {path.parent.relative_to(Path(__file__).parent) for path in TESTS if path.name.startswith("test_")}
    code = {path.parent.relative_to(PACKAGE) for path in PACKAGE.rglob("*.py") if path.name != "__init__.py"}
    parts = {Path(*path.parts[: 1 + (path.parts[:1] == ("toolbox",))]) for path in code}
    assert folders == parts | {Path(name) for name in ("agents", "docs", "oracles", "studies")}


def test_installed_packages_are_the_folders_with_code():
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["packages"]
    folders = {".".join(path.parent.relative_to(ROOT).parts) for path in PACKAGE.rglob("__init__.py")}
    assert set(listed) == folders | {"flexman_agents", "flexman_gym.examples"}
    programs = ROOT / "scripts", ROOT / "scripts" / "clients"
    assert all((path.parent / "__init__.py").exists() for path in FILES if path.parent not in programs)


@pytest.mark.slow
def test_importing_the_package_loads_no_heavy_library():
    """Nothing of SciPy either, but for the few modules at its root that Numba takes to read its version."""
    script = "import sys, numba; before = {*sys.modules}; import flexman_gym; "
    script += f"print([name for name in sys.modules if name.split('.')[0] in {sorted(HEAVY)}"
    script += " or name.startswith('scipy.') and name not in before])"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=environment, check=True)
    assert done.stdout.strip() == "[]"
