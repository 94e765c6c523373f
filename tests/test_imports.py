"""Imports: arrows between the rooms run one way, heavy libraries stay out, and files and functions stay small."""

import ast
import os
import subprocess
import sys
import tomllib
from graphlib import TopologicalSorter
from pathlib import Path

import flexman_gym

PACKAGE = Path(flexman_gym.__file__).parent
ROOT = PACKAGE.parent
MOST_LINES, MOST_FUNCTION_LINES, MOST_ARGUMENTS, MOST_KERNEL_ARGUMENTS = 500, 50, 7, 9

# Who may import whom, from the ground up: a folder uses what stands beside it, and itself, and nothing else of ours.
FLOORS = {
    "common": "kernels",  # a grid of processes compiles the kernels once
    "kernels": "",
    "scene": "common",
    "model": "scene kernels common",
    "simulation": "model scene kernels common",
    "fidelity": "simulation model scene common",
    "identification": "simulation model scene kernels common",
    "draw": "simulation model scene kernels common",
    "control": "simulation model kernels common",
    "envs": "draw control fidelity simulation model scene kernels common",
    "metrics": "common",
    "verification": "simulation model scene kernels common",
    "evaluation": "metrics envs draw control simulation scene kernels common",
    "league": "verification evaluation metrics envs draw control simulation scene kernels common",
    "agents": "flexman_gym league evaluation envs metrics draw control simulation scene common",
    "commands": "flexman_gym agents verification league evaluation envs draw control fidelity simulation model scene "
    "kernels common",
    "__main__": "flexman_gym commands",
    "studies": "flexman_gym agents verification league evaluation metrics envs draw control identification fidelity "
    "simulation model scene kernels common",
    "scripts": "flexman_gym __main__ agents studies verification league evaluation envs draw fidelity simulation model "
    "scene common",
}
# what flexman_gym/__init__.py gathers
PUBLIC = "evaluation envs control draw identification fidelity metrics simulation model scene"
INSIDE_KERNELS = {"numba", "llvmlite", "numpy", "math", "operator", "typing", "collections", "functools"}
# what names the folder of the binaries, and keeps them there
CACHE_ROOM = {"hashlib", "os", "sys", "tempfile", "pathlib", "pickle", "re", "shutil", "stat"}
OPEN = {"flexman_gym/commands/demo.py"}  # which is imported when it runs
HEAVY = {"torch", "stable_baselines3", "matplotlib", "pyvista", "ray"}

FILES = sorted(path for folder in (PACKAGE, ROOT / "agents", ROOT / "scripts") for path in folder.rglob("*.py"))
TESTS = sorted(Path(__file__).parent.rglob("*.py"))
KERNELS = [path for path in FILES if path.parent.name == "kernels"]


def name_of(path):
    """A short name for a test's id."""
    return str(path.relative_to(ROOT))


def floor(path):
    """The folder, or the single room of the ground floor, that a file belongs to; "flexman_gym" for the roof."""
    parts = path.relative_to(PACKAGE if PACKAGE in path.parents else ROOT).with_suffix("").parts
    if parts[:2] == ("scripts", "studies"):
        return "studies"
    return "flexman_gym" if parts[0] == "__init__" else parts[0]


def modules(tree):
    """Full names of imported modules, a from-import with each of its names, in a tree or a part of one."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are written in full"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def at_module_level(tree):
    """Modules imported outside functions: what importing the file loads."""
    inside = {module for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) for module in modules(node)}
    return [module for module in modules(tree) if module not in inside]


def targets(tree):
    """Floors that a file imports from."""
    for module in modules(tree):
        parts = module.split(".")
        if parts[0] == "flexman_agents":
            yield "agents"
        if parts[0] == "studies":
            yield "studies"
        if parts[0] == "flexman_gym":
            yield parts[1] if len(parts) > 1 and parts[1] in FLOORS else "flexman_gym"


def parsed(path):
    """The syntax tree of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def offenders(paths, rule):
    """What a rule says of each file that breaks it; it gives a text, "" for a file that keeps it."""
    said = {name_of(path): rule(path) for path in paths}
    return {name: words for name, words in said.items() if words}


def test_a_folder_imports_from_the_floors_below():
    def rule(path):
        here = floor(path)
        if here not in FLOORS and here != "flexman_gym":
            return "a new folder: write it into the table of floors"
        allowed = PUBLIC.split() if here == "flexman_gym" else [here, *FLOORS[here].split()]
        return ", ".join(sorted(set(targets(parsed(path))) - set(allowed)))

    assert offenders(FILES, rule) == {}


def test_the_table_of_floors_has_no_circle():
    order = list(FLOORS)
    for name, allowed in FLOORS.items():
        assert set(allowed.split()) <= {"flexman_gym", *order[: order.index(name)]}, name
        assert "flexman_gym" not in allowed.split() or order.index(name) > max(map(order.index, PUBLIC.split())), name


def test_files_import_each_other_in_no_circle():
    names = {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path for path in FILES}
    names = {name.replace("scripts.studies", "studies"): path for name, path in names.items()}
    graph = {}
    for name, path in names.items():
        result = set()
        for module in modules(parsed(path)):
            known = module if module in names else module.rpartition(".")[0]
            result |= {known} & names.keys() - {name}
        graph[name] = result
    tuple(TopologicalSorter(graph).static_order())  # raises CycleError


def test_what_is_installed_are_the_folders_with_code():
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["packages"]
    folders = {".".join(path.parent.relative_to(ROOT).parts) for path in PACKAGE.rglob("__init__.py")}
    assert set(listed) == folders | {"flexman_agents", "flexman_gym.examples"}
    assert all((path.parent / "__init__.py").exists() for path in FILES if path.parent != ROOT / "scripts")


def test_tests_import_no_tests():
    for path in TESTS:
        assert not [name for name in modules(parsed(path)) if name.split(".")[-1].startswith("test_")], path


def test_heavy_libraries_stay_in_their_rooms():
    def rule(path):
        loaded = {module.split(".")[0] for module in modules(parsed(path))}
        heavy = {module.split(".")[0] for module in at_module_level(parsed(path))} & HEAVY
        inside = PACKAGE in path.parents and name_of(path) not in OPEN
        return ", ".join(({"numba"} & loaded if path not in KERNELS else set()) | (heavy if inside else set()))

    assert offenders(FILES, rule) == {}


def test_kernels_import_next_to_nothing():
    def rule(path):
        loaded = {module.split(".")[0] for module in modules(parsed(path))} - {"flexman_gym"}
        return ", ".join(loaded - INSIDE_KERNELS - (CACHE_ROOM if path.stem in ("__init__", "cache") else set()))

    assert offenders(KERNELS, rule) == {}


def test_importing_the_package_loads_no_heavy_library():
    """Nothing of SciPy either, but for the few modules at its root that Numba takes to read its version."""
    script = "import sys, numba; before = {*sys.modules}; import flexman_gym; "
    script += f"print([name for name in sys.modules if name.split('.')[0] in {sorted(HEAVY)}"
    script += " or name.startswith('scipy.') and name not in before])"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=environment, check=True)
    assert done.stdout.strip() == "[]"


def too_large(path):
    """What of a file is larger than it should be."""
    lines = len(path.read_text(encoding="utf-8").splitlines())
    result = [f"{lines} lines"] if lines > MOST_LINES else []
    for node in ast.walk(parsed(path)):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
        body = node.lineno if path in TESTS else first  # the table of a parametrised test is no code
        if node.end_lineno - body + 1 > MOST_FUNCTION_LINES:
            result.append(f"{node.name} has {node.end_lineno - body + 1} lines")
        arguments = node.args.posonlyargs + node.args.args
        most = MOST_KERNEL_ARGUMENTS if path in KERNELS else MOST_ARGUMENTS
        count = len(arguments) - bool(arguments and arguments[0].arg in ("self", "cls"))
        if path not in TESTS and count > most:
            result.append(f"{node.name} has {count} arguments")
    return ", ".join(result)


def test_files_and_functions_are_small():
    assert offenders(FILES + TESTS, too_large) == {}


def test_the_rule_of_sizes_sees_what_is_too_large(tmp_path):
    """A rule that lists nothing may see nothing."""
    for name, text, words in (
        ("long.py", "x = 1\n" * 501, "501 lines"),
        ("deep.py", "def f():\n" + "    x = 1\n" * 50, "f has 51 lines"),
        ("wide.py", "def f(a, b, c, d, e, f, g, h): ...\n", "f has 8 arguments"),
        ("good.py", "def f(self, b, c, d, e, f, g, h): ...\n", ""),
    ):
        (tmp_path / name).write_text(text)
        assert too_large(tmp_path / name) == words


def test_a_file_opens_with_one_sentence():
    def rule(path):
        first = (ast.get_docstring(parsed(path)) or "").split("\n")[0]
        good = (first[:1].isupper() or first.startswith("flexman_gym: ")) and (":" in first or first.endswith("."))
        return "" if good else first or "nothing"

    assert offenders(FILES + TESTS, rule) == {}
