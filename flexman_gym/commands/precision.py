"""Chart the error of the tip in a scene against computing time.

The error is the largest distance of the tip from its motion with four elements a link and foreshortening. The chart
has models and methods, with the default of the environments in a ring, and MuJoCo, Exudyn and Pinocchio where they are
installed.
"""

import argparse
import math
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from flexman_gym.commands import CommandLine, add_options, load_scene, output_file
from flexman_gym.common.formatting import json_text

if TYPE_CHECKING:
    from flexman_gym.toolbox.precision.runs import PrecisionRow

PICTURE = Path("out/precision.png")
HEAD = f"{'model':<34}{'method':<22}{'step, ms':>9}{'error, mm':>12}{'CPU ms per s':>13}"


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    add_options(parser, "scene", "--json")
    parser.add_argument(
        "--method", nargs="+", metavar="METHOD", help="methods, see flexman list methods (default: a selection)"
    )
    parser.add_argument(
        "--step", type=float, metavar="S", help="longest step, s; it is halved 6 times (default: two output steps)"
    )
    parser.add_argument("--all", action="store_true", help="print all runs, not only those that none beats")
    parser.add_argument("--own", action="store_true", help="leave other simulators out")
    parser.add_argument("--out", type=output_file, metavar="FILE", default=PICTURE, help="chart (default: %(default)s)")


def _run(options: argparse.Namespace) -> int:
    """Run the scene, print a table or JSON document and draw the chart; return 0."""
    from flexman_gym.simulation.diagnostics import explain_bending
    from flexman_gym.simulation.scene_simulation import simulate
    from flexman_gym.toolbox.precision.charts import conclusion, draw_scenes, front_of
    from flexman_gym.toolbox.precision.scene_runs import default_run, our_rows, peer_timers, precision_scene

    scene = load_scene(options.scene)
    result = precision_scene(scene, Path(options.scene).stem)
    floor = result.reference.floor
    table = sys.stderr if options.json else sys.stdout
    print(
        f"reference: {result.reference.source}; its error of mesh and steps is about {1e3 * floor:.2g} mm", file=table
    )
    model, method, step = default_run(scene)
    if bending := explain_bending(model, simulate(scene, model, method, step).states):
        print(f"! {bending}", file=sys.stderr)
    rows = list(our_rows(result, _methods(options.method), options.step))
    timers, left_out = ([], []) if options.own else peer_timers(result)
    rows += [timer() for timer in timers]
    best = front_of(rows, floor)
    shown = rows if options.all else [*best, *rows[:1], *rows[len(rows) - len(timers) :]]
    if options.json:
        reference = {"source": result.reference.source, "error": floor}
        texts = {"left_out": left_out, "conclusion": conclusion(rows)}
        print(json_text({"reference": reference, "runs": [*map(asdict, shown)], **texts}))
    else:
        print("\n".join([HEAD, *(_line(row, "default" if row is rows[0] else "") for row in shown)]))
        print("\n".join([*left_out, conclusion(rows)]), flush=True)
    try:
        print(f"{draw_scenes([(rows, floor, conclusion(rows))], options.out)} has the chart", file=table)
    except ImportError as error:
        print(error, file=table)
    return 0


def _methods(given: list[str] | None) -> list[str]:
    """Return the names of methods of fixed steps.

    Raises:
        ValueError: for a name that is not a method, or a method that chooses its steps.
    """
    from flexman_gym.common.checks import one_of
    from flexman_gym.simulation.methods import METHODS

    known = [name for name, method in METHODS.items() if not method.adaptive]
    return [one_of("--method", name, known) for name in given or ()]


def _line(row: "PrecisionRow", note: str) -> str:
    """Return a line of the table."""
    shown = f"{1e3 * row.error:.3g}" if math.isfinite(row.error) else row.status
    step = f"{1e3 * row.step:.3g}" if row.step is not None else ""
    return f"{row.model:<34}{row.method:<22}{step:>9}{shown:>12}{1e3 * row.cpu:>13.3g}  {note}".rstrip()


EXAMPLES = (
    "flexman precision paper_ff --own --method gauss_3",
    "flexman precision paper_rr --own --method rk4 --json | python3 -m json.tool",
)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)
