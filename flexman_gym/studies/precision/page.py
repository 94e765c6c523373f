"""Precision, page: the tables and the conclusion of a study of work and precision, with numbers from its rows."""

import math
from collections.abc import Sequence

from flexman_gym.simulation.amplification import largest_growth
from flexman_gym.simulation.methods import METHODS
from flexman_gym.studies.machine import machine_text
from flexman_gym.studies.markdown import markdown_table
from flexman_gym.studies.precision.charts import METHOD_STYLES
from flexman_gym.studies.precision.measure import Floor, Row, cheapest, cost_at, pareto_front, setbacks, settled

ERRORS = (1e-2, 1e-3, 1e-4, 1e-5)  # m
GOAL = 3.0  # how many times cheaper than ros2 an extrapolation should be at 1e-4 m
GOAL_BESIDE_PIECES = 50.0  # how many times cheaper than MuJoCo's 8 pieces and Euler we should be at its error
NEAR = 5e-3  # m; the finest models agree to about 4 mm, so that this is hardly worse than MuJoCo with 8 pieces
WANTED = 3e-3  # m, a time error to name the cost of
GOAL_BESIDE_FRAMES = 150.0  # how many times cheaper than Exudyn's floating frame we should be at that time error


def page(rows: Sequence[Row], floors: Sequence[Floor]) -> str:
    """A page in Markdown: the conclusion, then pictures and tables of each scene."""
    lines = ["# Speed against accuracy", ""]
    lines += ["Every row of `work_precision.csv` is one run; `python scripts/work_precision.py --folder docs` writes "]
    lines[-1] += f"all of this anew. Computed with {machine_text()}, one core."
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
        lines += ["", *front_table(mine, known[0].floor)]
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
    cells = []
    for method in METHOD_STYLES:
        found = [cheapest(rows, model, method, error) for error in ERRORS]
        cells.append([method, *("-" if row is None else f"{1e3 * row.cpu:.3g} ({row.setting})" for row in found)])
    lines += markdown_table(["method", *errors], cells)
    ratios = {method: ratio(rows, model, method) for method in METHOD_STYLES if method.startswith("extrapolated")}
    texts = [f"{method} {_times(value)}" for method, value in ratios.items()]
    return [*lines, "", f"Cost of ros2 over that of an extrapolation at 1e-4 m: {', '.join(texts)}."]


def ratio(rows: Sequence[Row], model: str, method: str, error: float = 1e-4) -> float | None:
    """How many times cheaper than ros2 a method reaches a time error (m); None where one of them does not."""
    ours, other = cheapest(rows, model, "ros2", error), cheapest(rows, model, method, error)
    return None if ours is None or other is None else ours.cpu / other.cpu


def front_table(rows: Sequence[Row], floor: float) -> list[str]:
    """The runs on the Pareto front of the total error; errors below the floor (m) are all the same."""
    points = [(row.cpu, math.inf if row.total_error is None else max(floor, row.total_error)) for row in rows]
    heads = ["CPU ms per simulated second", "total error, mm", "model", "method", "setting"]
    cells = []
    for row in (rows[i] for i in pareto_front(points)):
        numbers = [f"{1e3 * row.cpu:.3g}", f"{1e3 * (row.total_error or 0.0):.3g}"]
        cells.append([*numbers, row.model, row.method, row.setting])
    return ["Pareto front of the total error:", "", *markdown_table(heads, cells)]


def conclusion(rows: Sequence[Row], floors: Sequence[Floor]) -> list[str]:
    """Sentences with numbers from the rows."""
    found: list[str] = []
    pairs = [(floor.scene, floor.model) for floor in floors if floor.model]
    for scene, model in pairs:
        mine = [row for row in rows if row.scene == scene]
        found.append(f"{scene}, {model}: {_winners(mine, model)}")
    found += _extrapolation(rows, pairs)
    return [*found, *_instability(rows), *_modes(rows), PRIOR]


PRIOR = (
    "W-methods of order 3 with a frozen Jacobian (ROS34PW2, ROS3w) were tried on this system before: their order falls "
    "to 2 and they lose stability, since the mass matrix changes within a step. What is offered instead extrapolates "
    "the linearly implicit Euler method, with a fresh mass matrix in every part of a step."
)


def _instability(rows: Sequence[Row]) -> list[str]:
    """That finer steps can do harm, where they do, and why."""
    pairs = [pair for pair in setbacks(rows) if pair[1].method.startswith("extrapolated")]
    if not pairs:
        return []
    known = {name: largest_growth(METHODS[name]) for name in sorted({fine.method for _, fine in pairs})}
    growth = [f"{factor:.4f} for {name} (at {y:.2g})" for name, (factor, y) in known.items()]
    worst = {fine.method: (coarse, fine) for coarse, fine in pairs if math.isfinite(fine.time_error or 0.0)}
    places = [
        f"{method} on {fine.scene}, {fine.model}: {_metres(coarse)} at {coarse.setting}, "
        f"{_metres(fine)} at {fine.setting}"
        for method, (coarse, fine) in sorted(worst.items())
    ]
    return [
        "Finer steps of an extrapolation can do harm on an arm without damping, since it amplifies an undamped "
        "oscillation whose angular frequency times the step is about 1. Its factor for one step is at worst "
        f"{'; '.join(growth)}. At long steps only slow modes are in that band, and steps are few; at short ones "
        f"stiff modes are. {len(pairs)} of the pairs of scene and model and method show it, as {'; '.join(places)}."
    ]


def _modes(rows: Sequence[Row]) -> list[str]:
    """That the lowest modes can miss one that counts."""
    texts = []
    for scene in dict.fromkeys(row.scene for row in rows):
        least = [_least(rows, scene, f"{count} modes a link") for count in (4, 7, 9)]
        if all(map(math.isfinite, least)):
            texts.append(f"{scene} {', '.join(f'{1e3 * error:.3g}' for error in least)} mm")
    if not texts:
        return []
    return [
        "Loaded modes are taken by frequency and found at zero angles, where link 3 continues link 2 and does not load "
        "its torsion, which therefore comes late. Smallest total errors with 4, 7 and 9 modes a link: "
        f"{'; '.join(texts)}."
    ]


def _least(rows: Sequence[Row], scene: str, model: str) -> float:
    """The smallest total error of a model in a scene, m; infinite without one."""
    errors = [row.total_error for row in rows if (row.scene, row.model) == (scene, model)]
    return min((error for error in errors if error is not None), default=math.inf)


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
    missing = 0
    for scene, model in pairs:
        mine = [row for row in rows if row.scene == scene]
        known = {method: ratio(mine, model, method) for method in METHOD_STYLES if method.startswith("extrapolated")}
        missing += sum(value is None for value in known.values())
        best += [(value, f"{method} on {scene}, {model}") for method, value in known.items() if value is not None]
    if not best:
        return []
    most, least = max(best), min(best)
    count = sum(value >= GOAL for value, _ in best)
    return [
        f"The goal of an extrapolation is to be {GOAL:g} times cheaper than ros2 at 1e-4 m. It is at best "
        f"{most[0]:.2g} times ({most[1]}), at worst {least[0]:.2g} times ({least[1]}); {count} of {len(best)} "
        f"reach it, and {missing} more have no run within 1e-4 m; the tables and charts below show why."
    ]


def _metres(row: Row) -> str:
    return f"{row.time_error:.1e} m" if row.time_error is not None and math.isfinite(row.time_error) else row.status


def _times(value: float | None) -> str:
    return "-" if value is None else f"{value:.2g} times"


def peers_conclusion(rows: Sequence[Row], peers: Sequence[Row], plain: str) -> list[str]:
    """What a comparison with other codes says; `plain` is the model whose time error counts."""
    return [*_pieces(rows, peers), *_alone(rows, peers), *_frames(rows, peers, plain), *_rigid(rows, peers)]


def _pieces(rows: Sequence[Row], peers: Sequence[Row]) -> list[str]:
    """How much cheaper we are than MuJoCo's rigid pieces at their total error."""
    found = []
    for pieces in (8, 4):
        known = [row for row in peers if (row.model, row.method) == (f"MuJoCo, {pieces} pieces", "Euler")]
        if not known:
            continue
        peer = min(known, key=lambda row: row.cpu)
        limit = peer.total_error or 0.0
        texts = [
            f"the cheapest no less accurate is {_cheapest_text(_within(rows, limit), peer)}",
            "the cheapest of which every finer step that was tried is so too is "
            f"{_cheapest_text(settled(rows, limit), peer)}",
        ]
        if pieces == 8:
            near = _cheapest_text(_within(rows, NEAR), peer)
            texts.append(f"within {1e3 * NEAR:g} mm it is {near}. The goal is {GOAL_BESIDE_PIECES:g} times")
        found.append(f"{_text(peer)}. Of ours, {'; '.join(texts)}.")
    return found


def _frames(rows: Sequence[Row], peers: Sequence[Row], plain: str) -> list[str]:
    """How much cheaper we are than Exudyn's floating frame of the same elements at a time error."""
    mine = [row for row in rows if row.model == plain and row.time_error is not None]
    within = [row for row in mine if (row.time_error or 0.0) <= WANTED]
    if not within:
        return []
    steady = settled(mine, WANTED, "time_error")
    best = [min(found, key=lambda row: row.cpu) for found in (within, steady) if found]
    costs = [f"{row.method}, {row.setting}, for {1e3 * row.cpu:.3g} ms of CPU a simulated second" for row in best]
    found = [f"{plain}, time error within {1e3 * WANTED:g} mm: {'; with every finer step so too: '.join(costs)}."]
    names = dict.fromkeys((row.model, row.method) for row in peers if row.model.startswith("Exudyn"))
    for name in names:
        theirs = cost_at([row for row in peers if (row.model, row.method) == name], WANTED)
        if theirs is not None:
            ratios = " and ".join(f"{theirs / row.cpu:.3g}" for row in best)
            text = f"{', '.join(name)}, between its steps at that time error: {1e3 * theirs:.3g} ms"
            found.append(f"{text}; ours is {ratios} times cheaper. The goal is {GOAL_BESIDE_FRAMES:g} times.")
    return found


def _rigid(rows: Sequence[Row], peers: Sequence[Row]) -> list[str]:
    """What a rigid arm costs, and how far from the truth it is."""
    known = [row for row in (*rows, *peers) if row.model.split(", ")[-1] == "rigid"]
    if not known:
        return []
    costs = [f"{row.model.removesuffix('rigid') or 'ours, '}{1e3 * row.cpu:.3g} ms" for row in known]
    far = max(row.total_error or 0.0 for row in known)
    return [f"A rigid arm, RK4 at {known[0].setting}: {'; '.join(costs)}; {far:.2g} m from the truth."]


def _alone(rows: Sequence[Row], peers: Sequence[Row]) -> list[str]:
    """The error of each model at its shortest step, so that nobody takes a lucky step for a good model."""
    known: dict[str, Row] = {}
    for row in sorted([*rows, *peers], key=lambda row: (row.model, -(row.step or math.inf))):
        if row.method in ("implicit_midpoint", "RK4") and "rigid" not in row.model:
            known[row.model] = row
    texts = [f"{row.model} {1e3 * (row.total_error or 0.0):.2g} mm ({row.setting})" for row in known.values()]
    return texts and [
        f"Errors of the models alone, at short steps of methods without numerical damping: {'; '.join(texts)}. Where a "
        "longer step is better than its model, errors of model and method cancel in part."
    ]


def _within(rows: Sequence[Row], error: float) -> list[Row]:
    return [row for row in rows if (row.total_error or 0.0) <= error]


def _cheapest_text(rows: Sequence[Row], peer: Row) -> str:
    best = min(rows, key=lambda row: row.cpu, default=None)
    return "none" if best is None else f"{_text(best)}, {peer.cpu / best.cpu:.3g} times cheaper"


def _text(row: Row) -> str:
    cost = f"{1e3 * row.cpu:.3g} ms of CPU a simulated second"
    return f"{row.model}, {row.method} at {row.setting}: {1e3 * (row.total_error or 0.0):.2g} mm for {cost}"
