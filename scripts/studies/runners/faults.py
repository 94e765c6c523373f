"""Fault tolerance of training runs: kills, interrupts, a full disk, and two runs in one folder."""

from argparse import Namespace
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from flexman_gym.common.computer import computer_text
from studies.faults import Fault, disk_full, faults, page, small_disk
from studies.study import Study, Table


def measure(options: Namespace) -> Iterator[Fault]:
    """Yield the results of all faults."""
    with TemporaryDirectory() as place, small_disk(Path(place) / "small") as small:
        yield from faults(Path(place), tuple(options.kills))
        yield disk_full(Path(place), small)


def report(rows: Sequence[Fault]) -> int:
    """Return 1 if a run lost its results."""
    return int(any(fault.survived < fault.tried for fault in rows))


RUNNER = Study(
    tables=(Table("faults", Fault),),
    measure=lambda options: [measure(options)],
    pages={"faults.md": page},
    report=report,
    options={
        "--kills": {"type": int, "nargs": 2, "default": (20, 10), "help": "kills per algorithm: saving, any time"},
    },
    comment=lambda _: computer_text(("torch",)),
)
