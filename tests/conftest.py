"""Collection: marks the tests that take long, whose names are in slow.txt, so that `make quick` leaves them out."""

from pathlib import Path

import pytest

SLOW = frozenset((Path(__file__).parent / "slow.txt").read_text(encoding="utf-8").split())


def pytest_collection_modifyitems(items):
    """Mark as slow each test of which a case took more than 0.25 s of CPU when it was measured, and whole files."""
    for item in items:
        name = item.nodeid.split("[")[0].removeprefix("tests/")
        if {name, name.split("::")[0]} & SLOW:
            item.add_marker(pytest.mark.slow)
