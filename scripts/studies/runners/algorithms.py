"""Algorithms of training at equal CPU time: PPO, SAC, TQC and CrossQ."""

from argparse import Namespace
from collections.abc import Iterator

from flexman_gym.common.computer import computer_text
from flexman_gym.common.parallel import Workers
from studies.files import folder, read_rows
from studies.learning.algorithms import BUDGETS, RECIPES, AlgorithmRow, Cell, measure, run_settings
from studies.learning.algorithms_page import page
from studies.study import Study, Table

FILE = "algorithms"


def rows(options: Namespace) -> Iterator[AlgorithmRow]:
    """Yield the stored rows, unless all are made anew, and the missing rows of the chosen runs."""
    path = options.folder / f"{FILE}.csv"
    known = {row.key: row for row in (read_rows(path, AlgorithmRow) if path.exists() and not options.anew else ())}
    cells = [Cell(run_settings(name, seed), options.kept / name / f"seed-{seed}", sorted(options.minutes))
             for seed in range(options.seeds) for name in options.only]  # fmt: skip
    return measure(known, cells, Workers.of(options))


RUNNER = Study(
    tables=(Table(FILE, AlgorithmRow),),
    measure=lambda options: [rows(options)],
    pages={"algorithms.md": page},
    options={
        "--only": {"nargs": "+", "choices": [*RECIPES], "default": [*RECIPES], "help": "algorithms to run"},
        "--seeds": {
            "type": int,
            "default": 1,  # one seed of all algorithms takes two and a half hours of CPU time
            "metavar": "N",
            "help": "runs of each algorithm, seeds 0 to N - 1 (default: %(default)s)",
        },
        "--minutes": {
            "nargs": "+",
            "type": float,
            "choices": BUDGETS,
            "default": BUDGETS,
            "help": "CPU times of the evaluations, min",
        },
        "--anew": {"action": "store_true", "help": "ignore the stored rows; those in the run folders remain"},
        "--kept": {"type": folder, "default": "runs/algorithms", "help": "folder of the training runs"},
    },
    parallel=True,
    comment=lambda _: computer_text(("stable-baselines3", "sb3-contrib", "torch")),
)
