"""Safety filter: agents, conditions and limits, trainings, and a search of the worst case."""

from argparse import Namespace
from collections.abc import Iterator
from typing import Any

from studies.evidence import ROOT
from studies.markdown import replaced_part
from studies.safety.learning import LearningRow, learning_rows
from studies.safety.measure import CELLS, SafetyRow, row
from studies.safety.page import cells, page
from studies.safety.worst_case import WorstRow, worst_rows
from studies.study import KEPT, Study, Table

PAGE = ROOT / "docs" / "safety.md"  # has a table of the rows


def measure(options: Namespace) -> tuple[Iterator[Any], ...]:
    """Return the rows of the cells, of the trainings and of the worst cases."""
    return (row(cell, options.kept) for cell in CELLS), learning_rows(options.kept), worst_rows()


RUNNER = Study(
    tables=(
        Table("safety", SafetyRow, 4),
        Table("safety_learning", LearningRow, 4),
        Table("safety_worst", WorstRow, 4),
    ),
    measure=measure,
    pages={
        "safety.md": lambda rows, learned, _, files: page(rows, learned, files),
        str(PAGE): lambda rows, *_: replaced_part(PAGE.read_text(encoding="utf-8"), "cells", cells(rows)),
    },
    options={"--kept": KEPT["--kept"] | {"default": "out/safety"}},
)
