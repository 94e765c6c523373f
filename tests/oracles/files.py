"""Paths of the project, its reference solutions and its scripts."""

import importlib
import sys
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).parents[2]
SCRIPTS = ROOT / "scripts"
REFERENCE = SCRIPTS / "studies" / "verification" / "reference"  # scenes, and solutions of independent codes
__all__ = ["REFERENCE", "ROOT", "SCRIPTS", "command"]


def command(name: str) -> ModuleType:
    """Import a script as a module, with its folder first in the path."""
    sys.path.insert(0, str(SCRIPTS))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(SCRIPTS))
