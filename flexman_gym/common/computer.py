"""Computer: processor, Python version and package versions behind a result, and imports of optional packages."""

import platform
import re
from collections.abc import Iterable
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

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


def optional_module(name: str, user: str, extra: str) -> Any:
    """Return a module of an optional package.

    Args:
        name: name of the module.
        user: part of the library that needs it, for the error message.
        extra: extra of this package that installs it.

    Raises:
        ImportError: if it is not installed, with a one-line message.
    """
    try:
        return import_module(name)
    except ImportError:
        package = name.partition(".")[0]
        text = f"{user} needs {package}: pip install 'flexman_gym[{extra}]'"
        raise ImportError(text, name=package) from None


def _versions(names: Iterable[str]) -> dict[str, str]:
    result = {}
    for name in names:
        try:
            result[name] = version(name)
        except PackageNotFoundError:
            continue
    return result
