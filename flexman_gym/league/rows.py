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

from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.common.checks import short_path
from flexman_gym.common.computer import computer_info
from flexman_gym.common.files import write_atomically
from flexman_gym.common.parallel import Workers, parallel_map_unordered
from flexman_gym.common.renamed import current_methods
from flexman_gym.common.run_folder import BEST, NEWEST, SETTINGS
from flexman_gym.common.time_series import read_csv_rows
from flexman_gym.control.actions import ActionMode
from flexman_gym.control.agent import Law
from flexman_gym.control.controller import EpisodeInfo, Readings
from flexman_gym.control.references.optimised_slews import SHIPPED_TABLE, SlewTable
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.agent import BASELINES, AgentSpec, design_for, find_agent
from flexman_gym.evaluation.agent_info import check_seeds_unseen, describe_agent, is_realisable
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.policy_files import ABOUT, ARRAYS, policy_folder
from flexman_gym.evaluation.rollout import EpisodeRecord, compile_kernels, rollout
from flexman_gym.league.scenarios import find_plant, find_scenario
from flexman_gym.metrics import damping_ratio

Kind = TypeVar("Kind")
PACKAGE = Path(__file__).parents[1]
ROWS, CELLS = "rows.csv", "cells.csv"
BLOCK = 25  # episodes side by side in a cell
TIME_RATIO = "multiple"  # of the settling time of the optimised slew
DAMPING = "damping"  # equivalent ratio of the tip's swings from its first arrival on
VALUES = (*METRICS, TIME_RATIO, DAMPING)
FORMER_HEADS = {"entrant": "agent", "venue": "scenario"}  # heads of columns in rows of version 0.2 -> heads
FORMER_METRICS: tuple[
    str, ...
] = ()  # metrics of earlier versions, no longer in VALUES; the columns of older rows are skipped
# code that determines a row, beside agent, scenario and packages; texts of pages are not among it
SOURCES = ("common/arrays.py", "kernels", "scene", "model", "simulation", "control", "envs", "metrics",
           *(f"evaluation/{name}.py" for name in ("agent", "metrics", "rollout")), "league/rows.py",
           "league/scenarios.py")  # fmt: skip
REFERENCE_AGENTS = ("zero", "privileged-lqr")  # agents whose mean rewards are the scores 0 and 1; run in every scenario


class EpisodeRow(NamedTuple):
    """Episode: hash of all that determines it, agent, scenario, seed, and its VALUES; nan for a missing one."""

    key: str
    agent: str
    scenario: str
    seed: int
    values: tuple[float, ...]


class EpisodeBlock(NamedTuple):
    """Block of episodes of an agent in a scenario: the seeds from `first` to the one before `end`.

    Attributes:
        action, design: CPU time of an action of an arm and of the start of an episode, microseconds.
        why: reason for which it was not run, "" where it was.
    """

    key: str
    agent: str
    scenario: str
    first: int
    end: int
    action: float = np.nan
    design: float = np.nan
    why: str = ""


class LeagueRows:
    """Results of a league: rows by scenario, agent and seed, and cells by scenario, agent and first seed."""

    def __init__(self, rows: Iterable[EpisodeRow] = (), cells: Iterable[EpisodeBlock] = ()) -> None:
        self.rows = {(row.scenario, row.agent, row.seed): row for row in rows}
        self.cells = {(cell.scenario, cell.agent, cell.first): cell for cell in cells}

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read the rows and cells of a folder by the heads of their columns; empty where there are none.

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
        return cls(_read(folder / ROWS, _row, EpisodeRow._fields[:4], (*VALUES, *FORMER_METRICS)), cells)

    def save(self, folder: Path) -> None:
        """Write both, sorted, so that the files do not depend on the order of the runs."""
        rows = ([*row[:4], *map(repr, row.values)] for _, row in sorted(self.rows.items()))
        _write(folder / ROWS, (*EpisodeRow._fields[:4], *VALUES), rows)
        _write(
            folder / CELLS, EpisodeBlock._fields, (cell for _, cell in sorted(self.cells.items()))
        )  # last: a cell has rows

    def has(self, cell: EpisodeBlock) -> bool:
        """Return whether a cell was run, or refused, with the present agent, scenario and code."""
        known = self.cells.get((cell.scenario, cell.agent, cell.first))
        return known is not None and known.key == cell.key and known.end >= cell.end

    def add(self, cell: EpisodeBlock, rows: Iterable[EpisodeRow]) -> None:
        """Add a cell and its rows, in place of all rows of another version of the agent or the scenario."""
        who = cell.scenario, cell.agent
        self.rows = {place: row for place, row in self.rows.items() if place[:2] != who or row.key == cell.key}
        self.cells = {place: each for place, each in self.cells.items() if place[:2] != who or each.key == cell.key}
        self.cells[*who, cell.first] = cell
        self.rows |= {(*who, row.seed): row for row in rows}


def run_league(
    agents: Sequence[str], scenarios: Sequence[str], seeds: range, folder: Path, jobs: Workers | int = 1,
    say: Callable[[str], None] = print,
) -> LeagueRows:  # fmt: skip
    """Run the cells that a folder does not have yet, and write its files after each.

    Args:
        agents: names, see `find_agent`.
        scenarios: names, see `find_scenario`.
        seeds: of the episodes, consecutive.
        folder: of the files.
        jobs: `Workers`, or a number of processes; rows are the same for all of them.
        say: function that takes one line of text for each cell.

    Raises:
        FileNotFoundError, ValueError: one line, also for a run that was trained on some of the seeds; nothing is
            run then.
    """
    for agent in agents:
        check_seeds_unseen(agent, seeds)
        describe_agent(agent)
    results = LeagueRows.load(folder)
    keys = {(who, scenario): row_key(who, scenario) for scenario in scenarios for who in agents}
    blocks = [(first, min(first + BLOCK, seeds.stop)) for first in range(seeds.start, seeds.stop, BLOCK)]
    cells = [EpisodeBlock(key, *place, *block) for place, key in keys.items() for block in blocks]
    left = [cell for cell in cells if not results.has(cell)]
    folder.mkdir(parents=True, exist_ok=True)
    for count, (_, (cell, rows)) in enumerate(
        parallel_map_unordered(run_block, left, jobs, prepare=compile_kernels), 1
    ):
        results.add(cell, rows)
        results.save(folder)
        what = cell.why or f"{cell.action:.0f} us an action"
        say(f"{count} of {len(left)}: {cell.agent} on {cell.scenario}, {cell.first} to {cell.end - 1}: {what}")
    return results


def run_block(cell: EpisodeBlock) -> tuple[EpisodeBlock, list[EpisodeRow]]:
    """Run the episodes of a cell; a cell that is refused has the reason and no rows."""
    try:
        scenario, agent = find_scenario(cell.scenario), find_agent(cell.agent)
        if _is_lab(cell.scenario) and not is_realisable(cell.agent) and cell.agent not in REFERENCE_AGENTS:
            return cell._replace(why="it needs more than a laboratory can tell it"), []
        seeds, (player, watch) = range(cell.first, cell.end), _timed(agent, scenario.given)
        result = rollout(player, scenario.environment, seeds, moved=find_plant(scenario.plant))
    except ValueError as error:
        words, _, allowed = str(error).splitlines()[0].partition(" is not allowed; give ")
        return cell._replace(why=f"{words.split(':')[0]}: only {allowed}" if allowed else words), []
    times, rows = optimised_settling_times(scenario.environment), []
    for seed, record in zip(seeds, result.records, strict=True):
        values = {name: figure.of(record) for name, figure in METRICS.items()}
        multiple = values["settling_time"] / times.get(seed, np.nan)
        values |= {TIME_RATIO: multiple, DAMPING: equivalent_damping(record)}
        rows.append(EpisodeRow(cell.key, cell.agent, cell.scenario, seed, tuple(values.values())))
    action, design = (watch.acting, watch.designing) if watch else (0.0, 0.0)
    return cell._replace(action=1e6 * action / float(np.sum(result.lengths)), design=1e6 * design / len(seeds)), rows


def optimised_settling_times(environment: Configuration) -> dict[int, float]:
    """Settling times (s) of the optimised slews of an environment by seed, where the table that is shipped is its."""
    table = SlewTable.load(SHIPPED_TABLE)
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


def row_key(agent: str, scenario: str) -> str:
    """Hash of all that rows follow from: settings of scenario and agent, files of a run, the code, and versions."""
    *both, plant = find_scenario(scenario)
    parts: list[Any] = [*(each.to_plain() for each in both), plant, code_hash()]
    parts += [computer_info(("mujoco",) if plant == "mujoco" else ()) | {"processor": ""}, _is_lab(scenario)]
    folder = policy_folder(agent) or Path(agent)
    files = [] if agent in BASELINES else [folder / name for name in (SETTINGS, BEST, NEWEST, ABOUT, ARRAYS)]
    known = [hashlib.sha256(path.read_bytes()).hexdigest() for path in files if path.is_file()] or [agent]
    return hashlib.sha256(json.dumps([parts, known], sort_keys=True).encode()).hexdigest()[:16]


class _TimedMode:
    """Action mode with its base, and the CPU time (s) of it and of the law of its agent."""

    def __init__(self, inner: ActionMode) -> None:
        self.inner, self.acting, self.designing = inner, 0.0, 0.0
        self.joints, self.names, self.sensors = inner.joints, inner.names, inner.sensors
        self.observation_sizes = getattr(inner, "observation_sizes", {})

    def __deepcopy__(self, memo: object) -> Self:
        return self  # a rollout copies the mode; the times are read from this one

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        begun = process_time()
        self.inner.reset(arms, episode, count)
        self.designing += process_time() - begun

    def act(self, actions: Array, readings: Readings, applied: Array, active: BoolArray) -> Array:
        return self.timed(self.inner.act)(actions, readings, applied, active)

    def observe(self, readings: Readings, applied: Array, active: BoolArray) -> Array:
        return self.timed(self.inner.observe)(readings, applied, active)  # type: ignore[attr-defined]

    def timed(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function whose time counts as that of an action."""

        def call(*arguments: Any) -> Any:
            begun = process_time()
            result = function(*arguments)
            self.acting += process_time() - begun
            return result

        return call


def _timed(agent: AgentSpec, given: Configuration) -> tuple[AgentSpec, _TimedMode | None]:
    """Return an agent designed for an environment, and its clock; "zero" takes no time."""
    if agent.interface is None or (agent.law is None and "base" not in agent.interface):
        return agent, None
    designed = design_for(agent, given)
    assert designed.interface is not None
    watch = _TimedMode(designed.interface["actions"])
    law: Law | None = watch.timed(designed.law) if designed.law else None
    return replace(designed, law=law, interface={**designed.interface, "base": None, "actions": watch}), watch


def _is_lab(scenario: str) -> bool:
    """Return whether agents of a scenario may need only what a laboratory measures."""
    where, _, change = scenario.partition("@")[0].rpartition("/")
    name = where if "=" in change else scenario.partition("@")[0]
    return policy_folder(name) is None and Configuration.find(name).settings.get("sensors") == "lab"


def _read(
    path: Path, make: Callable[[dict[str, str]], Kind], heads: Sequence[str], metrics: Sequence[str] = ()
) -> list[Kind]:
    """Return what is made of each line of a table with these heads and some of the metrics."""
    lines = read_csv_rows(path)
    found = [FORMER_HEADS.get(name, name) for name in next(lines, [])]
    unknown, missing = [name for name in found if name not in (*heads, *metrics)], set(heads) - {*found}
    if unknown or missing or len(set(found)) < len(found):
        allowed = f"{', '.join(heads)}{' and the metrics of the league' if metrics else ''}, each once"
        raise ValueError(f"{short_path(path)}: its heads are not those of a league; give {allowed}")
    result = []
    for number, line in enumerate(lines, 2):
        try:
            result.append(make(dict(zip(found, map(current_methods, line), strict=True))))
        except ValueError:
            allowed = f"{len(found)} entries, numbers where they belong"
            raise ValueError(f"{short_path(path)}: line {number} is not one of a league; give {allowed}") from None
    return result


def _row(entries: Mapping[str, str]) -> EpisodeRow:
    values = tuple(float(entries.get(name, "nan")) for name in VALUES)
    return EpisodeRow(entries["key"], entries["agent"], entries["scenario"], int(entries["seed"]), values)


def _cell(entries: Mapping[str, str]) -> EpisodeBlock:
    kinds: dict[str, Callable[[str], Any]] = {"first": int, "end": int, "action": float, "design": float}
    return EpisodeBlock(**{name: kinds.get(name, str)(entry) for name, entry in entries.items()})


def _write(path: Path, heads: Sequence[str], rows: Iterable[Iterable[Any]]) -> None:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([heads, *rows])
    write_atomically(path, lambda file: file.write(text.getvalue().encode()))
