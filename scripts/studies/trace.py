"""Dependencies of a program: the definitions of a checkout that its run used, and the files that it read."""

import os
import subprocess
import sys
from collections import defaultdict
from collections.abc import Container, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from studies.dependencies import STATEMENTS, Name, Sources, short_hash
from studies.tracing import sitecustomize

FOLDER = Path(sitecustomize.__file__).parent  # of the file that Python imports at its start
DRAWING = "scripts/studies/study.py:Study.draw"  # function whose calls decide pages and charts, and no rows


@dataclass
class Dependencies:
    """Digests of what a run used.

    Attributes:
        definitions: source file -> name of a definition -> digest.
        files: other file -> digest.
    """

    definitions: dict[str, dict[str, str]] = field(default_factory=dict)
    files: dict[str, str] = field(default_factory=dict)

    def changes(self, sources: Sources, root: Path) -> list[str]:
        """Return the definitions and files that have changed since, as "forces.py stage_forces"."""
        now = ((Name(path, name), digest) for path, names in self.definitions.items() for name, digest in names.items())
        changed = [f"{Path(name.path).name} {name.name}" for name, digest in now if sources.digest(name) != digest]
        return changed + [Path(path).name for path, digest in self.files.items() if file_digest(root / path) != digest]


def file_digest(path: Path, before: float | None = None) -> str:
    """Return the digest of a file, of YAML without comments; "" if there is none, or if it is newer than a time, s."""
    if not path.is_file() or (before is not None and path.stat().st_mtime > before):
        return ""
    data = path.read_bytes()
    return short_hash(repr(yaml.safe_load(data)).encode() if path.suffix == ".yaml" else data)


def run_traced(command: Sequence[str], root: Path, record: Path, rows: bool = True) -> None:
    """Run a Python program with arguments, and append what it uses, in all its processes, to a record.

    Args:
        command: arguments of Python.
        root: root of the checkout, in which the program runs.
        record: file that `read_record` reads; a run that was interrupted goes on with the same file.
        rows: True if only rows matter: what is called to draw pages and charts is left out.

    Raises:
        subprocess.CalledProcessError: if the program fails.
    """
    record.parent.mkdir(parents=True, exist_ok=True)
    paths = [str(FOLDER), *filter(None, [os.environ.get("PYTHONPATH")])]
    settings = {sitecustomize.OUTPUT: str(record.resolve()), sitecustomize.ROOT: str(root),
                sitecustomize.IGNORED: DRAWING if rows else "", "PYTHONPATH": os.pathsep.join(paths)}  # fmt: skip
    subprocess.run([sys.executable, *command], cwd=root, env=os.environ | settings, check=True)


class _Graph:
    """Definitions that a run used: those that it called, and from them the kernels and constants that they name.

    Args:
        lines: lines of a record, see `sitecustomize`.
        sources: sources as they were at the start of the run.
        neutral: source files that change no result.
    """

    def __init__(self, lines: set[tuple[str, ...]], sources: Sources, neutral: Container[str]) -> None:
        self._sources, self._neutral = sources, neutral
        self._modules = {path for kind, path, _, _ in lines if kind == "import"}
        self._at_import = defaultdict[Name, list[tuple[str, ...]]](list)
        self.names: dict[Name, bool] = {}
        self.files: set[str] = set()
        for line in (each for each in lines if each[3]):
            path, _, number = line[3].rpartition(":")
            for name in self._at(path, int(number)):
                self._at_import[name].append(line)
        for line in (each for each in lines if not each[3]):
            self._use(line)

    def _at(self, path: str, line: int) -> list[Name]:
        module = self._sources.module(path)
        return [Name(path, name) for name in module.at(line)] if module else []

    def _use(self, line: tuple[str, ...]) -> None:
        """Add what a line of the record notes."""
        kind, path, name, _ = line
        if kind == "read" and name not in self._neutral:
            self.files.add(path)
        elif kind == "call":
            number = name.removeprefix("line ")
            for each in self._at(path, int(number)) if number != name else [Name(path, name)]:
                self._add(each, False)

    def _add(self, first: Name, inside: bool) -> None:
        """Add a definition and what it names; inside compiled code also functions and methods, which are not traced."""
        waiting = [(first, inside)]
        while waiting:
            name, inside = waiting.pop()
            module = self._sources.module(name.path)
            if module is None or name.name not in module.nodes or name.path in self._neutral:
                continue
            if self.names.get(name) in (True, inside):
                continue
            kind = self._sources.kind(name)
            inside = inside or kind == "compiled"
            self.names[name] = inside
            if kind == "constant":
                for line in self._at_import[name]:
                    self._use(line)
            own = [name.name.rpartition(".")[0], STATEMENTS, *(module.registered if inside else ())]
            if inside and kind == "class":
                own += [each for each in module.nodes if each.startswith(f"{name.name}.")]
            waiting += [(Name(name.path, each), inside) for each in own]
            for each in self._sources.references(name):
                if inside or (each.path in self._modules and self._sources.kind(each) != "function"):
                    waiting.append((each, inside and kind != "constant"))


def read_record(record: Path, sources: Sources, neutral: Container[str], start: float) -> Dependencies:
    """Return the dependencies of a run.

    Args:
        record: file that `run_traced` has written.
        sources: sources as they were at the start of the run.
        neutral: source files that change no result.
        start: time of the start, s; files that were modified later count as changed.
    """
    lines = {tuple(line.split("\t")) for line in record.read_text(encoding="utf-8").splitlines()}
    graph = _Graph(lines, sources, neutral)
    result = Dependencies()
    for name in sorted(graph.names):
        result.definitions.setdefault(name.path, {})[name.name] = sources.digest(name)
    found = (path for path in sorted(graph.files) if (sources.root / path).is_file())
    result.files = {path: file_digest(sources.root / path, start) for path in found}
    return result
