"""Print what a program loads, and how the folders depend on each other: python scripts/architecture.py [checkout]

The core consists of the folders CORE of `flexman_gym`, all other folders are features. An arrow is an import of one
folder by another, wherever it stands in a file; imports that serve type checkers only are left out.
"""

import ast
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

CORE = ("common", "kernels", "scene", "model", "simulation", "agent", "envs", "metrics", "evaluation")
TOOLBOX, ABOVE = "toolbox", ("commands", "policies", "examples")
REPEATS = 5  # imports whose CPU time is measured; the smallest counts, as other programs only add to it
BASE = "import numpy, numba, gymnasium"
SCENE = "from dataclasses import replace; s = replace(fm.catalog.paper_scene('rr'), duration=0.02)"
PROGRAMS = {
    "import flexman_gym": "",
    "gym.make": "gymnasium.make('FlexRRR-v0').reset(seed=0)",
    "fm.simulate": f"{SCENE}; fm.simulate(s)",
    "fm.evaluate('pd')": "fm.evaluate('pd', 'FlexRRR-v0', seeds=1)",
}
LOADED = """
import sys, json
names = [n for n, m in sys.modules.items() if n.split(".")[0] in ("flexman_gym", "flexman_agents")]
files = [sys.modules[n].__file__ for n in names if getattr(sys.modules[n], "__file__", None)]
heavy = [n for n in ("scipy", "yaml", "safetensors") if n in sys.modules]
print(json.dumps({"modules": len(files), "lines": sum(open(f).read().count("\\n") for f in files), "heavy": heavy}))
"""


def run(program: str, root: Path) -> str:
    """Return the output of a Python program that imports the package of a checkout."""
    environment = os.environ | {"PYTHONPATH": str(root), "FLEXMAN_QUIET": "1"}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment, check=True)
    return done.stdout.splitlines()[-1]


def cpu_seconds(program: str, root: Path) -> float:
    """Return the smallest CPU time of a program, s, after a first run that compiles the modules."""
    timed = f"{program}\nimport time; print(time.process_time())"
    return min(float(run(timed, root)) for _ in range(REPEATS + 1))


def folder(module: str, root: Path) -> str:
    """Return the folder of a module below the package; "" for a module of the package itself.

    The rooms of the toolbox are folders of their own.
    """
    parts = module.split(".")[1:]
    depth = 2 if parts[:1] == [TOOLBOX] else 1
    place = root / "flexman_gym" / Path(*parts[:depth])
    return ".".join(parts[:depth]) if parts and place.is_dir() else ""


def imports(path: Path) -> Iterator[str]:
    """Yield the modules of the package that a file imports, without those for type checkers."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    typed = {node for block in ast.walk(tree) if isinstance(block, ast.If) and "TYPE_CHECKING" in ast.dump(block.test)
             for node in ast.walk(block)}  # fmt: skip
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node not in typed and (node.module or "").startswith("flexman_gym"):
            yield from (f"{node.module}.{each.name}" for each in node.names)
        elif isinstance(node, ast.Import):
            yield from (each.name for each in node.names if each.name.startswith("flexman_gym."))


def structure(root: Path) -> dict[str, object]:
    """Return sizes of the core and the numbers of arrows between folders."""
    package, arrows = root / "flexman_gym", set()
    core = {"files": 0, "lines": 0, "names": 0}
    for path in sorted(package.rglob("*.py")):
        module = ".".join(("flexman_gym", *path.relative_to(package).with_suffix("").parts))
        here, text = folder(module, root), path.read_text(encoding="utf-8")
        if here in CORE:
            core["files"] += 1
            core["lines"] += text.count("\n")
            defined = (ast.FunctionDef, ast.ClassDef)
            core["names"] += sum(isinstance(node, defined) and node.name[0] != "_" for node in ast.parse(text).body)
        arrows |= {(here, folder(each, root)) for each in imports(path)}
    arrows = {(a, b) for a, b in arrows if a != b and a and b and a.split(".")[0] not in ABOVE}
    counts = {
        "arrows in the core": [(a, b) for a, b in arrows if a in CORE and b in CORE],
        "core to feature": [(a, b) for a, b in arrows if a in CORE and b not in CORE],
        "feature to feature": [(a, b) for a, b in arrows if a not in CORE and b not in CORE],
    }
    result: dict[str, object] = {"core": core}
    for name, each in counts.items():
        result[name] = f"{len(each)}: {', '.join(f'{a} -> {b}' for a, b in sorted(each))}"
    return result


def main() -> int:
    """Print all counts of a checkout."""
    root = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[1]).resolve()
    start = "import gymnasium, flexman_gym as fm\n"
    for name, program in PROGRAMS.items():
        print(name, json.loads(run(start + program + LOADED, root)))
    base = cpu_seconds(BASE, root)
    own = cpu_seconds(f"{BASE}, flexman_gym", root) - base
    print(f"import flexman_gym: {own:.2f} CPU s above {base:.2f} s of {BASE}")
    for name, value in structure(root).items():
        print(name, value)
    return 0


if __name__ == "__main__":
    sys.exit(main())
