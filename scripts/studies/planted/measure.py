"""Planted errors: changes of the sources, and whether the tests detect them."""

import atexit
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from flexman_gym.common import files
from studies.files import read_rows


@dataclass(frozen=True)
class Change:
    """A planted error.

    Attributes:
        room: of the table, such as "kernels".
        error: what is wrong, in words.
        file: path from the root of the checkout.
        old, new: the text that is replaced, which stands in the file once, and what takes its place.
        tests: files or tests, paths from the root, the quickest first.
        equivalent: why no test can notice; "" where one should.
    """

    room: str
    error: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    equivalent: str = ""

    def applied(self, root: Path) -> str:
        """Return the changed text of its file in a checkout.

        Raises:
            ValueError: where the old text does not stand in the file exactly once.
        """
        path = root / self.file
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        if (count := text.count(self.old)) != 1:
            raise ValueError(f"{self.file}: {self.old!r} stands there {count} times, not once ({self.error})")
        return text.replace(self.old, self.new)


CHECKOUT = Path(__file__).parents[3]
CAUGHT, SURVIVED, EQUIVALENT = "caught", "survived", "equivalent"
LONGEST = 900  # s, for the tests of one change; what hangs is noticed too
# in the copy: an example that fails is enough, a small one takes minutes more
SETTINGS = """from hypothesis import Phase, settings

settings.register_profile("planted", phases=[Phase.explicit, Phase.generate])
settings.load_profile("planted")
"""
FAILED, NOTHING_FAILED, INTERRUPTED = 1, 0, 2  # exit statuses of pytest


@dataclass(frozen=True)
class Planted:
    """Outcome of a planted error: a row of the table.

    Attributes:
        room, error, file: as of the change.
        outcome: "caught", "survived" or "equivalent".
        by: the first test that failed, or the reason of an equivalent change.
        seconds: that the tests ran.
    """

    room: str
    error: str
    file: str
    outcome: str
    by: str
    seconds: float


def planted(change: Change) -> Planted:
    """Plant a change in the copy of this process."""
    return _copy().plant(change)


@cache
def _copy() -> "Copy":
    """A copy of the checkout that ends with the process."""
    place = TemporaryDirectory()
    atexit.register(place.cleanup)
    return Copy(CHECKOUT, Path(place.name))


class Copy:
    """A copy of a checkout in a folder.

    Attributes:
        root: the folder.
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
        self._green: set[str] = set()  # tests that pass without an error

    def plant(self, change: Change) -> Planted:
        """Make a change, runs its tests until one fails, and takes the change back.

        Raises:
            RuntimeError: where the test that fails does so without the change too, or there is no such test.
        """
        path = self.root / change.file
        whole = path.read_text(encoding="utf-8")
        path.write_text(change.applied(self.root), encoding="utf-8")
        started = time.perf_counter()
        try:
            failed = self.failing(change.tests, own_kernels="/kernels/" in change.file)
        finally:
            path.write_text(whole, encoding="utf-8")
        self._check_green(failed, change.tests)
        outcome = CAUGHT if failed else EQUIVALENT if change.equivalent else SURVIVED
        by = failed.removeprefix("tests/") or change.equivalent
        return Planted(change.room, change.error, change.file, outcome, by, time.perf_counter() - started)

    def _check_green(self, failed: str, tests: Iterable[str]) -> None:
        """Believes a test that has failed only if it passes without an error."""
        named = [failed] if failed.partition("::")[0].endswith(".py") else [*tests] if failed else []
        for test in named:
            if test not in self._green and (still := self.failing([test])):
                raise RuntimeError(f"{still} fails without an error too")
            self._green.add(test)

    def failing(self, tests: Iterable[str], own_kernels: bool = False) -> str:
        """Return the first test that fails, "" if all pass.

        Args:
            tests: files or tests, paths from the root.
            own_kernels: whether compiled kernels go to a folder that is thrown away.

        Raises:
            RuntimeError: where there is no such test.
        """
        command = [sys.executable, "-B", "-m", "pytest", "-q", "-x", "--tb=no", "-p", "no:cacheprovider", *tests]
        names = str(self.root), str(self.root / "build" / "names")
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(names), "PYTHONDONTWRITEBYTECODE": "1"}
        kernels = self.root / "build" / "kernels"
        if own_kernels:
            environment["NUMBA_CACHE_DIR"] = str(kernels)
        try:
            done = subprocess.run(
                command, cwd=self.root, env=environment, capture_output=True, text=True, timeout=LONGEST
            )
        except subprocess.TimeoutExpired:
            return f"no end after {LONGEST} s"
        finally:
            shutil.rmtree(kernels, ignore_errors=True)
        if done.returncode == NOTHING_FAILED:
            return ""
        for line in done.stdout.splitlines():
            if line.startswith(("FAILED ", "ERROR ")):
                return line.split(" - ")[0].split(" ", 1)[1]
        if done.returncode not in (FAILED, INTERRUPTED) and done.returncode > 0:
            raise RuntimeError(f"pytest says: {' '.join((done.stdout + done.stderr).split())[-300:]}")
        return f"the tests end with the status {done.returncode}"


ERRORS = Path(__file__).parent / "errors"  # a file for each room
NAMES = (
    "kernels", "model", "simulation", "environment", "tasks", "sensors", "laboratory", "control", "metrics", "agents",
    "draw", "fidelity", "command",
)  # fmt: skip


def changes(room: str) -> Iterator[Change]:
    """Return the planted errors of a folder, from its file."""
    for group in files.read_data(ERRORS / f"{room}.yaml", list):
        tests = tuple(f"tests/{test}" for test in group["tests"])
        for entry in group["errors"]:
            yield Change(room=room, file=group["file"], tests=tests, **entry)


ROOMS: dict[str, list[Change]] = {name: list(changes(name)) for name in NAMES}


def kept(path: Path) -> dict[tuple[str, str], Planted]:
    """Return the rows of a file by folder and error, none if there is no file."""
    rows = read_rows(path, Planted) if path.is_file() else []
    return {(row.room, row.error): row for row in rows}


def misplaced(root: Path, chosen: Iterable[Change]) -> list[str]:
    """Return a line for each error whose old text does not occur once in its file or whose tests do not exist."""
    result = []
    for change in chosen:
        try:
            change.applied(root)
        except ValueError as error:
            result.append(str(error))
        result += [f"{test} is no test" for test in change.tests if not (root / test.split("::")[0]).is_file()]
    return result
