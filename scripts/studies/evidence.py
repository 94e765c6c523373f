"""Age of rows, pages, pictures and certificates with respect to the code that made them, and making them again."""

import json
import shlex
import shutil
import subprocess
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from pkgutil import resolve_name
from resource import RUSAGE_CHILDREN, getrusage
from typing import Any, NamedTuple

import flexman_gym
from flexman_gym.common import files
from flexman_gym.common.computer import computer_info
from studies.dependencies import Sources, hash_of, long_hash
from studies.files import add_code, today
from studies.trace import Dependencies, read_record, run_traced

ROOT = Path(__file__).parents[2]
STUDIES = Path(__file__).with_name("evidence.yaml")
RECORDS = Path("docs/evidence/made")  # folder below the root: NAME.json of each study that was made or drawn
TRACES = Path("out/evidence")  # folder below the root: records of runs, with which an interrupted run goes on
CURRENT, STALE, UNKNOWN, MISSING = "current", "older than its code", "not recorded", "missing"
MODULES = {"flexman": "flexman_gym"}  # first word of a command -> module that runs it, if another than its name
SECONDS = "seconds"  # kind of the line of a trace with the CPU time of a session


class Age(NamedTuple):
    """Age of rows or of drawings.

    Attributes:
        state: CURRENT, STALE, UNKNOWN or MISSING.
        changes: what has changed since, such as "forces.py stage_forces".
    """

    state: str
    changes: Sequence[str] = ()


@dataclass(frozen=True)
class EvidenceStudy:
    """Study of `evidence.yaml`: its files and its commands.

    Attributes:
        name: name of the study.
        rows: patterns of files that the commands write.
        minutes: CPU time, min.
        commands: commands that make everything: a program of `python -m`, or a file of `scripts`, with arguments.
        drawn: patterns of files that are drawn from the rows.
        redraw: command that only draws; "" if there is none.
        folder: folder of the rows of a program of `python -m studies`, relative to the root.
        built: folder in which the commands write, if they run only what is missing there; its files are copied to their
            places at the end.
        code: files and folders that the study uses in processes that cannot be traced.
        outdated: function, as "module:name", that returns which rows are older than their code, if each has a digest.
        budget: largest CPU time, min; of studies that take hours.
    """

    name: str
    rows: Sequence[str]
    minutes: float
    commands: Sequence[str] = ()
    drawn: Sequence[str] = ()
    redraw: str = ""
    folder: str = "docs/evidence"
    built: str = ""
    code: Sequence[str] = ()
    outdated: str = ""
    budget: float | None = None


def studies(path: Path = STUDIES) -> dict[str, EvidenceStudy]:
    """Return the studies of a file by name.

    Raises:
        ValueError: if the file is damaged.
    """

    def study(name: str, options: str = "", **entry: Any) -> EvidenceStudy:
        made = EvidenceStudy(name, **entry)
        if made.commands:
            return made
        command = f"studies {name} --folder {made.folder}"
        redraw = f"{command} --redraw" if made.drawn else ""
        return replace(made, commands=(f"{command} {options}".rstrip(),), redraw=redraw)

    return {name: study(name, **entry) for name, entry in files.read_data(path, dict)["studies"].items()}


class Checkout:
    """Sources, records and results of a checkout.

    Args:
        root: root of the checkout.
        neutral: source files that change no result.
    """

    def __init__(self, root: Path = ROOT, neutral: Sequence[str] | None = None) -> None:
        self.root, self.sources, self.start = root, Sources(root), time.time()
        self.neutral = files.read_data(STUDIES, dict)["neutral"] if neutral is None else neutral

    @cached_property
    def code(self) -> str:
        """Hash of all code and data of the packages, with which an interrupted run may go on."""
        return hash_of(("flexman_gym", "agents", "scripts/studies"), self.root)

    def record(self, name: str) -> dict[str, Any]:
        """Return what is known of the last making of a study; {} for nothing."""
        path = self.root / RECORDS / f"{name}.json"
        return dict(json.loads(path.read_text(encoding="utf-8"))) if path.exists() else {}

    def write_record(self, name: str, record: Mapping[str, Any]) -> None:
        """Write what is known of a study."""
        path = self.root / RECORDS / f"{name}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps(record, separators=(",", ":"), sort_keys=True).replace("},", "},\n") + "\n"
        files.write_atomically(path, lambda file: file.write(text.encode()))

    def minutes(self, study: EvidenceStudy) -> float:
        """Return the CPU time of all rows of a study, min: measured when they were made, else its estimate."""
        return study.minutes if study.outdated else float(self.record(study.name).get("minutes", study.minutes))

    def rows_age(self, study: EvidenceStudy) -> Age:
        """Return the age of the rows of a study."""
        known = self.record(study.name)
        age = self._age(study.rows, known.get("rows"))
        if age.state in (CURRENT, STALE) and study.code and known["folders"] != hash_of(study.code, self.root):
            return Age(STALE, [*age.changes, *study.code])
        changes = resolve_name(study.outdated)(self.root) if study.outdated and age.state in (CURRENT, STALE) else ()
        return Age(STALE, [*age.changes, *changes]) if changes else age

    def drawing_age(self, study: EvidenceStudy) -> Age:
        """Return the age of the pages and charts of a study, which depend on its rows."""
        return self._age(study.drawn, self.record(study.name).get("drawing"))

    def _age(self, patterns: Sequence[str], known: dict[str, Any] | None) -> Age:
        if not all(any(self.root.glob(pattern)) for pattern in patterns):
            return Age(MISSING)
        if known is None:
            return Age(UNKNOWN)
        changes = Dependencies(**known).changes(self.sources, self.root)
        return Age(STALE, changes) if changes else Age(CURRENT)

    def make(self, study: EvidenceStudy) -> None:
        """Run the commands of a study, and record what they used.

        An interrupted run goes on with the same record: the parts that are finished are not computed again.

        Raises:
            subprocess.CalledProcessError: if a command fails; nothing is recorded then.
        """
        trace = self.root / TRACES / f"trace-{study.name}-{self.code}"
        for command in study.commands:
            before = _children_seconds()
            try:
                run_traced(_arguments(command.format(hash=self.code)), self.root, trace)
            finally:
                with trace.open("a", encoding="utf-8") as file:
                    file.write(f"{SECONDS}\t{_children_seconds() - before:.1f}\t\t\n")
        self._copy_built(study)
        rows = self._dependencies(trace, [*study.rows, *study.drawn], self.start)
        if study.outdated:  # the digest of each row covers its files; a copy of the checkout reads all others
            rows.files.clear()
        code = {"rows": asdict(rows), "folders": hash_of(study.code, self.root) if study.code else ""}
        digest = long_hash(json.dumps(code, sort_keys=True).encode())
        for path in (path for pattern in study.rows for path in self.root.glob(pattern) if path.suffix == ".csv"):
            add_code(path, digest)
        minutes = round(sum(_sessions(trace)) / 60, 1)
        made = {"code": digest, "date": today(), "minutes": minutes, "version": flexman_gym.__version__,
                "processor": computer_info()["processor"]}  # fmt: skip
        self.write_record(study.name, code | made)

    def _copy_built(self, study: EvidenceStudy) -> None:
        """Copy rows, pages and charts from the folder in which a study was built, if it has one."""
        source = self.root / study.built.format(hash=self.code)
        for pattern in map(Path, (*study.rows, *study.drawn) if study.built else ()):
            for path in source.glob(pattern.name):
                shutil.copy(path, self.root / pattern.parent)

    def draw(self, study: EvidenceStudy) -> None:
        """Draw pages and charts from the stored rows, and record what was used.

        Raises:
            subprocess.CalledProcessError: if the command fails.
        """
        trace, start = self.root / TRACES / f"drawing-{study.name}", time.time()
        trace.unlink(missing_ok=True)
        run_traced(_arguments(study.redraw), self.root, trace, rows=False)
        drawing = asdict(self._dependencies(trace, study.drawn, start))
        self.write_record(study.name, self.record(study.name) | {"drawing": drawing})

    def files_read(self, command: str) -> set[str]:
        """Return the files of the checkout that a command reads."""
        trace = self.root / TRACES / "read"
        trace.unlink(missing_ok=True)
        with suppress(subprocess.CalledProcessError):  # its own message
            run_traced(_arguments(command), self.root, trace, rows=False)
        return {line.split("\t")[1] for line in trace.read_text(encoding="utf-8").splitlines() if line[:5] == "read\t"}

    def _dependencies(self, trace: Path, own: Sequence[str], start: float) -> Dependencies:
        """Return the dependencies of a run that started at a time (s), without the files that it wrote itself."""
        found = read_record(trace, self.sources, self.neutral, start)
        for path in (path for pattern in own for path in self.root.glob(pattern)):
            found.files.pop(path.relative_to(self.root).as_posix(), None)
        return found


def make(study: EvidenceStudy, root: Path = ROOT, rows: bool = True, neutral: Sequence[str] | None = None) -> None:
    """Make what is older than its code, rows and drawings, and record it; a part that is current is not made again.

    Args:
        study: study of `studies`.
        root: root of the checkout.
        rows: False to draw from the stored rows, which keep their record.
        neutral: source files that change no result; None for those of `evidence.yaml`.

    Raises:
        subprocess.CalledProcessError: if a command fails; nothing is recorded then.
    """
    checkout = Checkout(root, neutral)
    if rows and checkout.rows_age(study).state != CURRENT:
        checkout.make(study)
    if study.redraw and checkout.drawing_age(study).state != CURRENT:
        checkout.draw(study)


def _sessions(trace: Path) -> list[float]:
    """Return the CPU times of the sessions of a run, s, and remove them: the run has ended."""
    lines = trace.read_text(encoding="utf-8").splitlines(keepends=True)
    trace.write_text("".join(line for line in lines if not line.startswith(SECONDS)), encoding="utf-8")
    return [float(line.split("\t")[1]) for line in lines if line.startswith(SECONDS)]


def _children_seconds() -> float:
    """Return the CPU time of all processes that were started here and have ended, s."""
    used = getrusage(RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _arguments(command: str) -> list[str]:
    """Return the arguments of Python for a command; the functions of a script are traced as those of a module."""
    program, *words = shlex.split(command)
    return ["-m", MODULES.get(program, Path(program).stem), *words]
