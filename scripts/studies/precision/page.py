"""Page of the work-precision study: tables, conclusions, and the files of the study."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

from flexman_gym.common.computer import computer_text
from flexman_gym.common.parallel import Workers, parallel_map
from flexman_gym.envs.vector_env import compile_kernels
from flexman_gym.simulation.methods import METHODS
from studies.files import read_rows, write_rows
from studies.markdown import introduced_table
from studies.methods import extrapolations_of, largest_growth, methods_of
from studies.precision.charts import time_error_chart, total_error_chart
from studies.precision.measure import (
    Floor,
    PrecisionRow,
    Study,
    cases,
    cheapest,
    choices,
    grid,
    pareto_front,
    quick_grid,
    quick_study,
    setbacks,
    study,
)

ERRORS = (1e-2, 1e-3, 1e-4, 1e-5)  # m
COMPARED = 1e-4  # m; time error at which extrapolations are compared with ros2
COUNTS = (4, 7, 9)  # modes per link in the table of total errors

WINNERS = "The cheapest method within each time error, and its CPU ms per simulated second:"
WINNER = "{method}: {cost:.3g}"
RATIOS = (
    "The cost of `ros2` divided by that of each extrapolation at a time error of {error:.0e} m. "
    "There is no ratio if one of the two has no run within this error."
)
INSTABILITY = (
    "An extrapolation amplifies an undamped vibration in a band of omega h, its angular frequency times the step. "
    "At long steps this band contains only slow modes, and the number of steps is small. At short steps it contains "
    "stiff modes. Therefore a finer step can increase the error of an arm without damping, as in {count} combinations "
    "of scene, model and method. The table has an example of each method and the largest growth factor of one step."
)
INSTABILITY_HEADS = ("method", "largest factor", "at omega h", "scene", "model", "time error", "with a finer step")
SETBACK = "{error} at {setting}"
MODES = (
    "A model contains the modes of lowest frequency of each link, computed at zero joint angles. In this posture link "
    "3 is aligned with link 2 and does not load its torsion, so that the torsional mode has a high frequency and is "
    "omitted at first. Smallest total errors, mm:"
)


def conclusions(rows: Sequence[PrecisionRow], floors: Sequence[Floor]) -> list[str]:
    """Return the conclusions as Markdown lines."""
    pairs = [(floor.scene, floor.model) for floor in floors if floor.model]
    return [*_winners(rows, pairs), *_ratios(rows, pairs), *_instability(rows), *_modes(rows)]


def _winners(rows: Sequence[PrecisionRow], pairs: Sequence[tuple[str, str]]) -> list[str]:
    """Return the cheapest method at each error."""
    cells = []
    for scene, model in pairs:
        mine = [row for row in rows if row.scene == scene]
        cells.append([scene, model, *(_winner(mine, model, error) for error in ERRORS)])
    return introduced_table(WINNERS, ("scene", "model", *(f"{error:.0e} m" for error in ERRORS)), cells)


def _winner(rows: Sequence[PrecisionRow], model: str, error: float) -> str:
    every = [cheapest(rows, model, method, error) for method in methods_of(rows)]
    best = min((row for row in every if row is not None), key=lambda row: row.cpu, default=None)
    return "none" if best is None else WINNER.format(method=best.method, cost=1e3 * best.cpu)


def _ratios(rows: Sequence[PrecisionRow], pairs: Sequence[tuple[str, str]]) -> list[str]:
    """Return the cost of ros2 relative to each extrapolation."""
    names, cells = extrapolations_of(rows), []
    for scene, model in pairs:
        mine = [row for row in rows if row.scene == scene]
        cells.append([scene, model, *(_ratio(mine, model, name) for name in names)])
    return introduced_table(RATIOS.format(error=COMPARED), ("scene", "model", *names), cells)


def _ratio(rows: Sequence[PrecisionRow], model: str, method: str) -> str:
    ours, other = (cheapest(rows, model, name, COMPARED) for name in ("ros2", method))
    return "-" if ours is None or other is None else f"{ours.cpu / other.cpu:.2g}"


def _instability(rows: Sequence[PrecisionRow]) -> list[str]:
    """Return the table of cases in which a finer step increases the error."""
    names = extrapolations_of(rows)
    pairs = [pair for pair in setbacks(rows) if pair[1].method in names]
    if not pairs:
        return []
    pairs.sort(key=lambda pair: math.isfinite(pair[1].time_error or 0.0))  # the last pair of a method is shown
    examples = {fine.method: (coarse, fine) for coarse, fine in pairs}
    cells = [_setback(*examples[name]) for name in names if name in examples]
    return introduced_table(INSTABILITY.format(count=len(pairs)), INSTABILITY_HEADS, cells)


def _setback(coarse: PrecisionRow, fine: PrecisionRow) -> list[str]:
    factor, angle = largest_growth(METHODS[fine.method])
    errors = [SETBACK.format(error=_metres(row), setting=row.setting) for row in (coarse, fine)]
    return [fine.method, f"{factor:.4f}", f"{angle:.2g}", fine.scene, fine.model, *errors]


def _modes(rows: Sequence[PrecisionRow]) -> list[str]:
    """Return the table of total errors by number of modes, which shows that low modes can omit an important one."""
    cells = []
    for scene in dict.fromkeys(row.scene for row in rows):
        least = [_least(rows, scene, f"{count} modes a link") for count in COUNTS]
        if all(map(math.isfinite, least)):
            cells.append([scene, *(f"{1e3 * error:.3g}" for error in least)])
    heads = ("scene", *(f"{count} modes a link" for count in COUNTS))
    return introduced_table(MODES, heads, cells) if cells else []


def _least(rows: Sequence[PrecisionRow], scene: str, model: str) -> float:
    """Return the smallest total error of a model in a scene, m; infinite without a run."""
    errors = [row.total_error for row in rows if (row.scene, row.model) == (scene, model)]
    return min((error for error in errors if error is not None), default=math.inf)


def _metres(row: PrecisionRow) -> str:
    return f"{row.time_error:.1e} m" if row.time_error is not None and math.isfinite(row.time_error) else row.status


SAYS = (
    "This page compares error and computing time of every method and model on four scenes. No method is the cheapest "
    "in all cases; for high accuracy it is mostly a Gauss method or an extrapolation. A model with a few of the "
    "lowest modes stays inaccurate at any step. Extrapolations amplify undamped vibrations, so that a shorter step "
    "can increase the error. Choose by a scene that is similar to yours."
)
HEAD = (
    "Every row of `work_precision.csv` is one run. `python scripts/work_precision.py --folder docs/evidence` rewrites "
    "the rows, the charts and this page."
)
COMPUTER = "Computed with {computer}, one core."
EXPLANATION = (
    "The error of a run is the largest distance of its tip from a reference. The reference of the *time error* is the "
    "converged solution of the same model, so that only the method contributes. The reference of the *total error* is "
    "an independent or finest solution of the scene, so that model and method contribute. The cost is CPU time per "
    "simulated second: the best of a few repetitions, without compilation. The broad pale line in a chart is the "
    "Pareto front: no other run is both cheaper and more accurate. The dashed line is the error of the reference "
    "itself, its floor."
)
FLOORS = "The references and their floors:"
FLOOR_HEADS = ("error", "reference", "floor, m")
TIMED = "time error, {model}"
COSTS = "CPU ms per simulated second of the cheapest run within each time error, and its setting, for {model}:"
COST = "{cost:.3g} ({setting})"
FRONT = "The Pareto front of the total error:"
FRONT_HEADS = ("CPU ms per simulated second", "total error, mm", "model", "method", "setting")


def page(rows: Sequence[PrecisionRow], floors: Sequence[Floor]) -> str:
    """Return the page as Markdown: conclusions first, then charts and tables of each scene."""
    lines = ["# Speed against accuracy", "", SAYS, "", HEAD, "", COMPUTER.format(computer=computer_text()), ""]
    lines += [EXPLANATION, "", "## Conclusion", "", *conclusions(rows, floors)]
    for name in dict.fromkeys(floor.scene for floor in floors):
        mine = [row for row in rows if row.scene == name]
        lines += _scene(mine, [floor for floor in floors if floor.scene == name])
    return "\n".join(lines).rstrip() + "\n"


def pictures(scene: str) -> tuple[str, str]:
    """Return the file names of the charts of the time error and of the total error."""
    name = scene.replace(", ", "_").replace(" ", "").replace(".", "")
    return f"work_precision_{name}_time.png", f"work_precision_{name}_total.png"


def _scene(rows: Sequence[PrecisionRow], floors: Sequence[Floor]) -> list[str]:
    """Return the section of a scene; `floors` begins with the floor of its total error."""
    total, *timed = floors
    lines = [f"## {total.scene}: {total.title}", ""]
    lines += [line for file in pictures(total.scene) for line in (f"![{total.title}]({file})", "")]
    errors = [TIMED.format(model=floor.model) if floor.model else "total error" for floor in floors]
    cells = [(name, floor.source, f"{floor.floor:.1e}") for name, floor in zip(errors, floors, strict=True)]
    lines += introduced_table(FLOORS, FLOOR_HEADS, cells)
    for floor in timed:
        lines += cost_table(rows, floor.model)
    return [*lines, *_front_table(rows, total.floor)]


def cost_table(rows: Sequence[PrecisionRow], model: str) -> list[str]:
    """Return the table of the cheapest run of each method within each error, CPU ms per simulated second."""
    heads = ["method", *(f"{error:.0e} m" for error in ERRORS)]
    cells = [
        [method, *(_cost(cheapest(rows, model, method, error)) for error in ERRORS)] for method in methods_of(rows)
    ]
    return introduced_table(COSTS.format(model=model), heads, cells)


def _front_table(rows: Sequence[PrecisionRow], floor: float) -> list[str]:
    """Return the table of the Pareto front of the total error; errors below the floor (m) count as equal."""
    points = [(row.cpu, math.inf if row.total_error is None else max(floor, row.total_error)) for row in rows]
    cells = [
        (f"{1e3 * row.cpu:.3g}", f"{1e3 * (row.total_error or 0.0):.3g}", row.model, row.method, row.setting)
        for row in (rows[i] for i in pareto_front(points))
    ]
    return introduced_table(FRONT, FRONT_HEADS, cells)


def _cost(row: PrecisionRow | None) -> str:
    return "-" if row is None else COST.format(cost=1e3 * row.cpu, setting=row.setting)


ROWS_FILE, FLOORS_FILE, PAGE_FILE = "work_precision.csv", "work_precision_truths.csv", "work_precision.md"


def compute(
    reference: Path, folder: Path, quick: bool = False, workers: Workers | int = 1, kept: Path | None = None
) -> None:
    """Compute all rows, or a small grid of a short scene, and write the files of rows and floors.

    Args:
        reference: folder of the reference scenes and solutions.
        folder: output folder.
        quick: compute only the small grid.
        workers: see `common.parallel.parallel_map`.
        kept: folder of finished cells, see `common.parallel.parallel_map`.
    """
    cells = [("", "", "")] if quick else [(str(reference), case.name, model) for case in cases(reference)
                                          for model in choices(case.scene)]  # fmt: skip
    rows: list[PrecisionRow] = []
    floors: dict[tuple[str, str], Floor] = {}
    for done in parallel_map(_computed, cells, workers, kept, compile_kernels):
        rows += [PrecisionRow(**row) for row in done["rows"]]
        floors |= {(each["scene"], each["model"]): Floor(**each) for each in done["floors"]}
    write_rows(rows, folder / ROWS_FILE)
    write_rows(list(floors.values()), folder / FLOORS_FILE)


def _computed(cell: tuple[str, str, str]) -> dict[str, Any]:
    """Return rows and floors of a cell (reference folder, scene, model) as plain data; no scene: the quick study."""
    reference, scene, model = cell
    result, timed = _known_study(reference, scene)
    rows = grid(result, timed, [model]) if scene else quick_grid(result)
    return {"rows": [asdict(row) for row in rows], "floors": [asdict(floor) for floor in result.floors()]}


@cache
def _known_study(reference: str, scene: str) -> tuple[Study, tuple[str, ...]]:
    """Return a study and the models with studied time error, cached per process."""
    if not scene:
        return quick_study(), ()
    case = next(case for case in cases(Path(reference)) if case.name == scene)
    return study(case, Path(reference)), case.timed


def publish(folder: Path) -> None:
    """Draw the charts (with Matplotlib only) and write the page from the files of a folder."""
    rows, floors = read_rows(folder / ROWS_FILE, PrecisionRow), read_rows(folder / FLOORS_FILE, Floor)
    for scene in dict.fromkeys(row.scene for row in rows):
        mine = [row for row in rows if row.scene == scene]
        total, *timed = (floor for floor in floors if floor.scene == scene)
        files = [folder / name for name in pictures(scene)]
        try:
            time_error_chart(mine, {each.model: each.floor for each in timed}, f"Time error: {total.title}", files[0])
            total_error_chart(mine, total.floor, f"Total error: {total.title}", files[1])
        except ImportError as error:
            print(f"no pictures: {error}")
    (folder / PAGE_FILE).write_text(page(rows, floors), encoding="utf-8")
