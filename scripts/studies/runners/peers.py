"""Simulations of the paper's arm, compared with other codes."""

from argparse import Namespace
from collections.abc import Iterable, Iterator
from typing import Any

import flexman_gym as fm
from flexman_gym.common.computer import computer_text
from flexman_gym.toolbox.precision.runs import PrecisionRow
from studies.peers.measure import (
    PEERS,
    Decay,
    batch_rows,
    decays,
    in_turns,
    large_rotation_solution,
    of_peers,
    ours,
    study,
    theirs,
)
from studies.peers.page import draw, page
from studies.study import Study, Table
from studies.verification.motions import REFERENCE


def measure(options: Namespace) -> Iterator[Iterable[Any]]:
    """Yield the rows of all simulators, in interleaved rounds, and of their numerical damping."""
    result = study(large_rotation_solution(REFERENCE))
    alone = in_turns(ours(result) + theirs(result))
    yield alone + batch_rows(result, alone)
    yield decays(fm.catalog.paper_rrr(), of_peers(alone))


RUNNER = Study(
    tables=(Table("peers", PrecisionRow), Table("peers_damping", Decay)),
    measure=measure,
    pages={"peers.md": page},
    charts=lambda folder, rows, _: draw(rows, large_rotation_solution(REFERENCE).floor, folder),
    comment=lambda _: computer_text(PEERS.values()),
)
