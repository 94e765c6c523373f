"""Simulate a scene file and write its motion to a table."""

import argparse
import sys
from pathlib import Path

import numpy as np

from flexman_gym.commands import CommandLine, add_options, load_scene, output_file


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    add_options(parser, "scene")
    parser.add_argument(
        "--method", default="auto", help="integration method, see flexman list methods (default: %(default)s)"
    )
    parser.add_argument("--step", type=float, metavar="S", help="step, s, for a method with fixed steps")
    parser.add_argument(
        "--rtol", type=float, default=1e-6, help="relative tolerance, for an adaptive method (default: %(default)s)"
    )
    parser.add_argument(
        "--out",
        type=output_file,
        metavar="FILE",
        help=".csv: table of time, tip, angles and energy; .npz: episode for flexman replay",
    )


def _run(options: argparse.Namespace) -> int:
    """Simulate and print a summary; return 0, or 1 if the simulation fails before its end."""
    from flexman_gym.common.files import write_file
    from flexman_gym.simulation.episode import Episode
    from flexman_gym.simulation.scene_simulation import simulate

    scene = load_scene(options.scene)
    result = simulate(scene, method=options.method, step=options.step, rtol=options.rtol)
    if options.out is not None and options.out.suffix == ".npz":
        Episode.from_trajectory(result, Path(options.scene).stem).save(options.out)
    elif options.out is not None:
        columns = {"tip": result.tip, "joint_angle": result.joint_angles, "motor_angle": result.motor_angles}
        heads = [f"{name}_{i}" for name, values in columns.items() for i in range(1, values.shape[1] + 1)]
        table = np.column_stack([result.time, *columns.values(), result.energy])
        head = ",".join(["time", *heads, "energy"])
        write_file(options.out, lambda file: np.savetxt(file, table, "%.12g", ",", header=head, comments=""))
    last = ", ".join(f"{each:.6g}" for each in result.tip[-1])
    print(f"status: {result.status}, to {result.time[-1]:g} s in {result.wall_seconds:.3g} s")
    print(f"evaluations: {result.evaluations}")
    print(f"energy: {result.energy[-1]:.6g} J, largest residual {np.abs(result.energy_residual).max():.2g} J")
    print(f"tip at the end: {last} m")
    for line in result.explanation().splitlines():
        print(f"! {line}", file=sys.stderr)
    return int(result.status != "ok")


EXAMPLES = (
    "flexman simulate paper_ff --out motion.csv",
    "flexman simulate paper_rr --method rk4 --step 0.001",
    "flexman simulate paper_fr --out fr.npz  # for flexman replay",
)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)
