"""Precision, conclusions: sentences about a study of work and precision, with numbers from its rows."""

import math
from collections.abc import Sequence

from flexman_gym.simulation.amplification import largest_growth
from flexman_gym.simulation.methods import METHODS
from studies.methods import extrapolations_of, methods_of
from studies.precision.measure import Floor, Row, cheapest, setbacks

ERRORS = (1e-2, 1e-3, 1e-4, 1e-5)  # m
GOAL = 3.0  # how many times cheaper than ros2 an extrapolation should be at 1e-4 m
COUNTS = (4, 7, 9)  # of modes a link, whose smallest total errors are named

WINNERS = "{scene}, {model}: {winners}."
CHEAPEST = "{error:.0e} m is cheapest with {method}, {setting} ({cost:.3g} ms)"
UNREACHED = "nothing reaches {error:.0e} m"
EXTRAPOLATION = (
    "The goal of an extrapolation is to be {goal:g} times cheaper than ros2 at 1e-4 m. "
    "At best it is {most:.2g} times cheaper ({best}), at worst {least:.2g} times ({worst}). "
    "{reached} of {count} reach the goal, and {missing} more have no run within 1e-4 m. "
    "The tables and charts below show why."
)
INSTABILITY = (
    "Finer steps of an extrapolation can do harm on an arm without damping. "
    "An extrapolation amplifies an undamped oscillation whose angular frequency times the step is about 1. "
    "Its factor for one step is at worst {growth}. "
    "At long steps only slow modes are in that band, and steps are few; at short ones stiff modes are. "
    "{count} combinations of scene, model and method show it, such as {places}."
)
GROWTH = "{factor:.4f} for {method} (at {angle:.2g})"
SETBACK = "{method} on {scene}, {model}: {coarse_error} at {coarse}, {fine_error} at {fine}"
MODES = (
    "Loaded modes are taken by frequency and found at zero angles, where link 3 continues link 2 and does not load its "
    "torsion. That mode therefore comes late. Smallest total errors with {counts} modes a link: {errors}."
)
PRIOR = (
    "W-methods of order 3 with a frozen Jacobian (ROS34PW2, ROS3w) were tried on this system before: their order falls "
    "to 2 and they lose stability, since the mass matrix changes within a step. What is offered instead extrapolates "
    "the linearly implicit Euler method, with a fresh mass matrix in every part of a step."
)


def conclusions(rows: Sequence[Row], floors: Sequence[Floor]) -> list[str]:
    """Sentences with numbers from the rows."""
    pairs = [(floor.scene, floor.model) for floor in floors if floor.model]
    result = [WINNERS.format(scene=scene, model=model, winners=_winners(rows, scene, model)) for scene, model in pairs]
    return [*result, *_extrapolation(rows, pairs), *_instability(rows), *_modes(rows), PRIOR]


def ratio(rows: Sequence[Row], model: str, method: str, error: float = 1e-4) -> float | None:
    """How many times cheaper than ros2 a method reaches a time error (m); None where one of them does not."""
    ours, other = cheapest(rows, model, "ros2", error), cheapest(rows, model, method, error)
    return None if ours is None or other is None else ours.cpu / other.cpu


def _winners(rows: Sequence[Row], scene: str, model: str) -> str:
    """Who is cheapest at each error."""
    mine = [row for row in rows if row.scene == scene]
    texts = []
    for error in ERRORS:
        every = [cheapest(mine, model, method, error) for method in methods_of(mine)]
        best = min((row for row in every if row is not None), key=lambda row: row.cpu, default=None)
        if best is None:
            texts.append(UNREACHED.format(error=error))
        else:
            texts.append(CHEAPEST.format(error=error, method=best.method, setting=best.setting, cost=1e3 * best.cpu))
    return "; ".join(texts)


def _extrapolation(rows: Sequence[Row], pairs: Sequence[tuple[str, str]]) -> list[str]:
    """Whether an extrapolation is as many times cheaper than ros2 as asked."""
    result = []
    for scene, model in pairs:
        mine = [row for row in rows if row.scene == scene]
        known = {method: ratio(mine, model, method) for method in extrapolations_of(mine)}
        result += [(times, f"{method} on {scene}, {model}") for method, times in known.items()]
    ratios = [(times, name) for times, name in result if times is not None]
    if not ratios:
        return []
    (most, best), (least, worst) = max(ratios), min(ratios)
    numbers = {"most": most, "best": best, "least": least, "worst": worst, "count": len(ratios)}
    numbers |= {"reached": sum(times >= GOAL for times, _ in ratios), "missing": len(result) - len(ratios)}
    return [EXTRAPOLATION.format(goal=GOAL, **numbers)]


def _instability(rows: Sequence[Row]) -> list[str]:
    """That finer steps can do harm, where they do, and why."""
    names = extrapolations_of(rows)
    pairs = [pair for pair in setbacks(rows) if pair[1].method in names]
    if not pairs:
        return []
    known = {name: largest_growth(METHODS[name]) for name in sorted({fine.method for _, fine in pairs})}
    growth = [GROWTH.format(factor=factor, method=name, angle=angle) for name, (factor, angle) in known.items()]
    worst = {fine.method: (coarse, fine) for coarse, fine in pairs if math.isfinite(fine.time_error or 0.0)}
    places = [_setback(*worst[method]) for method in sorted(worst)]
    return [INSTABILITY.format(growth="; ".join(growth), count=len(pairs), places="; ".join(places))]


def _setback(coarse: Row, fine: Row) -> str:
    names = {"method": fine.method, "scene": fine.scene, "model": fine.model}
    errors = {"coarse_error": _metres(coarse), "fine_error": _metres(fine)}
    return SETBACK.format(**names, **errors, coarse=coarse.setting, fine=fine.setting)


def _modes(rows: Sequence[Row]) -> list[str]:
    """That the lowest modes can miss one that counts."""
    texts = []
    for scene in dict.fromkeys(row.scene for row in rows):
        least = [_least(rows, scene, f"{count} modes a link") for count in COUNTS]
        if all(map(math.isfinite, least)):
            texts.append(f"{scene} {', '.join(f'{1e3 * error:.3g}' for error in least)} mm")
    *some, last = map(str, COUNTS)
    return texts and [MODES.format(counts=f"{', '.join(some)} and {last}", errors="; ".join(texts))]


def _least(rows: Sequence[Row], scene: str, model: str) -> float:
    """The smallest total error of a model in a scene, m; infinite without one."""
    errors = [row.total_error for row in rows if (row.scene, row.model) == (scene, model)]
    return min((error for error in errors if error is not None), default=math.inf)


def _metres(row: Row) -> str:
    return f"{row.time_error:.1e} m" if row.time_error is not None and math.isfinite(row.time_error) else row.status
