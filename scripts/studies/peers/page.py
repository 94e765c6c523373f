"""Page and chart of the comparison with other simulators."""

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, metadata
from itertools import cycle
from pathlib import Path

import flexman_gym as fm
from flexman_gym.common.computer import computer_text
from flexman_gym.common.plot_style import BLUE, GREEN, MIDDLE, ORANGE, RED, SKY
from studies.markdown import introduced_table
from studies.methods import BLACK, PINE, PINK, PURPLE
from studies.peers.measure import PEERS, ROUNDS, decays, of_peers
from studies.peers.newton import cables
from studies.precision.charts import AGREEMENT, TOTAL_ERROR, draw_floor, draw_front, draw_runs, finish, new_panels
from studies.precision.measure import PLAIN, PrecisionRow, cost_at, settled

COLOURS = (ORANGE, RED, PURPLE, GREEN, SKY, BLACK, MIDDLE, PINK, PINE)  # models of other simulators; ours are blue
MARKERS = "ov^D<PX>"  # methods of other simulators; ours are squares


def _peers_chart(
    rows: Sequence[PrecisionRow], peers: Sequence[PrecisionRow], floor: float, title: str, path: Path
) -> None:
    """Plot total error against cost of our runs and other simulators: a colour per model, a marker per method."""
    figure, (axes,) = new_panels(1, title, 6.4)
    draw_runs(axes, rows, "total_error", "flexman_gym", {"color": BLUE, "marker": "s", "linestyle": ""})
    colours = _in_turn((row.model for row in peers), COLOURS)
    markers = _in_turn((row.method for row in peers), MARKERS)
    for model, method in dict.fromkeys((row.model, row.method) for row in peers):
        result = [row for row in peers if (row.model, row.method) == (model, method)]
        look = {"color": colours[model], "marker": markers[method], "markersize": 7.0}
        draw_runs(axes, result, "total_error", f"{model}, {method}", look)
    draw_front(axes, [*rows, *peers], "total_error", floor)
    draw_floor(axes, floor, AGREEMENT)
    axes.set_ylabel(TOTAL_ERROR)
    finish(figure, [axes], path)


def _in_turn(names: Iterable[str], values: Sequence[str]) -> dict[str, str]:
    """Assign values to names cyclically."""
    return dict(zip(dict.fromkeys(names), cycle(values), strict=False))


MANY = " arms on "  # part of the scene name of batch rows
PICTURE, TITLE = "work_precision_peers.png", "The paper's arm, everything flexible"
NEAR = 5e-3  # m; similar to the error of MuJoCo with 8 pieces, since the finest models agree to about 4 mm only
WANTED = 3e-3  # m; time error at which costs are compared

PAGE = """# Comparison with other simulators

This page compares cost and tip error of the same arm in several simulators. For an error of millimetres MuJoCo's rigid
pieces and Exudyn's floating frame cost tens to hundreds of times as much as our cheapest run. The finest models of most
simulators agree to millimetres. A rigid arm is cheaper, but its tip error is large. All results are for one scene;
ratios differ in other scenes.

The rows are in `peers.csv`. Each run simulates 2 s of the paper's flexible arm under 400 N m per joint. The error is
the largest distance of the tip from that of an independent large-rotation code. The cost is CPU time on one core, the
best of {rounds} interleaved rounds.

- Ours: plain meshes, 20 modes of one of them, and the choice of `choose_model` for an error of 4.5 mm.
- MuJoCo: every link consists of 4 or 8 rigid pieces with springs, or of one rigid piece. The `discrete` integrator
  dissipates the vibration.
- MuJoCo's rods: every link is a 1-D flex of equal pieces, which bends, twists and stretches. Its points have no rotary
  inertia, which is therefore assigned to the bodies at both ends. Only round and rectangular sections are supported.
  The `implicit` and `implicitfast` integrators do not support rods, and `discrete` does not support springs along
  edges.
- Exudyn: a floating frame of reference with 2 beam elements per link, integrated by the generalised-alpha method. It
  has the mass points, shapes and stiffness of our model without foreshortening. The build is without range checks, the
  model without user functions. It runs with the fastest settings for this arm and with its default settings. For links
  that bend out of a plane the rotation of the tips is treated slightly differently: the converged tip is within 5 mm of
  ours. The time error refers to its own converged run.
- Pinocchio: links and joints are rigid. The compiled `aba` is called from a Runge-Kutta loop in Python.
- SoRoMoX: geometric variable strain on the CPU, with quadratic bending and constant torsion along a link. Rotors are
  added to its mass matrix, and the Runge-Kutta loop is compiled.
- Newton's cables: {cables}.

The rigid arms show the cost of flexibility and the error without it.

![error over cost]({picture})

Computed with {computer}, one core. The command is `python scripts/compare_peers.py --folder docs/evidence`.

{conclusion}
"""

COST = "CPU ms per simulated second"
PIECES = (
    "Each run of MuJoCo's Euler method is followed by the cheapest of our runs with at most the same error. "
    "If the error also holds at all finer steps, it does not result from cancellation of errors."
)
PIECES_HEADS = ("run", "model", "method", "step", "error, mm", COST, "speed-up")
THEIRS, CHEAPEST, SETTLED = "MuJoCo", "ours, at most the same error", "ours, also at all finer steps"
NEARLY = "ours, within {near:g} mm"
ALONE = (
    "The error of each model, at a short step of a method without numerical damping. "
    "If a longer step has a smaller error, errors of model and method cancel in part."
)
OURS = "The cost of a time error of {limit:g} mm with {model}. Exudyn's is interpolated between its steps."
OURS_SETTLED = OURS + " Our second run stays within this error at all finer steps too."
OUR_RUN = "ours, {method}, {setting}"
LICENCES = "Version, licence (from the package metadata) and settings of each package."
SETTINGS = {
    "MuJoCo": "contacts and constraints off, the longest stable step of each integrator",
    "Exudyn": "generalised-alpha, Newton's tolerance 0.001 with Eigen's dense solver, and its defaults",
    "Pinocchio": "RK4 at 1 ms",
    "SoRoMoX": "JAX in double precision, RK4 at 0.667 ms",
}
DECAY = "Numerical damping: loss of amplitude of the lowest mode per second, for an arm without damping."
ABREAST = (
    "{scene}: simulated seconds of one arm per wall-clock second, in the fastest round. "
    "Each row is compared with the fastest one of the same error."
)
ABREAST_HEADS = ("model", "method", "step", "error, mm", "simulated s per s", "slow-down", "cores used")
RIGID = "The cost of a rigid arm, by RK4 at {setting}. Its tip error is {error:.2g} m."


def publish(rows: Sequence[PrecisionRow], floor: float, folder: Path) -> str:
    """Draw the chart and write the page; return its text. `floor` is the error of the reference, m."""
    many = [row for row in rows if MANY in row.scene]
    peers = of_peers(alone := [row for row in rows if row not in many])
    mine = [row for row in alone if row not in peers]
    _peers_chart(mine, peers, floor, TITLE, folder / PICTURE)
    text = page(mine, peers, many)
    (folder / "peers.md").write_text(text, encoding="utf-8")
    return text


def page(rows: Sequence[PrecisionRow], peers: Sequence[PrecisionRow], many: Sequence[PrecisionRow]) -> str:
    """Return the page as Markdown from our rows, those of other simulators, and those of batches of arms."""
    found = [name for name in PEERS if any(row.model.startswith(name) for row in peers)]
    computer = computer_text(PEERS[name] for name in found)
    texts = [*conclusions(rows, peers, PLAIN), *_decays(peers), *_abreast(many), *_licences(found)]
    known = {"rounds": ROUNDS, "picture": PICTURE, "cables": cables(), "computer": computer}
    return PAGE.format(**known, conclusion="\n".join(texts).rstrip())


def conclusions(rows: Sequence[PrecisionRow], peers: Sequence[PrecisionRow], plain: str) -> list[str]:
    """Return the tables of single runs; `plain` is the model whose time error is studied."""
    return [*_pieces(rows, peers), *_alone(rows, peers), *_frames(rows, peers, plain), *_rigid(rows, peers)]


def _pieces(rows: Sequence[PrecisionRow], peers: Sequence[PrecisionRow]) -> list[str]:
    """Return the cost of MuJoCo's rigid pieces relative to ours at their total error."""
    cells = []
    for pieces in (8, 4):
        known = [row for row in peers if (row.model, row.method) == (f"MuJoCo, {pieces} pieces", "Euler")]
        if not known:
            continue
        peer = min(known, key=lambda row: row.cpu)
        limit = peer.total_error or 0.0
        ours = {CHEAPEST: _within(rows, limit), SETTLED: settled(rows, limit)}
        if limit < NEAR:
            ours[NEARLY.format(near=1e3 * NEAR)] = _within(rows, NEAR)
        cells += [_cells(name, runs, peer) for name, runs in ({THEIRS: [peer]} | ours).items() if runs]
    return introduced_table(PIECES, PIECES_HEADS, cells) if cells else []


def _alone(rows: Sequence[PrecisionRow], peers: Sequence[PrecisionRow]) -> list[str]:
    """Return the error of each model at its shortest step, which separates model errors from time errors."""
    known: dict[str, PrecisionRow] = {}
    for row in sorted([*rows, *peers], key=lambda row: (row.model, -(row.step or math.inf))):
        if row.method in ("implicit_midpoint", "RK4") and "rigid" not in row.model:
            known[row.model] = row
    cells = [(row.model, _millimetres(row), row.setting) for row in known.values()]
    return introduced_table(ALONE, ("model", "error, mm", "step"), cells) if cells else []


def _frames(rows: Sequence[PrecisionRow], peers: Sequence[PrecisionRow], plain: str) -> list[str]:
    """Return the cost of Exudyn's floating frame with the same elements relative to ours at a time error."""
    mine = [row for row in rows if row.model == plain and row.time_error is not None]
    within = [row for row in mine if (row.time_error or 0.0) <= WANTED]
    steady = settled(mine, WANTED, "time_error")
    best = [min(result, key=lambda row: row.cpu) for result in (within, steady) if result]
    costs = [(OUR_RUN.format(method=row.method, setting=row.setting), row.cpu) for row in best]
    for name in dict.fromkeys((row.model, row.method) for row in peers if row.model.startswith("Exudyn")):
        theirs = cost_at([row for row in peers if (row.model, row.method) == name], WANTED)
        costs += [] if theirs is None else [(", ".join(name), theirs)]
    heads = ("run", COST, *("relative to our first", "relative to our second")[: len(best)])
    cells = [(name, f"{1e3 * cost:.3g}", *(f"{cost / row.cpu:.3g}" for row in best)) for name, cost in costs]
    text = (OURS_SETTLED if steady else OURS).format(model=plain, limit=1e3 * WANTED)
    return introduced_table(text, heads, cells) if best else []


def _rigid(rows: Sequence[PrecisionRow], peers: Sequence[PrecisionRow]) -> list[str]:
    """Return the cost of a rigid arm and its distance from the reference."""
    known = [row for row in (*rows, *peers) if row.model.split(", ")[-1] == "rigid"]
    if not known:
        return []
    cells = [(row.model.removesuffix("rigid").removesuffix(", ") or "ours", f"{1e3 * row.cpu:.3g}") for row in known]
    far = max(row.total_error or 0.0 for row in known)
    return introduced_table(RIGID.format(setting=known[0].setting, error=far), ("code", COST), cells)


def _decays(peers: Sequence[PrecisionRow]) -> list[str]:
    """Return the numerical damping of the lowest mode by the integrators."""
    shares = decays(fm.catalog.paper_rrr(), peers)
    cells = [(name, f"{1e3 * step:.3g} ms", f"{100 * abs(round(share, 8)):.3g} %") for name, step, share in shares]
    return introduced_table(DECAY, ("integrator", "step", "loss per second"), cells)


def _abreast(many: Sequence[PrecisionRow]) -> list[str]:
    """Return the rates of many arms on all cores, each relative to the fastest method of equal error."""
    cells = []
    for row in sorted(many, key=lambda row: (_millimetres(row), row.wall)):
        best = min(many, key=lambda other: (_millimetres(other) != _millimetres(row), other.wall))
        speeds = f"{1 / row.wall:.4g}", f"{row.wall / best.wall:.3g}", f"{row.cpu / row.wall:.2g}"
        cells.append((row.model, row.method, row.setting, _millimetres(row), *speeds))
    return introduced_table(ABREAST.format(scene=many[0].scene), ABREAST_HEADS, cells) if many else []


def _licences(names: Sequence[str]) -> list[str]:
    """Return the table of versions, licences and settings of the installed packages."""
    cells = []
    for name in names:
        with suppress(PackageNotFoundError):
            known = metadata(PEERS[name])
            cells.append((name, known["Version"], known["License-Expression"], SETTINGS[name]))
    return introduced_table(LICENCES, ("package", "version", "licence", "settings"), cells) if cells else []


def _within(rows: Sequence[PrecisionRow], error: float) -> list[PrecisionRow]:
    return [row for row in rows if (row.total_error or 0.0) <= error]


def _cells(name: str, runs: Sequence[PrecisionRow], peer: PrecisionRow) -> list[str]:
    """Return the table cells of the cheapest of some runs, with its cost relative to a peer."""
    best = min(runs, key=lambda row: row.cpu)
    run = [name, best.model, best.method, best.setting, _millimetres(best)]
    return [*run, f"{1e3 * best.cpu:.3g}", f"{peer.cpu / best.cpu:.3g}"]


def _millimetres(row: PrecisionRow) -> str:
    return f"{1e3 * (row.total_error or 0.0):.2g}"
