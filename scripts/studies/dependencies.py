"""Definitions of a checkout, the static graph of their names, and digests by which a change is noticed.

A definition is a function, a method, a class without its methods, or a constant of a module. The statements of a module
that define no name count as one definition, STATEMENTS.
"""

import ast
import hashlib
import os
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from functools import cache, cached_property
from pathlib import Path
from typing import NamedTuple

from studies.tracing.sitecustomize import FUNCTION, is_compiled, source_path, statements

STATEMENTS = "statements"  # name of the definition of the other statements of a module
DIGITS, LONG = 6, 12  # hexadecimal digits of the digest of a definition, and of everything
FOLDERS = {"flexman_agents": "agents", "studies": "scripts/studies"}  # package -> folder, if another than its name
PLACE = re.compile(r"([A-Za-z_][\w.]*):([A-Za-z_]\w*)")  # entry of a `Registry`
UNUSED = {"ctx", "kind", "type_comment", "type_params"}  # fields of the syntax tree without a meaning here
NO_NODES: tuple[ast.AST, ...] = ()


class Name(NamedTuple):
    """Definition of a checkout.

    Attributes:
        path: source file relative to the root.
        name: name, of a method "Class.method"; "" for the module as a whole.
    """

    path: str
    name: str


def short_hash(data: bytes) -> str:
    """Return the first digits of a hash."""
    return hashlib.sha256(data).hexdigest()[:DIGITS]


def long_hash(data: bytes) -> str:
    """Return the first digits of a hash that stands for everything on which rows depend."""
    return hashlib.sha256(data).hexdigest()[:LONG]


def hash_of(patterns: Iterable[str], root: Path) -> str:
    """Return the hash of the files below files, folders and patterns, without docstrings and comments of Python."""
    found: set[Path] = set()
    for pattern in patterns:
        for path in root.glob(pattern):
            found |= {each for each in path.rglob("*") if each.is_file()} if path.is_dir() else {path}
    texts = []
    for path in sorted(each for each in found if "__pycache__" not in each.parts):
        data = path.read_bytes()
        text = plain(ast.parse(data)).encode() if path.suffix == ".py" else data
        texts.append(f"{path.relative_to(root).as_posix()}\0".encode() + text)
    return long_hash(b"\0".join(texts))


class Module:
    """Definitions and imported names of a source file."""

    def __init__(self, path: str, data: bytes) -> None:
        self.path, self.nodes, self.imports = path, defaultdict[str, list[ast.AST]](list), dict[str, tuple[str, str]]()
        self.compiled: set[str] = set()
        for each in statements(ast.parse(data).body):
            self._add(each, "")

    def _add(self, node: ast.stmt, prefix: str) -> None:
        """Add a statement of the module or of a class."""
        if isinstance(node, FUNCTION | ast.ClassDef):
            self.nodes[prefix + node.name].append(node)
            if is_compiled(node):
                self.compiled.add(prefix + node.name)
            for each in node.body if isinstance(node, ast.ClassDef) else ():
                if isinstance(each, FUNCTION | ast.ClassDef):
                    self._add(each, f"{prefix}{node.name}.")
        elif isinstance(node, ast.Import | ast.ImportFrom):
            self.imports |= imported(node)
        elif names := _assigned(node):
            for name in names:
                self.nodes[name].append(node)
        elif not _is_text(node):
            self.nodes[STATEMENTS].append(node)

    @cached_property
    def registered(self) -> list[str]:
        """Definitions that their decorators register for the compiler, in a module with compiled functions."""
        decorated = (name for name, nodes in self.nodes.items()
                     if any(getattr(node, "decorator_list", ()) for node in nodes))  # fmt: skip
        return [name for name in decorated if self.compiled and name not in self.compiled and "." not in name]

    def at(self, line: int) -> list[str]:
        """Return the names that the statement at a line defines, unless it is a function or a class."""
        return [name for name, nodes in self.nodes.items() for node in nodes
                if not isinstance(node, FUNCTION | ast.ClassDef) and node.lineno <= line <= node.end_lineno]  # type: ignore[attr-defined]  # fmt: skip


def imported(node: ast.Import | ast.ImportFrom) -> dict[str, tuple[str, str]]:
    """Return local name -> module and name in it ("" for the module itself) of an import."""
    if isinstance(node, ast.ImportFrom):
        return {each.asname or each.name: (node.module or "", each.name) for each in node.names}
    return {each.asname or each.name.partition(".")[0]: (each.name if each.asname else each.name.partition(".")[0], "")
            for each in node.names}  # fmt: skip


def _assigned(node: ast.stmt) -> set[str]:
    """Return the names that a statement assigns, without the variables of its comprehensions."""
    nodes = list(ast.walk(node))
    inside = {id(part) for each in nodes if isinstance(each, ast.comprehension) for part in ast.walk(each.target)}
    return {each.id for each in nodes if isinstance(each, ast.Name) and _is_stored(each) and id(each) not in inside}


def _is_stored(name: ast.Name) -> bool:
    return isinstance(name.ctx, ast.Store)


def _is_text(node: ast.AST) -> bool:
    """Return True for a docstring."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _children(node: ast.AST, top: bool = True) -> Iterator[tuple[str, ast.AST | object]]:
    """Yield the fields that decide a result: no docstrings, no annotations but those of a class, no methods."""
    for name, value in ast.iter_fields(node):
        if name in UNUSED or value is None or value == []:
            continue
        if name == "returns" or (name == "annotation" and isinstance(node, ast.arg)):
            continue
        if name == "body" and isinstance(value, list):
            kept = [each for each in value if not _is_text(each)]
            methods = isinstance(node, ast.ClassDef) and top  # definitions of their own
            yield name, [each for each in kept if not (methods and isinstance(each, FUNCTION | ast.ClassDef))]
        else:
            yield name, value


def plain(node: object, top: bool = True) -> str:
    """Return the syntax tree as text that is equal for all versions of Python, without what changes no result."""
    if isinstance(node, ast.AST):
        fields = (f"{name}={plain(value, False)}" for name, value in _children(node, top))
        return f"{type(node).__name__}({','.join(fields)})"
    return f"[{','.join(plain(each, False) for each in node)}]" if isinstance(node, list) else repr(node)


def _walk(node: object, top: bool = True) -> Iterator[ast.AST]:
    """Yield the nodes that `plain` prints."""
    if isinstance(node, ast.AST):
        yield node
        for _, value in _children(node, top):
            yield from _walk(value, False)
    for each in node if isinstance(node, list) else ():
        yield from _walk(each, False)


class Sources:
    """Source files of a checkout, as they were when this object was made.

    Args:
        root: root of the checkout.
    """

    def __init__(self, root: Path) -> None:
        self.root, self._texts = root, dict[str, bytes]()
        for folder, folders, names in os.walk(root):
            inside = [each for each in folders if source_path(os.path.join(folder, each), str(root))]
            folders[:] = [each for each in inside if not each.startswith(".") and each != "node_modules"]
            for path in (Path(folder, name) for name in names if name.endswith(".py")):
                self._texts[path.relative_to(root).as_posix()] = path.read_bytes()
        self.module = cache(self._module)
        self.digest = cache(self._digest)
        self._resolved = cache(self._resolve)

    def _module(self, path: str) -> Module | None:
        return Module(path, self._texts[path]) if path in self._texts else None

    def find(self, dotted: str) -> str:
        """Return the path of a module; "" for one of another package."""
        first, _, rest = dotted.partition(".")
        for folder in (FOLDERS.get(first, first), f"scripts/{first}"):
            stem = f"{folder}/{rest.replace('.', '/')}".rstrip("/")
            for path in (f"{stem}.py", f"{stem}/__init__.py"):
                if path in self._texts:
                    return path
        return ""

    def _digest(self, name: Name) -> str:
        """Return the digest of a definition; "" if it is gone."""
        module = self.module(name.path)
        nodes = module.nodes.get(name.name, NO_NODES) if module else NO_NODES
        return short_hash("\n".join(map(plain, nodes)).encode()) if nodes else ""

    def _resolve(self, path: str, names: tuple[str, ...]) -> Name | None:
        """Return the definition of a name with attributes, as seen in a module."""
        module = self.module(path)
        if module is None or not names:
            return Name(path, "") if module else None
        if names[0] in module.nodes:
            return Name(path, names[0])
        if names[0] in module.imports:
            return self.imported(*module.imports[names[0]], names[1:])
        return None

    def imported(self, dotted: str, name: str, more: tuple[str, ...] = ()) -> Name | None:
        """Return the definition of an imported name with attributes; None for one of another package."""
        path = self.find(dotted)
        names = (name, *more) if name else more
        if path and names and (found := self._resolved(path, names)):
            return found
        if names and self.find(f"{dotted}.{names[0]}"):
            return self.imported(f"{dotted}.{names[0]}", "", names[1:])
        return Name(path, "") if path else None

    def references(self, name: Name) -> set[Name]:
        """Return the definitions that the text of a definition names."""
        module, found = self.module(name.path), set[Name]()
        for node in module.nodes.get(name.name, NO_NODES) if module else NO_NODES:
            nodes = _without_annotations(list(_walk(node)))
            own: dict[str, tuple[str, str]] = {}
            for each in nodes:
                own |= imported(each) if isinstance(each, ast.Import | ast.ImportFrom) else {}
            local = _local_names(nodes) if isinstance(node, FUNCTION) else set()
            for chain in _chains(nodes):
                if chain[0] in own:
                    found.add(self.imported(*own[chain[0]], chain[1:]) or name)
                elif chain[0] not in local:
                    found.add(self._resolved(name.path, chain) or name)
            for text in (each.value for each in nodes if isinstance(each, ast.Constant)):
                if isinstance(text, str) and (place := PLACE.fullmatch(text)):
                    found.add(self.imported(place[1], place[2]) or name)
        return {each for each in found if each.name} - {name}

    def kind(self, name: Name) -> str:
        """Return "compiled", "function", "class" or "constant"."""
        module = self.module(name.path)
        if module is None or name.name in module.compiled:
            return "compiled" if module else "constant"
        node = module.nodes[name.name][0]
        return "function" if isinstance(node, FUNCTION) else "class" if isinstance(node, ast.ClassDef) else "constant"


def _without_annotations(nodes: list[ast.AST]) -> list[ast.AST]:
    """Return the nodes that are no part of the annotation of a field or a variable."""
    types = (each.annotation for each in nodes if isinstance(each, ast.AnnAssign))
    parts = {id(part) for each in types for part in ast.walk(each)}
    return [each for each in nodes if id(each) not in parts]


def _local_names(nodes: list[ast.AST]) -> set[str]:
    """Return the arguments and variables of a function and of those inside it."""
    stored = {each.id for each in nodes if isinstance(each, ast.Name) and _is_stored(each)}
    shared = {name for each in nodes if isinstance(each, ast.Global) for name in each.names}
    return (stored | {each.arg for each in nodes if isinstance(each, ast.arg)}) - shared


def _chains(nodes: Iterable[ast.AST]) -> Iterator[tuple[str, ...]]:
    """Yield names that are read, with their attributes: `a.b.c` and its parts."""
    for each in nodes:
        names: list[str] = []
        node: ast.AST = each
        while isinstance(node, ast.Attribute):
            names.insert(0, node.attr)
            node = node.value
        if isinstance(node, ast.Name) and not _is_stored(node):
            yield node.id, *names
