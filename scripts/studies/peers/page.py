"""Page and chart of the comparison with other simulators."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from flexman_gym.common.markdown import markdown_table
from flexman_gym.common.plot_style import BLUE, BROWN, GREEN, PURPLE, RED, SLATE
from flexman_gym.toolbox.precision.runs import PrecisionRow
from studies.peers.measure import ROUNDS, Decay, of_peers
from studies.precision.charts import draw_floor, draw_runs, finish, front, new_panel
from studies.precision.measure import PLAIN, cost_at, settled
from studies.screen import picture, screen

MANY = " arms on "  # part of the scene name of batch rows
PICTURE, TITLE = "work_precision_peers.svg", "The paper's arm, everything flexible: error of the tip over cost"
NEAR = 5e-3  # m; similar to the error of MuJoCo with 8 pieces, since the finest models agree to about 4 mm only
WANTED = 3e-3  # m; time error at which costs are compared
DISCRETE = "discrete"
FAMILIES = {  # label -> colour, marker, and part of the model names
    "MuJoCo, rigid pieces": (RED, "o", "pieces"), "MuJoCo, rigid pieces, discrete": (BROWN, "^", "pieces"),
    "MuJoCo, rods": (PURPLE, "D", "rods"), "Exudyn, floating frame": (SLATE, "P", "Exudyn"),
    "SoRoMoX, quadratic strains": (GREEN, "v", "SoRoMoX"),
}  # fmt: skip
MESSAGE = "Our cheapest runs need less CPU time than the other codes"
QUESTION = "How much CPU time do simulators need for the same arm, and how far apart are their results?"
ANSWER = """**At the error of MuJoCo with 8 rigid pieces per link ({error:.2g} mm) our cheapest run is {exact:.3g}
times as fast; {steady:.3g} times, if the error has to hold at all shorter steps too.** At a time error of {wanted:g}
mm Exudyn's floating frame with the same elements costs {exudyn:.3g} times as much with its fastest settings,
{default:.3g} times with the default ones."""
BODY = """{picture}

{table}

Each run simulates 2 s under 400 N m per joint. The error is the largest distance of the tip from that of an
independent large-rotation code; the cost is CPU time on one core, best of {rounds} rounds. In other
scenes the ratios differ. Exudyn's frame has two elements per link without foreshortening; ours, SoRoMoX and
MuJoCo's pieces agree to millimetres.

- A rigid arm: {rigid:.2g} ms, wrong by {far:.2g} m.
- MuJoCo's `discrete` integrator takes {discrete:.0%} of the amplitude of the lowest mode per second at {step:g} ms;
  our methods and the other integrators take less than {others:.0e} of it."""
HEADS = ("code", "model", "method, step", "error, mm", "CPU ms per s")


def draw(every: Sequence[PrecisionRow], floor: float, folder: Path) -> None:
    """Plot our Pareto front as a line and the runs of each family of other simulators as points.

    Args:
        every: all runs.
        floor: error of the reference, m.
        folder: output folder.
    """
    rows, peers = _parts(every)
    figure, axes = new_panel(TITLE)
    draw_runs(axes, front(rows, "total_error", floor), "total_error", "flexman_gym, cheapest runs",
              {"color": BLUE, "marker": "s", "linewidth": 2.0, "drawstyle": "steps-post"})  # fmt: skip
    for name, (colour, marker, part) in FAMILIES.items():
        own = [row for row in peers if part in row.model and (row.method == DISCRETE) == name.endswith(DISCRETE)]
        look = {"color": colour, "marker": marker, "linestyle": "", "markersize": 7.0}
        draw_runs(axes, own, "total_error", name, look)
    draw_floor(axes, floor, "agreement of the finest models")
    axes.set_ylabel("largest distance of the tip\nfrom the independent code (m)")
    finish(figure, folder / PICTURE)


def _parts(rows: Sequence[PrecisionRow]) -> tuple[list[PrecisionRow], list[PrecisionRow]]:
    """Return our runs of single arms, and those of other simulators."""
    alone = [row for row in rows if MANY not in row.scene]
    peers = of_peers(alone)
    return [row for row in alone if row not in peers], peers


def page(every: Sequence[PrecisionRow], losses: Sequence[Decay], files: Mapping[str, str]) -> str:
    """Return the page as Markdown.

    Args:
        every: all runs.
        losses: numerical damping of the integrators.
        files: files of rows and losses with their comments.
    """
    rows, peers = _parts(every)
    mujoco = _cheapest(row for row in peers if (row.model, row.method) == ("MuJoCo, 8 pieces", "Euler"))
    error = mujoco.total_error or 0.0
    exact, near = (_cheapest(row for row in rows if (row.total_error or 0.0) <= limit) for limit in (error, NEAR))
    steady = _cheapest(settled(rows, error))
    mine = [row for row in rows if row.model == PLAIN and row.time_error is not None and row.time_error <= WANTED]
    base = _cheapest(mine).cpu
    exudyn = [row for row in peers if row.model.startswith("Exudyn")]
    costs = sorted(cost_at([row for row in exudyn if row.method == method], WANTED) or 0.0
                   for method in {row.method for row in exudyn})  # fmt: skip
    rigid = {row.model.split(",")[0]: row for row in (*rows, *peers) if row.model.split(", ")[-1] == "rigid"}
    lossy = max((loss for loss in losses if DISCRETE in loss.integrator), key=lambda loss: loss.step)
    answer = ANSWER.format(error=1e3 * error, exact=mujoco.cpu / exact.cpu, steady=mujoco.cpu / steady.cpu,
                           wanted=1e3 * WANTED, exudyn=costs[0] / base, default=costs[-1] / base)  # fmt: skip
    shown = [("ours", exact), ("ours", near), _named(mujoco), *(_named(row) for row in _finest(peers))]
    body = BODY.format(
        picture=picture(MESSAGE, PICTURE),
        table="\n".join(markdown_table(HEADS, [_cells(*each) for each in shown])), rounds=ROUNDS,
        rigid=1e3 * rigid["rigid"].cpu, far=rigid["rigid"].total_error,
        discrete=lossy.loss, step=1e3 * lossy.step,
        others=max(abs(loss.loss) for loss in losses if DISCRETE not in loss.integrator) or 1e-8,
    )  # fmt: skip
    return screen("Comparison with other simulators", QUESTION, answer, body, files, "peers")


def _finest(peers: Sequence[PrecisionRow]) -> list[PrecisionRow]:
    """Return the most accurate run of each family, without the integrator with numerical damping."""
    families = {part for _, _, part in FAMILIES.values()}
    own = ([row for row in peers if part in row.model and row.method != DISCRETE] for part in sorted(families))
    return [min(runs, key=lambda row: row.total_error or 0.0) for runs in own if runs]


def _named(row: PrecisionRow) -> tuple[str, PrecisionRow]:
    return row.model.split(",")[0], row


def _cells(code: str, row: PrecisionRow) -> tuple[str, ...]:
    model = row.model.removeprefix(f"{code}, ")
    return code, model, f"{row.method}, {row.setting}", f"{1e3 * (row.total_error or 0.0):.2g}", f"{1e3 * row.cpu:.3g}"


def _cheapest(rows: Iterable[PrecisionRow]) -> PrecisionRow:
    return min(rows, key=lambda row: row.cpu)
