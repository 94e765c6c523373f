"""Tests of source files: sizes, private names, packages; rules beyond ruff and import-linter."""

import ast
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import flexman_gym

PACKAGE = Path(flexman_gym.__file__).parent
ROOT = PACKAGE.parent
MOST_LINES, MOST_FUNCTION_LINES = 500, 50
OURS = {"flexman_gym", "flexman_agents", "studies"}
HEAVY = {"torch", "stable_baselines3", "matplotlib", "pyvista", "ray"}
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


def test_installed_packages_are_the_folders_with_code():
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["packages"]
    folders = {".".join(path.parent.relative_to(ROOT).parts) for path in PACKAGE.rglob("__init__.py")}
    assert set(listed) == folders | {"flexman_agents", "flexman_gym.examples"}
    assert all((path.parent / "__init__.py").exists() for path in FILES if path.parent != ROOT / "scripts")


def test_importing_the_package_loads_no_heavy_library():
    """Nothing of SciPy either, but for the few modules at its root that Numba takes to read its version."""
    script = "import sys, numba; before = {*sys.modules}; import flexman_gym; "
    script += f"print([name for name in sys.modules if name.split('.')[0] in {sorted(HEAVY)}"
    script += " or name.startswith('scipy.') and name not in before])"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=environment, check=True)
    assert done.stdout.strip() == "[]"
