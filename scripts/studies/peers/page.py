"""Page and chart of the comparison with other simulators."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from flexman_gym.common.markdown import markdown_table
from flexman_gym.toolbox.precision.charts import (
    CHOSEN,
    cheapest_equal,
    conclusion,
    draw_scenes,
    family_of,
    lasting_errors,
    ratio_text,
)
from flexman_gym.toolbox.precision.runs import OK, PrecisionRow
from flexman_gym.toolbox.precision.scene_runs import PLAIN, RIGID, SHORTENED
from studies.peers.measure import PAPER, ROUNDS, Decay, of_peers
from studies.precision.measure import Floor, cost_at
from studies.screen import picture, screen

PICTURE, NARROW = "speed_accuracy.svg", "speed_accuracy_phone.svg"  # two panels side by side; one, for phones
NEAR = 6e-3  # m; error at which costs of all simulators are compared
WANTED = 3e-3  # m; time error at which costs are compared
DISCRETE = "discrete"
MESSAGE = "Error of the tip over computing time in four scenes: our cheapest runs, the default, and other simulators"
QUESTION = "How much CPU time do simulators need for the same motion, and how far apart are their results?"
ANSWER = """**{scenes}** For the paper's arm within {near:g} mm, near the agreement of the finest models ({floor:.2g}
mm), MuJoCo's rigid pieces take {mujoco} times and SoRoMoX {soromox} times as long as our cheapest run. At a time error
of {wanted:g} mm Exudyn's floating frame with the same elements costs {exudyn:.2g} to {default:.0f} times as much."""
BODY = """{picture}

[Speed and accuracy](../accuracy_and_speed.md) explains the chart. The table has the runs of the paper's arm.

{table}

The error is the largest distance of the tip from that of an independent large-rotation code (other scenes: four
elements a link). Costs are the lowest CPU times of {rounds} rounds.

- A rigid arm: {rigid:.2g} ms, wrong by {far:.2g} m.
- MuJoCo's `discrete` integrator takes {discrete:.0%} of the amplitude of the lowest mode per second at {step:g} ms; the
  others take less than {others:.0e} of it."""
CHOSEN_HEADS = ("scene", "tolerance", "coordinates", "method, step", "error", "CPU ms per s",
                "cost of all coordinates / choice")  # fmt: skip
RUN_HEADS = "error at most", "scene", "model", "method, step", "error", "CPU ms per s"
LIMITS = 30e-3, NEAR, 1e-3  # m; errors of the table of runs
HEADS = ("code", "model", "method, step", "error, mm", "CPU ms per s")


def draw(every: Sequence[PrecisionRow], floors: Sequence[Floor], folder: Path) -> None:
    """Draw a panel for each scene, with its conclusion as the title."""
    panels = []
    for floor in floors:
        rows = [row for row in every if row.scene == floor.scene]
        panels.append((rows, floor.floor, f"{floor.title}\n{conclusion(rows)}"))
    draw_scenes(panels, folder / PICTURE)
    draw_scenes(panels, folder / NARROW, columns=1)


def page(
    every: Sequence[PrecisionRow], floors: Sequence[Floor], losses: Sequence[Decay], files: Mapping[str, str]
) -> str:
    """Return the page as Markdown.

    Args:
        every: all runs.
        floors: scenes and errors of their references.
        losses: numerical damping of the integrators.
        files: files of rows and losses with their comments.
    """
    paper = [row for row in every if row.scene == PAPER]
    peers = of_peers(paper)
    rows = [row for row in paper if family_of(row) is None]
    mujoco = _cheapest(row for row in peers if (row.model, row.method) == ("MuJoCo, 8 pieces", "Euler"))
    floor = next(each.floor for each in floors if each.scene == PAPER)
    best = {name: _cheapest(row for row in peers if row.model.startswith(name) and row.error <= NEAR)
            for name in ("MuJoCo", "SoRoMoX")}  # fmt: skip
    best["ours"] = _cheapest(_within(lasting_errors(rows, floor), NEAR))
    mine = [row for row in rows if row.model == PLAIN and row.time_error is not None and row.time_error <= WANTED]
    exudyn = [row for row in peers if row.model.startswith("Exudyn")]
    costs = sorted(cost_at([row for row in exudyn if row.method == method], WANTED) or 0.0
                   for method in {row.method for row in exudyn})  # fmt: skip
    rigid = _cheapest(row for row in rows if row.model == RIGID)
    lossy = max((loss for loss in losses if DISCRETE in loss.integrator), key=lambda loss: loss.step)
    answer = ANSWER.format(
        scenes=_ratios(every, floors), near=1e3 * NEAR, floor=1e3 * floor,
        mujoco=ratio_text(best["MuJoCo"], best["ours"]), soromox=ratio_text(best["SoRoMoX"], best["ours"]),
        wanted=1e3 * WANTED, exudyn=costs[0] / _cheapest(mine).cpu, default=costs[-1] / _cheapest(mine).cpu,
    )  # fmt: skip
    chosen = next(row for row in rows if row.model.startswith(CHOSEN))
    shown = [("ours, default", rows[0]), ("ours", chosen), ("ours", best["ours"])]
    shown += [_named(row) for row in (mujoco, *_finest(peers))]
    body = BODY.format(
        picture=picture(MESSAGE, PICTURE),
        table="\n".join(markdown_table(HEADS, [_cells(*each) for each in shown])), rounds=ROUNDS,
        rigid=1e3 * rigid.cpu, far=rigid.total_error, discrete=lossy.loss, step=1e3 * lossy.step,
        others=max(abs(loss.loss) for loss in losses if DISCRETE not in loss.integrator) or 1e-8,
    )  # fmt: skip
    return screen("Comparison with other simulators", QUESTION, answer, body, files, "peers")


def chosen_lines(every: Sequence[PrecisionRow], floors: Sequence[Floor], files: Mapping[str, str]) -> list[str]:
    """Return the table of the models of `choose_model`, for docs/accuracy_and_speed.md."""
    cells = []
    for floor in floors:
        rows = [row for row in every if row.scene == floor.scene]
        chosen = next(row for row in rows if row.model.startswith(CHOSEN))
        tolerance, _, size = chosen.model.removeprefix(CHOSEN).partition(": ")
        whole = [row.cpu for row in rows if row.model == SHORTENED and row.error <= chosen.error]
        ratio = f"{min(whole) / chosen.cpu:.2g}" if whole else "-"
        cells.append((floor.title, tolerance, size.removesuffix(" coordinates"), f"`{chosen.method}`, {chosen.setting}",
                      f"{1e3 * chosen.error:.2g} mm", f"{1e3 * chosen.cpu:.2g}", ratio))  # fmt: skip
    source = f"Rows: [peers.csv](evidence/peers.csv), {files['peers.csv']}."
    return ["", *markdown_table(CHOSEN_HEADS, cells), "", source, ""]


def run_lines(every: Sequence[PrecisionRow], floors: Sequence[Floor]) -> list[str]:
    """Return the table of the cheapest of our runs within each error, for docs/accuracy_and_speed.md."""
    cells = []
    for limit in LIMITS:
        for floor in floors:
            errors = lasting_errors([row for row in every if row.scene == floor.scene], floor.floor)
            if within := _within(errors, limit):
                best = _cheapest(within)
                cells.append((f"{1e3 * limit:g} mm", floor.title, best.model, f"`{best.method}`, {best.setting}",
                              f"{1e3 * errors[best]:.2g} mm", f"{1e3 * best.cpu:.2g}"))  # fmt: skip
    return ["", *markdown_table(RUN_HEADS, cells), ""]


def _within(errors: Mapping[PrecisionRow, float], limit: float) -> list[PrecisionRow]:
    """Return our runs, without those of `choose_model`, whose lasting error is at most a limit, m."""
    return [row for row, error in errors.items() if error <= limit and not row.model.startswith(CHOSEN)]


def _ratios(every: Sequence[PrecisionRow], floors: Sequence[Floor]) -> str:
    """Return a sentence with the cost of MuJoCo at the error of the default, relative to the default, in each scene."""
    factors = []
    for floor in floors:
        rows = [row for row in every if row.scene == floor.scene]
        equal = cheapest_equal(rows)
        factors.append("-" if equal is None else ratio_text(equal, rows[0]))
    shown = f"{', '.join(factors[:-1])} and {factors[-1]}"
    where = f"in the {len(floors)} scenes"
    return f"The quickest other simulator as accurate as the default takes {shown} times as long {where}."


def _finest(peers: Sequence[PrecisionRow]) -> list[PrecisionRow]:
    """Return the most accurate run of each family, without the integrator with numerical damping."""
    families: dict[str | None, list[PrecisionRow]] = {}
    for row in peers:
        if row.method != DISCRETE and "rigid" not in row.model and row.status == OK:
            families.setdefault(family_of(row), []).append(row)
    return [min(runs, key=lambda row: row.error) for runs in families.values()]


def _named(row: PrecisionRow) -> tuple[str, PrecisionRow]:
    return row.model.split(",")[0], row


def _cells(code: str, row: PrecisionRow) -> tuple[str, ...]:
    model = row.model.removeprefix(f"{code}, ")
    return code, model, f"{row.method}, {row.setting}", f"{1e3 * row.error:.2g}", f"{1e3 * row.cpu:.3g}"


def _cheapest(rows: Iterable[PrecisionRow]) -> PrecisionRow:
    return min(rows, key=lambda row: row.cpu)
