"""Shaped motions of simulated arms under servos."""

from collections.abc import Sequence

from studies.machine.measure import DATA
from studies.shaping.measure import ShapingRow, real_frequencies, simulate
from studies.study import Study, Table


def report(rows: Sequence[ShapingRow]) -> None:
    """Print the shares of arms, and the frequencies of the real arm."""
    print(
        f"{sum(row.left <= 0.05 for row in rows)} of {len(rows)} arms keep at most 5 % of the vibration; the interval "
        f"contains the residual of {sum(row.low <= row.residual <= row.high for row in rows)}; in "
        f"{sum(row.found < row.modes for row in rows)} records a second mode is below the noise"
    )
    for name, frequency in real_frequencies(DATA).items():
        print(f"real arm, {name}: {frequency:.4g} Hz")


RUNNER = Study(
    tables=(Table("shaping", ShapingRow),),
    measure=lambda options: [map(simulate, range(options.arms))],
    report=report,
    options={"--arms": {"type": int, "default": 30, "help": "number of random arms (default: %(default)s)"}},
)
