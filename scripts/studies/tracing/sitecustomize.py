"""Record of the functions of a checkout that a program calls, and of the files that it reads, in all its processes.

Python imports this file at its start if its folder is in PYTHONPATH, and it acts only if OUTPUT is set, see
`studies.trace`. Workers inherit both variables. Each module of the checkout is compiled with a probe in each function,
`if _probe_7: _note(...)`, which notes the first call and then costs some nanoseconds a call: a profile function would
double the time of Python. A line of the record is appended as soon as it is known, so that a process may end anyhow.
"""

import ast
import os
import sys
from collections.abc import Iterator
from importlib.machinery import SourceFileLoader
from typing import Any

OUTPUT, ROOT, IGNORED = "STUDIES_TRACE", "STUDIES_TRACE_ROOT", "STUDIES_TRACE_IGNORED"  # environment variables
COMPILED = {"kernel", "released", "inner", "njit", "jit", "intrinsic"}  # decorators of functions without a probe
NO_SOURCES = {"out", "build", "runs"}  # folders of the checkout with results
OTHERS = ".", "flexman_gym.egg-info"  # first letters of folders of tools
Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
FUNCTION = ast.FunctionDef | ast.AsyncFunctionDef


def statements(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    """Yield the statements of a module, those of its conditions and `try` included."""
    for each in body:
        if isinstance(each, ast.If | ast.Try):
            handlers = each.handlers if isinstance(each, ast.Try) else []
            final = each.finalbody if isinstance(each, ast.Try) else []
            yield from statements([*each.body, *(one for part in handlers for one in part.body), *each.orelse, *final])
        else:
            yield each


def is_compiled(node: ast.stmt) -> bool:
    """Return True for a function that Numba compiles."""
    names = set()
    for each in node.decorator_list if isinstance(node, FUNCTION) else ():
        function = each.func if isinstance(each, ast.Call) else each
        names.add(function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", ""))
    return bool(names & COMPILED)


def source_path(path: str, root: str) -> str:
    """Return the path of a file relative to the root; "" outside of the checkout and in its folders of results."""
    if not path.startswith(root + os.sep):
        return ""
    relative = path[len(root) + 1 :].replace(os.sep, "/")
    first = relative.partition("/")[0]
    return "" if first.startswith(OTHERS) or first in NO_SOURCES else relative


class _Probes(ast.NodeTransformer):
    """Insertion of probes into the functions of a module, and into lambdas outside of functions."""

    def __init__(self, path: str) -> None:
        self._path, self._names, self.count = path, [""], 0

    def _probe(self, name: str) -> ast.expr:
        """Return `_probe_7 and _note(globals(), "_probe_7", path, name)`."""
        probe = f"_probe_{self.count}"
        self.count += 1
        return ast.parse(f"{probe} and _note(globals(), {probe!r}, {self._path!r}, {name!r})", mode="eval").body

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        self._names.append(f"{self._names[-1]}{node.name}.")
        self.generic_visit(node)
        self._names.pop()
        return node

    def visit_FunctionDef(self, node: Any) -> ast.AST:
        if not is_compiled(node):
            place = int(ast.get_docstring(node, clean=False) is not None)
            probe = ast.Expr(self._probe(self._names[-1] + node.name))
            for each in ast.walk(probe):
                ast.copy_location(each, node.body[min(place, len(node.body) - 1)])
            node.body.insert(place, probe)
        return node

    visit_AsyncFunctionDef = visit_FunctionDef

    def visit_Lambda(self, node: ast.Lambda) -> ast.AST:
        owner = self._names[-1].removesuffix(".") or f"line {node.lineno}"
        tuple_ = ast.Tuple([self._probe(owner), node.body], ast.Load())
        node.body = ast.Subscript(tuple_, ast.Constant(1), ast.Load())
        for each in (node.body, *ast.walk(tuple_.elts[0]), tuple_, node.body.slice):
            ast.copy_location(each, node)
        return node


def with_probes(data: bytes, path: str) -> ast.Module:
    """Return the syntax tree of a source file with a probe in each function."""
    tree, probes = ast.parse(data), _Probes(path)
    probes.visit(tree)
    place = sum(1 for _ in _head(tree.body))
    names = [f"_probe_{number}" for number in range(probes.count)]
    first = "".join(f"{name} = " for name in names) + "True\n" if names else ""
    tree.body[place:place] = ast.parse(f"from sitecustomize import note as _note\n{first}").body
    return ast.fix_missing_locations(tree)


def _head(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    """Yield the statements that must come first: docstring and `from __future__`."""
    for number, each in enumerate(body):
        text = isinstance(each, ast.Expr) and isinstance(each.value, ast.Constant) and number == 0
        if not text and not (isinstance(each, ast.ImportFrom) and each.module == "__future__"):
            return
        yield each


class _Record:
    """File to which lines are appended: kind, path, name or reader, and the statement of the import that caused it."""

    def __init__(self) -> None:
        self.root = os.environ[ROOT]
        self._file = os.open(os.environ[OUTPUT], os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        self._ignored = os.environ.get(IGNORED, "")
        self._known: set[str] = set()
        self._busy = False

    def write(self, *words: str) -> None:
        """Append a line, once."""
        line = "\t".join(words)
        if line not in self._known:
            self._known.add(line)
            os.write(self._file, f"{line}\n".encode())

    def owner(self, frame: Any) -> tuple[bool, str, str]:
        """Return whether a call counts, the innermost file of the checkout, and the line of a module under import.

        A call below `IGNORED` does not count. The line of a module of another package is that of no statement here.
        """
        reader = ""
        while frame is not None:
            code = frame.f_code
            path = source_path(code.co_filename, self.root)
            reader = reader or path
            if f"{path}:{code.co_qualname}" == self._ignored:
                return False, "", ""
            if code.co_name == "<module>" and frame.f_globals.get("__name__") != "__main__":
                return True, reader, f"{path}:{frame.f_lineno}"
            frame = frame.f_back
        return True, reader, ""

    def opened(self, event: str, arguments: tuple[Any, ...]) -> None:
        """Note a file of the checkout that is opened for reading; an audit hook."""
        if event != "open" or self._busy or not isinstance(arguments[0], str | bytes):
            return
        path, flags = os.fsdecode(arguments[0]), arguments[2]
        path = source_path(os.path.abspath(path), self.root)
        if path and not path.endswith((".py", ".pyc")) and not (flags or 0) & (os.O_WRONLY | os.O_RDWR):
            self._busy = True
            counts, reader, owner = self.owner(sys._getframe(1))
            if counts:
                self.write("read", path, reader, owner)
            self._busy = False


def note(variables: dict[str, Any], probe: str, path: str, name: str) -> None:
    """Note a call; the probe is switched off unless the call is one of an import or does not count."""
    counts, _, owner = _record.owner(sys._getframe(1))
    if counts:
        _record.write("call", path, name, owner)
        if not owner:
            variables[probe] = False


def _compiled(loader: SourceFileLoader, name: str) -> Any:
    """Return the code of a module, with probes if it belongs to the checkout; a method of the loader."""
    path = loader.get_filename(name)
    relative = source_path(path, _record.root)
    if not relative or relative.startswith("scripts/studies/tracing/"):
        return _original(loader, name)
    _record.write("import", relative, "", "")
    return compile(with_probes(loader.get_data(path), relative), path, "exec", dont_inherit=True)


if os.environ.get(OUTPUT) and __name__ == "sitecustomize":  # not where another module imports this one
    _record = _Record()
    _original = SourceFileLoader.get_code
    SourceFileLoader.get_code = _compiled  # type: ignore[method-assign, assignment]
    sys.addaudithook(_record.opened)
