"""Table: all planted errors, room by room, and the rows that became of them."""

from collections.abc import Iterable, Iterator
from pathlib import Path

from flexman_gym.scene import file
from studies.planted.change import Change
from studies.planted.planting import Planted
from studies.table import read_rows

ERRORS = Path(__file__).parent / "errors"  # a file for each room
NAMES = (
    "kernels", "model", "simulation", "environment", "tasks", "sensors", "laboratory", "control", "metrics", "agents",
    "draw", "fidelity", "command",
)  # fmt: skip


def changes(room: str) -> Iterator[Change]:
    """Gives the changes of a room, from its file."""
    for group in file.read(ERRORS / f"{room}.yaml", list):
        tests = tuple(f"tests/{test}" for test in group["tests"])
        for entry in group["errors"]:
            yield Change(room=room, file=group["file"], tests=tests, **entry)


ROOMS: dict[str, list[Change]] = {name: list(changes(name)) for name in NAMES}


def kept(path: Path) -> dict[tuple[str, str], Planted]:
    """Gives the rows of a file by room and error, none where there is no file."""
    rows = read_rows(path, Planted) if path.is_file() else []
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
