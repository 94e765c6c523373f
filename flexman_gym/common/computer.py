"""Computer: processor, Python version and package versions behind a result."""

import platform
import re
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

CORE_PACKAGES = ("flexman_gym", "numba", "numpy", "scipy")


def computer_info(more: Iterable[str] = ()) -> dict[str, str]:
    """Return the processor and the versions of Python, of the core packages and of `more` packages, if installed."""
    file = Path("/proc/cpuinfo")
    match = re.search(r"model name\s*: (.*)", file.read_text() if file.exists() else "")
    processor = match[1] if match else platform.processor() or platform.machine()
    return {"processor": processor, "python": platform.python_version()} | _versions((*CORE_PACKAGES, *more))


def computer_text(more: Iterable[str] = ()) -> str:
    """Return the entries of `computer_info` on one line."""
    return ", ".join(f"{name} {value}" for name, value in computer_info(more).items())


def _versions(names: Iterable[str]) -> dict[str, str]:
    result = {}
    for name in names:
        try:
            result[name] = version(name)
        except PackageNotFoundError:
            continue
    return result
