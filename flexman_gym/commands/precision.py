"""Compare methods on a scene: error of the tip and computing time."""

import argparse

import numpy as np

from flexman_gym.commands import CommandLine, add_options

DEFAULT_METHODS = ("rk4", "dopri5", "ros2", "midpoint_2", "midpoint_3", "extrapolated_euler_5")
HALVINGS = 5  # number of times that the step is halved
REFERENCE_METHOD, REFERENCE_RTOL = "dop853", 1e-9  # method of the reference; its relative local error, 1


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    add_options(parser, "scene")
    parser.add_argument(
        "--method", nargs="+", metavar="METHOD", help="methods, see flexman list methods (default: a selection)"
    )
    parser.add_argument(
        "--step",
        type=float,
        default=0.02,
        metavar="S",
        help=f"longest step, s; it is halved {HALVINGS} times (default: %(default)s)",
    )


def _run(options: argparse.Namespace) -> int:
    """Print a line for each method and step, with errors against the reference method; return 0."""
    from flexman_gym.scene.scene import Scene
    from flexman_gym.simulation.methods import METHODS as KNOWN
    from flexman_gym.simulation.scene_simulation import simulate

    names = options.method or [name for name in DEFAULT_METHODS if name in KNOWN]
    scene = Scene.load(options.scene)
    reference = simulate(scene, method=REFERENCE_METHOD, rtol=REFERENCE_RTOL)
    print(f"{REFERENCE_METHOD}, rtol {REFERENCE_RTOL:g}: {reference.status}, {reference.wall_seconds:.3g} s")
    print(f"{'method':<22}{'step, ms':>10}{'status':>16}{'error, m':>12}{'evaluations':>13}{'time, s':>10}")
    for name in names:
        for step in options.step / 2.0 ** np.arange(HALVINGS + 1):
            result = simulate(scene, method=name, step=float(step))
            rows = min(len(result.tip), len(reference.tip))
            error = np.linalg.norm(result.tip[:rows] - reference.tip[:rows], axis=1).max()
            shown_error = f"{error:.3g}" if result.status == "ok" else "-"
            line = f"{name:<22}{1e3 * step:>10.4g}{result.status:>16}{shown_error:>12}{result.evaluations:>13}"
            print(f"{line}{result.wall_seconds:>10.3g}", flush=True)
    return 0


COMMAND = CommandLine(_arguments, _run)
