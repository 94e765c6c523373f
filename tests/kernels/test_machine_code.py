"""Machine code of kernels in a wheel: when it is used, and that kernels compile otherwise, with the same results."""

import json
import os
import shutil
import types

import numba
import pytest
from machine_code import SOURCES, called_names
from numba.core.dispatcher import Dispatcher

from flexman_gym import kernels
from flexman_gym.kernels import machine_code
from flexman_gym.kernels.cache import CODE_SETTINGS

from oracles.files import ROOT
from oracles.small_package import copied, process, run

MODULE = """from flexman_gym.kernels.compile import inner, kernel
@inner
def third(x):
    return x / 3.0
@kernel
def thirds(x):
    return 2.0 * third(x)
@kernel
def other(x):
    return x + 1.0
@kernel
def called(x):
    return x * x
@kernel
def caller(x):
    return called(x) + 1.0
"""
CALL = """from numba.core import event
compiled = []
class Listener(event.Listener):
    def on_start(self, event): compiled.append(event.data["dispatcher"].py_func.__name__)
    def on_end(self, event): pass
event.register("numba:compile", Listener())
from flexman_gym.kernels import machine_code
{before}
from flexman_gym.kernels.thirds import caller, other, thirds
print(thirds(1.0).hex(), other(1.0).hex(), caller(3.0).hex(), ",".join(compiled) or "nothing")
"""
EXPECTED = [(2.0 * (1.0 / 3.0)).hex(), (2.0).hex(), (10.0).hex()]
MAKE = """import json
from pathlib import Path
from flexman_gym.kernels import CACHE_FOLDER, machine_code
from machine_code import write_level
for level in machine_code.LEVELS:
    write_level(Path(CACHE_FOLDER), machine_code.FOLDER / level)
(machine_code.FOLDER / machine_code.MADE_WITH).write_text(json.dumps(machine_code.made_with()))
"""
ALL = "thirds,third,other,caller,called"

pytestmark = pytest.mark.skipif(not machine_code.LEVELS, reason="no level is known for this kind of processor")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return a package with machine code, made for this processor under the name of each level."""
    package, cache = tmp_path_factory.mktemp("package"), tmp_path_factory.mktemp("cache")
    copied(package, 1)
    (package / "flexman_gym" / "kernels" / "thirds.py").write_text(MODULE)
    assert run(package, cache, CALL.format(before="")) == [*EXPECTED, ALL]
    done = process(package, cache, MAKE, PYTHONPATH=f"{package}:{ROOT / 'scripts'}")
    assert done.returncode == 0, done.stderr
    return package


@pytest.fixture
def package(made, tmp_path):
    """Return a copy of the package that a test can change."""
    shutil.copytree(made / "flexman_gym", tmp_path / "flexman_gym")
    return tmp_path


def files(package, kernel):
    """Return the files of a kernel at all levels, as the processor decides which is used."""
    return [package / "flexman_gym" / "kernels" / "machine_code" / level / kernel for level in machine_code.LEVELS]


def used(package, before="", **settings):
    """Return the names of the kernels that compile, after a comparison of the results."""
    *results, compiled = run(package, package / "cache", CALL.format(before=before), **settings)
    assert results == EXPECTED
    return compiled


@pytest.mark.slow
def test_nothing_compiles_and_nothing_is_cached(package):
    assert used(package) == "nothing"
    assert not list((package / "cache").rglob("*.nb?"))


@pytest.mark.slow
def test_no_cache_folder_is_needed(package):
    """Nor is there a warning, as no kernel compiles."""
    (package / "file").write_text("")
    (package / f"user-{os.getuid()}").symlink_to(package)
    done = process(package, package / "file", CALL.format(before=""), TMPDIR=str(package))
    assert done.stdout.split() == [*EXPECTED, "nothing"] and done.stderr == ""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["numba", "llvmlite", "python", "NUMBA_OPT", "sources of kernels"])
def test_kernels_compile_if_it_was_made_with_something_else(package, name):
    path = package / "flexman_gym" / "kernels" / "machine_code" / machine_code.MADE_WITH
    made = json.loads(path.read_text())
    path.write_text(json.dumps(made | {name: "0.68.0"}))
    assert used(package) == ALL
    script = "from flexman_gym.kernels import machine_code as m; print(m.LEVEL, m.REASON, sep=': ')"
    assert process(package, package / "cache", script).stdout == (
        f"None: it was made with {name} 0.68.0, here {made[name]}\n"
    )


@pytest.mark.slow
def test_an_edited_source_compiles(package):
    with (package / "flexman_gym" / "kernels" / "thirds.py").open("a") as file:
        file.write("# edited\n")
    assert used(package) == ALL


@pytest.mark.slow
@pytest.mark.parametrize("damage", ["last byte", "short", "empty", "missing"])
def test_a_damaged_file_concerns_its_kernel_only(package, damage):
    for path in files(package, "thirds.other"):
        content = path.read_bytes()
        wrong = {"last byte": content[:-1] + bytes([content[-1] ^ 1]), "short": content[:40], "empty": b""}
        path.unlink() if damage == "missing" else path.write_bytes(wrong[damage])
    assert used(package) == "other"


@pytest.mark.slow
def test_a_signature_that_the_file_lacks_compiles(package):
    script = "from flexman_gym.kernels.thirds import other; print(other(1), other(1.0), len(other.overloads))"
    assert run(package, package / "cache", script) == ["2.0", "2.0", "2"]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "value"), [("CPU_NAME", "generic"), ("CPU_FEATURES", "+sse2"), ("OPT", "1")])
def test_settings_of_numba_compile(package, name, value):
    assert used(package, **{f"NUMBA_{name}": value}) == ALL


@pytest.fixture
def levels(tmp_path, monkeypatch):
    """Return a function that gives the level of a processor without some of its instructions."""
    monkeypatch.setattr(machine_code, "FOLDER", tmp_path)
    monkeypatch.setattr(machine_code, "LEVELS", machine_code._LEVELS["x86_64"])
    for name in machine_code.PROCESSOR_SETTINGS:
        monkeypatch.setattr(numba.config, name, None)
    for level in machine_code.LEVELS:
        (tmp_path / level).mkdir()
    (tmp_path / machine_code.MADE_WITH).write_text(json.dumps(machine_code.made_with()))

    def level(*lacking):
        features = {name: name not in lacking for name in machine_code.LEVELS["x86-64-v4"].split()}
        monkeypatch.setattr(machine_code.binding, "get_host_cpu_features", lambda: features)
        return machine_code.find_level()

    return level


def test_the_level_is_the_fastest_whose_instructions_the_processor_has(levels):
    assert levels() == ("x86-64-v4", "")
    for name in ("avx512vl", "avx512f"):
        assert levels(name) == ("x86-64-v3", "")
    for name in ("fma", "avx2", "bmi2"):
        assert levels(name) == (None, "the processor lacks instructions of x86-64-v4, x86-64-v3")


def test_an_unknown_processor_compiles(levels, monkeypatch):
    levels()

    def fail():
        raise RuntimeError

    monkeypatch.setattr(machine_code.binding, "get_host_cpu_features", fail)
    assert machine_code.find_level() == (None, "the features of the processor are unknown")


@pytest.mark.parametrize("content", [None, "", "{"])
def test_a_folder_without_versions_is_none(levels, tmp_path, content):
    path = tmp_path / machine_code.MADE_WITH
    path.unlink() if content is None else path.write_text(content)
    assert levels() == (None, "this installation brings none")


def test_what_it_is_made_with_has_all_settings_of_the_code():
    """Those of the processor are the level's."""
    names = {f"NUMBA_{name}" for name in CODE_SETTINGS} - {f"NUMBA_{name}" for name in machine_code.PROCESSOR_SETTINGS}
    assert machine_code.made_with().keys() == names | {"numba", "llvmlite", "python", "sources of kernels"}


@pytest.mark.slow
def test_the_code_for_other_kernels_is_left_out_where_none_calls_the_kernel(made):
    """In its place are functions that trap; those that a kernel calls keep theirs."""
    for name, trap in (("other", True), ("called", False)):
        for path in files(made, f"thirds.{name}"):
            assert (b"llvm.trap" in path.read_bytes()) == trap


@pytest.mark.slow
def test_a_kernel_that_compiles_can_call_one_of_the_machine_code(package):
    for path in files(package, "thirds.caller"):
        path.unlink()
    script = "from flexman_gym.kernels.thirds import called, caller; print(called(3.0), caller(1.0))"
    assert run(package, package / "cache", script) == ["9.0", "2.0"]


def test_names_of_kernels_that_kernels_call_are_found():
    """Each name in a function of the kernels that is a kernel in its module."""

    def names(code):
        yield from code.co_names
        for each in code.co_consts:
            if isinstance(each, types.CodeType):
                yield from names(each)

    found = {each for module in vars(kernels).values() if isinstance(module, types.ModuleType)
             for each in vars(module).values() if isinstance(each, Dispatcher)}  # fmt: skip
    called = {each for each in found if each.stats.cache_path}
    used = {each.py_func.__globals__.get(name) for each in found for name in names(each.py_func.__code__)} & called
    assert len(called) > 30 and len(used) > 5
    assert {each.py_func.__name__ for each in used} <= called_names(SOURCES)
    assert "advance_batch" not in called_names(SOURCES)
