"""Training and evaluation of the recipes, and ablations of the settings of one."""

from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import TypeVar

from flexman_gym.common.computer import computer_text
from flexman_gym.common.parallel import Workers
from studies.files import folder, read_rows
from studies.learning.algorithms import AlgorithmRow
from studies.learning.measure import (
    LearningRow,
    Point,
    cases,
    controllers,
    picture,
    points,
    run_folder,
    runs,
    tasks,
)
from studies.learning.page import page
from studies.results import DOCS, Results
from studies.study import Study, Table

KNOWN = {f"{case.kind}/{case.name}": case for case in cases()}  # cases with training
ALONE = {"controllers": controllers, "tasks": tasks}  # cases without training
NAMES = [*KNOWN, *ALONE]
ROWS, CURVES = "evidence/learning", "evidence/learning_curves"  # the page is in the folder above
Row = TypeVar("Row", LearningRow, Point)


def rows(options: Namespace) -> Iterator[LearningRow]:
    """Yield the rows of the cases."""
    for name in options.only:
        yield from ALONE[name]() if name in ALONE else runs(KNOWN[name], options.kept, Workers.of(options))


def curves(options: Namespace) -> Iterator[Point]:
    """Yield the learning curves of all seeds of the recipes."""
    for case in (each for name, each in KNOWN.items() if name in options.only and each.kind == "recipe"):
        for seed in range(case.seeds):
            yield from points(case.name, seed, run_folder(case, options.kept, seed))


def with_others(file: Path, new: Iterator[Row], kind: type[Row]) -> Iterator[Row]:
    """Yield new rows and, before them, the stored rows of other cases."""
    result = list(new)
    own = {_case(row) for row in result}
    yield from (row for row in (read_rows(file, kind) if file.exists() else ()) if _case(row) not in own)
    yield from result


def _case(row: LearningRow | Point) -> tuple[str, str]:
    return getattr(row, "kind", "recipe"), row.name


def measure(options: Namespace) -> tuple[Iterator[LearningRow], Iterator[Point]]:
    """Return rows and learning curves."""
    folder = options.folder
    return (with_others(folder / f"{ROWS}.csv", rows(options), LearningRow),
            with_others(folder / f"{CURVES}.csv", curves(options), Point))  # fmt: skip


def compared() -> list[AlgorithmRow]:
    """Return the rows of the comparison of algorithms, which the page quotes."""
    return read_rows(DOCS / "evidence" / "algorithms.csv", AlgorithmRow)


RUNNER = Study(
    tables=(Table(ROWS, LearningRow), Table(CURVES, Point)),
    measure=measure,
    pages={"results.md": lambda rows, _, files: page(rows, files["learning.csv"], Results(), compared())},
    charts=lambda folder, _, curves: [picture(curves, folder / "evidence")],
    options={
        "--only": {
            "nargs": "+",
            "choices": NAMES,
            "default": NAMES,
            "metavar": "CASE",
            "help": f"cases to run, from {', '.join(NAMES)}; others keep their rows",
        },
        "--kept": {"type": folder, "default": "runs/learning", "help": "folder of the training runs"},
    },
    parallel=True,
    comment=lambda _: computer_text(("stable-baselines3", "torch")),
)
