"""Tests of the core without features, and the limit of the number of skipped tests."""

import re
import sys
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import settings

# the first example of a test loads or compiles kernels, for any time on a loaded computer
settings.register_profile("untimed", settings.default, deadline=None)
settings.load_profile("untimed")

FEATURES = ("flexman_gym.toolbox", "flexman_gym.commands", "flexman_agents", "studies", "torch", "stable_baselines3",
            "sb3_contrib")  # fmt: skip
MISSING = re.compile(r"could not import|No module named|is not installed")  # reasons of skips for a missing package


def pytest_addoption(parser):
    """Add the options of the core, and those that limit the number of skipped tests."""
    parser.addoption(
        "--core", action="store_true",
        help="run the tests of the core, without the marker `feature`; each import of a feature fails",
    )  # fmt: skip
    parser.addoption("--most-skips", type=int, help="fail with more skipped tests, and with one for a missing package")
    parser.addoption(
        "--without", action="append", default=[], metavar="NAME",
        help="package or program that cannot be installed here: tests skipped for it are listed and not counted",
    )  # fmt: skip


class FeatureBlocker:
    """Finder of modules that fails a test of the core which imports a feature."""

    @staticmethod
    def find_spec(name, path=None, target=None):
        """Fail for a module of a feature; return None for other modules, which the next finder looks for."""
        if name.startswith(tuple(f"{each}." for each in FEATURES)) or name in FEATURES:
            text = "is a feature, which a test of the core does not import; move the test to the folder of the feature"
            pytest.fail(f"{name} {text} or mark it `feature`")


def pytest_configure(config):
    """Block imports of features in a run of the core."""
    if config.getoption("--core"):
        sys.meta_path.insert(0, FeatureBlocker)


def pytest_ignore_collect(collection_path, config):
    """Leave out the folders and files beside those of the core in a run of the core; None leaves it to pytest."""
    if not config.getoption("--core"):
        return None
    from architecture import CORE

    parts = collection_path.relative_to(Path(__file__).parent).parts
    return True if parts and parts[0] not in CORE else None


def long_tests():
    """Return the tests with the marker `long`: names of files, tests, or tests with parameters, or with `[n:]`.

    `[n:]` leaves n cases of a test without the marker, the first ones that are not listed themselves.
    """
    path = Path(__file__).parent / "long_tests.txt"
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    return [line for line in lines if line and not line.startswith("#")]


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Mark the long tests, and deselect tests with the marker `feature` in a run of the core."""
    names, cases = set(long_tests()), Counter()
    kept = {name: int(count) for name, count in re.findall(r"^(.*)\[(\d+):\]$", "\n".join(names), re.MULTILINE)}
    for item in items:
        whole, (file, _, _) = item.nodeid.removeprefix("tests/"), item.nodeid.removeprefix("tests/").partition("::")
        test = whole.partition("[")[0]
        listed = bool(names & {whole, test, file})
        cases[test] += not listed
        if listed or cases[test] > kept.get(test, cases[test]):
            item.add_marker("long")
    if config.getoption("--core"):
        chosen = [item for item in items if not item.get_closest_marker("feature")]
        config.hook.pytest_deselected(items=[item for item in items if item not in chosen])
        items[:] = chosen


def too_many_skips(reasons, most, without=()):
    """Return lines that say why the skips with these reasons are too many, and those that are not counted.

    Args:
        reasons: reason of each skipped test.
        most: largest number of skipped tests.
        without: names of packages and programs; reasons that contain one are not counted.

    Returns:
        Lines for faults, and lines for tests that are not counted.
    """
    allowed = [reason for reason in reasons if any(name.lower() in reason.lower() for name in without)]
    counted = [reason for reason in reasons if reason not in allowed]
    faults = [f"{count} skipped: {reason}" for reason, count in Counter(counted).items() if MISSING.search(reason)]
    if len(counted) > most:
        faults.append(f"{len(counted)} tests are skipped, at most {most} are allowed")
    return faults, [f"{count} skipped, not counted: {reason}" for reason, count in Counter(allowed).items()]


def _skip_lines(config):
    """Return the lines of `too_many_skips` for the reports of this run; nothing without the option."""
    most, reporter = config.getoption("--most-skips"), config.pluginmanager.getplugin("terminalreporter")
    if most is None or reporter is None or hasattr(config, "workerinput"):
        return [], []
    reasons = [each.longrepr[2].removeprefix("Skipped: ") for each in reporter.stats.get("skipped", [])]
    return too_many_skips(reasons, most, config.getoption("--without"))


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session, exitstatus):
    """Fail a run with too many skipped tests."""
    if exitstatus == pytest.ExitCode.OK and _skip_lines(session.config)[0]:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter):
    """Print why the skipped tests are too many, and those that are not counted."""
    faults, allowed = _skip_lines(terminalreporter.config)
    if faults or allowed:
        terminalreporter.section("skipped tests")
        for line in [*faults, *allowed]:
            terminalreporter.line(line)
