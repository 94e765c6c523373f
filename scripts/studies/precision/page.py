"""Precision, page: the tables of a study of work and precision below its conclusion."""

import math
from collections.abc import Sequence

from flexman_gym.verification.machine import machine_text
from flexman_gym.verification.markdown import introduced_table
from studies.methods import methods_of
from studies.precision.conclusions import ERRORS, conclusions
from studies.precision.measure import Floor, Row, cheapest, pareto_front

SAYS = (
    "Error against computing time, for every method and model on four scenes. No method is the cheapest "
    "everywhere: where accuracy counts it is mostly one of Gauss's or an extrapolation. A model with a few of the "
    "lowest modes stays inaccurate however short its steps are. Extrapolations make undamped vibrations grow, so "
    "a shorter step can do harm. Choose by a scene that is like yours."
)
HEAD = (
    "Every row of `work_precision.csv` is one run. `python scripts/work_precision.py --folder docs` writes all of this "
    "anew."
)
MACHINE = "Computed with {machine}, one core."
EXPLANATION = (
    "The error of a run is the largest distance of its tip from a reference. For the *time error* the reference is the "
    "converged solution of the same model, so the method alone causes it. For the *total error* the reference is the "
    "truth of the scene, so model and method cause it together. The cost is CPU time per simulated second: the best of "
    "a few repeats, without compilation. In a chart a broad pale line is the Pareto front: no other run is both "
    "cheaper and more accurate. A dashed line is the error of the reference itself, its floor."
)
FLOORS = "The references and their floors:"
FLOOR_HEADS = ("error", "reference", "floor, m")
TIMED = "time error, {model}"
COSTS = "CPU ms per simulated second of the cheapest run within each time error, and its setting, for {model}:"
COST = "{cost:.3g} ({setting})"
FRONT = "The Pareto front of the total error:"
FRONT_HEADS = ("CPU ms per simulated second", "total error, mm", "model", "method", "setting")


def page(rows: Sequence[Row], floors: Sequence[Floor]) -> str:
    """A page in Markdown: the conclusion, then pictures and tables of each scene."""
    lines = ["# Speed against accuracy", "", SAYS, "", HEAD, "", MACHINE.format(machine=machine_text()), ""]
    lines += [EXPLANATION, "", "## Conclusion", "", *conclusions(rows, floors)]
    for name in dict.fromkeys(floor.scene for floor in floors):
        mine = [row for row in rows if row.scene == name]
        lines += _scene(mine, [floor for floor in floors if floor.scene == name])
    return "\n".join(lines).rstrip() + "\n"


def pictures(scene: str) -> tuple[str, str]:
    """Names of the files with the time error and with the total error."""
    name = scene.replace(", ", "_").replace(" ", "").replace(".", "")
    return f"work_precision_{name}_time.png", f"work_precision_{name}_total.png"


def _scene(rows: Sequence[Row], floors: Sequence[Floor]) -> list[str]:
    """The section of a scene, whose own floor comes first."""
    total, *timed = floors
    lines = [f"## {total.scene}: {total.title}", ""]
    lines += [line for file in pictures(total.scene) for line in (f"![{total.title}]({file})", "")]
    judged = [TIMED.format(model=floor.model) if floor.model else "total error" for floor in floors]
    cells = [(name, floor.source, f"{floor.floor:.1e}") for name, floor in zip(judged, floors, strict=True)]
    lines += introduced_table(FLOORS, FLOOR_HEADS, cells)
    for floor in timed:
        lines += cost_table(rows, floor.model)
    return [*lines, *front_table(rows, total.floor)]


def cost_table(rows: Sequence[Row], model: str) -> list[str]:
    """The cheapest run of each method that reaches each error, in CPU ms per simulated second."""
    heads = ["method", *(f"{error:.0e} m" for error in ERRORS)]
    cells = [
        [method, *(_cost(cheapest(rows, model, method, error)) for error in ERRORS)] for method in methods_of(rows)
    ]
    return introduced_table(COSTS.format(model=model), heads, cells)


def front_table(rows: Sequence[Row], floor: float) -> list[str]:
    """The runs on the Pareto front of the total error; errors below the floor (m) are all the same."""
    points = [(row.cpu, math.inf if row.total_error is None else max(floor, row.total_error)) for row in rows]
    cells = [
        (f"{1e3 * row.cpu:.3g}", f"{1e3 * (row.total_error or 0.0):.3g}", row.model, row.method, row.setting)
        for row in (rows[i] for i in pareto_front(points))
    ]
    return introduced_table(FRONT, FRONT_HEADS, cells)


def _cost(row: Row | None) -> str:
    return "-" if row is None else COST.format(cost=1e3 * row.cpu, setting=row.setting)
