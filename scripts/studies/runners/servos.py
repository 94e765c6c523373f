"""Gain limits of joint servos."""

import warnings
from argparse import Namespace
from collections.abc import Iterator
from typing import Any

from studies.servos.measure import FrictionRow, ServoRow, friction_rows, rows
from studies.servos.page import page
from studies.study import Study, Table


def measure(options: Namespace) -> tuple[Iterator[Any], ...]:
    """Return the rows of the limits without and with friction."""
    warnings.filterwarnings("ignore", "actions: a servo", UserWarning)  # unstable servos are intended here
    return rows(), friction_rows()


RUNNER = Study(
    tables=(Table("servos", ServoRow), Table("servos_friction", FrictionRow, 12)),
    measure=measure,
    pages={"servos.md": page},
)
