"""Policy for all arms, on arms that its training has not drawn."""

from argparse import Namespace
from collections.abc import Iterator

from flexman_gym.common.parallel import Workers, parallel_map
from flexman_gym.envs.vector_env import compile_kernels
from studies.generalist.measure import AGENTS, ARMS, GeneralistRow, rows_of
from studies.generalist.page import page
from studies.study import KEPT, Study, Table


def measure(options: Namespace) -> Iterator[GeneralistRow]:
    """Yield the rows of all arms and agents."""
    cells = [(arm, agent) for arm in ARMS for agent in AGENTS]
    for rows in parallel_map(rows_of, cells, Workers.of(options), options.kept, compile_kernels):
        yield from (GeneralistRow(**row) for row in rows)


RUNNER = Study(
    tables=[Table("generalist", GeneralistRow)],
    measure=lambda options: [measure(options)],
    pages={"generalist.md": page},
    options=KEPT,
    parallel=True,
)
