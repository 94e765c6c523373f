"""Planted errors: deliberate faults in the sources, and the test that detects each."""

import atexit
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from flexman_gym.common import files
from studies.dependencies import hash_of, long_hash
from studies.files import read_rows


@dataclass(frozen=True)
class Change:
    """A planted error.

    Attributes:
        part: part of the library, a key of `PARTS`, for instance "kernels".
        error: description.
        file: path of the source file, relative to the root of the checkout.
        old, new: replaced text, which occurs once in the file, and its replacement.
        tests: test files or tests, paths relative to the root, fastest first.
        equivalent: reason why no test can detect the change; "" if a test should.
        first: test that caught the error in an earlier run, which runs before the others; "" if none is known.
    """

    part: str
    error: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    equivalent: str = ""
    first: str = ""

    def applied(self, root: Path) -> str:
        """Return the text of the source file of a checkout with the change applied.

        Raises:
            ValueError: if the old text does not occur exactly once in the file.
        """
        path = root / self.file
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        if (count := text.count(self.old)) != 1:
            raise ValueError(f"{self.file}: {self.old!r} occurs {count} times; it must occur once ({self.error})")
        return text.replace(self.old, self.new)


CHECKOUT = Path(__file__).parents[3]
ROWS = "docs/evidence/planted.csv"
CAUGHT, SURVIVED, EQUIVALENT = "caught", "survived", "equivalent"
# s; time limit of the tests of one change, in compiled kernels and elsewhere; a hanging test counts as a failure
LONGEST, LONGEST_IN_PYTHON = 900, 600
# Hypothesis profile of the copy: no shrinking, since the first failing example suffices and shrinking takes minutes
SETTINGS = """from hypothesis import Phase, settings

settings.register_profile("planted", phases=[Phase.explicit, Phase.generate])
settings.load_profile("planted")
"""
FAILED, NOTHING_FAILED, INTERRUPTED = 1, 0, 2  # exit statuses of pytest


@dataclass(frozen=True)
class Planted:
    """Outcome of a planted error: a row of docs/evidence/planted.csv.

    Attributes:
        part, error, file: see `Change`.
        outcome: "caught", "survived" or "equivalent".
        by: first failing test, or the reason why the change is equivalent.
        seconds: run time of the tests, s.
        code: digest of the error, of its source file and of the files of its tests, see `code_of`.
    """

    part: str
    error: str
    file: str
    outcome: str
    by: str
    seconds: float
    code: str = ""


def planted(change: Change, green: Iterable[str] = ()) -> Planted | str:
    """Plant an error in the checkout copy of this process and return its outcome, or why there is none.

    Args:
        change: the error.
        green: tests that pass on the unchanged sources.
    """
    copy = _copy()
    copy.green.update(green)
    try:
        return copy.plant(change)
    except RuntimeError as error:
        return f"{change.part}: {change.error}: {error}"


def passing(tests: Sequence[str]) -> list[str]:
    """Return the tests and cases that pass on the unchanged sources, see `Copy.passing`."""
    return _copy().passing(tests)


def code_of(change: Change, root: Path = CHECKOUT) -> str:
    """Return the digest of an error, its source file and its test files, without comments and docstrings."""
    used = dict.fromkeys([change.file, *(test.partition("::")[0] for test in change.tests)])
    return long_hash("\0".join([change.old, change.new, *(_file_code(root, path) for path in used)]).encode())


@cache
def _file_code(root: Path, path: str) -> str:
    return hash_of([path], root)


def outdated(root: Path = CHECKOUT) -> list[str]:
    """Return which errors of the tables have no row of the present code, by part: "model: 3 errors"."""
    rows = kept(root / ROWS)
    counts = {part: sum(not is_current(change, rows, root) for change in every) for part, every in PARTS.items()}
    return [f"{part}: {count} error{'s' * (count != 1)}" for part, count in counts.items() if count]


def is_current(change: Change, rows: Mapping[tuple[str, str], Planted], root: Path = CHECKOUT) -> bool:
    """Return True if an error has a row of the present code."""
    row = rows.get((change.part, change.error))
    return row is not None and row.code == code_of(change, root)


def with_first_test(change: Change, row: Planted | None) -> Change:
    """Return a change with the test of an earlier row to run first, if that test still exists."""
    test, _, _ = (row.by if row else "").partition("[")
    file, _, name = test.partition("::")
    path = CHECKOUT / "tests" / file
    exists = name and path.is_file() and f"def {name.rpartition('::')[2]}(" in path.read_text(encoding="utf-8")
    return replace(change, first=f"tests/{test}") if exists else change


@cache
def _copy() -> "Copy":
    """Return the checkout copy of this process; the folder is deleted when the process ends."""
    place = TemporaryDirectory()
    atexit.register(place.cleanup)
    return Copy(CHECKOUT, Path(place.name))


class Copy:
    """Copy of a checkout in which errors are planted.

    Attributes:
        root: folder of the copy.
        green: tests that pass on the unchanged sources.
    """

    def __init__(self, checkout: Path, root: Path) -> None:
        self.root = root
        command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
        listed = subprocess.run(command, cwd=checkout, capture_output=True, text=True, check=True)
        for name in filter(None, listed.stdout.split("\0")):
            path = checkout / name
            if path.is_file() and not path.is_symlink():  # neither deleted files nor links to folders
                (root / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(path, root / name)
        names = root / "build" / "names"
        names.mkdir(parents=True)
        (names / "flexman_agents").symlink_to("../../agents")
        (root / "conftest.py").write_text(SETTINGS, encoding="utf-8")
        # checked by content: a source that changes twice in a second is compiled anew each time
        compiled = [sys.executable, "-m", "compileall", "-q", "--invalidation-mode", "checked-hash", str(root)]
        subprocess.run(compiled, capture_output=True, check=False)  # sources with errors of syntax stay
        self.green: set[str] = set()

    def plant(self, change: Change) -> Planted:
        """Apply a change, run its tests until one fails, and revert the change.

        Raises:
            RuntimeError: if the failing test also fails without the change, or does not exist.
        """
        path = self.root / change.file
        whole = path.read_text(encoding="utf-8")
        path.write_text(change.applied(self.root), encoding="utf-8")
        started = time.perf_counter()
        own_kernels = "/kernels/" in change.file
        try:
            failed = self.failing([change.first], own_kernels) if change.first else ""
            failed = failed or self.failing(change.tests, own_kernels)
        finally:
            path.write_text(whole, encoding="utf-8")
        self._check_green(failed, change.tests)
        outcome = CAUGHT if failed else EQUIVALENT if change.equivalent else SURVIVED
        by = failed.removeprefix("tests/") or change.equivalent
        seconds = time.perf_counter() - started
        return Planted(change.part, change.error, change.file, outcome, by, seconds, code_of(change, self.root))

    def _check_green(self, failed: str, tests: Iterable[str]) -> None:
        """Raise RuntimeError if a failed test also fails on the unchanged sources."""
        named = [failed] if failed.partition("::")[0].endswith(".py") else [*tests] if failed else []
        for test in named:
            if test not in self.green and (failing := self.failing([test])):
                raise RuntimeError(f"{failing} also fails without a planted error")
            self.green.add(test)

    def passing(self, tests: Iterable[str]) -> list[str]:
        """Return the names of the tests and of their cases that pass on the unchanged sources, in one run."""
        done = self._pytest(["-rp", *tests])
        return [line.split(" ", 1)[1] for line in done.stdout.splitlines() if line.startswith("PASSED ")]

    def failing(self, tests: Iterable[str], own_kernels: bool = False) -> str:
        """Return the first failing test, or "" if all pass.

        Args:
            tests: test files or tests, paths relative to the root.
            own_kernels: compile kernels into a temporary cache, which is deleted afterwards.

        Raises:
            RuntimeError: if a test does not exist.
        """
        longest = LONGEST if own_kernels else LONGEST_IN_PYTHON
        try:
            done = self._pytest(["-x", *tests], own_kernels, longest)
        except subprocess.TimeoutExpired:
            return f"timeout after {longest} s"
        if done.returncode == NOTHING_FAILED:
            return ""
        for line in done.stdout.splitlines():
            if line.startswith(("FAILED ", "ERROR ")):
                return line.split(" - ")[0].split(" ", 1)[1]
        if done.returncode not in (FAILED, INTERRUPTED) and done.returncode > 0:
            raise RuntimeError(f"pytest: {' '.join((done.stdout + done.stderr).split())[-300:]}")
        return f"the tests end with exit status {done.returncode}"

    def _pytest(
        self, arguments: Iterable[str], own_kernels: bool = False, longest: float | None = None
    ) -> subprocess.CompletedProcess[str]:
        """Run pytest in the copy, for `longest` seconds at most; see `failing`."""
        command = [sys.executable, "-B", "-m", "pytest", "-q", "--tb=no", "-p", "no:cacheprovider", *arguments]
        names = str(self.root), str(self.root / "build" / "names")
        environment = {name: value for name, value in os.environ.items() if name != "PYTEST_ADDOPTS"}
        environment |= {"PYTHONPATH": os.pathsep.join(names), "PYTHONDONTWRITEBYTECODE": "1"}
        kernels = self.root / "build" / "kernels"
        if own_kernels:
            environment |= {"NUMBA_CACHE_DIR": str(kernels), "FLEXMAN_COMPILE_AHEAD": "0"}
        try:
            return subprocess.run(
                command, cwd=self.root, env=environment, capture_output=True, text=True, timeout=longest, check=False
            )
        finally:
            shutil.rmtree(kernels, ignore_errors=True)


ERRORS = Path(__file__).parent / "errors"  # one file per part
NAMES = (
    "kernels", "model", "simulation", "environment", "tasks", "sensors", "laboratory", "control", "metrics", "agents",
    "draw", "fidelity", "command", "machine", "own_arm", "foundation",
)  # fmt: skip


def changes(part: str) -> Iterator[Change]:
    """Yield the planted errors of a part, read from its YAML file."""
    for group in files.read_data(ERRORS / f"{part}.yaml", list, of_package=True):
        tests = tuple(f"tests/{test}" for test in group["tests"])
        for entry in group["errors"]:
            yield Change(part=part, file=group["file"], tests=tests, **entry)


PARTS: dict[str, list[Change]] = {name: list(changes(name)) for name in NAMES}


def kept(path: Path) -> dict[tuple[str, str], Planted]:
    """Return the rows of a CSV file by (part, error); empty if the file does not exist."""
    rows = read_rows(path, Planted) if path.is_file() else []
    return {(row.part, row.error): row for row in rows}


def misplaced(root: Path, chosen: Iterable[Change]) -> list[str]:
    """Return a message for each error whose old text does not occur once or whose test files are missing."""
    result = []
    for change in chosen:
        try:
            change.applied(root)
        except ValueError as error:
            result.append(str(error))
        result += [f"{test} is not a test file" for test in change.tests if not (root / test.split("::")[0]).is_file()]
    return result
