"""Rows of a league: results of every agent in every scenario, computed in blocks of episodes and stored as CSV."""

import ast
import csv
import hashlib
import io
import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, Self, TypeVar

import numpy as np

from flexman_gym.agent.base_controllers import BASES
from flexman_gym.common.computer import computer_info
from flexman_gym.common.errors import short_path
from flexman_gym.common.files import CONVERSION, write_atomically
from flexman_gym.common.parallel import Workers, parallel_map_unordered
from flexman_gym.common.run_folder import BEST, NEWEST, SETTINGS
from flexman_gym.common.tables import read_csv_rows
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.vector_env import compile_kernels
from flexman_gym.evaluation.agent_info import check_seeds_unseen, describe_agent
from flexman_gym.evaluation.agents import find_agent, is_baseline
from flexman_gym.evaluation.metrics import LIMIT_METRICS, METRICS
from flexman_gym.evaluation.policy_files import ARRAYS, METADATA, policy_folder
from flexman_gym.evaluation.rollouts import rollout
from flexman_gym.toolbox.controllers.references.optimised_slews import SHIPPED_TABLE, SlewTable
from flexman_gym.toolbox.league.scenarios import PLANTS, find_scenario

Kind = TypeVar("Kind")
PACKAGE = Path(__file__).parents[2]
ROWS, CELLS = "rows.csv", "cells.csv"
BLOCK = 25  # episodes of a cell, which are simulated together as one batch
TIME_RATIO = "multiple"  # dimensionless; settling time relative to the settling time of the optimised slew
DAMPING = "damping"  # dimensionless; equivalent damping ratio of the tip's oscillation after its first arrival
LIMITED = tuple(metric.name for metric in LIMIT_METRICS)
VALUES = (*METRICS, TIME_RATIO, DAMPING, *LIMITED)  # columns of the values of a row
# Sources on which the results in a row depend, in addition to agent, scenario and package versions.
SOURCES = ("common/arrays.py", "kernels", "scene", "model", "simulation", "agent", "envs", "metrics",
           *(f"evaluation/{name}.py" for name in ("agents", "metrics", "rollouts")), "toolbox/controllers",
           "toolbox/safety", "toolbox/league/rows.py", "toolbox/league/scenarios.py")  # fmt: skip
REFERENCE_AGENTS = ("zero", "privileged-lqr")  # their mean returns are the scores 0 and 1; they run in every scenario


class EpisodeRow(NamedTuple):
    """Results of one episode.

    Attributes:
        key: hash of all inputs of the results, see `_row_key`.
        agent: name of the agent.
        scenario: name of the scenario.
        seed: seed of the episode.
        values: values of the columns VALUES; nan for a missing value.
    """

    key: str
    agent: str
    scenario: str
    seed: int
    values: tuple[float, ...]


class EpisodeBlock(NamedTuple):
    """Cell of a league: a block of episodes of one agent in one scenario, simulated together as one batch.

    Attributes:
        key: hash of all inputs of the results, see `_row_key`.
        agent: name of the agent.
        scenario: name of the scenario.
        first, end: first seed, and last seed + 1.
        action, design: CPU time of an action for one arm, and of the start of an episode, microseconds.
        why: reason for which the cell has no rows; "" for a cell with rows.
    """

    key: str
    agent: str
    scenario: str
    first: int
    end: int
    action: float = np.nan
    design: float = np.nan
    why: str = ""

    def run(self) -> tuple["EpisodeBlock", list[EpisodeRow]]:
        """Run the episodes; return the cell with CPU times, or with the reason for no rows, and its rows."""
        try:
            scenario, agent = find_scenario(self.scenario), find_agent(self.agent)
            lab = _is_lab(self.scenario) and self.agent not in REFERENCE_AGENTS
            if lab and not describe_agent(self.agent).realisable:
                return self._replace(why="it needs information that a laboratory cannot measure"), []
            seeds, (agent, clock) = range(self.first, self.end), agent.timed(scenario.given)
            result = rollout(agent, scenario.environment, seeds, set_plant=PLANTS[scenario.plant][1])
        except ValueError as error:
            words, _, allowed = str(error).splitlines()[0].partition(" is not allowed; give ")
            return self._replace(why=f"{words.split(':')[0]}: only {allowed}" if allowed else words), []
        times, rows = optimised_settling_times(scenario.environment), []
        for seed, record in zip(seeds, result.records, strict=True):
            values = {name: metric.function(record) for name, metric in METRICS.items()}
            multiple = values["settling_time"] / times.get(seed, np.nan)
            values |= {TIME_RATIO: multiple, DAMPING: record.equivalent_damping()}
            values |= {each.name: np.nan if record.excess is None else each.function(record) for each in LIMIT_METRICS}
            rows.append(EpisodeRow(self.key, self.agent, self.scenario, seed, tuple(values.values())))
        action, design = (clock.action_seconds, clock.start_seconds) if clock else (0.0, 0.0)
        action = 1e6 * action / float(np.sum(result.lengths))
        return self._replace(action=action, design=1e6 * design / len(seeds)), rows


class LeagueRows:
    """Results of a league.

    Args:
        rows: results of episodes.
        cells: cells of the rows.

    Attributes:
        rows: (scenario, agent, seed) -> results of the episode.
        cells: (scenario, agent, first seed) -> cell.
    """

    def __init__(self, rows: Iterable[EpisodeRow] = (), cells: Iterable[EpisodeBlock] = ()) -> None:
        self.rows = {(row.scenario, row.agent, row.seed): row for row in rows}
        self.cells = {(cell.scenario, cell.agent, cell.first): cell for cell in cells}

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read the rows and cells of a folder; empty for a folder without them.

        Columns are found by their heads, in any order. A metric without a column is nan.

        Args:
            folder: folder of the files.

        Raises:
            FileNotFoundError: for cells without rows.
            ValueError: for unknown, missing and repeated heads, for a line with too few or too many entries, and for
                an entry other than a number in a column of numbers.
        """
        if not os.path.exists(folder / CELLS):  # False for any text; Path.exists raises for some
            return cls()
        cells = _read(folder / CELLS, _cell, EpisodeBlock._fields)
        return cls(_read(folder / ROWS, _row, EpisodeRow._fields[:4], VALUES), cells)

    def save(self, folder: Path) -> None:
        """Write rows and cells in sorted order, so that the files do not depend on the order of the computation."""
        rows = ([*row[:4], *map(repr, row.values)] for _, row in sorted(self.rows.items()))
        _write(folder / ROWS, (*EpisodeRow._fields[:4], *VALUES), rows)
        cells = (cell for _, cell in sorted(self.cells.items()))
        _write(folder / CELLS, EpisodeBlock._fields, cells)  # after the rows: a cell in the file has its rows

    def has(self, cell: EpisodeBlock) -> bool:
        """Return True if the results contain the cell with the same key, with rows or a reason for no rows."""
        stored = self.cells.get((cell.scenario, cell.agent, cell.first))
        return stored is not None and stored.key == cell.key and stored.end >= cell.end

    def add(self, cell: EpisodeBlock, rows: Iterable[EpisodeRow]) -> None:
        """Add a cell and its rows; remove all rows and cells of the same agent and scenario with another key."""
        pair = cell.scenario, cell.agent
        self.rows = {index: row for index, row in self.rows.items() if index[:2] != pair or row.key == cell.key}
        self.cells = {index: each for index, each in self.cells.items() if index[:2] != pair or each.key == cell.key}
        self.cells[*pair, cell.first] = cell
        self.rows |= {(*pair, row.seed): row for row in rows}


def run_league(
    agents: Sequence[str], scenarios: Sequence[str], seeds: range, folder: Path, jobs: Workers | int = 1,
    log: Callable[[str], None] = print,
) -> LeagueRows:  # fmt: skip
    """Run the cells that a folder lacks, and write its files after each cell; return all its rows and cells.

    Args:
        agents: names of agents, see `find_agent`.
        scenarios: names of scenarios, see `find_scenario`.
        seeds: consecutive seeds of the episodes.
        folder: folder of the files.
        jobs: `Workers`, or a number of processes; the rows do not depend on this choice.
        log: function of one line of text for each cell.

    Raises:
        ValueError, FileNotFoundError: for an unknown agent or environment.
        ValueError: for a run whose training used some of the seeds, before any simulation; and for an unknown scenario.
    """
    for agent in agents:
        check_seeds_unseen(agent, seeds)
        describe_agent(agent)
    results = LeagueRows.load(folder)
    keys = {(agent, scenario): _row_key(agent, scenario) for scenario in scenarios for agent in agents}
    blocks = [(first, min(first + BLOCK, seeds.stop)) for first in range(seeds.start, seeds.stop, BLOCK)]
    cells = [EpisodeBlock(key, *pair, *block) for pair, key in keys.items() for block in blocks]
    missing = [cell for cell in cells if not results.has(cell)]
    folder.mkdir(parents=True, exist_ok=True)
    for count, (_, (cell, rows)) in enumerate(
        parallel_map_unordered(EpisodeBlock.run, missing, jobs, prepare=compile_kernels), 1
    ):
        results.add(cell, rows)
        results.save(folder)
        result = cell.why or f"{cell.action:.0f} us an action"
        log(f"{count} of {len(missing)}: {cell.agent} on {cell.scenario}, {cell.first} to {cell.end - 1}: {result}")
    return results


@cache
def _code_hash(package: Path, sources: tuple[str, ...]) -> str:
    """Return a hash of the sources of a package without comments and docstrings."""
    found = (path for name in sources for path in ([package / name] if "." in name else (package / name).rglob("*")))
    files = sorted(path for path in found if path.suffix in (".py", ".yaml", ".npz"))
    text = b"".join(path.relative_to(package).as_posix().encode() + _content_without_comments(path) for path in files)
    return hashlib.sha256(text).hexdigest()[:16]


def _content_without_comments(path: Path) -> bytes:
    """Return the content of a file, without comments and docstrings if it is Python code."""
    if path.suffix != ".py":
        return path.read_bytes()
    tree = ast.parse(path.read_bytes())
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            texts = [each for each in node.body if isinstance(each, ast.Expr) and isinstance(each.value, ast.Constant)]
            node.body = [each for each in node.body if each not in texts]
    return ast.dump(tree).encode()


def _row_key(agent: str, scenario: str) -> str:
    """Return a hash of all inputs of the results: scenario, agent, files of a run, code and package versions."""
    *both, plant = find_scenario(scenario)
    parts: list[Any] = [*(each.to_plain() for each in both), plant, _code_hash(PACKAGE, SOURCES)]
    parts += [computer_info(("mujoco",) if plant == "mujoco" else ()) | {"processor": ""}, _is_lab(scenario)]
    folder = policy_folder(agent) or Path(agent)
    of_run = [] if is_baseline(agent) else [folder / name for name in (SETTINGS, BEST, NEWEST, METADATA, ARRAYS)]
    files = [path] if (path := BASES.file(agent)) else of_run
    hashes = [hashlib.sha256(path.read_bytes()).hexdigest() for path in files if path.is_file()] or [agent]
    return hashlib.sha256(json.dumps([parts, hashes], sort_keys=True).encode()).hexdigest()[:16]


def _is_lab(scenario: str) -> bool:
    """Return True if a scenario has the sensors of a laboratory, for agents that use measurable signals only."""
    where, _, change = scenario.partition("@")[0].rpartition("/")
    name = where if "=" in change else scenario.partition("@")[0]
    return policy_folder(name) is None and Configuration.find(name).given.get("sensors") == "lab"


def _read(
    path: Path, make: Callable[[dict[str, str]], Kind], heads: Sequence[str], metrics: Sequence[str] = ()
) -> list[Kind]:
    """Return the result of `make` for each line of a CSV file with these heads and some of the metrics."""
    lines = read_csv_rows(path)
    found = next(lines, [])
    unknown, missing = [name for name in found if name not in (*heads, *metrics)], set(heads) - {*found}
    if unknown or missing or len(set(found)) < len(found):
        allowed = f"{', '.join(heads)}{' and the metrics of the league' if metrics else ''}, each once"
        # A file that is no league may contain secrets; only a word among heads of a league is printed.
        words = [name for name in unknown if name.isidentifier() and {*heads} & {*found}]
        wrong = f"{short_path(words[0])} is no head" if words else "its heads are not those"
        raise ValueError(f"{short_path(path)}: {wrong} of a league; give {allowed}; {CONVERSION}")
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
    return EpisodeRow(entries["key"], entries["agent"], entries["scenario"], int(entries["seed"]), values)


def _cell(entries: Mapping[str, str]) -> EpisodeBlock:
    kinds: dict[str, Callable[[str], Any]] = {"first": int, "end": int, "action": float, "design": float}
    return EpisodeBlock(**{name: kinds.get(name, str)(entry) for name, entry in entries.items()})


def _write(path: Path, heads: Sequence[str], rows: Iterable[Iterable[Any]]) -> None:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([heads, *rows])
    write_atomically(path, lambda file: file.write(text.getvalue().encode()))


def optimised_settling_times(environment: Configuration) -> dict[int, float]:
    """Return the settling times, s, of optimised slews by seed; {} for an environment without a table of slews."""
    table = SlewTable.load(SHIPPED_TABLE)
    if table.about.get("environment") != environment.to_plain():
        return {}
    return {seed: table.settling_time(seed) for seed in table.found}
