"""Draw plots: modes, Bode and Campbell diagrams, learning curves.

Plots and their subjects: modes, map, campbell (an environment, an arm, or a file of one); bode (an environment);
learning (folders of runs); league, robustness (the folder of a league); episode, side (saved episodes).
"""

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from flexman_gym.commands import CommandLine

if TYPE_CHECKING:
    from flexman_gym.model.model import Model


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    parser.add_argument("what", choices=sorted(PLOTS), metavar="plot", help=", ".join(sorted(PLOTS)))
    parser.add_argument("subject", nargs="+", help="environment, arm, file or folder to plot, see above")
    parser.add_argument(
        "--out",
        type=Path,
        help="file, or folder for the plots of a league (default: PLOT.png; side: .gif or .mp4, default side.gif)",
    )
    parser.add_argument(
        "--angles", type=float, nargs="+", metavar="RAD", help="joint angles, rad (modes, bode; default: zero)"
    )
    parser.add_argument(
        "--mode", type=int, metavar="N", default=1, help="number of the mode (map; default: the lowest)"
    )
    parser.add_argument("--count", type=int, metavar="N", default=6, help="number of modes (default: %(default)s)")
    parser.add_argument(
        "--fastest", type=float, metavar="RAD/S",
        help="largest joint rate, rad/s (campbell; default: the lowest natural frequency)",
    )  # fmt: skip
    parser.add_argument("--column", help="column of progress.csv (learning; default: the mean return)")


def _run(options: argparse.Namespace) -> int:
    """Draw the plots and print their paths; return 0."""
    out = options.out or Path(f"{options.what}.{'gif' if options.what == 'side' else 'png'}")
    for path in PLOTS[options.what](options, out):
        print(path)
    return 0


def _find_model(name: str, stiffening: bool = False) -> "Model":
    """Return the model of an environment, an arm or a file."""
    from flexman_gym.common import files
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.envs.config.fidelity import resolve_fidelity
    from flexman_gym.model.model import build_model
    from flexman_gym.scene.serialization import ARMS, SUFFIXES, URDF, find_arm

    data = files.read_data(Path(name)) if name.endswith(SUFFIXES) else {}
    if name in ARMS or name.endswith(URDF) or {"arm", "links", "urdf"} & set(data):
        return build_model(find_arm(name), stiffening=stiffening)
    model = resolve_fidelity(Configuration.find(name)).model
    return build_model(model.arm, **vars(model.choice) | {"stiffening": stiffening}) if stiffening else model


def _modes(options: argparse.Namespace, out: Path) -> list[Path]:
    from flexman_gym.toolbox.view.frequency_diagrams import draw_mode_shapes
    from flexman_gym.toolbox.view.video import write_picture

    return [write_picture(draw_mode_shapes(_find_model(options.subject[0]), options.angles, options.count), out)]


def _map(options: argparse.Namespace, out: Path) -> list[Path]:
    from flexman_gym.toolbox.view.frequency_diagrams import frequency_map

    return [frequency_map(_find_model(options.subject[0]), out, options.mode)]


def _campbell(options: argparse.Namespace, out: Path) -> list[Path]:
    import numpy as np

    from flexman_gym.model.dynamics import frequencies
    from flexman_gym.toolbox.view.frequency_diagrams import campbell_diagram

    model = _find_model(options.subject[0], stiffening=True)
    if model.n_dof == model.n_joints:
        raise ValueError(f"subject: {options.subject[0]} is not allowed; give an arm with flexible links or joints")
    fastest = options.fastest or 2 * np.pi * float(frequencies(model, lock_joints=True)[0])
    return [campbell_diagram(model, np.linspace(0.0, fastest, 31), out, options.count)]


def _bode(options: argparse.Namespace, out: Path) -> list[Path]:
    import numpy as np

    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.envs.config.fidelity import resolve_fidelity
    from flexman_gym.toolbox.controllers.margins import describe_stuck_motors, margins, sampled_loops
    from flexman_gym.toolbox.view.frequency_diagrams import bode_diagram

    environment = Configuration.find(options.subject[0])
    model, period, gains = resolve_fidelity(environment).model, environment.control_period, environment.pd_gains
    angles = options.angles or [0.0] * model.n_joints
    frequencies = np.geomspace(0.01, 0.5 / period, 1200)
    loops = sampled_loops(model, angles, period, environment.max_delay, environment.drive_bandwidth)
    stuck = margins(loops, gains["stiffness"], gains["damping"]).stuck
    loop = next(each for each in loops if each.stuck == stuck)
    responses = loop.open_loop_responses(gains["stiffness"], gains["damping"], frequencies, period)
    named = {f"motor {i + 1}": response for i, response in enumerate(responses) if i not in stuck}
    title = f"{options.subject[0]}: loops of the PD, each opened at one motor{describe_stuck_motors(stuck)}"
    return [bode_diagram(frequencies, named, out, title)]


def _learning(options: argparse.Namespace, out: Path) -> list[Path]:
    from flexman_gym.toolbox.view.learning_curves import draw_learning_curves, read_progress

    runs, label = {}, options.column
    for folder in map(Path, options.subject):
        seeds = sorted(each.parent for each in folder.glob("*/progress.csv")) or [folder]
        found = [read_progress(seed, label) for seed in seeds]
        label = found[0][2]
        runs[folder.name] = [(steps, values) for steps, values, _ in found]
    return [draw_learning_curves(runs, out, str(label))]


def _league(options: argparse.Namespace, out: Path) -> list[Path]:
    from flexman_gym.toolbox.league.charts import draw_charts
    from flexman_gym.toolbox.league.rows import LeagueRows
    from flexman_gym.toolbox.league.standings import Standings

    folder = Path(options.subject[0])
    results, out = LeagueRows.load(folder), options.out or folder
    if out.suffix:
        raise ValueError(f"--out: {out} is not allowed; give a folder, as a league has several plots")
    out.mkdir(parents=True, exist_ok=True)
    paths = draw_charts(Standings(results), out, options.what == "robustness")
    if not paths:
        allowed = "the folder of a league" + (" with sweeps" if options.what == "robustness" else "")
        raise ValueError(f"subject: {folder} is not allowed; give {allowed}")
    return paths


def _episode(options: argparse.Namespace, out: Path) -> list[Path]:
    from flexman_gym.simulation.episode import Episode
    from flexman_gym.toolbox.view.trajectories import draw_episodes

    loaded = [Episode.load(path) for path in options.subject]
    names = [each.name for each in loaded]
    labels = [name if names.count(name) == 1 else f"{name} {i + 1}" for i, name in enumerate(names)]
    draw_episodes(dict(zip(labels, loaded, strict=True)), out)
    return [out]


def _side(options: argparse.Namespace, out: Path) -> list[Path]:
    from flexman_gym.simulation.episode import Episode
    from flexman_gym.toolbox.view.comparison import side_by_side
    from flexman_gym.toolbox.view.video import write_video

    episodes = [Episode.load(path) for path in options.subject]
    size, rate, seconds, hold = VIDEO
    if out.suffix == ".gif":
        size, rate, seconds, hold = GIF
        seconds = min(seconds, max(float(each.time[-1]) for each in episodes))
        rate = min(rate, 100.0 / math.ceil(100.0 * seconds / GIF_FRAMES))  # GIFs count hundredths of a second
    return [write_video(side_by_side(episodes, size, rate, seconds, hold), out, rate)]


# size (pixels), frames per second, longest motion (s) and still end (s) of `side_by_side`
GIF, VIDEO = ((480, 360), 10.0, 20.0, 2.0), ((1280, 720), 50.0, math.inf, 0.0)
GIF_FRAMES = 80  # frames of the motion in a GIF
PLOTS: dict[str, Callable[[argparse.Namespace, Path], list[Path]]] = {
    "modes": _modes, "map": _map, "bode": _bode, "campbell": _campbell, "learning": _learning, "league": _league,
    "robustness": _league, "episode": _episode, "side": _side,
}  # fmt: skip


EXAMPLES = (
    "flexman draw modes FlexRRR-v0 --angles 0.3 0.5 -1.0",
    "flexman draw bode FlexOne-v0 --out loops.png",
    "flexman draw campbell one_link --fastest 60",
)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)
