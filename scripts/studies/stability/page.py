"""Stability page: the tables and conclusions under the charts, whose numbers all come from the rows."""

import math
from collections import Counter
from collections.abc import Sequence
from functools import partial
from itertools import product

from flexman_gym.simulation.amplification import stability_limit
from flexman_gym.simulation.methods import METHODS
from flexman_gym.verification.markdown import markdown_table
from studies.methods import explicit_methods, methods_of
from studies.stability.conclusions import map_sections, names_of, percent
from studies.stability.damping import DAMPING, DAMPING_STEPS, FREQUENCY, IN_PERIODS, KEPT, NATURAL
from studies.stability.drift import DRIFT
from studies.stability.limits import AMPLIFICATION, LIMIT
from studies.stability.maps import THRESHOLD
from studies.stability.measure import (
    DIVERGED,
    INACCURATE,
    INVENTED,
    LIMIT_TOLERANCE,
    NOT_CONVERGED,
    OK,
    VERDICTS,
    Row,
    growth_per_step,
    select,
)

HEAD = (
    "`python scripts/stability.py --folder docs` writes this page, its pictures and its rows "
    "([stability.csv](stability.csv)) anew; every number below comes from the rows, or from the coefficients of "
    "a method. No other simulator stands beside these; [ring_down.md](ring_down.md) has MuJoCo's."
)
MACHINE = "Computed with {machine}."
READING = (
    "Every fixed-step method follows a short motion of which the tip is known from `dop853` at a tolerance of 1e-9. A "
    "run is *ok* when its tip stays within {threshold:g} mm of that, *inaccurate* when not. It has *diverged* when its "
    "status says so, when its tip is further than two reaches away, or when it invented ten times the energy turned "
    "over. *Not converged* is the status of an implicit method whose iteration failed."
)
PREDICTION = (
    "The prediction is c / omega_max with the highest natural frequency of the straight arm, its joints free. c is the "
    "largest omega h at which a step multiplies a vibration by no more than 1 + {growth:.2g}: the growth that the "
    "measurement, the energy of a small vibration over 2000 steps, just tolerates."
)
LIMIT_HEADS = ("method", "c without any growth", "c of the prediction", "measured / predicted")
PREDICTED = (
    "**{right} of {count} predicted limits are right to {tolerance}; the worst is off by {worst}.** One number of the "
    "model, its highest frequency, therefore decides the step of an explicit method. `dopri5` at a fixed step is a "
    "special case: strictly it has the smallest c, and beyond it grows at first so slowly that short runs do not show "
    "it."
)
RADIUS_HEADS = ("other method", "largest spectral radius", "at omega h")
GROWING = (
    "No method of this second table has a limit in the sense of the first, but {methods} multiply an undamped "
    "vibration by more than 1 in a band of omega h: what they gain in order, they pay with a slow growth that only "
    "damping of the arm, or a step away from the band, can hold."
)
VIBRATION = (
    "The straight arm, cut to 2, 4 and 4 modes of its links (without link 1's torsion), vibrates with micrometres in "
    "its modes 1, 2 and 3 at once, without any damping. Amplitude and frequency after 10 s, rotors of 1 kg m^2:"
)
# What a method keeps of a mode at a step, such as that of ros2 at 5 ms in mode 2: ros2_5_2.
DAMPED = (
    "**At 5 ms `ros2` keeps {ros2_5_1}, {ros2_5_2} and {ros2_5_3} of modes 1, 2 and 3; at 20 ms {ros2_20_1}, "
    "{ros2_20_2} and {ros2_20_3}: a stable run that destroyed the vibration.** `implicit_midpoint` keeps {midpoint} of "
    "mode 2 at 20 ms, but it swings at {frequency:.3g} Hz instead of {natural:.3g}. `extrapolated_euler_3` does the "
    'opposite at 5 ms: {third_order} of mode 2 are "left". `extrapolated_euler_5` is the most faithful of the linearly '
    "implicit ones at 5 ms ({fifth_order}), and yet it and its kin diverge at other steps ({diverged}), where some "
    "mode falls into their band of growth."
)
AMPLITUDES = (
    "The amplification factor predicts these amplitudes to {worst:.1e} of themselves (where more than 0.1 % is left); "
    "the semi-implicit Euler method keeps them, but reads up to {euler} off at an instant, because what it conserves "
    "is not quite the energy. Numerical damping can therefore be computed before a run."
)
IN_CONTROL_PERIODS = (
    "`generalised_alpha` carries an acceleration of its own from step to step, and a `Simulator` keeps it from one "
    "control period of 20 ms to the next: of mode 2 at 5 ms {in_periods} are then left, as in one run ({in_one_run})."
)
DRIFT_HEADS = ("method", "steps of 1 ms", "largest energy error (relative)", "verdict")
FINISHED = (
    "**Of {count} methods {finished} reach {steps:.0e} steps; the smallest energy error is {error:.1e}, of `{best}`.**"
)
LOST = "{methods} diverged: modes in their band of growth took over."
STUCK = "The iteration of {methods} failed on the way."
ENERGIES = (
    "The energy of `ros2` is off by up to {ros2:.1e}, that of `implicit_midpoint` by {midpoint:.1e} as far as it came."
)


def summary(rows: Sequence[Row]) -> str:
    """How many rows of each study have which verdict."""
    lines = []
    for study in dict.fromkeys(row.study for row in rows):
        count = Counter(row.verdict for row in rows if row.study == study)
        lines.append(f"{study}: " + ", ".join(f"{count[verdict]} {verdict}" for verdict in VERDICTS if count[verdict]))
    limits = select(rows, quantity=LIMIT)
    return "\n".join([*lines, f"largest departure from a predicted limit: {percent(worst_limit(limits))}"])


def worst_limit(limits: Sequence[Row]) -> float:
    """The largest relative departure of a measured limit from its prediction."""
    return max(abs(row.value / (row.expected or math.nan) - 1.0) for row in limits)


def page(machine: str, rows: Sequence[Row]) -> str:
    """The page as Markdown, from all rows; `machine` says what computed them."""
    head = ["# Stability: where methods fail, and what they damp", "", HEAD, "", MACHINE.format(machine=machine), ""]
    reading = ["## How to read the maps", "", READING.format(threshold=1e3 * THRESHOLD), ""]
    sections = [*_limits(rows), *map_sections(rows), *_damping(rows), *_drift(rows)]
    return "\n".join([*head, *reading, *sections]).rstrip() + "\n"


def _limits(rows: Sequence[Row]) -> list[str]:
    result, growth = select(rows, quantity=LIMIT), growth_per_step()
    lines = ["## Limits of explicit methods", "", "![limits](stability_step_limit.png)", ""]
    lines += [PREDICTION.format(growth=growth), ""]
    lines += markdown_table(LIMIT_HEADS, (_limit(name, select(result, method=name)) for name in methods_of(result)))
    numbers = {"right": len(select(result, verdict=OK)), "count": len(result)}
    texts = {"tolerance": percent(LIMIT_TOLERANCE), "worst": percent(worst_limit(result))}
    lines += ["", PREDICTED.format(**numbers, **texts), ""]
    amplified = select(rows, study=AMPLIFICATION)
    lines += markdown_table(
        RADIUS_HEADS, ((row.method, f"{row.value:.6f}", f"{row.parameter:.3g}") for row in amplified)
    )
    growing = [row.method for row in amplified if row.value > 1.0 + 1e-9]
    return [*lines, "", GROWING.format(methods=names_of(growing)), ""]


def _limit(name: str, own: Sequence[Row]) -> list[str]:
    """The cells of a method in the table of limits."""
    method, ratios = METHODS[name], [row.value / (row.expected or math.nan) for row in own]
    limits = [f"{stability_limit(method, growth):.4g}" for growth in (0.0, growth_per_step())]
    return [name, *limits, f"{min(ratios):.4f} to {max(ratios):.4f}"]


def _damping(rows: Sequence[Row]) -> list[str]:
    lines = ["## Numerical damping", "", "![damping](stability_damping.png)", "", VIBRATION, ""]
    for quantity, head in ((KEPT, "amplitude of mode 2 kept"), (FREQUENCY, "frequency of mode 2 (Hz)")):
        result = select(rows, study=f"{DAMPING} 1", parameter=2.0, quantity=quantity)
        cells = []
        for name in methods_of(result):
            own = {row.step: row for row in select(result, method=name)}
            cells.append([name, *(_damped(own[step]) for step in DAMPING_STEPS)])
        lines += [*markdown_table([head, *(f"{1e3 * step:g} ms" for step in DAMPING_STEPS)], cells), ""]
    return [*lines, _damping_conclusion(rows), "", *_amplitude_conclusions(rows)]


def _damping_conclusion(rows: Sequence[Row]) -> str:
    share, result = partial(_share, rows), select(rows, study=f"{DAMPING} 1", parameter=2.0)
    slow = select(result, method="implicit_midpoint", step=0.02, quantity=FREQUENCY)[0]
    diverged = ", ".join(
        f"`{row.method}` at {1e3 * row.step:g} ms"
        for row in select(result, quantity=KEPT, verdict=DIVERGED)
        if row.method not in explicit_methods()
    )
    places = product((0.005, 0.02), (1, 2, 3))
    shares = {f"ros2_{1e3 * step:g}_{mode}": share("ros2", step, mode) for step, mode in places}
    shares |= {
        "midpoint": share("implicit_midpoint", 0.02),
        "third_order": share("extrapolated_euler_3", 0.005),
        "fifth_order": share("extrapolated_euler_5", 0.005),
    }
    natural = select(result, quantity=NATURAL)[0].value
    return DAMPED.format(**shares, diverged=diverged, frequency=slow.value, natural=natural)


def _amplitude_conclusions(rows: Sequence[Row]) -> list[str]:
    kept = [row for row in rows if row.quantity == KEPT and row.verdict in (OK, INACCURATE) and row.value > 1e-3]
    euler = max(abs(row.value - 1.0) for row in kept if row.method == "semi_implicit_euler")
    others = [row for row in kept if row.method != "semi_implicit_euler"]
    worst = max(abs(row.value / (row.expected or math.nan) - 1.0) for row in others)
    share = partial(_share, rows, "generalised_alpha", 0.005)
    periods = IN_CONTROL_PERIODS.format(in_periods=share(quantity=IN_PERIODS), in_one_run=share())
    return [AMPLITUDES.format(worst=worst, euler=percent(euler)), "", periods, ""]


def _share(rows: Sequence[Row], name: str, step: float, mode: float = 2.0, quantity: str = KEPT) -> str:
    """What a method leaves of a mode of the arm with rotors of 1 kg m^2."""
    wanted = {"study": f"{DAMPING} 1", "method": name, "step": step, "parameter": mode, "quantity": quantity}
    return percent(select(rows, **wanted)[0].value)


def _drift(rows: Sequence[Row]) -> list[str]:
    result = select(rows, study=DRIFT)
    last = {name: select(result, method=name)[-1] for name in methods_of(result)}
    cells = [(name, f"{row.parameter:.3g}", f"{row.value:.1e}", row.verdict) for name, row in last.items()]
    finished = [row for row in last.values() if row.verdict in (OK, INACCURATE)]
    best = min(finished, key=lambda row: row.value)
    numbers = {"count": len(last), "finished": len(finished), "steps": best.parameter, "error": best.value}
    sentences = [FINISHED.format(**numbers, best=best.method)]
    for verdict, sentence in ((DIVERGED, LOST), (NOT_CONVERGED, STUCK)):
        failed = [name for name, row in last.items() if row.verdict == verdict]
        if failed:
            sentences.append(sentence.format(methods=names_of(failed)))
    sentences.append(ENERGIES.format(ros2=last["ros2"].value, midpoint=last["implicit_midpoint"].value))
    lines = ["## Long runs", "", "![drift](stability_drift.png)", "", *markdown_table(DRIFT_HEADS, cells)]
    return [*lines, "", " ".join(sentences), ""]


def _damped(row: Row) -> str:
    if math.isnan(row.value):
        return row.verdict
    if row.verdict == DIVERGED and (row.quantity == FREQUENCY or row.value > INVENTED):
        return DIVERGED
    text = f"{row.value:.3f}" if row.quantity == FREQUENCY else percent(row.value)
    return f"{text} ({DIVERGED})" if row.verdict == DIVERGED else text
