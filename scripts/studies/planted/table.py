"""Table: all planted errors, room by room, and the rows that became of them."""

from collections.abc import Iterable
from pathlib import Path

from studies.planted import agents, kernels, laboratory, learning, models, showing, steps
from studies.planted.change import Change
from studies.planted.planting import Planted
from studies.table import read_rows

ROOMS: dict[str, list[Change]] = {
    "kernels": [*kernels.JOINTS_AND_FORCES, *kernels.MOTION, *steps.STEPS],
    "model": list(models.MODEL),
    "simulation": list(models.SIMULATION),
    "environment": list(learning.ENVIRONMENT),
    "tasks": list(learning.TASKS),
    "sensors": list(learning.SENSORS),
    "laboratory": list(laboratory.LABORATORY),
    "control": list(learning.CONTROL),
    "metrics": list(learning.METRICS),
    "agents": list(agents.AGENTS),
    "draw": list(showing.DRAW),
    "fidelity": list(showing.FIDELITY),
    "command": list(showing.COMMAND),
}


def kept(file: Path) -> dict[tuple[str, str], Planted]:
    """Gives the rows of a file by room and error, none where there is no file."""
    rows = read_rows(file, Planted) if file.is_file() else []
    return {(row.room, row.error): row for row in rows}


def misplaced(root: Path, chosen: Iterable[Change]) -> list[str]:
    """Gives a line for each change whose old text is not once in its file, or whose tests are not there."""
    result = []
    for change in chosen:
        try:
            change.applied(root)
        except ValueError as error:
            result.append(str(error))
        result += [f"{test} is no test" for test in change.tests if not (root / test.split("::")[0]).is_file()]
    return result
