"""Real-time loops, their faults and a round trip; as root, for real-time priority."""

from argparse import Namespace
from collections.abc import Iterator
from typing import Any

from studies.drive.measure import (
    FAULT_LOOPS,
    LOOPS,
    UNDISTURBED,
    FaultRow,
    LoopRow,
    RoundTripRow,
    UndisturbedRow,
    conditions,
    measure_faults,
    measure_loop,
    measure_round_trip,
    measure_undisturbed,
)
from studies.drive.page import page
from studies.study import Study, Table


def measure(options: Namespace) -> tuple[Iterator[Any], ...]:
    """Return the rows of loops, faults, undisturbed runs and fits."""
    given = conditions(options.episodes)
    return (
        (measure_loop(agent, name, each) for agent in LOOPS for name, each in given.items()),
        (row for agent in FAULT_LOOPS for row in measure_faults(agent)),
        (measure_undisturbed(agent, options.runs) for agent in UNDISTURBED),
        (measure_round_trip(joint, factor) for joint in range(3) for factor in (0.8, 1.2)),
    )


RUNNER = Study(
    tables=(Table("drive", LoopRow, 4), Table("drive_faults", FaultRow, 4),
            Table("drive_undisturbed", UndisturbedRow, 4), Table("drive_fits", RoundTripRow, 4)),
    measure=measure,
    pages={"drive.md": page},
    options={
        "--episodes": {"type": int, "default": 5, "help": "episodes with priority (default: %(default)s)"},
        "--runs": {"type": int, "default": 100, "help": "undisturbed runs (default: %(default)s)"},
    },
)  # fmt: skip
