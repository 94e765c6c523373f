"""Precision, conclusions: tables about a study of work and precision, each with a text that introduces it."""

import math
from collections.abc import Sequence

from flexman_gym.simulation.amplification import largest_growth
from flexman_gym.simulation.methods import METHODS
from flexman_gym.verification.markdown import introduced_table
from studies.methods import extrapolations_of, methods_of
from studies.precision.measure import Floor, Row, cheapest, setbacks

ERRORS = (1e-2, 1e-3, 1e-4, 1e-5)  # m
COMPARED = 1e-4  # m, the time error at which extrapolations are compared with ros2
COUNTS = (4, 7, 9)  # of modes a link, whose smallest total errors are named

WINNERS = "The cheapest method within each time error, and its CPU ms per simulated second:"
WINNER = "{method}: {cost:.3g}"
RATIOS = (
    "The cost of `ros2` over that of each extrapolation within a time error of {error:.0e} m. "
    "There is no ratio where one of the two has no run within that error."
)
INSTABILITY = (
    "An extrapolation amplifies an undamped vibration in a band of omega h, its angular frequency times the step. "
    "At long steps only slow modes are in that band, and steps are few. At short steps stiff modes are in it. "
    "So a finer step can do harm on an arm without damping: {count} combinations of scene, model and method show it. "
    "The table has an example for each method, beside the largest growth factor of one step."
)
INSTABILITY_HEADS = ("method", "largest factor", "at omega h", "scene", "model", "time error", "with a finer step")
SETBACK = "{error} at {setting}"
MODES = (
    "A model keeps the modes of lowest frequency of each link, found at zero joint angles. There link 3 does not load "
    "the torsion of link 2, which it continues. So the mode of this torsion comes late. Smallest total errors, mm:"
)


def conclusions(rows: Sequence[Row], floors: Sequence[Floor]) -> list[str]:
    """Lines with numbers from the rows."""
    pairs = [(floor.scene, floor.model) for floor in floors if floor.model]
    return [*_winners(rows, pairs), *_ratios(rows, pairs), *_instability(rows), *_modes(rows)]


def _winners(rows: Sequence[Row], pairs: Sequence[tuple[str, str]]) -> list[str]:
    """Who is cheapest at each error."""
    cells = []
    for scene, model in pairs:
        mine = [row for row in rows if row.scene == scene]
        cells.append([scene, model, *(_winner(mine, model, error) for error in ERRORS)])
    return introduced_table(WINNERS, ("scene", "model", *(f"{error:.0e} m" for error in ERRORS)), cells)


def _winner(rows: Sequence[Row], model: str, error: float) -> str:
    every = [cheapest(rows, model, method, error) for method in methods_of(rows)]
    best = min((row for row in every if row is not None), key=lambda row: row.cpu, default=None)
    return "none" if best is None else WINNER.format(method=best.method, cost=1e3 * best.cpu)


def _ratios(rows: Sequence[Row], pairs: Sequence[tuple[str, str]]) -> list[str]:
    """How many times cheaper than ros2 each extrapolation is."""
    names, cells = extrapolations_of(rows), []
    for scene, model in pairs:
        mine = [row for row in rows if row.scene == scene]
        cells.append([scene, model, *(_ratio(mine, model, name) for name in names)])
    return introduced_table(RATIOS.format(error=COMPARED), ("scene", "model", *names), cells)


def _ratio(rows: Sequence[Row], model: str, method: str) -> str:
    ours, other = (cheapest(rows, model, name, COMPARED) for name in ("ros2", method))
    return "-" if ours is None or other is None else f"{ours.cpu / other.cpu:.2g}"


def _instability(rows: Sequence[Row]) -> list[str]:
    """That finer steps can do harm, where they do, and why."""
    names = extrapolations_of(rows)
    pairs = [pair for pair in setbacks(rows) if pair[1].method in names]
    if not pairs:
        return []
    pairs.sort(key=lambda pair: math.isfinite(pair[1].time_error or 0.0))  # the last of a method is shown
    examples = {fine.method: (coarse, fine) for coarse, fine in pairs}
    cells = [_setback(*examples[name]) for name in names if name in examples]
    return introduced_table(INSTABILITY.format(count=len(pairs)), INSTABILITY_HEADS, cells)


def _setback(coarse: Row, fine: Row) -> list[str]:
    factor, angle = largest_growth(METHODS[fine.method])
    errors = [SETBACK.format(error=_metres(row), setting=row.setting) for row in (coarse, fine)]
    return [fine.method, f"{factor:.4f}", f"{angle:.2g}", fine.scene, fine.model, *errors]


def _modes(rows: Sequence[Row]) -> list[str]:
    """That the lowest modes can miss one that counts."""
    cells = []
    for scene in dict.fromkeys(row.scene for row in rows):
        least = [_least(rows, scene, f"{count} modes a link") for count in COUNTS]
        if all(map(math.isfinite, least)):
            cells.append([scene, *(f"{1e3 * error:.3g}" for error in least)])
    heads = ("scene", *(f"{count} modes a link" for count in COUNTS))
    return introduced_table(MODES, heads, cells) if cells else []


def _least(rows: Sequence[Row], scene: str, model: str) -> float:
    """The smallest total error of a model in a scene, m; infinite without one."""
    errors = [row.total_error for row in rows if (row.scene, row.model) == (scene, model)]
    return min((error for error in errors if error is not None), default=math.inf)


def _metres(row: Row) -> str:
    return f"{row.time_error:.1e} m" if row.time_error is not None and math.isfinite(row.time_error) else row.status
