"""Docstrings: every public function, class and method has one, and all have one form."""

import ast
import re
from itertools import pairwise
from pathlib import Path

import pytest

import flexman_gym

PACKAGE = Path(flexman_gym.__file__).parent
ROOT = PACKAGE.parent
FOLDERS = (
    "scene",
    "model",
    "simulation",
    "fidelity",
    "draw",
    "control",
    "metrics",
    "verification",
    "commands",
    "scripts/studies",
    "agents",
)

SECTIONS = {"Attributes:", "Args:", "Returns:", "Raises:", "Yields:", "Examples:"}
FREE_HEADINGS = {
    "FlexManEnv": {
        "Arm", "Actions", "Observations", "Reward", "Start and end", "Info", "Fidelity", "Version history",
    },
}  # fmt: skip
HEADING = re.compile(r"[A-Z][a-z]+( [a-z]+){0,2}:?")
# A name and a text; a table of more columns is allowed.
TWO_COLUMNS = re.compile(r" *[\w.`]+(, [\w.`]+)* {2,}\S+( \S+)*")
RAISES = re.compile(r" *Raises \w*(Error|Exception)\b.*")


def public(body, prefix=""):
    """Names and nodes of the public functions, classes and methods of a body."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield prefix + node.name, node
            if isinstance(node, ast.ClassDef):
                yield from public(node.body, f"{prefix}{node.name}.")


def flaws(docstring, free_headings=()):
    """The lines of a docstring that break the form."""
    first, *rest = (docstring or "").split("\n")
    result = [] if first.endswith((".", ":")) else [f"the first line is no sentence: {first!r}"]
    result += [f"columns: {line!r}" for line in rest if TWO_COLUMNS.fullmatch(line)]
    result += [f"errors outside a section: {line!r}" for line in rest if RAISES.fullmatch(line)]
    headings = [line for line, after in pairwise(rest) if HEADING.fullmatch(line) and after.startswith(" ")]
    return result + [f"another section: {line!r}" for line in headings if line not in SECTIONS.union(free_headings)]


def files(folder):
    """The files of a folder, which has some."""
    result = sorted(((ROOT if folder in ("agents", "scripts/studies") else PACKAGE) / folder).rglob("*.py"))
    assert result, folder
    return result


def test_docstrings_have_one_form():
    result = {}
    for path in (path for folder in FOLDERS for path in files(folder)):
        for name, node in public(ast.parse(path.read_text(encoding="utf-8")).body):
            lines = flaws(ast.get_docstring(node), FREE_HEADINGS.get(name, ()))
            result |= {f"{path.relative_to(ROOT)} {name}": lines} if lines else {}
    assert result == {}


@pytest.mark.parametrize(
    ("docstring", "count"),
    [
        ("Gives the mass, kg.", 0),
        ("A link.\n\nAttributes:\n    mass: kg.\n\nRaises:\n    ValueError: for a mass < 0.", 0),
        ("A link.\n\nThe table is:\n\n    name    entries  unit\n    angles  0-2      rad", 0),
        (None, 1),
        ("Gives the mass", 1),
        ("A link.\n\nmass    kg\nlength  m, of the link", 2),
        ("A link.\n\n    mass, length  of the link", 1),
        ("A link.\n\nRaises ValueError for a mass < 0.", 1),
        ("A link.\n\nParameters:\n    mass: kg.", 1),
        ("A link.\n\nUse of it\n    In an arm.", 1),
    ],
)
def test_the_rule_finds_other_forms(docstring, count):
    assert len(flaws(docstring)) == count
