"""Paths of the project, its reference solutions and its scripts."""

import importlib
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = ROOT / "scripts"
REFERENCE = SCRIPTS / "studies" / "verification" / "reference"  # scenes, and solutions of independent codes
PROGRAMS = [path.stem for path in sorted((SCRIPTS / "studies" / "runners").glob("[!_]*.py"))]
STUDIES = [name for name in PROGRAMS if name not in ("coverage", "endurance", "evidence")]  # those with rows
__all__ = ["PROGRAMS", "REFERENCE", "ROOT", "SCRIPTS", "STUDIES", "command", "runner"]


def command(name: str) -> ModuleType:
    """Import a script as a module, with its folder first in the path."""
    sys.path.insert(0, str(SCRIPTS))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(SCRIPTS))


def runner(name: str) -> Any:
    """Return the program of `python -m studies` with a name; skip the test if its packages are not installed."""
    return pytest.importorskip(f"studies.runners.{name}", exc_type=ImportError).RUNNER
