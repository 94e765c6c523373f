"""Tests of the dependencies of a run: what it used in all processes, kernels, constants and files, and nothing else."""

import ast
import subprocess
import sys
import time

import pytest

from studies.dependencies import Name, Sources, hash_of, plain
from studies.trace import Dependencies, read_record, run_traced

FILES = {
    "own/__init__.py": "",
    "own/kernels.py": '''"""Kernels."""

from numba import njit

kernel = njit(error_model="numpy")
SCALE = 2.0  # of nothing
OFFSET = SCALE + 1.0
UNUSED = 3.0


@kernel
def inner(x):
    """Return x, scaled."""
    return SCALE * x


@kernel
def outer(x):
    return inner(x) + OFFSET


@kernel
def other(x):
    return UNUSED * x


def registering(function):
    return function


def helper(x):
    return x / 3.0


@registering
def registered(x):
    return helper(x)
''',
    "own/work.py": '''import os
from pathlib import Path

import numpy as np
import yaml

from own import kernels
from own.table import TABLE, twice

HERE = Path(__file__).parent


class Base:
    limit = 8.0


class Settings(Base):
    gain = 4.0

    def __init__(self):
        data = yaml.safe_load((HERE / "settings.yaml").read_text())
        self.factor = data["factor"]

    def product(self, x):
        # a comment
        return self.gain * self.factor * x

    def idle(self):
        return 0.0


def last(x):
    return x


def never():
    return 2.0


def task(x):
    """Return a number."""
    twice(x)
    if x < 0.0:
        never()
    weights = np.load(HERE / "policy.npz")["weights"]
    return float(Settings().product(kernels.outer(x)) + weights.sum() + TABLE["one"])


def end(x):
    last(x)
    os._exit(0)


def idle():
    return 0.0
''',
    "own/table.py": """def made(number):
    return number + 0.0


def checked(number):
    return number


def twice(number):
    return 2.0 * number


TABLE = {"one": made(1.0)}
TABLE["two"] = 9.0
CHECKED = checked(1.0)
TWICE = twice(1.0)
PLACES = {"first": "own.plugin:FIRST", "second": "own.unloaded:SECOND"}
""",
    "own/plugin.py": "FIRST = 5.0\nNEVER = 6.0\n",
    "own/unloaded.py": "SECOND = 7.0\n",
    "own/shapes.py": 'SHAPES = {"square": lambda x: x**2}\nOTHERS = {"cube": lambda x: x**3}\n'
    "\n\nclass Hidden:\n    factor = 6.0\n\n    def area(self):\n        return self.factor\n",
    "own/outside.py": "def called():\n    return 1\n",
    "own/threads.py": "def threaded():\n    return 1\n",
    "own/drawing.py": "def page():\n    return 1\n",
    "own/settings.yaml": "factor: 2.0  # a comment\n",
    "own/unread.yaml": "factor: 2.0\n",
    "scripts/studies/study.py": """from own.drawing import page


class Study:
    def draw(self):
        return page()
""",
    "program.py": """import sys
from importlib import import_module
from multiprocessing import get_context
from threading import Thread

sys.path[:0] = ["scripts/studies", "../others"]


def main():
    from flexman_gym.common.parallel import parallel_map
    from own.table import PLACES
    from own.threads import threaded
    from own.work import end, task
    from study import Study

    place, name = PLACES["first"].split(":")
    import_module("outsider")
    getattr(import_module("own.shapes"), "SHAPES")["square"](2.0)
    getattr(import_module("own.shapes"), "Hidden")().area()
    print(getattr(import_module(place), name) + sum(parallel_map(task, [1.0, 2.0], 2)))
    Thread(target=threaded).start()
    process = get_context("fork").Process(target=end, args=(1,))
    process.start()
    process.join()
    Study().draw()
    open("rows.csv", "w").write("row")


if __name__ == "__main__":
    main()
""",
}


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """Return a checkout, and the dependencies of its program with worker processes."""
    import numpy as np

    root = tmp_path_factory.mktemp("checkout")
    for path, text in FILES.items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text(text)
    (root.parent / "others").mkdir()
    (root.parent / "others" / "outsider.py").write_text("from own.outside import called\n\ncalled()\n")
    np.savez(root / "own" / "policy.npz", weights=np.ones(3))
    np.savez(root / "own" / "second.npz", weights=np.ones(3))
    sources, start = Sources(root), time.time() + 1.0
    run_traced(["-m", "program"], root, root / "out" / "trace")
    return root, read_record(root / "out" / "trace", sources, (), start)


CHANGED = [
    ("own/work.py", "self.gain * self.factor", "self.gain + self.factor", "work.py Settings.product"),  # in a worker
    ("own/work.py", "gain = 4.0", "gain = 5.0", "work.py Settings"),  # field of a class
    ("own/work.py", "    return x\n", "    return -x\n", "work.py last"),  # in a process that ends by os._exit
    ("own/work.py", "Path(__file__).parent", "Path(__file__).absolute().parent", "work.py HERE"),
    ("own/threads.py", "return 1", "return 2", "threads.py threaded"),
    ("own/kernels.py", "inner(x) + OFFSET", "inner(x) - OFFSET", "kernels.py outer"),  # kernel called by Python
    ("own/kernels.py", "SCALE * x", "SCALE / x", "kernels.py inner"),  # kernel called by a kernel
    ("own/kernels.py", "SCALE = 2.0", "SCALE = 2.5", "kernels.py SCALE"),  # constant of a kernel
    ("own/kernels.py", "SCALE + 1.0", "SCALE + 2.0", "kernels.py OFFSET"),
    ("own/kernels.py", '"numpy"', '"python"', "kernels.py kernel"),  # decorator
    ("own/table.py", "number + 0.0", "number + 1.0", "table.py made"),  # called by the import, for a constant in use
    ("own/kernels.py", "return helper(x)", "return -helper(x)", "kernels.py registered"),  # of the compiler
    ("own/kernels.py", "x / 3.0", "x / 4.0", "kernels.py helper"),
    ("own/work.py", "limit = 8.0", "limit = 9.0", "work.py Base"),
    ("own/table.py", "2.0 * number", "3.0 * number", "table.py twice"),  # called by the import and by the run
    ("own/shapes.py", "x**2", "x**4", "shapes.py SHAPES"),
    ("own/shapes.py", "factor = 6.0", "factor = 7.0", "shapes.py Hidden"),  # field of a class that no text names
    ("own/table.py", "9.0", "9.5", "table.py statements"),
    ("own/table.py", "made(1.0)", "made(2.0)", "table.py TABLE"),
    ("own/plugin.py", "5.0", "5.5", "plugin.py FIRST"),  # entry of a table that was loaded
    ("own/settings.yaml", "2.0", "3.0", "settings.yaml"),
    ("own/policy.npz", "", "", "policy.npz"),
]
UNCHANGED = [
    ("own/work.py", "def idle():\n    return 0.0", "def idle():\n    return 1.0"),  # function that was not called
    ("own/work.py", "    return 2.0", "    return 3.0"),  # named by a function, and not called
    ("own/work.py", "def idle(self):\n        return 0.0", "def idle(self):\n        return 1.0"),
    ("own/work.py", '"""Return a number."""', '"""Return another number."""'),
    ("own/work.py", "# a comment", "# another comment"),
    ("own/work.py", "self.gain * self.factor * x", "(\n            self.gain * self.factor * x\n        )"),
    ("own/kernels.py", '"""Return x, scaled."""', ""),
    ("own/kernels.py", "# of nothing", ""),
    ("own/kernels.py", "UNUSED * x", "UNUSED / x"),  # kernel that nothing calls, and its constant
    ("own/kernels.py", "UNUSED = 3.0", "UNUSED = 4.0"),
    ("own/table.py", "return number\n", "return number + 1\n"),  # called by the import, for a constant of nobody
    ("own/table.py", "twice(1.0)", "twice(2.0)"),
    ("own/outside.py", "return 1", "return 2"),  # called by the import of another package
    ("own/shapes.py", "x**3", "x**4"),
    ("own/plugin.py", "6.0", "6.5"),
    ("own/unloaded.py", "7.0", "7.5"),  # entry of a table that was not loaded
    ("own/drawing.py", "return 1", "return 2"),  # it decides no rows
    ("own/settings.yaml", "# a comment", ""),
    ("own/unread.yaml", "2.0", "3.0"),
    ("own/second.npz", "", ""),
]


def changes(checkout, file, old, new):
    """Return what is noticed of a planted change; without an old text a byte is added to the file."""
    root, known = checkout
    path = root / file
    before = path.read_bytes()
    assert not old or before.decode().count(old) == 1
    path.write_bytes(before.decode().replace(old, new).encode() if old else before + b"0")
    try:
        return known.changes(Sources(root), root)
    finally:
        path.write_bytes(before)


@pytest.mark.slow
@pytest.mark.parametrize(("file", "old", "new", "name"), CHANGED)
def test_a_change_of_what_a_run_used_is_noticed_by_its_name(checkout, file, old, new, name):
    assert changes(checkout, file, old, new) == [name]


@pytest.mark.slow
@pytest.mark.parametrize(("file", "old", "new"), UNCHANGED)
def test_a_change_of_anything_else_is_not_noticed(checkout, file, old, new):
    assert changes(checkout, file, old, new) == []


@pytest.mark.slow
def test_files_that_are_read_count_and_no_others(checkout):
    assert checkout[1].files.keys() == {"own/settings.yaml", "own/policy.npz"}


@pytest.mark.slow
def test_a_file_that_is_gone_or_renamed_is_a_change(checkout):
    root, known = checkout
    for name in ("threads.py", "policy.npz"):
        (root / "own" / name).rename(root / "own" / "moved")
        assert [each.split()[0] for each in known.changes(Sources(root), root)] == [name]
        (root / "own" / "moved").rename(root / "own" / name)
    assert known.changes(Sources(root), root) == []


@pytest.mark.slow
def test_code_in_neutral_files_and_what_it_reads_does_not_count(checkout):
    root, known = checkout
    found = read_record(root / "out" / "trace", Sources(root), ("own/work.py", "own/threads.py"), time.time() + 1.0)
    assert known.definitions.keys() - found.definitions.keys() == {"own/work.py", "own/threads.py", "own/kernels.py"}
    assert "own/settings.yaml" in known.files and "own/settings.yaml" not in found.files


@pytest.mark.slow
def test_a_file_that_changed_during_the_run_counts_as_changed(checkout):
    root, _ = checkout
    found = read_record(root / "out" / "trace", Sources(root), (), 0.0)
    assert set(found.changes(Sources(root), root)) == {"settings.yaml", "policy.npz"}


@pytest.mark.slow
def test_a_traced_program_prints_the_same_and_fails_as_it_does_alone(checkout, tmp_path, capfd):
    root, _ = checkout
    call = [sys.executable, "-m", "program"]
    alone = subprocess.run(call, cwd=root, capture_output=True, text=True, check=True).stdout
    run_traced(["-m", "program"], root, tmp_path / "trace")
    assert capfd.readouterr().out == alone
    with pytest.raises(subprocess.CalledProcessError):
        run_traced(["-c", "raise SystemExit(3)"], root, tmp_path / "trace")


def test_names_are_found_through_imports_and_attributes(tmp_path):
    for path, text in {
        "own/__init__.py": "from own.parts import NUMBER as SAME\n",
        "own/parts.py": "NUMBER = 1\nOTHER = NUMBER\n\nclass Part:\n    size = NUMBER\n",
        "use.py": "import own\nimport own.parts as parts\nfrom own.parts import Part\n\n"
                  "def f(OTHER: Part, x=own.SAME):\n    from own import parts as inside\n"
                  "    return OTHER, inside.OTHER\n\n"
                  "def g():\n    return parts.Part.size\n\n"
                  "def h(Part):\n    parts = Part\n    return parts.OTHER, Part\n",
    }.items():  # fmt: skip
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_text(text)
    sources = Sources(tmp_path)
    found = {name: {each.name for each in sources.references(Name("use.py", name))} for name in "fgh"}
    assert found == {"f": {"NUMBER", "OTHER"}, "g": {"Part"}, "h": set()}
    assert sources.references(Name("own/parts.py", "Part")) == {Name("own/parts.py", "NUMBER")}


def test_the_text_of_a_definition_is_that_of_all_versions_of_python():
    """Later versions have more fields, which are empty in earlier ones."""
    node = ast.parse('def f(x: int) -> int:\n    """Text."""\n    return x  # a comment\n').body[0]
    body = "body=[Return(value=Name(id='x'))]"
    assert plain(node) == f"FunctionDef(name='f',args=arguments(args=[arg(arg='x')]),{body})"


def test_a_folder_is_hashed_with_its_names_and_data(tmp_path):
    (tmp_path / "code").mkdir()
    (tmp_path / "code" / "double.py").write_text("FACTOR = 2.0\n")
    first = hash_of(["code"], tmp_path)
    (tmp_path / "code" / "double.py").write_text("FACTOR = 2.0  # a comment\n")
    assert hash_of(["code"], tmp_path) == first
    (tmp_path / "code" / "data.csv").write_text("1\n")
    assert (second := hash_of(["code"], tmp_path)) != first
    (tmp_path / "code" / "data.csv").write_text("2\n")
    assert hash_of(["code"], tmp_path) not in (first, second)
    (tmp_path / "code" / "data.csv").unlink()
    (tmp_path / "code" / "double.py").rename(tmp_path / "code" / "twice.py")
    assert hash_of(["code"], tmp_path) != first


def test_nothing_used_never_changes(tmp_path):
    assert Dependencies().changes(Sources(tmp_path), tmp_path) == []
