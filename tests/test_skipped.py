"""Limit of the number of skipped tests: options --most-skips and --without of tests/conftest.py."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import conftest
import pytest

SKIPS = "import pytest\n\n\n@pytest.mark.parametrize('k', range({count}))\ndef test_skip(k):\n    {skip}\n"
REASONS = {
    "reason": "pytest.skip('only root can do this')",
    "package": "pytest.importorskip('no_such_package')",
    "named": "pytest.skip('ray is not installed')",
}


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "count", "options", "status", "line"), [
    ("reason", 2, ["--most-skips=2"], 0, "2 skipped"),
    ("reason", 3, ["--most-skips=2"], 1, "3 tests are skipped, at most 2 are allowed"),
    ("reason", 3, [], 0, "3 skipped"),
    ("package", 1, ["--most-skips=2"], 1, "1 skipped: could not import 'no_such_package'"),
    ("named", 3, ["--most-skips=2", "--without=ray"], 0, "3 skipped, not counted: ray is not installed"),
    ("named", 1, ["--most-skips=2", "--without=chromium"], 1, "1 skipped: ray is not installed"),
])  # fmt: skip
def test_skips_beyond_the_limit_or_for_a_missing_package_fail(kind, count, options, status, line, tmp_path):
    shutil.copy(Path(__file__).with_name("conftest.py"), tmp_path)
    (tmp_path / "test_skip.py").write_text(SKIPS.format(count=count, skip=REASONS[kind]))
    command = [sys.executable, "-m", "pytest", "-p", "xdist", "-p", "no:cacheprovider", "-n", "1", *options]
    environment = os.environ | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_ADDOPTS": ""}
    done = subprocess.run([*command, "test_skip.py"], cwd=tmp_path, capture_output=True, text=True, env=environment)
    assert done.returncode == status, done.stdout + done.stderr
    assert line in done.stdout


def test_long_tests_exist():
    """A line of the list names a file and one of its tests."""
    tests = Path(__file__).parent
    for line in conftest.long_tests():
        file, _, name = line.partition("::")
        text = (tests / file).read_text(encoding="utf-8")
        assert not name or f"def {name.partition('[')[0]}(" in text, line


def test_cases_beyond_a_number_are_long(tmp_path):
    """A line with `[2:]` marks all cases of its test but the first two."""
    shutil.copy(Path(__file__).with_name("conftest.py"), tmp_path)
    (tmp_path / "long_tests.txt").write_text("test_cases.py::test_case[2:]\n")
    cases = "import pytest\n\n@pytest.mark.parametrize('case', range(5))\ndef test_case(case):\n    pass\n"
    (tmp_path / "test_cases.py").write_text(cases)
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-m", "long", "--co", "-q"]
    environment = os.environ | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_ADDOPTS": ""}
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, env=environment)
    assert [line.partition("::")[2] for line in done.stdout.splitlines() if "::" in line] == [
        f"test_case[{case}]" for case in (2, 3, 4)
    ]
