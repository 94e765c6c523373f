"""Errors of integration methods on released vibrations."""

from argparse import Namespace
from collections.abc import Iterator

from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from studies.ringdown.measure import RingDownRow, rows
from studies.ringdown.page import TITLES, draw, page
from studies.study import QUICK, Study, Table

ARMS, FEW, THEIRS = 128, 12, 6  # arms per case: batched methods, other methods, MuJoCo


def measure(options: Namespace) -> Iterator[RingDownRow]:
    """Yield the rows of all kinds of motion, and those of MuJoCo if it is installed."""
    arms, few = (2, 1) if options.quick else (ARMS, FEW)
    for kind in TITLES:
        yield from rows(kind, arms, few)
    try:
        from studies.ringdown import mujoco
    except ModuleNotFoundError:
        print("MuJoCo is missing, so it is left out: pip install 'flexman_gym[peers]'")
        return
    yield from () if options.quick else mujoco.rows(THEIRS)


def default() -> tuple[str, float]:
    """Return method and step (s) of an environment by default."""
    chosen = resolve_fidelity(Configuration())
    return str(chosen.method), chosen.step


RUNNER = Study(
    tables=(Table("ring_down", RingDownRow),),
    measure=lambda options: [measure(options)],
    pages={"ring_down.md": lambda rows, files: page(rows, default(), files)},
    charts=lambda folder, rows: draw(rows, folder, default()),
    options=QUICK,
)
