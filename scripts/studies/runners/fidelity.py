"""Accuracy, error estimates and cost of the models chosen by `choose_model`."""

from argparse import Namespace
from collections.abc import Iterator

from flexman_gym.common.parallel import Workers, parallel_map
from flexman_gym.envs.vector_env import compile_kernels
from studies.fidelity.measure import SCENES, FidelityRow, rows_of
from studies.fidelity.page import page
from studies.study import KEPT, Study, Table


def measure(file: str, options: Namespace) -> Iterator[FidelityRow]:
    """Yield the rows of a file of scenes."""
    cells = [(file, name) for name in SCENES[file]()]
    for rows in parallel_map(rows_of, cells, Workers.of(options), options.kept, compile_kernels):
        yield from (FidelityRow(**row) for row in rows)


RUNNER = Study(
    tables=[Table(file.removesuffix(".csv"), FidelityRow, 9) for file in SCENES],
    measure=lambda options: [measure(file, options) for file in SCENES],
    pages={"fidelity.md": page},
    options=KEPT,
    parallel=True,
)
