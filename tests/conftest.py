"""Limit of the number of skipped tests."""

import re
from collections import Counter

import pytest

MISSING = re.compile(r"could not import|No module named|is not installed")  # reasons of skips for a missing package


def pytest_addoption(parser):
    """Add the options that limit the number of skipped tests."""
    parser.addoption("--most-skips", type=int, help="fail with more skipped tests, and with one for a missing package")
    parser.addoption(
        "--without", action="append", default=[], metavar="NAME",
        help="package or program that cannot be installed here: tests skipped for it are listed and not counted",
    )  # fmt: skip


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
