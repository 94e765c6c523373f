"""Tell how an arm rings over postures and payloads, and what input shapers leave of it."""

import argparse
import csv
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from flexman_gym.commands import CommandLine

if TYPE_CHECKING:
    from flexman_gym.control.input_shaping.shapers import OperatingPoint, ShaperEvaluation
    from flexman_gym.model.model import Model

DEFAULT_POSTURES, MAX_ANGLE = (
    8,
    1.2,
)  # how many are looked at; rad, up to which they are drawn for an arm without a task
MAX_FREQUENCY = 25.0  # Hz, of the vibrations that the model of an arm without an environment has to show
MOTOR_STATES = ("held", "free")


def _arguments(result: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    from flexman_gym.scene.serialization import ARMS

    where = (
        f"an environment as `flexman evaluate` takes it, an arm ({', '.join(ARMS)}), or a file with an arm or a scene"
    )
    result.add_argument("arm", help=where)
    ends = ("LOW", "HIGH")
    result.add_argument("--payload", type=float, nargs=2, metavar=ends, help="kg; else what the environment draws")
    result.add_argument(
        "--postures", type=int, default=DEFAULT_POSTURES, help="goals of an environment's first episodes"
    )
    result.add_argument("--csv", type=Path, metavar="FILE", help="a table of all modes and what is left of them")


def _run(options: argparse.Namespace) -> int:
    """Print modes, shapers and a recommendation; return 0."""
    from flexman_gym.control.input_shaping.shapers import evaluate_shapers, find_operating_points

    if options.postures < 1:
        options.parser.error(f"--postures: {options.postures} is not allowed; give a whole number > 0")
    model, postures, payloads = _find_model(options.arm, options.postures)
    if options.payload:
        payloads = [options.payload[0], sum(options.payload) / 2.0, options.payload[1]]
    cases = find_operating_points(model, postures, payloads)
    print(f"{options.arm}: {len(postures)} postures, payloads of {', '.join(f'{mass:g}' for mass in payloads)} kg")
    if not all(len(case.held) for case in cases):
        print("recommendation: none, for nothing bends that the motors move")
        return 0
    answers = evaluate_shapers(cases)
    print("\n".join([*_mode_lines(cases), "", *_shaper_lines(answers), "", _recommendation(cases, answers)]))
    if options.csv:
        _write_table(options.csv, cases, answers)
    return 0


def _find_model(name: str, count: int) -> "tuple[Model, np.ndarray, list[float]]":
    """Return the model of an arm, postures (count, n) rad and payloads (kg)."""
    from flexman_gym.common import files
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.fidelity.model_selection import assembled_modes
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
    episodes, disturbed = venv.unwrapped.episodes, environment.disturbed  # type: ignore[attr-defined]
    result = episodes.batch.model, episodes.view.goal_angles.copy(), disturbed.payload_mass if disturbed else None
    venv.close()
    return result


def _mode_lines(cases: "Sequence[OperatingPoint]") -> list[str]:
    """Return a line for each mode: its frequencies and damping ratios over all cases."""
    result = [f"{'mode':<18}{'Hz, least':>12}{'median':>10}{'most':>10}{'damping ratio':>22}{'tip, m/rad':>12}"]
    for motors in MOTOR_STATES:
        found = [getattr(case, motors) for case in cases]
        for number in range(min(map(len, found))):
            frequency, ratio, tip = np.array([modes[number] for modes in found]).T
            ratios, moves = f"{ratio.min():.2g} to {ratio.max():.2g}", f"{np.median(tip):.3g}"
            line = f"{f'{number + 1}, motors {motors}':<18}{frequency.min():>12.4g}{np.median(frequency):>10.4g}"
            line += f"{frequency.max():>10.4g}{ratios:>22}"
            result.append(line + (f"{moves:>12}" if motors == "held" else ""))
    return result


def _shaper_lines(answers: "Sequence[ShaperEvaluation]") -> list[str]:
    """Return a line for each shaper: delay, tolerated frequency error, residual vibration (median and worst case)."""
    from flexman_gym.control.input_shaping.shapers import TOLERATED_RESIDUAL

    count = answers[0].residuals.shape[1]
    heads = "".join(f"{f'mode {number + 1}, %':>16}" for number in range(count))
    result = [
        f"{'shaper, of modes':<20}{'delay, s':>10}{f'bears for {TOLERATED_RESIDUAL:g} %':>20}{'tip, %':>16}{heads}"
    ]
    for each in answers:
        errors = f"{each.tolerated_errors[0]:+.0%} to {each.tolerated_errors[1]:+.0%}"
        columns = [each.tip, *each.residuals.T]
        cells = "".join(f"{f'{np.median(left):.1f} / {left.max():.1f}':>16}" for left in columns)
        result.append(f"{_shaper_name(each):<20}{each.delay:>10.3g}{errors:>20}{cells}")
    return [*result, "left: median / worst case, in percent of what one step of the motors causes"]


def _shaper_name(answer: "ShaperEvaluation") -> str:
    """Return the name of a shaper with its modes."""
    return f"{answer.name}, 1" if answer.modes == 1 else f"{answer.name}, 1 + 2"


def _recommendation(cases: "Sequence[OperatingPoint]", answers: "Sequence[ShaperEvaluation]") -> str:
    """Return the recommendation with its reason."""
    from flexman_gym.control.input_shaping.shapers import TIP_VIBRATION_LIMIT, median_operating_point, recommend_shaper

    best = recommend_shaper(answers)
    if best is not None:
        return (
            f"recommendation: {_shaper_name(best)}, designed for the middle case. It leaves {best.tip.max():.1f} % of "
            f"the "
            f"tip's vibration at worst. Of all that leave at most {TIP_VIBRATION_LIMIT:g} % it delays least, by "
            f"{best.delay:.3g} s."
        )
    least = min(answers, key=lambda answer: float(answer.tip.max()))
    row = int(least.tip.argmax())
    number = int((least.residuals[row] * cases[row].held[: least.residuals.shape[1], 2]).argmax())
    here, there = (float(case.held[number, 0]) for case in (median_operating_point(cases), cases[row]))
    return (
        f"recommendation: none. The best, {_shaper_name(least)}, leaves {least.tip.max():.1f} % of the tip's "
        f"vibration at "
        f"worst, and {TIP_VIBRATION_LIMIT:g} % is the most that is wanted. There mode {number + 1} is at {there:.3g} "
        f"Hz, in the "
        f"middle case at {here:.3g} Hz. Shape for the posture and payload of each slew, or damp by feedback."
    )


def _write_table(path: Path, cases: "Sequence[OperatingPoint]", answers: "Sequence[ShaperEvaluation]") -> None:
    """Write a row for each mode of each case; residual vibrations are those with held motors."""
    heads = [f"motor_angle_{i + 1}" for i in range(len(cases[0].posture))]
    heads += ["payload", "motors", "mode", "frequency", "damping_ratio", *map(_shaper_name, answers)]
    with path.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(heads)
        for row, case in enumerate(cases):
            for motors in MOTOR_STATES:
                for number, (frequency, ratio, _) in enumerate(getattr(case, motors).tolist()):
                    known = motors == "held" and number < answers[0].residuals.shape[1]
                    left = [f"{each.residuals[row, number]:.6g}" if known else "" for each in answers]
                    place = [f"{angle:.6g}" for angle in case.posture]
                    cells = [
                        *place,
                        f"{case.payload:.6g}",
                        motors,
                        number + 1,
                        f"{frequency:.8g}",
                        f"{ratio:.6g}",
                        *left,
                    ]
                    table.writerow(cells)


COMMAND = CommandLine(_arguments, _run)
