"""Reproduce Figures 6 to 11 of the paper.

The arm of the paper moves for 2 s from rest under 400 N m at each joint, with rigid links and joints, with flexible
links, and with flexible links and joints. A figure has the difference between the flexible and the rigid arm, as a plot
and as a table.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from flexman_gym.commands import CommandLine, output_folder
from flexman_gym.toolbox.view.paper import (
    FIGURES,
    FLEXIBLE_CASES,
    PAPER_CASES,
    figure_name,
    figure_unit,
    paper_curves,
    paper_figures,
)

if TYPE_CHECKING:
    from flexman_gym.simulation.trajectory import Trajectory

METHOD, RTOL = "dop853", 1e-7  # integration method; its relative local error, 1
AREAS = {"printed": 0.028, "corrected": 0.0028}  # m^2; readings of the area of link 1 in Table 1, see `paper_rrr`


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    parser.add_argument(
        "--figure",
        type=int,
        nargs="+",
        choices=FIGURES,
        default=[*FIGURES],
        metavar="N",
        help=f"numbers of the figures, {FIGURES[0]} to {FIGURES[-1]} (default: all)",
    )
    parser.add_argument(
        "--area",
        choices=AREAS,
        default="printed",
        help="area of link 1: as printed in Table 1, or a tenth of it, which is possible (default: %(default)s)",
    )
    parser.add_argument(
        "--method",
        help=f"integration method, see flexman list methods (default: {METHOD}; with a step that of environments)",
    )
    parser.add_argument("--step", type=float, metavar="S", help="step, s, for a method with fixed steps")
    parser.add_argument(
        "--folder", type=output_folder, default=Path("out/paper"), help="output folder (default: %(default)s)"
    )


def _run(options: argparse.Namespace) -> int:
    """Simulate, print and write the figures; return 0, or 1 without figures if a simulation fails before its end."""
    from flexman_gym.simulation.methods import DEFAULT_METHOD

    method = options.method or (METHOD if options.step is None else DEFAULT_METHOD)
    trajectories = simulate_cases(options.area, method, options.step)
    if failed := [PAPER_CASES[case] for case, each in trajectories.items() if each.status != "ok"]:
        print(f"no figures: the simulation of {' and of '.join(failed)} fails", file=sys.stderr)
        return 1
    print_largest(trajectories, options.figure)
    rigid, flexible_links, flexible_both = trajectories.values()
    paths = paper_figures(rigid, flexible_links, flexible_both, options.folder, options.figure)
    print(f"{options.folder}: {', '.join(path.name for path in paths)}; figure_*.csv have the curves")
    return 0


def simulate_cases(area: str = "printed", method: str = METHOD, step: float | None = None) -> dict[str, "Trajectory"]:
    """Return the trajectories of the three cases of the paper by name, and print a line for each.

    Args:
        area: area of link 1, a key of AREAS.
        method: integration method.
        step: step of a method with fixed steps, s; None for an adaptive method.
    """
    from flexman_gym.scene.catalog import paper_rrr, paper_scene
    from flexman_gym.simulation.scene_simulation import simulate

    arm = paper_rrr(area)
    (other,) = (f"{name}: {value} m^2" for name, value in AREAS.items() if name != area)
    print(f"Arm of the paper, area of link 1 {area}: {AREAS[area]} m^2 (the other reading is {other})")
    print(f"{'2 s under 400 N m at each joint':<33}{'status':<15}{'computing':>10}{'largest energy residual':>26}")
    trajectories = {}
    for case, name in PAPER_CASES.items():
        result = simulate(replace(paper_scene(case), arm=arm), method=method, step=step, rtol=RTOL)
        residual = np.abs(result.energy_residual).max()
        line = f"{name:<33}{result.status:<15}{result.wall_seconds:>8.2f} s{residual:>24.1e} J"
        print(line, flush=True)  # in one piece: messages about kernels come between the rows
        for cause in result.explanation().splitlines():
            print(f"! {cause}", file=sys.stderr)
        trajectories[case] = result
    return trajectories


def print_largest(trajectories: Mapping[str, "Trajectory"], figures: Sequence[int]) -> None:
    """Print the largest absolute difference between the flexible and the rigid arm in each figure, and its time."""
    names = "".join(PAPER_CASES[case].ljust(30) for case in FLEXIBLE_CASES)
    print(f"{'largest difference to rigid arm':<33}{names.rstrip()}")
    for figure in figures:
        line = f"{figure_name(figure):<33}"
        for time, difference in paper_curves(trajectories, figure).values():
            row = np.abs(difference).argmax()
            line += f"{difference[row]:.3f} {figure_unit(figure)} at {time[row]:.2f} s".ljust(30)
        print(line.rstrip())


EXAMPLES = (
    "flexman paper  # Figures 6 to 11, in out/paper",
    "flexman paper --figure 6 --area corrected",
)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)
