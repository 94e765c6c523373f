"""Precision, page: the tables of a study of work and precision below its conclusion."""

import math
from collections.abc import Sequence

from flexman_gym.verification.machine import machine_text
from flexman_gym.verification.markdown import bullets, markdown_table
from studies.methods import extrapolations_of, methods_of
from studies.precision.conclusions import ERRORS, conclusions, ratio
from studies.precision.measure import Floor, Row, cheapest, pareto_front

HEAD = (
    "Every row of `work_precision.csv` is one run; `python scripts/work_precision.py --folder docs` writes all of this "
    "anew. Computed with {machine}, one core."
)
EXPLANATION = (
    "The error is the largest distance of the tip during the run. *Time error*: from the converged solution of the "
    "same model, so that of the method alone. *Total error*: from the truth of the scene, so that of model and "
    "method together. The cost is CPU time (the best of a few repeats, without compilation) per simulated second. "
    "A broad pale line marks the runs that no other run beats in both; a dashed line is the error of the truth."
)
FLOOR = "{judged}: {source}, floor {floor:.1e} m"
COSTS = "CPU ms per simulated second of the cheapest run within a time error, {model}:"
COST = "{cost:.3g} ({setting})"
GAINS = "Cost of ros2 over that of an extrapolation at 1e-4 m: {gains}."
GAIN = "{method} {times:.2g} times"
NO_GAIN = "{method} -"
FRONT = "Pareto front of the total error:"
FRONT_HEADS = ("CPU ms per simulated second", "total error, mm", "model", "method", "setting")


def page(rows: Sequence[Row], floors: Sequence[Floor]) -> str:
    """A page in Markdown: the conclusion, then pictures and tables of each scene."""
    lines = ["# Speed against accuracy", "", HEAD.format(machine=machine_text()), "", EXPLANATION, ""]
    lines += ["## Conclusion", "", *bullets(conclusions(rows, floors))]
    for name in dict.fromkeys(floor.scene for floor in floors):
        mine = [row for row in rows if row.scene == name]
        lines += _scene(mine, [floor for floor in floors if floor.scene == name])
    return "\n".join(lines) + "\n"


def pictures(scene: str) -> tuple[str, str]:
    """Names of the files with the time error and with the total error."""
    name = scene.replace(", ", "_").replace(" ", "").replace(".", "")
    return f"work_precision_{name}_time.png", f"work_precision_{name}_total.png"


def _scene(rows: Sequence[Row], floors: Sequence[Floor]) -> list[str]:
    """The section of a scene, whose own floor comes first."""
    total, *timed = floors
    lines = ["", f"## {total.scene}: {total.title}", ""]
    lines += [line for file in pictures(total.scene) for line in (f"![{total.title}]({file})", "")]
    lines += bullets(
        FLOOR.format(judged=floor.model or "total error", source=floor.source, floor=floor.floor) for floor in floors
    )
    for floor in timed:
        lines += ["", *cost_table(rows, floor.model)]
    return [*lines, "", *front_table(rows, total.floor)]


def cost_table(rows: Sequence[Row], model: str) -> list[str]:
    """The cheapest run of each method that reaches each error, in CPU ms per simulated second."""
    heads = ["method", *(f"{error:.0e} m" for error in ERRORS)]
    cells = [
        [method, *(_cost(cheapest(rows, model, method, error)) for error in ERRORS)] for method in methods_of(rows)
    ]
    ratios = {method: ratio(rows, model, method) for method in extrapolations_of(rows)}
    gains = [_gain(method, times) for method, times in ratios.items()]
    lines = [COSTS.format(model=model), "", *markdown_table(heads, cells)]
    return [*lines, "", GAINS.format(gains=", ".join(gains))]


def front_table(rows: Sequence[Row], floor: float) -> list[str]:
    """The runs on the Pareto front of the total error; errors below the floor (m) are all the same."""
    points = [(row.cpu, math.inf if row.total_error is None else max(floor, row.total_error)) for row in rows]
    cells = [
        (f"{1e3 * row.cpu:.3g}", f"{1e3 * (row.total_error or 0.0):.3g}", row.model, row.method, row.setting)
        for row in (rows[i] for i in pareto_front(points))
    ]
    return [FRONT, "", *markdown_table(FRONT_HEADS, cells)]


def _gain(method: str, times: float | None) -> str:
    return (NO_GAIN if times is None else GAIN).format(method=method, times=times)


def _cost(row: Row | None) -> str:
    return "-" if row is None else COST.format(cost=1e3 * row.cpu, setting=row.setting)
