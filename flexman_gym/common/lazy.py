"""Names of a package that are imported at their first use (Scientific Python, SPEC 1)."""

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def lazy_names(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` of a module for the imports in its block `if TYPE_CHECKING:`.

    Type checkers and editors read these imports as usual; at run time each is made when its name is first used.

    Args:
        package: name of the module.
    """
    homes: dict[str, tuple[str, str]] = {}

    def find(name: str) -> Any:
        if not homes:
            homes.update(_imports(Path(str(sys.modules[package].__file__))))
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        home, attribute = homes[name]
        module = import_module(home)
        known = home != package and hasattr(module, attribute)
        value = getattr(module, attribute) if known else import_module(f"{home}.{attribute}")
        setattr(sys.modules[package], name, value)
        return value

    def names() -> list[str]:
        return sorted({*vars(sys.modules[package]), *sys.modules[package].__all__})

    return find, names


def _imports(path: Path) -> dict[str, tuple[str, str]]:
    """Return module and attribute of each name that the block `if TYPE_CHECKING:` of a file imports."""
    blocks = [node for node in ast.parse(path.read_text(encoding="utf-8")).body if isinstance(node, ast.If)]
    return {
        alias.asname or alias.name: (str(node.module), alias.name)
        for block in blocks
        if isinstance(block.test, ast.Name) and block.test.id == "TYPE_CHECKING"
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
