"""Rows of a league: episodes of every agent in every scenario, run block by block and kept as CSV."""

import ast
import csv
import hashlib
import io
import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from time import process_time
from typing import Any, NamedTuple, Self, TypeVar

import numpy as np

from flexman_gym.common.arrays import Array, Flags, IntArray
from flexman_gym.common.checks import short_path
from flexman_gym.common.computer import computer_info
from flexman_gym.common.files import write_atomically
from flexman_gym.common.grid import Workers, run_cells
from flexman_gym.common.run_folder import BEST, NEWEST, SETTINGS
from flexman_gym.common.time_series import read_csv_lines
from flexman_gym.control.actions import ActionMode
from flexman_gym.control.agent import Law
from flexman_gym.control.controller import EpisodeInfo, Readings
from flexman_gym.control.references.optimised_slews import SHIPPED, SlewTable
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.agent import BASELINES, AgentSpec, design_for, find_agent
from flexman_gym.evaluation.agent_info import check_unseen, describe_agent, is_realisable
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.policy_files import ABOUT, ARRAYS, policy_folder
from flexman_gym.evaluation.rollout import EpisodeRecord, rollout
from flexman_gym.league.scenarios import find_plant, find_scenario
from flexman_gym.metrics import damping_ratio

Kind = TypeVar("Kind")
PACKAGE = Path(__file__).parents[1]
ROWS, CELLS = "rows.csv", "cells.csv"
BLOCK = 25  # episodes side by side in a cell
MULTIPLE = "multiple"  # of the settling time of the optimised slew
DAMPING = "damping"  # equivalent ratio of the tip's swings from its first arrival on
VALUES = (*METRICS, MULTIPLE, DAMPING)
FORMER: tuple[str, ...] = ()  # metrics of earlier versions, no longer in VALUES; the columns of older rows are skipped
# what a row follows from beside entrant, venue and packages; texts of pages are not among it
SOURCES = ("common/arrays.py", "kernels", "scene", "model", "simulation", "control", "envs", "metrics",
           *(f"evaluation/{name}.py" for name in ("agent", "metrics", "rollout")), "league/rows.py",
           "league/scenarios.py")  # fmt: skip
SCALE = ("zero", "privileged-lqr")  # whose rewards mean 0 and 1, so that they are played everywhere


class EpisodeRow(NamedTuple):
    """An episode: what it follows from, as a hash, who, where, its seed, and its VALUES; nan where there is none."""

    key: str
    entrant: str
    venue: str
    seed: int
    values: tuple[float, ...]


class EpisodeBlock(NamedTuple):
    """A block of episodes: who, where, and the seeds from the first to the one before `end`.

    Attributes:
        action, design: CPU time of an action of an arm and of the start of an episode, microseconds.
        why: it was not played, "" where it was.
    """

    key: str
    entrant: str
    venue: str
    first: int
    end: int
    action: float = np.nan
    design: float = np.nan
    why: str = ""


class LeagueRows:
    """What is played so far: rows by venue, entrant and seed, and cells by venue, entrant and first seed."""

    def __init__(self, rows: Iterable[EpisodeRow] = (), cells: Iterable[EpisodeBlock] = ()) -> None:
        self.rows = {(row.venue, row.entrant, row.seed): row for row in rows}
        self.cells = {(cell.venue, cell.entrant, cell.first): cell for cell in cells}

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read the rows and cells of a folder by the heads of their columns; an empty book where there are none.

        The order of the columns is free. A metric that older rows do not have is nan in them, and a column of FORMER
        is skipped, so that the other values stay right whatever VALUES is.

        Raises:
            FileNotFoundError: for cells without rows.
            ValueError: one line with the file, for unknown, missing and repeated heads, for a line that has not an
                entry for each head, and for an entry that is no number where one belongs.
        """
        if not os.path.exists(folder / CELLS):  # whatever the name is
            return cls()
        cells = _read(folder / CELLS, _cell, EpisodeBlock._fields)
        return cls(_read(folder / ROWS, _row, EpisodeRow._fields[:4], (*VALUES, *FORMER)), cells)

    def save(self, folder: Path) -> None:
        """Writes both, sorted, so that the order in which they were played leaves no trace."""
        rows = ([*row[:4], *map(repr, row.values)] for _, row in sorted(self.rows.items()))
        _write(folder / ROWS, (*EpisodeRow._fields[:4], *VALUES), rows)
        _write(
            folder / CELLS, EpisodeBlock._fields, (cell for _, cell in sorted(self.cells.items()))
        )  # last: a cell has rows

    def has(self, cell: EpisodeBlock) -> bool:
        """Whether a cell was played, or could not be, with what would play it now."""
        known = self.cells.get((cell.venue, cell.entrant, cell.first))
        return known is not None and known.key == cell.key and known.end >= cell.end

    def add(self, cell: EpisodeBlock, rows: Iterable[EpisodeRow]) -> None:
        """Takes what was played, in place of all that another version of the entrant or the venue did."""
        who = cell.venue, cell.entrant
        self.rows = {place: row for place, row in self.rows.items() if place[:2] != who or row.key == cell.key}
        self.cells = {place: each for place, each in self.cells.items() if place[:2] != who or each.key == cell.key}
        self.cells[*who, cell.first] = cell
        self.rows |= {(*who, row.seed): row for row in rows}


def run_league(
    entrants: Sequence[str], venues: Sequence[str], seeds: range, folder: Path, jobs: Workers | int = 1,
    say: Callable[[str], None] = print,
) -> LeagueRows:  # fmt: skip
    """Plays the cells that a folder does not have yet, and writes its files after each.

    Args:
        entrants: see `find_agent` and `find_scenario`.
        venues: see `find_agent` and `find_scenario`.
        seeds: of the episodes, one after the other.
        folder: of the files.
        jobs: who plays, see `Workers`, or so many processes; rows are the same for all of them.
        say: is told of each cell.

    Raises:
        FileNotFoundError, ValueError: one line, also for a run that was trained on some of the seeds, and for a
            baseline without the words that the page needs; nothing is played then.
    """
    for entrant in entrants:
        check_unseen(entrant, seeds)
        describe_agent(entrant)
    book = LeagueRows.load(folder)
    keys = {(who, venue): row_key(who, venue) for venue in venues for who in entrants}
    blocks = [(first, min(first + BLOCK, seeds.stop)) for first in range(seeds.start, seeds.stop, BLOCK)]
    cells = [EpisodeBlock(key, *place, *block) for place, key in keys.items() for block in blocks]
    left = [cell for cell in cells if not book.has(cell)]
    folder.mkdir(parents=True, exist_ok=True)
    for count, (_, (cell, rows)) in enumerate(run_cells(run_block, left, jobs), 1):
        book.add(cell, rows)
        book.save(folder)
        what = cell.why or f"{cell.action:.0f} us an action"
        say(f"{count} of {len(left)}: {cell.entrant} on {cell.venue}, {cell.first} to {cell.end - 1}: {what}")
    return book


def run_block(cell: EpisodeBlock) -> tuple[EpisodeBlock, list[EpisodeRow]]:
    """Plays a cell; one that is refused says why and has no rows."""
    try:
        venue, entrant = find_scenario(cell.venue), find_agent(cell.entrant)
        if _is_lab(cell.venue) and not is_realisable(cell.entrant) and cell.entrant not in SCALE:
            return cell._replace(why="it needs more than a laboratory can tell it"), []
        seeds, (player, watch) = range(cell.first, cell.end), _timed(entrant, venue.told)
        result = rollout(player, venue.environment, seeds, moved=find_plant(venue.plant))
    except ValueError as error:
        words, _, allowed = str(error).splitlines()[0].partition(" is not allowed; give ")
        return cell._replace(why=f"{words.split(':')[0]}: only {allowed}" if allowed else words), []
    times, rows = optimised_times(venue.environment), []
    for seed, record in zip(seeds, result.records, strict=True):
        values = {name: figure.of(record) for name, figure in METRICS.items()}
        multiple = values["settling_time"] / times.get(seed, np.nan)
        values |= {MULTIPLE: multiple, DAMPING: equivalent_damping(record)}
        rows.append(EpisodeRow(cell.key, cell.entrant, cell.venue, seed, tuple(values.values())))
    action, design = (watch.acting, watch.designing) if watch else (0.0, 0.0)
    return cell._replace(action=1e6 * action / float(np.sum(result.lengths)), design=1e6 * design / len(seeds)), rows


def optimised_times(environment: Configuration) -> dict[int, float]:
    """Settling times (s) of the optimised slews of an environment by seed, where the table that is shipped is its."""
    table = SlewTable.load(SHIPPED)
    same = table.about.get("environment") == environment.to_plain()
    return {seed: table.settling_time(seed) for seed in table.found} if same else {}


def equivalent_damping(record: EpisodeRecord) -> float:
    """Gives the damping ratio of the tip's swings along the axis of its largest motion after its first arrival.

    It is infinite where the tip does not swing, and 0 where it never comes within the band.
    """
    inside = np.flatnonzero(record.errors <= record.band)
    if record.failure or not len(inside) or len(record.tips) - inside[0] < 3:
        return 0.0
    tips = record.tips[inside[0] :]
    ratio = damping_ratio(tips[:, np.argmax(np.ptp(tips, axis=0))])
    return np.inf if np.isnan(ratio) else ratio


@cache
def code_hash() -> str:
    """Gives a hash of the files of SOURCES, in which comments and docstrings do not count."""
    found = (path for name in SOURCES for path in ([PACKAGE / name] if "." in name else (PACKAGE / name).rglob("*")))
    files = sorted(path for path in found if path.suffix in (".py", ".yaml", ".npz"))
    text = b"".join(path.relative_to(PACKAGE).as_posix().encode() + _content_without_comments(path) for path in files)
    return hashlib.sha256(text).hexdigest()[:16]


def _content_without_comments(path: Path) -> bytes:
    """The content of a file, of code without comments and docstrings."""
    if path.suffix != ".py":
        return path.read_bytes()
    tree = ast.parse(path.read_bytes())
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            node.body = [each for each in node.body if not _is_text(each)]
    return ast.dump(tree).encode()


def _is_text(statement: ast.stmt) -> bool:
    """Whether a statement is a text alone, as the docstrings of modules, functions, classes and constants are."""
    return isinstance(statement, ast.Expr) and isinstance(getattr(statement.value, "value", None), str)


def row_key(entrant: str, venue: str) -> str:
    """Hash of all that rows follow from: settings of venue and entrant, files of a run, the code, and versions."""
    *both, plant = find_scenario(venue)
    parts: list[Any] = [*(each.to_plain() for each in both), plant, code_hash()]
    parts += [computer_info(("mujoco",) if plant == "mujoco" else ()) | {"processor": ""}, _is_lab(venue)]
    folder = policy_folder(entrant) or Path(entrant)
    files = [] if entrant in BASELINES else [folder / name for name in (SETTINGS, BEST, NEWEST, ABOUT, ARRAYS)]
    known = [hashlib.sha256(path.read_bytes()).hexdigest() for path in files if path.is_file()] or [entrant]
    return hashlib.sha256(json.dumps([parts, known], sort_keys=True).encode()).hexdigest()[:16]


class _TimedMode:
    """Action mode with its base, and the CPU time (s) of it and of the law of its agent."""

    def __init__(self, inner: ActionMode) -> None:
        self.inner, self.acting, self.designing = inner, 0.0, 0.0
        self.joints, self.names, self.sensors = inner.joints, inner.names, inner.sensors
        self.shown = getattr(inner, "shown", {})

    def __deepcopy__(self, memo: object) -> Self:
        return self  # a rollout copies the mode; the times are read from this one

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        begun = process_time()
        self.inner.reset(arms, episode, count)
        self.designing += process_time() - begun

    def act(self, actions: Array, readings: Readings, applied: Array, playing: Flags) -> Array:
        return self.timed(self.inner.act)(actions, readings, applied, playing)

    def look(self, readings: Readings, applied: Array, playing: Flags) -> Array:
        return self.timed(self.inner.look)(readings, applied, playing)  # type: ignore[attr-defined]

    def timed(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function whose time counts as that of an action."""

        def call(*arguments: Any) -> Any:
            begun = process_time()
            result = function(*arguments)
            self.acting += process_time() - begun
            return result

        return call


def _timed(entrant: AgentSpec, told: Configuration) -> tuple[AgentSpec, _TimedMode | None]:
    """Return an agent designed for what is told of the environment, and its clock; "zero" takes no time."""
    if entrant.interface is None or (entrant.law is None and "base" not in entrant.interface):
        return entrant, None
    designed = design_for(entrant, told)
    assert designed.interface is not None
    watch = _TimedMode(designed.interface["actions"])
    law: Law | None = watch.timed(designed.law) if designed.law else None
    return replace(designed, law=law, interface={**designed.interface, "base": None, "actions": watch}), watch


def _is_lab(venue: str) -> bool:
    """Whether only what a laboratory measures may be known there."""
    return "=" not in venue and Configuration.find(venue.partition("@")[0]).settings.get("sensors") == "lab"


def _read(
    path: Path, make: Callable[[dict[str, str]], Kind], heads: Sequence[str], metrics: Sequence[str] = ()
) -> list[Kind]:
    """Return what is made of each line of a table with these heads and some of the metrics."""
    lines = read_csv_lines(path)
    found = next(lines, [])
    unknown, missing = [name for name in found if name not in (*heads, *metrics)], set(heads) - {*found}
    if unknown or missing or len(set(found)) < len(found):
        allowed = f"{', '.join(heads)}{' and the metrics of the league' if metrics else ''}, each once"
        raise ValueError(f"{short_path(path)}: its heads are not those of a league; give {allowed}")
    result = []
    for number, line in enumerate(lines, 2):
        try:
            result.append(make(dict(zip(found, line, strict=True))))
        except ValueError:
            allowed = f"{len(found)} entries, numbers where they belong"
            raise ValueError(f"{short_path(path)}: line {number} is not one of a league; give {allowed}") from None
    return result


def _row(entries: Mapping[str, str]) -> EpisodeRow:
    values = tuple(float(entries.get(name, "nan")) for name in VALUES)
    return EpisodeRow(entries["key"], entries["entrant"], entries["venue"], int(entries["seed"]), values)


def _cell(entries: Mapping[str, str]) -> EpisodeBlock:
    kinds: dict[str, Callable[[str], Any]] = {"first": int, "end": int, "action": float, "design": float}
    return EpisodeBlock(**{name: kinds.get(name, str)(entry) for name, entry in entries.items()})


def _write(path: Path, heads: Sequence[str], rows: Iterable[Iterable[Any]]) -> None:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([heads, *rows])
    write_atomically(path, lambda file: file.write(text.getvalue().encode()))
