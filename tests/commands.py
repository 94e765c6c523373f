"""Commands: the scripts of the project as modules, for tests that call them in their own process."""

import importlib
import sys
from pathlib import Path
from types import ModuleType

SCRIPTS = Path(__file__).parents[1] / "scripts"


def command(name: str) -> ModuleType:
    """The script of that name, imported as Python does for one that is run: its folder comes first."""
    sys.path.insert(0, str(SCRIPTS))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(SCRIPTS))
