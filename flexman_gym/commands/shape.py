"""Shape a trajectory so that an arm stops without vibration.

SUBJECT is a CSV file of the ringing after a stop, in any units, or an arm. The trajectory is a CSV file with units in
its header, or a message of ROS with a JointTrajectory (YAML, JSON). Without it, the modes of the arm over postures and
payloads are printed, with the residual vibration of each input shaper and a recommendation.
"""

import argparse
import csv
import io
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from flexman_gym.commands import CommandLine, output_file
from flexman_gym.common.checks import finite, whole_number
from flexman_gym.common.errors import value_error
from flexman_gym.common.files import write_file
from flexman_gym.common.formatting import text_table

if TYPE_CHECKING:
    from flexman_gym.model.model import Model
    from flexman_gym.toolbox.controllers.input_shaping.motion import Motion
    from flexman_gym.toolbox.controllers.input_shaping.shaped_motion import ShapedMotion
    from flexman_gym.toolbox.controllers.input_shaping.shapers import OperatingPoint, ShaperEvaluation
    from flexman_gym.toolbox.identification.ringing import Ringing

DEFAULT_POSTURES, MAX_POSTURES = 8, 10_000  # number of postures without --postures; largest number
MAX_ANGLE = 1.2  # rad; largest joint angle of random postures, for an arm without a task
MAX_FREQUENCY = 25.0  # Hz; highest frequency in the model of an arm without an environment
SHOWN_POINTS = 20_000  # most points of a line in a plot
SHOWN_CYCLES = 10.0  # cycles of the first mode in a plot after the stop
MOTOR_STATES = ("held", "free")


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    from flexman_gym.toolbox.controllers.input_shaping.shaped_motion import AUTO, LIMITS, SCALING
    from flexman_gym.toolbox.controllers.input_shaping.shapers import SHAPERS

    names = "environment as in flexman evaluate, arm (flexman list arms), or file of an arm or a scene"
    parser.add_argument("subject", help=f"CSV file of the ringing, {names}")
    parser.add_argument("trajectory", type=Path, nargs="?", help="CSV, YAML or JSON file of joint positions over time")
    about = "shaped trajectory, in the form of the given one"
    parser.add_argument("--out", type=output_file, metavar="FILE", help=about)
    parser.add_argument(
        "--residual",
        type=float,
        metavar="X",
        default=0.05,
        help="allowed residual, as a fraction (default: %(default)s)",
    )
    parser.add_argument(
        "--shaper", default=AUTO, help=f"{', '.join(SHAPERS)}, {SCALING}, or {AUTO}: the shortest (default: {AUTO})"
    )
    parser.add_argument(
        "--limits", nargs="+", default=[], metavar="NAME=VALUE", help=f"{', '.join(LIMITS)}; rad or m, and s"
    )
    parser.add_argument(
        "--servo", type=float, metavar="HZ", help="bandwidth of the servos of an arm (default: its motors are held)"
    )
    parser.add_argument("--picture", type=output_file, metavar="FILE", help="plot of the trajectory and its vibration")
    parser.add_argument(
        "--column",
        action="append",
        metavar="NAME",
        help="column of a CSV file, once for each (default: all but commands)",
    )
    parser.add_argument("--rate", type=float, metavar="HZ", help="sampling rate of the shaped trajectory")
    parser.add_argument("--payload", type=float, nargs=2, metavar=("LOW", "HIGH"), help="range of the payload, kg")
    parser.add_argument(
        "--postures",
        type=int,
        metavar="N",
        default=DEFAULT_POSTURES,
        help="without trajectory: number of postures, the first goals (default: %(default)s)",
    )
    parser.add_argument("--csv", type=output_file, metavar="FILE", help="without trajectory: table of all modes")


def _run(options: argparse.Namespace) -> int:
    """Shape a trajectory and write it, or print the modes of an arm or a record; return 0."""
    from flexman_gym.toolbox.controllers.input_shaping.shaped_motion import ShapedMotion

    ringing, motion = _read(options)
    if motion is None:
        return _print_modes(ringing) if ringing else _compare(options)
    ringing = ringing or _arm_ringing(options, motion)
    given = [each.partition("=") for each in options.limits]
    limits = {name: finite(f"--limits {name}", _number(value)) for name, _, value in given}
    found = ShapedMotion.find(motion, ringing, options.residual, options.shaper, limits)
    _print_modes(ringing)
    if len(found.unshaped.values) > len(motion.values):
        print(f"the limits need {found.unshaped.duration:.4g} s in place of {motion.duration:.4g} s before shaping")
    print(f"shaper: {found.shaper}; {motion.duration:.4g} s become {found.motion.duration:.4g} s")
    for frequency, (nominal, low, high) in zip(ringing.frequencies, 100.0 * found.residuals, strict=True):
        print(f"residual at {frequency:.4g} Hz: {nominal:.2f} % of the unshaped one, from {low:.2f} to {high:.2f} %")
    if options.out:
        found.motion.write(options.out)
        print(f"{options.out}: {len(found.motion.values)} samples")
    if options.picture:
        _draw(found, ringing, options.picture)
    return 0


def _read(options: argparse.Namespace) -> "tuple[Ringing | None, Motion | None]":
    """Return the modes of a record and the trajectory, where given; print how their files were read to stderr.

    A chosen column may be one of the record, of the trajectory, or of both.
    """
    from flexman_gym.common.tables import is_table
    from flexman_gym.common.time_series import TimeSeries, listed
    from flexman_gym.toolbox.controllers.input_shaping.motion import Motion
    from flexman_gym.toolbox.identification.ringing import Ringing

    files = [path for path in (options.subject, options.trajectory) if path and is_table(path)]
    tables = {path: TimeSeries.read(path) for path in files}
    chosen = {path: [name for name in options.column or () if each.has(name)] for path, each in tables.items()}
    for name in options.column or ():
        if not any(name in names for names in chosen.values()):
            known = [each for table in tables.values() for each in table.columns]
            raise value_error("--column", name, f"one of {listed(known)}" if known else "none without a CSV file")
    ringing = motion = None
    if options.subject in tables:
        record = tables[options.subject].select(chosen[options.subject] or None)
        print("\n".join(record.remarks), file=sys.stderr)
        with warnings.catch_warnings(record=True, action="always", category=UserWarning) as remarks:
            ringing = Ringing.estimate(record.times, record.table, list(record.columns))
        for each in remarks:
            print(each.message, file=sys.stderr)
    if options.trajectory:
        motion = Motion.read(options.trajectory, options.rate, chosen.get(options.trajectory) or None)
        if motion.remarks:
            print("\n".join(motion.remarks), file=sys.stderr)
    return ringing, motion


def _number(text: str) -> object:
    """Return the number of a text, or the text."""
    try:
        return float(text)
    except ValueError:
        return text


def _arm_ringing(options: argparse.Namespace, motion: "Motion") -> "Ringing":
    """Return the modes of an arm at the end of a motion."""
    from flexman_gym.common.files import naming
    from flexman_gym.toolbox.controllers.input_shaping.predicted_ringing import predicted_ringing

    model, posture = _find_model(options.subject, 1)[0], motion.positions[-1]
    if len(posture) != model.n_joints:
        columns = f"{len(posture)} columns of positions"
        raise value_error(
            options.trajectory.name, columns, f"{model.n_joints}, one for each joint of {options.subject}"
        )
    with naming(options.subject):
        return predicted_ringing(model, posture, options.payload, options.residual, options.servo)


def _print_modes(ringing: "Ringing") -> int:
    """Print frequencies and damping ratios with their standard deviations; return 0."""
    assert ringing.damping is not None
    for values in np.reshape([ringing.measured, ringing.deviations], (2, 2, -1)).T.tolist():
        (frequency, error), (ratio, ratio_error) = values
        print(f"mode: {frequency:.5g} +- {error:.2g} Hz, damping ratio {ratio:.3g} +- {ratio_error:.2g}")
    return 0


def _draw(found: "ShapedMotion", ringing: "Ringing", path: Path) -> None:
    """Plot the position that moves most and the vibration that it excites, unshaped and shaped."""
    from scipy.signal import fftconvolve

    from flexman_gym.common.plot_style import BLUE, SLATE, new_figure, save_figure

    figure = new_figure((7.0, 4.4), 120, layout="constrained")
    motion, response = figure.subplots(2, 1, sharex=True)
    column = int(np.ptp(found.unshaped.positions, axis=0).argmax())
    period, rates = found.motion.period, 2.0 * np.pi * np.array(ringing.frequencies)
    count = int(len(found.motion.values) + SHOWN_CYCLES / (ringing.frequencies[0] * period))
    times, scale, apart = period * np.arange(count), 0.0, -(-count // SHOWN_POINTS)
    decay = np.exp(-np.outer(rates * np.array(ringing.damping), times)) * np.sin(np.outer(rates, times))
    for each, name, colour in ((found.unshaped, "unshaped", SLATE), (found.motion, found.shaper, BLUE)):
        positions = np.pad(each.positions[:, column], (1, count - len(each.values)), mode="edge")
        vibration = fftconvolve(decay.sum(axis=0), np.diff(positions, 2))[:count]
        scale = scale or 100.0 / np.abs(vibration).max()
        for axes, values in ((motion, positions[1:]), (response, scale * vibration)):
            axes.plot(times[::apart], values[::apart], color=colour, label=name)
    motion.set_ylabel("position (rad or m)")
    motion.legend(frameon=False)
    response.set(xlabel="time (s)", ylabel="vibration (% of largest)")
    print(f"{save_figure(figure, path)} shows position and predicted vibration.")


def _compare(options: argparse.Namespace) -> int:
    """Print modes of an arm, shapers and a recommendation; return 0."""
    from flexman_gym.toolbox.controllers.input_shaping.shapers import OperatingPoint, ShaperEvaluation

    count = whole_number("--postures", options.postures, 1, MAX_POSTURES)
    model, postures, payloads = _find_model(options.subject, count)
    if options.payload:
        payloads = [options.payload[0], sum(options.payload) / 2.0, options.payload[1]]
    cases = OperatingPoint.find(model, postures, payloads)
    print(f"{options.subject}: {len(postures)} postures, payloads of {', '.join(f'{mass:g}' for mass in payloads)} kg")
    if not all(len(case.held) for case in cases):
        print("recommendation: none, as the motors excite no vibration")
        return 0
    median, evaluations, best = ShaperEvaluation.compare(cases)
    sentence = _recommendation(cases, evaluations, median, best)
    print("\n".join([*_mode_lines(cases), "", *_shaper_lines(evaluations), "", sentence]))
    if options.csv:
        _write_table(options.csv, cases, evaluations)
    return 0


def _find_model(name: str, count: int) -> "tuple[Model, np.ndarray, list[float]]":
    """Return the model of an arm, postures (count, n) rad and payloads (kg)."""
    from flexman_gym.common import files
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.model.assembled_modes import assembled_modes
    from flexman_gym.model.model import build_model
    from flexman_gym.scene.serialization import ARMS, SUFFIXES, find_arm

    data = files.read_data(Path(name)) if name.endswith(SUFFIXES) else None
    if name in ARMS or (isinstance(data, dict) and ("arm" in data or "links" in data) and "id" not in data):
        arm = find_arm(name)
        model = build_model(arm, 2, assembled_modes(arm, 2, MAX_FREQUENCY))
        postures = np.random.default_rng(0).uniform(-MAX_ANGLE, MAX_ANGLE, (count, arm.n_joints))
        drawn = None
    else:
        model, postures, drawn = _environment_model(Configuration.find(name), count)
    nominal = float(model.constants.payload_mass[0])
    low, high = drawn or (0.0, 2.0 * nominal)
    return model, postures, sorted({low, 0.5 * (low + high), high})


def _environment_model(environment: object, count: int) -> "tuple[Model, np.ndarray, tuple[float, float] | None]":
    """Return the model of an environment, goals of its first episodes (count, n) rad, and its payloads (kg)."""
    import gymnasium as gym

    from flexman_gym.envs.config.configuration import Configuration

    assert isinstance(environment, Configuration)
    venv = gym.make_vec(environment.id, count, "vector_entry_point", **environment.keywords())
    venv.reset(seed=list(range(count)))  # type: ignore[arg-type]
    episodes, disturbed = venv.unwrapped.episodes, environment.disturbances  # type: ignore[attr-defined]
    result = episodes.batch.model, episodes.view.goal_angles.copy(), disturbed.payload_mass if disturbed else None
    venv.close()
    return result


def _mode_lines(cases: "Sequence[OperatingPoint]") -> list[str]:
    """Return a line for each mode: frequencies (Hz) and damping ratios over all operating points."""
    result = [f"{'mode':<18}{'Hz, lowest':>12}{'median':>10}{'highest':>10}{'damping ratio':>22}{'tip, m/rad':>12}"]
    for motors in MOTOR_STATES:
        found = [getattr(case, motors) for case in cases]
        for number in range(min(map(len, found))):
            frequency, ratio, tip = np.array([modes[number] for modes in found]).T
            ratios, moves = f"{ratio.min():.2g} to {ratio.max():.2g}", f"{np.median(tip):.3g}"
            line = f"{f'{number + 1}, motors {motors}':<18}{frequency.min():>12.4g}{np.median(frequency):>10.4g}"
            line += f"{frequency.max():>10.4g}{ratios:>22}"
            result.append(line + (f"{moves:>12}" if motors == "held" else ""))
    return result


def _shaper_lines(evaluations: "Sequence[ShaperEvaluation]") -> list[str]:
    """Return a line for each shaper: delay, tolerated frequency error, median and largest residual vibration."""
    from flexman_gym.toolbox.controllers.input_shaping.shapers import TOLERATED_RESIDUAL

    count = evaluations[0].residuals.shape[1]
    modes = [f"mode {number + 1}, %" for number in range(count)]
    heads, rows = ["shaper, of modes", "delay, s", f"error at {TOLERATED_RESIDUAL:g} %", "tip, %", *modes], []
    for each in evaluations:
        errors = f"{each.tolerated_errors[0]:+.0%} to {each.tolerated_errors[1]:+.0%}"
        columns = [each.tip, *each.residuals.T]
        cells = [f"{np.median(residual):.1f} / {residual.max():.1f}" for residual in columns]
        rows.append([_shaper_name(each), f"{each.delay:.3g}", errors, *cells])
    return [
        *text_table(heads, rows),
        f"error: change of the frequency with a residual vibration of {TOLERATED_RESIDUAL:g} %",
        "tip and modes: residual vibration, median / worst case, in percent of that after an unshaped step",
    ]


def _shaper_name(shaper: "ShaperEvaluation") -> str:
    """Return the name of a shaper with its modes."""
    return f"{shaper.name}, 1" if shaper.modes == 1 else f"{shaper.name}, 1 + 2"


def _recommendation(
    cases: "Sequence[OperatingPoint]",
    evaluations: "Sequence[ShaperEvaluation]",
    middle: "OperatingPoint",
    best: "ShaperEvaluation | None",
) -> str:
    """Return the recommendation with its reason."""
    from flexman_gym.toolbox.controllers.input_shaping.shapers import TIP_VIBRATION_LIMIT

    if best is not None:
        return (
            f"recommendation: {_shaper_name(best)}, designed for the median case. In the worst case it leaves "
            f"{best.tip.max():.1f} % of the vibration of the tip. Its delay of {best.delay:.3g} s is the shortest of "
            f"all shapers that leave at most {TIP_VIBRATION_LIMIT:g} %."
        )
    best = min(evaluations, key=lambda each: float(each.tip.max()))
    row = int(best.tip.argmax())
    number = int((best.residuals[row] * cases[row].held[: best.residuals.shape[1], 2]).argmax())
    median, worst = (float(case.held[number, 0]) for case in (middle, cases[row]))
    return (
        f"recommendation: none. The best shaper, {_shaper_name(best)}, leaves {best.tip.max():.1f} % of the vibration "
        f"of the tip in the worst case, more than {TIP_VIBRATION_LIMIT:g} %: there mode {number + 1} is at "
        f"{worst:.3g} Hz, in the median case at {median:.3g} Hz. Design the shaper for the posture and payload of each "
        f"slew, or damp the vibration by feedback."
    )


def _write_table(path: Path, cases: "Sequence[OperatingPoint]", evaluations: "Sequence[ShaperEvaluation]") -> None:
    """Write a row for each mode of each operating point; residual vibrations are computed with held motors."""
    heads = [f"motor_angle_{i + 1}" for i in range(len(cases[0].posture))]
    heads += ["payload", "motors", "mode", "frequency", "damping_ratio", *map(_shaper_name, evaluations)]
    text = io.StringIO(newline="")
    table = csv.writer(text)
    table.writerow(heads)
    for row, case in enumerate(cases):
        for motors in MOTOR_STATES:
            for number, (frequency, ratio, _) in enumerate(getattr(case, motors).tolist()):
                known = motors == "held" and number < evaluations[0].residuals.shape[1]
                left = [f"{each.residuals[row, number]:.6g}" if known else "" for each in evaluations]
                place = [f"{angle:.6g}" for angle in case.posture]
                mode = [motors, number + 1, f"{frequency:.8g}", f"{ratio:.6g}"]
                table.writerow([*place, f"{case.payload:.6g}", *mode, *left])
    write_file(path, text.getvalue())


EXAMPLES = (
    "flexman shape FlexRRR-v0  # modes, and a recommended shaper",
    "flexman shape planar_2r --postures 4 --csv modes.csv",
)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)
