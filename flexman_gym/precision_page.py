"""Precision, page: the tables and the conclusion of a study of work and precision, with numbers from its rows."""

import math
from collections.abc import Sequence
from typing import Any

from flexman_gym.charts import METHOD_STYLES
from flexman_gym.precision import Floor, Row, cheapest, pareto_front, setbacks
from flexman_gym.verification import machine

ERRORS = (1e-2, 1e-3, 1e-4, 1e-5)  # m
ASKED = 3.0  # how many times cheaper than ros2 an extrapolation should be at 1e-4 m


def page(rows: Sequence[Row], floors: Sequence[Floor]) -> str:
    """A page in Markdown: the conclusion, then pictures and tables of each scene."""
    lines = ["# Speed against accuracy", ""]
    lines += ["Every row of `work_precision.csv` is one run; `python scripts/work_precision.py --folder docs` writes "]
    lines[-1] += "all of this anew. Computed with "
    lines[-1] += ", ".join(f"{name} {value}" for name, value in machine().items()) + ", one core."
    lines += ["", *_explanation(), "", "## Conclusion", ""]
    lines += [f"- {sentence}" for sentence in conclusion(rows, floors)]
    for name in dict.fromkeys(floor.scene for floor in floors):
        mine = [row for row in rows if row.scene == name]
        known = [floor for floor in floors if floor.scene == name]
        lines += ["", f"## {name}: {known[0].title}", ""]
        lines += [line for file in pictures(name) for line in (f"![{known[0].title}]({file})", "")]
        lines += [f"- {floor.model or 'total error'}: {floor.source}, floor {floor.floor:.1e} m" for floor in known]
        for floor in known[1:]:
            lines += ["", *cost_table(mine, floor.model)]
        lines += ["", *front_table(mine)]
    return "\n".join(lines) + "\n"


def pictures(scene: str) -> tuple[str, str]:
    """Names of the files with the time error and with the total error."""
    name = scene.replace(", ", "_").replace(" ", "").replace(".", "")
    return f"work_precision_{name}_time.png", f"work_precision_{name}_total.png"


def _explanation() -> list[str]:
    return [
        "The error is the largest distance of the tip during the run. *Time error*: from the converged solution of the "
        "same model, so that of the method alone. *Total error*: from the truth of the scene, so that of model and "
        "method together. The cost is CPU time (the best of a few repeats, without compilation) per simulated second. "
        "A broad pale line marks the runs that no other run beats in both; a dashed line is the error of the truth.",
    ]


def cost_table(rows: Sequence[Row], model: str) -> list[str]:
    """The cheapest run of each method that reaches each error, in CPU ms per simulated second."""
    errors = [f"{error:.0e} m" for error in ERRORS]
    lines = [f"CPU ms per simulated second of the cheapest run within a time error, {model}:", ""]
    lines += [_line(["method", *errors]), _line(["---"] * (1 + len(errors)))]
    for method in METHOD_STYLES:
        found = [cheapest(rows, model, method, error) for error in ERRORS]
        lines.append(
            _line([method, *("-" if row is None else f"{1e3 * row.cpu:.3g} ({row.setting})" for row in found)])
        )
    ratios = {method: ratio(rows, model, method) for method in METHOD_STYLES if method.startswith("extrapolated")}
    texts = [f"{method} {_times(value)}" for method, value in ratios.items()]
    return [*lines, "", f"Cost of ros2 over that of an extrapolation at 1e-4 m: {', '.join(texts)}."]


def ratio(rows: Sequence[Row], model: str, method: str, error: float = 1e-4) -> float | None:
    """How many times cheaper than ros2 a method reaches a time error (m); None where one of them does not."""
    ours, other = cheapest(rows, model, "ros2", error), cheapest(rows, model, method, error)
    return None if ours is None or other is None else ours.cpu / other.cpu


def front_table(rows: Sequence[Row]) -> list[str]:
    """The runs on the Pareto front of the total error."""
    points = [(row.cpu, math.inf if row.total_error is None else row.total_error) for row in rows]
    lines = ["Pareto front of the total error:", ""]
    lines += [_line(["CPU ms per simulated second", "total error, mm", "model", "method", "setting"])]
    lines += [_line(["---"] * 5)]
    for row in (rows[i] for i in pareto_front(points)):
        numbers = [f"{1e3 * row.cpu:.3g}", f"{1e3 * (row.total_error or 0.0):.3g}"]
        lines.append(_line([*numbers, row.model, row.method, row.setting]))
    return lines


def conclusion(rows: Sequence[Row], floors: Sequence[Floor]) -> list[str]:
    """Sentences with numbers from the rows."""
    found: list[str] = []
    pairs = [(floor.scene, floor.model) for floor in floors if floor.model]
    for scene, model in pairs:
        mine = [row for row in rows if row.scene == scene]
        found.append(f"{scene}, {model}: {_winners(mine, model)}")
    found += _extrapolation(rows, pairs)
    for coarse, fine in setbacks(rows):
        found.append(
            f"A finer step does harm, which means that the method is unstable there: {fine.method} on {fine.scene}, "
            f"{fine.model}, is off by {_metres(coarse)} at {coarse.setting} and by {_metres(fine)} at {fine.setting}."
        )
    return [*found, PRIOR]


PRIOR = (
    "W-methods of order 3 with a frozen Jacobian (ROS34PW2, ROS3w) were tried on this system before: their order falls "
    "to 2 and they lose stability, since the mass matrix changes within a step. What is offered instead extrapolates "
    "the linearly implicit Euler method, with a fresh mass matrix in every part of a step."
)


def _winners(rows: Sequence[Row], model: str) -> str:
    """Who is cheapest at each error."""
    texts = []
    for error in ERRORS:
        every = [cheapest(rows, model, method, error) for method in METHOD_STYLES]
        best = min((row for row in every if row is not None), key=lambda row: row.cpu, default=None)
        if best is None:
            texts.append(f"nothing reaches {error:.0e} m")
        else:
            texts.append(f"{error:.0e} m is cheapest with {best.method}, {best.setting} ({1e3 * best.cpu:.3g} ms)")
    return "; ".join(texts) + "."


def _extrapolation(rows: Sequence[Row], pairs: Sequence[tuple[str, str]]) -> list[str]:
    """Whether an extrapolation is as many times cheaper than ros2 as asked."""
    best: list[tuple[float, str]] = []
    for scene, model in pairs:
        mine = [row for row in rows if row.scene == scene]
        known = {method: ratio(mine, model, method) for method in METHOD_STYLES if method.startswith("extrapolated")}
        best += [(value, f"{method} on {scene}, {model}") for method, value in known.items() if value is not None]
    if not best:
        return []
    most, least = max(best), min(best)
    verdict = "reaches" if most[0] >= ASKED else "does not reach"
    count = sum(value >= ASKED for value, _ in best)
    return [
        f"An extrapolation asked to be {ASKED:g} times cheaper than ros2 at 1e-4 m {verdict} that: at best "
        f"{most[0]:.2g} times ({most[1]}), at worst {least[0]:.2g} times ({least[1]}); {count} of {len(best)} pairs "
        "reach it."
    ]


def _metres(row: Row) -> str:
    return f"{row.time_error:.1e} m" if row.time_error is not None and math.isfinite(row.time_error) else row.status


def _times(value: float | None) -> str:
    return "-" if value is None else f"{value:.2g} times"


def _line(cells: Sequence[Any]) -> str:
    return "| " + " | ".join(map(str, cells)) + " |"
