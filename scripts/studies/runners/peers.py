"""Error against computing time of our methods and of other simulators, in four scenes."""

from argparse import Namespace
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import flexman_gym as fm
from flexman_gym.common.computer import computer_text
from flexman_gym.toolbox.precision.runs import PrecisionRow
from studies.evidence import ROOT
from studies.markdown import replaced_part
from studies.peers.measure import PEERS, Decay, batch_rows, decays, measured, of_peers, scenes, study
from studies.peers.page import chosen_lines, draw, page, run_lines
from studies.precision.measure import Floor
from studies.study import Study, Table
from studies.verification.motions import REFERENCE

PAGE = ROOT / "docs" / "accuracy_and_speed.md"  # has a table of the rows


def measure(options: Namespace) -> Iterator[Iterable[Any]]:
    """Yield the rows of all simulators, the errors of the references, and the numerical damping of the simulators."""
    results = [(case, study(case, REFERENCE)) for case in scenes(REFERENCE)]
    done = [measured(*each) for each in results]
    paper = done[0][0]
    yield [row for rows, _ in done for row in rows] + batch_rows(results[0][1], paper)
    yield [floor for _, floor in done]
    yield decays(fm.catalog.paper_rrr(), of_peers(paper))


def tables(rows: Sequence[PrecisionRow], floors: Sequence[Floor], _: Sequence[Decay], files: Mapping[str, str]) -> str:
    """Return the page of speed and accuracy with its tables of runs and of chosen models."""
    text = replaced_part(PAGE.read_text(encoding="utf-8"), "runs", run_lines(rows, floors))
    return replaced_part(text, "chosen", chosen_lines(rows, floors, files))


RUNNER = Study(
    tables=(Table("peers", PrecisionRow), Table("peers_truths", Floor), Table("peers_damping", Decay)),
    measure=measure,
    pages={
        "peers.md": page,
        str(PAGE): tables,
    },
    charts=lambda folder, rows, floors, _: draw(rows, floors, folder),
    comment=lambda _: computer_text(PEERS.values()),
)
