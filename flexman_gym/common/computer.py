"""Computer: processor, Python, and versions of the packages that computed a result."""

import platform
import re
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

CORE_PACKAGES = ("flexman_gym", "numba", "numpy", "scipy")


def computer_info(more: Iterable[str] = ()) -> dict[str, str]:
    """Processor, Python, and the versions of our packages and of more of them, of those that are installed."""
    information = Path("/proc/cpuinfo")
    result = re.search(r"model name\s*: (.*)", information.read_text() if information.exists() else "")
    processor = result[1] if result else platform.processor() or platform.machine()
    return {"processor": processor, "python": platform.python_version()} | _versions((*CORE_PACKAGES, *more))


def computer_text(more: Iterable[str] = ()) -> str:
    """The same as names and values in a row."""
    return ", ".join(f"{name} {value}" for name, value in computer_info(more).items())


def _versions(names: Iterable[str]) -> dict[str, str]:
    result = {}
    for name in names:
        try:
            result[name] = version(name)
        except PackageNotFoundError:
            continue
    return result
