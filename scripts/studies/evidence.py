"""Age of rows, pages, pictures and policies with respect to the code on which they depend, and making them again."""

import ast
import hashlib
import io
import json
import shlex
import subprocess
import sys
import tokenize
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from typing import Any

import flexman_gym
from flexman_gym.common import files

ROOT = Path(__file__).parents[2]
STUDIES = Path(__file__).with_name("evidence.yaml")
RECORD = Path("docs/evidence/made.json")  # study -> version, minutes, and hashes of code and drawing; below the root
CURRENT, STALE, UNKNOWN, MISSING = "current", "older than its code", "code not recorded", "missing"
DIGITS = 12  # of a hash
MODULES = {"flexman": "flexman_gym", "studies": "studies"}  # first word of a command -> module that runs it


def code_text(path: Path) -> bytes:
    """Return a file as bytes; Python without docstrings, comments and empty lines, which do not change results."""
    data = path.read_bytes()
    if path.suffix != ".py":
        return data
    lines = data.decode("utf-8").splitlines()
    for token in tokenize.generate_tokens(io.StringIO(data.decode("utf-8")).readline):
        if token.type == tokenize.COMMENT:
            row, column = token.start
            lines[row - 1] = lines[row - 1][:column]
    for node in ast.walk(ast.parse(data)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            for row in range(node.lineno, (node.end_lineno or node.lineno) + 1):
                lines[row - 1] = ""
    return "\n".join(line.rstrip() for line in lines if line.strip()).encode()


def hash_of(paths: Iterable[str], root: Path = ROOT) -> str:
    """Return the hash of the files below files, folders and patterns, relative to the root."""
    found: set[Path] = set()
    for pattern in paths:
        for path in root.glob(pattern):
            found |= {each for each in path.rglob("*") if each.is_file()} if path.is_dir() else {path}
    result = hashlib.sha256()
    for path in sorted(each for each in found if "__pycache__" not in each.parts):
        result.update(f"{path.relative_to(root).as_posix()}\0".encode() + code_text(path) + b"\0")
    return result.hexdigest()[:DIGITS]


@dataclass(frozen=True)
class EvidenceStudy:
    """Study of `evidence.yaml`: its files, the code on which they depend, and its commands.

    Attributes:
        name: name of the study.
        code, drawing: files, folders or patterns that decide the rows, and how page and chart are drawn from them.
        rows, drawn: files that the commands write, and files that are drawn from the rows.
        commands: commands that make everything; `redraw` only draws; "" if there is none.
        folder: folder of the rows of a program of `python -m studies`, relative to the root.
        minutes: CPU time, min.
    """

    name: str
    code: Sequence[str]
    rows: Sequence[str]
    commands: Sequence[str]
    minutes: float
    drawing: Sequence[str] = field(default=())
    drawn: Sequence[str] = field(default=())
    redraw: str = ""
    folder: str = "docs/evidence"

    def rows_state(self, record: dict[str, Any], root: Path = ROOT) -> str:
        """Return the state of the rows with respect to the record of the study."""
        if not all(any(root.glob(pattern)) for pattern in self.rows):
            return MISSING
        known = record.get("code")
        return UNKNOWN if not known else CURRENT if known == hash_of(self.code, root) else STALE

    def drawing_state(self, record: dict[str, Any], root: Path = ROOT) -> str:
        """Return the state of page and chart with respect to the record of the study; rows count as their code."""
        if not all(any(root.glob(pattern)) for pattern in self.drawn):
            return MISSING
        return CURRENT if record.get("drawing") == self.drawing_hash(root) else STALE

    def drawing_hash(self, root: Path = ROOT) -> str:
        """Return the hash of the rows and of the code that draws them."""
        return hash_of([*self.rows, *self.drawing, "scripts/studies/screen.py"], root)


def studies(path: Path = STUDIES) -> dict[str, EvidenceStudy]:
    """Return the studies of a file by name, with the names of groups replaced by their files.

    Raises:
        ValueError: if the file is damaged.
    """
    data = files.read_data(path, dict)
    groups = data["groups"]

    def expanded(names: Sequence[str]) -> Iterator[str]:
        for name in names:
            yield from expanded(groups[name]) if name in groups else (name,)

    def study(name: str, options: str = "", **entry: Any) -> EvidenceStudy:
        made = EvidenceStudy(name, **{"commands": (), **entry, "code": tuple(dict.fromkeys(expanded(entry["code"])))})
        if made.commands:
            return made
        command = f"studies {name} --folder {made.folder}"
        redraw = f"{command} --redraw" if made.drawn else ""
        return replace(made, commands=(f"{command} {options}".rstrip(),), redraw=redraw)

    return {name: study(name, **entry) for name, entry in data["studies"].items()}


def read_record(root: Path = ROOT) -> dict[str, dict[str, Any]]:
    """Return study -> what is known of its last making."""
    return dict(json.loads((root / RECORD).read_text(encoding="utf-8")))


def make(study: EvidenceStudy, root: Path = ROOT, rows: bool = True) -> None:
    """Make what is older than its code, rows and drawings, and record it; a part that is current is not made again.

    Args:
        study: study of `studies`.
        root: root of the checkout.
        rows: False to draw from the stored rows, which keep their record.

    Raises:
        subprocess.CalledProcessError: if a command fails; nothing is recorded then.
    """
    known = read_record(root).get(study.name, {})
    if rows and study.rows_state(known, root) != CURRENT:
        code, started = hash_of(study.code, root), getrusage(RUSAGE_CHILDREN)
        for command in study.commands:
            _run(command.format(hash=code), root)
        ended = getrusage(RUSAGE_CHILDREN)
        seconds = ended.ru_utime + ended.ru_stime - started.ru_utime - started.ru_stime
        known = {"version": flexman_gym.__version__, "code": code, "minutes": round(seconds / 60, 1)}
    elif study.redraw and study.drawing_state(known, root) != CURRENT:
        _run(study.redraw, root)
    record = read_record(root) | {study.name: {**known, "drawing": study.drawing_hash(root)}}
    text = json.dumps(record, indent=1, sort_keys=True) + "\n"
    files.write_atomically(root / RECORD, lambda file: file.write(text.encode()))


def _run(command: str, root: Path) -> None:
    program, *arguments = shlex.split(command)
    start = ["-m", MODULES[program]] if program in MODULES else [program]
    subprocess.run([sys.executable, *start, *arguments], cwd=root, check=True)
