"""Peers, page: what a comparison with other codes says, with numbers from its rows."""

import math
from collections.abc import Sequence
from pathlib import Path

from flexman_gym.verification.machine import machine_text
from flexman_gym.verification.markdown import bullets
from studies.peers.charts import peers_chart
from studies.peers.compare import PEERS, ROUNDS, of_peers
from studies.precision.cases import PLAIN
from studies.precision.measure import Row, cost_at, settled

PICTURE, TITLE = "work_precision_peers.png", "The paper's arm, everything flexible"
GOAL_BESIDE_PIECES = 50.0  # how many times cheaper than MuJoCo's 8 pieces and Euler we should be at its error
NEAR = 5e-3  # m; the finest models agree to about 4 mm, so that this is hardly worse than MuJoCo with 8 pieces
WANTED = 3e-3  # m, a time error to name the cost of
GOAL_BESIDE_FRAMES = 150.0  # how many times cheaper than Exudyn's floating frame we should be at that time error

PAGE = """# Beside other codes

The rows are in `peers.csv`. Each run takes the paper's arm, everything flexible, through 2 s under 400 N m.
The error is the largest distance of the tip from an independent large-rotation code, the cost is CPU time on one core:
the best of {rounds} rounds in which all take turns.

- MuJoCo: every link 4 or 8 rigid pieces between springs, or one rigid link; compiled. Its `discrete` integrator eats
  the vibration.
- Exudyn: a floating frame of reference with 2 beam elements a link, the same mass points, shapes and stiffness as our
  model without foreshortening; generalised-alpha method; compiled, without range checks or user functions. Once with
  the settings that are quickest here, once with its default ones. Where links bend out of a plane it treats the
  rotation of their tips a little differently: its converged tip is within 5 mm of ours. Its time error is that from
  its own converged run.
- Pinocchio: rigid links and joints; its compiled `aba` called from a Runge-Kutta loop in Python.

The rigid arms show what flexibility costs, and what it costs to leave it out.

![error over cost]({picture})

Computed with {machine}, one core.

{conclusion}
"""

COST = "{cost:.3g} ms of CPU a simulated second"
RUN = "{model}, {method} at {setting}: {error:.2g} mm for " + COST
CHEAPER = "{run}, {times:.3g} times cheaper"
PIECES = (
    "{peer}. Of ours, the cheapest no less accurate is {cheapest}. "
    "The cheapest of which every finer step that was tried is so too is {settled}."
)
PIECES_NEAR = PIECES + " Within {near:g} mm it is {nearly}. The goal is {goal:g} times."
ALONE = (
    "Errors of the models alone, at short steps of methods without numerical damping: {errors}. "
    "Where a longer step is better than its model, errors of model and method cancel in part."
)
MODEL_ERROR = "{model} {error:.2g} mm ({setting})"
OURS = "{model}, time error within {limit:g} mm: {cheapest}."
OURS_SETTLED = "{model}, time error within {limit:g} mm: {cheapest}; with every finer step so too: {settled}."
OUR_RUN = "{method}, {setting}, for " + COST
FRAMES = (
    "{frame}, between its steps at that time error: {cost:.3g} ms; ours is {times} times cheaper. "
    "The goal is {goal:g} times."
)
RIGID = "A rigid arm, RK4 at {setting}: {costs}; {error:.2g} m from the truth."
RIGID_COST = "{code}, {cost:.3g} ms"


def publish(rows: Sequence[Row], floor: float, folder: Path) -> str:
    """Draws the rows, writes the page about them and returns it; `floor` is the error of the truth, m."""
    peers = of_peers(rows)
    mine = [row for row in rows if row not in peers]
    peers_chart(mine, peers, floor, TITLE, folder / PICTURE)
    text = page(mine, peers)
    (folder / "peers.md").write_text(text, encoding="utf-8")
    return text


def page(rows: Sequence[Row], peers: Sequence[Row]) -> str:
    """The page as Markdown, from our rows and those of peers."""
    packages = [package for name, package in PEERS.items() if any(row.model.startswith(name) for row in peers)]
    lines = bullets(conclusions(rows, peers, PLAIN))
    known = {"rounds": ROUNDS, "picture": PICTURE, "machine": machine_text(packages)}
    return PAGE.format(**known, conclusion="\n".join(lines))


def conclusions(rows: Sequence[Row], peers: Sequence[Row], plain: str) -> list[str]:
    """Sentences about our rows and those of peers; `plain` is the model whose time error counts."""
    return [*_pieces(rows, peers), *_alone(rows, peers), *_frames(rows, peers, plain), *_rigid(rows, peers)]


def _pieces(rows: Sequence[Row], peers: Sequence[Row]) -> list[str]:
    """How much cheaper we are than MuJoCo's rigid pieces at their total error."""
    result = []
    for pieces, sentences in ((8, PIECES_NEAR), (4, PIECES)):
        known = [row for row in peers if (row.model, row.method) == (f"MuJoCo, {pieces} pieces", "Euler")]
        if not known:
            continue
        peer = min(known, key=lambda row: row.cpu)
        limit = peer.total_error or 0.0
        texts = {
            "peer": _run(peer),
            "cheapest": _cheaper(_within(rows, limit), peer),
            "settled": _cheaper(settled(rows, limit), peer),
            "nearly": _cheaper(_within(rows, NEAR), peer),
        }
        result.append(sentences.format(**texts, near=1e3 * NEAR, goal=GOAL_BESIDE_PIECES))
    return result


def _alone(rows: Sequence[Row], peers: Sequence[Row]) -> list[str]:
    """The error of each model at its shortest step, so that nobody takes a lucky step for a good model."""
    known: dict[str, Row] = {}
    for row in sorted([*rows, *peers], key=lambda row: (row.model, -(row.step or math.inf))):
        if row.method in ("implicit_midpoint", "RK4") and "rigid" not in row.model:
            known[row.model] = row
    errors = [
        MODEL_ERROR.format(model=row.model, error=1e3 * (row.total_error or 0.0), setting=row.setting)
        for row in known.values()
    ]
    return errors and [ALONE.format(errors="; ".join(errors))]


def _frames(rows: Sequence[Row], peers: Sequence[Row], plain: str) -> list[str]:
    """How much cheaper we are than Exudyn's floating frame of the same elements at a time error."""
    mine = [row for row in rows if row.model == plain and row.time_error is not None]
    within = [row for row in mine if (row.time_error or 0.0) <= WANTED]
    if not within:
        return []
    steady = settled(mine, WANTED, "time_error")
    best = [min(result, key=lambda row: row.cpu) for result in (within, steady) if result]
    costs = [OUR_RUN.format(method=row.method, setting=row.setting, cost=1e3 * row.cpu) for row in best]
    names = dict(zip(("cheapest", "settled"), costs, strict=False))
    result = [(OURS_SETTLED if steady else OURS).format(model=plain, limit=1e3 * WANTED, **names)]
    for name in dict.fromkeys((row.model, row.method) for row in peers if row.model.startswith("Exudyn")):
        theirs = cost_at([row for row in peers if (row.model, row.method) == name], WANTED)
        if theirs is not None:
            times = " and ".join(f"{theirs / row.cpu:.3g}" for row in best)
            numbers = {"cost": 1e3 * theirs, "times": times, "goal": GOAL_BESIDE_FRAMES}
            result.append(FRAMES.format(frame=", ".join(name), **numbers))
    return result


def _rigid(rows: Sequence[Row], peers: Sequence[Row]) -> list[str]:
    """What a rigid arm costs, and how far from the truth it is."""
    known = [row for row in (*rows, *peers) if row.model.split(", ")[-1] == "rigid"]
    if not known:
        return []
    codes = [row.model.removesuffix("rigid").removesuffix(", ") or "ours" for row in known]
    costs = [RIGID_COST.format(code=code, cost=1e3 * row.cpu) for code, row in zip(codes, known, strict=True)]
    far = max(row.total_error or 0.0 for row in known)
    return [RIGID.format(setting=known[0].setting, costs="; ".join(costs), error=far)]


def _within(rows: Sequence[Row], error: float) -> list[Row]:
    return [row for row in rows if (row.total_error or 0.0) <= error]


def _cheaper(rows: Sequence[Row], peer: Row) -> str:
    best = min(rows, key=lambda row: row.cpu, default=None)
    return "none" if best is None else CHEAPER.format(run=_run(best), times=peer.cpu / best.cpu)


def _run(row: Row) -> str:
    numbers = {"error": 1e3 * (row.total_error or 0.0), "cost": 1e3 * row.cpu}
    return RUN.format(model=row.model, method=row.method, setting=row.setting, **numbers)
