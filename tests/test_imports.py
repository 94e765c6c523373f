"""Imports: arrows between the rooms run one way, heavy libraries stay out, and files and functions stay small."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import flexman_gym

PACKAGE = Path(flexman_gym.__file__).parent
ROOT = PACKAGE.parent
MOST_LINES, MOST_FUNCTION_LINES, MOST_ARGUMENTS, MOST_KERNEL_ARGUMENTS = 350, 60, 7, 9

# Who may import whom, in the order from the ground up: a room may use what stands beside it, and nothing else of ours.
ARROWS = {
    "closed_forms": "",
    "verification": "",
    "kernels": "",
    "checks": "",
    "arm": "checks",
    "scene_file": "checks",
    "drive": "checks",
    "scene": "drive arm checks scene_file",
    "catalog": "scene drive arm checks",
    "beam": "arm checks",
    "reduction": "beam arm checks",
    "dormand_prince": "",
    "methods": "dormand_prince kernels checks",
    "amplification": "methods beam",
    "model": "reduction beam scene arm checks kernels",
    "strain": "model beam scene arm checks",
    "dynamics": "model reduction beam scene arm checks kernels",
    "trajectory": "model beam checks kernels",
    "run": "model methods drive beam checks kernels",
    "movers": "run drive methods beam kernels",
    "batch": "movers run trajectory methods model beam checks kernels",
    "simulator": "batch run trajectory drive dynamics model methods reduction beam scene arm checks kernels",
    "fidelity_search": "trajectory simulator dynamics model methods beam scene checks",
    "fidelity": "fidelity_search amplification trajectory simulator dynamics model methods reduction beam scene arm"
    " checks",
    "control": "simulator dynamics model reduction beam scene catalog arm checks kernels",
    "sensors": "strain simulator dynamics model beam scene catalog arm checks kernels",
    "metrics": "simulator beam scene checks",
    "tasks": "sensors simulator dynamics model beam scene catalog arm checks kernels",
    "study": "fidelity metrics control simulator dynamics model methods scene catalog arm checks",
    "draw": "trajectory simulator dynamics model beam scene catalog arm checks",
    "precision": "simulator trajectory model scene beam",
    "precision_cases": "precision simulator drive model scene catalog",
    "charts": "precision draw",
    "precision_page": "amplification precision charts methods verification",
    "randomisation": "checks",
    "effects": "randomisation batch sensors model beam checks",
    "setup": "randomisation fidelity drive tasks sensors trajectory model methods beam scene catalog arm checks",
    "episodes": "setup effects randomisation batch tasks sensors model beam checks kernels",
    "envs": "episodes setup draw simulator model checks kernels",
    "vector_env": "envs episodes setup batch beam checks kernels",
    "verification_links": "verification closed_forms dynamics model beam arm",
    "verification_cases": "verification_links verification closed_forms simulator dynamics model beam catalog arm"
    " kernels",
    "verification_motions": "verification_cases verification trajectory drive simulator dynamics model beam scene"
    " catalog arm",
    "table": "",
    "stability": "amplification simulator dynamics model methods beam",
    "stability_cases": "amplification stability run simulator dynamics drive model methods beam catalog arm kernels",
    "stability_charts": "stability_cases stability draw methods",
    "stability_conclusions": "stability_cases stability",
    "stability_page": "amplification stability_conclusions stability_cases stability methods",
}
_PUBLIC = "vector_env envs episodes setup tasks sensors control metrics study draw fidelity simulator dynamics model"
_PUBLIC += " methods scene catalog arm batch randomisation strain drive trajectory run amplification"
ARROWS["flexman_gym"] = _PUBLIC
ARROWS["agents"] = f"agents flexman_gym checks {_PUBLIC}"
ARROWS["scripts"] = f"scripts agents flexman_gym checks {_PUBLIC} verification verification_cases verification_motions"
ARROWS["scripts"] += " stability stability_cases stability_charts stability_page"
ARROWS["scripts"] += " precision precision_cases precision_page charts beam table"
INSIDE_KERNELS = {"numba", "llvmlite", "numpy", "math", "operator", "typing", "collections"}
CACHE_ROOM = {"hashlib", "os", "tempfile", "pathlib"}  # kernels/__init__.py names the folder of the binaries
HEAVY = {"torch", "stable_baselines3", "matplotlib", "pyvista", "ray"}

FILES = sorted(path for folder in (PACKAGE, ROOT / "agents", ROOT / "scripts") for path in folder.rglob("*.py"))
TESTS = sorted(Path(__file__).parent.glob("*.py"))
KERNELS = [path for path in FILES if path.parent.name == "kernels"]


def name_of(path):
    """A short name for a test's id."""
    return str(path.relative_to(ROOT))


def room(path):
    """The room that a file belongs to."""
    if path.parent.name in ("kernels", "agents", "scripts"):
        return path.parent.name
    return path.parent.name if path.stem == "__init__" else path.stem


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
    """Rooms that a file imports."""
    for module in modules(tree):
        parts = module.split(".")
        if parts[0] in ("agents", "scripts"):
            yield parts[0]
        if parts[0] == "flexman_gym":
            yield parts[1] if len(parts) > 1 and parts[1] in ARROWS else "flexman_gym"


def parsed(path):
    """The syntax tree of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_arrows_run_one_way(path):
    assert room(path) in ARROWS, "a new room: write it into the table of arrows"
    allowed = {room(path), *ARROWS[room(path)].split()} if room(path) == "kernels" else ARROWS[room(path)].split()
    assert sorted(set(targets(parsed(path))) - set(allowed)) == []


def test_the_table_of_arrows_has_no_circle():
    order = list(ARROWS)
    for name, allowed in ARROWS.items():
        earlier = set(order[: order.index(name)]) | ({name} & {"agents", "scripts"})
        assert set(allowed.split()) <= earlier, name


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_heavy_libraries_stay_in_their_rooms(path):
    loaded = {module.split(".")[0] for module in modules(parsed(path))}
    if path not in KERNELS:
        assert "numba" not in loaded
    if PACKAGE in path.parents:
        assert not {module.split(".")[0] for module in at_module_level(parsed(path))} & HEAVY


@pytest.mark.parametrize("path", KERNELS, ids=name_of)
def test_kernels_import_next_to_nothing(path):
    loaded = {module.split(".")[0] for module in modules(parsed(path))} - {"flexman_gym"}
    assert loaded <= INSIDE_KERNELS | (CACHE_ROOM if path.stem == "__init__" else set())


def test_importing_the_package_loads_no_heavy_library():
    """Nothing of SciPy either, but for the few modules at its root that Numba takes to read its version."""
    script = "import sys, numba; before = {*sys.modules}; import flexman_gym; "
    script += f"print([name for name in sys.modules if name.split('.')[0] in {sorted(HEAVY)}"
    script += " or name.startswith('scipy.') and name not in before])"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=environment, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("path", FILES + TESTS, ids=name_of)
def test_files_and_functions_are_small(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= MOST_LINES
    for node in ast.walk(parsed(path)):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
        body = node.lineno if path in TESTS else first  # the table of a parametrised test is no code
        assert node.end_lineno - body + 1 <= MOST_FUNCTION_LINES, node.name
        if path in TESTS:
            continue
        arguments = node.args.posonlyargs + node.args.args
        most = MOST_KERNEL_ARGUMENTS if path in KERNELS else MOST_ARGUMENTS
        count = len(arguments) - bool(arguments and arguments[0].arg in ("self", "cls"))
        assert count <= most, f"{node.name} has {count} arguments"


@pytest.mark.parametrize("path", FILES + TESTS, ids=name_of)
def test_a_file_opens_with_one_sentence(path):
    first = (ast.get_docstring(parsed(path)) or "").split("\n")[0]
    assert first[:1].isupper() or first.startswith("flexman_gym: ")
    assert ":" in first or first.endswith(".")
