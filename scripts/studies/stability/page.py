"""Page of the stability study: tables and conclusions."""

import math
from collections import Counter
from collections.abc import Sequence
from functools import partial

from flexman_gym.common.markdown import markdown_table
from flexman_gym.simulation.methods import METHODS
from flexman_gym.simulation.stability import stability_limit
from studies.markdown import introduced_table
from studies.methods import methods_of
from studies.stability.measure import (
    DIVERGED,
    INACCURATE,
    INVENTED,
    LIMIT_TOLERANCE,
    MODES,
    NOT_CONVERGED,
    OK,
    PAYLOAD,
    SPIN,
    SPIN_STIFFENED,
    SPRINGS,
    VERDICTS,
    StabilityRow,
    growth_per_step,
    select,
)
from studies.stability.rows import (
    AMPLIFICATION,
    DAMPING,
    DAMPING_STEPS,
    DRIFT,
    ERROR,
    FREQUENCY,
    IN_PERIODS,
    KEPT,
    LIMIT,
    NATURAL,
    SPIN_LIMIT,
    THRESHOLD,
)

TITLES = {
    SPRINGS: "Joint stiffness",
    MODES: "Modes",
    PAYLOAD: "Payload",
    SPIN: "Spin without stiffening",
    SPIN_STIFFENED: "Spin with stiffening",
}
HEADS = ("method", *VERDICTS, "largest step that is ok everywhere, ms", "steps that fail somewhere, ms")

# Limits are those of `rk4`, in ms; errors are ranges.
ON_SPRINGS = (
    "**Stiff springs, not the motion, decide the step of an explicit method.** The springs have {soft:.0e} to "
    "{stiff:.0e} N m/rad. The limit of `rk4` falls from {first:.3g} ms on the softest to {last:.3g} ms on the "
    "stiffest. On soft springs it hardly falls, because there link 1's torsion is faster than all springs. "
    "`ros2` at 2.5 ms is off by {short}. At 20 ms it is off by {long}."
)
WITH_MODES = (
    "**The third mode of link 1, its torsion, takes the limit of `rk4` from {two:.3g} to {three:.3g} ms.** The full "
    "model has a limit of {full:.2g} ms. So the choice of modes decides whether an explicit method is possible. "
    "`ros2` at 2.5 ms is off by {short}, whatever is kept."
)
WITH_PAYLOAD = (
    "**A payload up to {heaviest:g} kg leaves the explicit limits alone.** The limit of `rk4` stays "
    "between {lowest:.3g} and {highest:.3g} ms. A payload slows the low modes, and the highest frequency is inside the "
    "arm. `ros2` at 20 ms is off by {long}."
)
IN_SPIN = (
    "The true tip is that of the model with stiffening. **The linear frame fails here, not the methods.** "
    "Within 5 s its deflection grows tenfold from {limit:.2f} rad/s on; the first frequency of the clamped link is "
    "{frequency:.2f} rad/s. The verdicts of all methods at the smallest step:"
)
IN_SPIN_STIFFENED = (
    "**With stiffening {sound} of {count} runs at {step:.3g} ms are ok.** The fastest spin is {fastest:g} rad/s. "
    "Some methods fail there at long steps: none has the stiffening in its Jacobian."
)
RANGE = "{least:.2g} to {most:.2g} mm"


def map_sections(rows: Sequence[StabilityRow]) -> list[str]:
    """Return the sections of the maps as Markdown lines: chart, counts and conclusion."""
    conclusions = {SPRINGS: _springs, MODES: _modes, PAYLOAD: _payload, SPIN: _spin, SPIN_STIFFENED: _spin_stiffened}
    return [line for study, conclude in conclusions.items() for line in _map(study, rows, conclude(rows))]


def _map(study: str, rows: Sequence[StabilityRow], conclusion: str) -> list[str]:
    title = TITLES[study]
    cells = select(rows, study=study, quantity=ERROR)
    lines = [f"## {title}", "", f"![{title}](stability_{study.replace(' ', '_')}.png)", ""]
    lines += markdown_table(HEADS, (_counts(name, select(cells, method=name)) for name in methods_of(cells)))
    return [*lines, "", conclusion, ""]


def _counts(name: str, cells: Sequence[StabilityRow]) -> list[str]:
    """Return the verdict counts of a method, the largest step with only ok cells below, and the range of failing steps.

    A run fails if it diverges or does not converge.
    """
    count = Counter(row.verdict for row in cells)
    best = 0.0
    for step in sorted({row.step for row in cells}):
        if any(row.verdict != OK for row in cells if row.step == step):
            break
        best = step
    failing = [row.step for row in cells if row.verdict in (DIVERGED, NOT_CONVERGED)]
    failed = dict.fromkeys(f"{1e3 * end(failing):.3g}" for end in (min, max)) if failing else ["none"]
    counts = (str(count[verdict]) for verdict in VERDICTS)
    return [name, *counts, f"{1e3 * best:.3g}" if best else "none", " to ".join(failed)]


def _springs(rows: Sequence[StabilityRow]) -> str:
    cells = select(rows, study=SPRINGS, quantity=ERROR)
    limits = select(rows, study=SPRINGS, quantity=LIMIT, method="rk4")
    soft, stiff = limits[0], limits[-1]
    numbers = {"soft": soft.parameter, "stiff": stiff.parameter, "first": 1e3 * soft.value, "last": 1e3 * stiff.value}
    texts = {"short": _error(cells, 0.0025), "long": _error(cells, 0.02)}
    return ON_SPRINGS.format(**numbers, **texts)


def _modes(rows: Sequence[StabilityRow]) -> str:
    cells = select(rows, study=MODES, quantity=ERROR)
    limits = {row.parameter: 1e3 * row.value for row in select(rows, study=MODES, quantity=LIMIT, method="rk4")}
    numbers = {"two": limits[2.0], "three": limits[3.0], "full": limits[12.0]}
    return WITH_MODES.format(**numbers, short=_error(cells, 0.0025))


def _payload(rows: Sequence[StabilityRow]) -> str:
    cells = select(rows, study=PAYLOAD, quantity=ERROR)
    limits = select(rows, study=PAYLOAD, quantity=LIMIT, method="rk4")
    values = [1e3 * row.value for row in limits]
    numbers = {"heaviest": limits[-1].parameter, "lowest": min(values), "highest": max(values)}
    return WITH_PAYLOAD.format(**numbers, long=_error(cells, 0.02))


def _spin(rows: Sequence[StabilityRow]) -> str:
    cells = select(rows, study=SPIN, quantity=ERROR)
    fine = select(cells, step=min(row.step for row in cells))
    limit = select(rows, quantity=SPIN_LIMIT)[0]
    text = IN_SPIN.format(limit=limit.value, frequency=limit.expected)
    rates = ((verdict, _rates(select(fine, verdict=verdict))) for verdict in VERDICTS)
    return "\n".join([text, "", *markdown_table(("verdict", "spin, rad/s"), (each for each in rates if each[1]))])


def _spin_stiffened(rows: Sequence[StabilityRow]) -> str:
    cells = select(rows, study=SPIN_STIFFENED, quantity=ERROR)
    smallest = min(row.step for row in cells)
    fine = select(cells, step=smallest)
    numbers = {"sound": len(select(fine, verdict=OK)), "count": len(fine), "step": 1e3 * smallest}
    numbers["fastest"] = max(row.parameter for row in cells)
    return IN_SPIN_STIFFENED.format(**numbers)


def _error(cells: Sequence[StabilityRow], step: float, name: str = "ros2") -> str:
    values = [1e3 * row.value for row in select(cells, method=name, step=step)]
    return RANGE.format(least=min(values), most=max(values))


def _rates(cells: Sequence[StabilityRow]) -> str:
    rates = sorted({row.parameter for row in cells})
    return ", ".join(f"{rate:g}" for rate in rates)


def _percent(value: float) -> str:
    """Return a share in percent, with more digits near 100."""
    return f"{100.0 * value:.3g} %" if value < 0.9 or value > 1.1 else f"{100.0 * value:.2f} %"


SAYS = (
    "Where each method stops being stable, and how much vibration it takes away. The highest frequency of the "
    "model decides the longest step of an explicit method, and predicts it. Stiff springs and fine meshes shorten "
    "that step, a payload does not. `ros2` bears far longer steps, and damps what it does not resolve. "
    "Extrapolations let undamped vibrations grow in a band of steps."
)
HEAD = (
    "`python scripts/stability.py --folder docs` writes this page, its pictures and its rows "
    "([stability.csv](stability.csv)) anew. Every number below comes from the rows, or from the coefficients of "
    "a method. [ring_down.md](ring_down.md) has MuJoCo beside our methods."
)
COMPUTER = "Computed with {computer}."
READING = (
    "Every fixed-step method follows a short motion. The true tip is that of `dop853` at a tolerance of 1e-9. "
    "A run has one of these verdicts:"
)
MEANINGS = {
    OK: "the tip stays within {threshold:g} mm of the true one",
    INACCURATE: "the tip does not stay so near",
    DIVERGED: "its status says so, its tip is beyond two reaches, or it invented ten times the energy turned over",
    NOT_CONVERGED: "the iteration of an implicit method failed",
}
PREDICTION = (
    "A step multiplies a vibration by at most 1 + {growth:.2g} while omega h is at most c. The predicted limit is c "
    "over the highest natural frequency of the straight arm, its joints free. The measurement takes the energy of a "
    "small vibration over 2000 steps, and just tolerates this growth."
)
LIMIT_HEADS = ("method", "c without any growth", "c of the prediction", "measured / predicted")
PREDICTED = (
    "**{right} of {count} predicted limits are right to {tolerance}.** The worst is off by {worst}. So one number of "
    "the model, its highest frequency, decides the step of an explicit method. `dopri5` at a fixed step has the "
    "smallest c. At longer steps a vibration grows so slowly at first that short runs do not show it."
)
RADIUS_HEADS = ("other method", "largest spectral radius", "at omega h")
GROWING = (
    "None of these methods has such a limit. But a method with a spectral radius above 1 slowly amplifies an undamped "
    "vibration in a band of omega h."
)
VIBRATION = (
    "The straight arm keeps the lowest modes of its links: 2, 4 and 4. The torsion of link 1 is not among them. "
    "Modes 1, 2 and 3 of the arm vibrate at once, by micrometres and without any damping. The rotors have 1 kg m^2. "
    "The tables hold what is left after 10 s."
)
DAMPED = (
    "**At 20 ms `ros2` is stable and leaves {ros2} of mode 2.** There `implicit_midpoint` keeps the amplitude, but "
    "swings at {frequency:.3g} Hz instead of {natural:.3g}. `extrapolated_euler_3` amplifies mode 2 at 5 ms, to "
    "{third_order}. Where an extrapolation diverged, some mode was in its band of growth."
)
AMPLITUDES = (
    "The amplification factor predicts these amplitudes to {worst:.1e} of themselves, where more than 0.1 % is left. "
    "So numerical damping can be computed before a run. The semi-implicit Euler method keeps an amplitude, but reads "
    "up to {euler} off at an instant, because what it conserves is not quite the energy."
)
IN_CONTROL_PERIODS = (
    "`generalised_alpha` carries an acceleration of its own from step to step. A `Simulator` keeps it from one control "
    "period of 20 ms to the next. At 5 ms it then leaves {in_periods} of the second mode, and {in_one_run} in one run."
)
DRIFT_HEADS = ("method", "steps of 1 ms", "largest energy error (relative)", "verdict")
FINISHED = (
    "**Of {count} methods {finished} reach {steps:.0e} steps.** The smallest energy error is {error:.1e}, of `{best}`."
)
LOST = "Where a method diverged, modes in its band of growth took over."


def summary(rows: Sequence[StabilityRow]) -> str:
    """Return the numbers of rows of each study by verdict."""
    lines = []
    for study in dict.fromkeys(row.study for row in rows):
        count = Counter(row.verdict for row in rows if row.study == study)
        lines.append(f"{study}: " + ", ".join(f"{count[verdict]} {verdict}" for verdict in VERDICTS if count[verdict]))
    limits = select(rows, quantity=LIMIT)
    return "\n".join([*lines, f"largest departure from a predicted limit: {_percent(_worst_limit(limits))}"])


def _worst_limit(limits: Sequence[StabilityRow]) -> float:
    """Return the largest relative error of a predicted limit."""
    return max(abs(row.value / (row.expected or math.nan) - 1.0) for row in limits)


def page(computer: str, rows: Sequence[StabilityRow]) -> str:
    """Return the page as Markdown; `computer` describes the computer of the study."""
    head = [
        "# Stability: where methods fail, and what they damp",
        "",
        SAYS,
        "",
        HEAD,
        "",
        COMPUTER.format(computer=computer),
        "",
    ]
    meanings = ((verdict, text.format(threshold=1e3 * THRESHOLD)) for verdict, text in MEANINGS.items())
    reading = ["## How to read the maps", "", *introduced_table(READING, ("verdict of a run", "meaning"), meanings)]
    sections = [*_limits(rows), *map_sections(rows), *_damping(rows), *_drift(rows)]
    return "\n".join([*head, *reading, *sections]).rstrip() + "\n"


def _limits(rows: Sequence[StabilityRow]) -> list[str]:
    result, growth = select(rows, quantity=LIMIT), growth_per_step()
    lines = ["## Limits of explicit methods", "", "![limits](stability_step_limit.png)", ""]
    lines += [PREDICTION.format(growth=growth), ""]
    lines += markdown_table(LIMIT_HEADS, (_limit(name, select(result, method=name)) for name in methods_of(result)))
    numbers = {"right": len(select(result, verdict=OK)), "count": len(result)}
    texts = {"tolerance": _percent(LIMIT_TOLERANCE), "worst": _percent(_worst_limit(result))}
    lines += ["", PREDICTED.format(**numbers, **texts), ""]
    amplified = select(rows, study=AMPLIFICATION)
    lines += markdown_table(
        RADIUS_HEADS, ((row.method, f"{row.value:.6f}", f"{row.parameter:.3g}") for row in amplified)
    )
    return [*lines, "", GROWING, ""]


def _limit(name: str, own: Sequence[StabilityRow]) -> list[str]:
    """Return the table cells of a method in the table of limits."""
    method, ratios = METHODS[name], [row.value / (row.expected or math.nan) for row in own]
    limits = [f"{stability_limit(method, growth):.4g}" for growth in (0.0, growth_per_step())]
    return [name, *limits, f"{min(ratios):.4f} to {max(ratios):.4f}"]


def _damping(rows: Sequence[StabilityRow]) -> list[str]:
    lines = ["## Numerical damping", "", "![damping](stability_damping.png)", "", VIBRATION, ""]
    steps = [f"{1e3 * step:g} ms" for step in DAMPING_STEPS]
    for quantity, head in ((KEPT, "amplitude of mode 2 kept"), (FREQUENCY, "frequency of mode 2 (Hz)")):
        result = select(rows, study=f"{DAMPING} 1", parameter=2.0, quantity=quantity)
        cells = []
        for name in methods_of(result):
            own = {row.step: row for row in select(result, method=name)}
            cells.append([name, *(_damped(own[step]) for step in DAMPING_STEPS)])
        lines += [*markdown_table([head, *steps], cells), ""]
    shares = ((f"mode {mode}", *(_share(rows, "ros2", step, mode) for step in DAMPING_STEPS)) for mode in (1, 2, 3))
    lines += [*markdown_table(["amplitude that ros2 keeps", *steps], shares), ""]
    return [*lines, _damping_conclusion(rows), "", *_amplitude_conclusions(rows)]


def _damping_conclusion(rows: Sequence[StabilityRow]) -> str:
    result = select(rows, study=f"{DAMPING} 1", parameter=2.0)
    slow = select(result, method="implicit_midpoint", step=0.02, quantity=FREQUENCY)[0]
    natural = select(result, quantity=NATURAL)[0].value
    shares = {"ros2": _share(rows, "ros2", 0.02), "third_order": _share(rows, "extrapolated_euler_3", 0.005)}
    return DAMPED.format(**shares, frequency=slow.value, natural=natural)


def _amplitude_conclusions(rows: Sequence[StabilityRow]) -> list[str]:
    kept = [row for row in rows if row.quantity == KEPT and row.verdict in (OK, INACCURATE) and row.value > 1e-3]
    euler = max(abs(row.value - 1.0) for row in kept if row.method == "semi_implicit_euler")
    others = [row for row in kept if row.method != "semi_implicit_euler"]
    worst = max(abs(row.value / (row.expected or math.nan) - 1.0) for row in others)
    share = partial(_share, rows, "generalised_alpha", 0.005)
    periods = IN_CONTROL_PERIODS.format(in_periods=share(quantity=IN_PERIODS), in_one_run=share())
    return [AMPLITUDES.format(worst=worst, euler=_percent(euler)), "", periods, ""]


def _share(rows: Sequence[StabilityRow], name: str, step: float, mode: float = 2.0, quantity: str = KEPT) -> str:
    """Return the remaining amplitude of a mode of the arm with rotors of 1 kg m^2."""
    wanted = {"study": f"{DAMPING} 1", "method": name, "step": step, "parameter": mode, "quantity": quantity}
    return _percent(select(rows, **wanted)[0].value)


def _drift(rows: Sequence[StabilityRow]) -> list[str]:
    result = select(rows, study=DRIFT)
    last = {name: select(result, method=name)[-1] for name in methods_of(result)}
    cells = [(name, f"{row.parameter:.3g}", f"{row.value:.1e}", row.verdict) for name, row in last.items()]
    finished = [row for row in last.values() if row.verdict in (OK, INACCURATE)]
    best = min(finished, key=lambda row: row.value)
    numbers = {"count": len(last), "finished": len(finished), "steps": best.parameter, "error": best.value}
    sentences = [FINISHED.format(**numbers, best=best.method)]
    if any(row.verdict == DIVERGED for row in last.values()):
        sentences.append(LOST)
    lines = ["## Long runs", "", "![drift](stability_drift.png)", "", *markdown_table(DRIFT_HEADS, cells)]
    return [*lines, "", " ".join(sentences), ""]


def _damped(row: StabilityRow) -> str:
    if math.isnan(row.value):
        return row.verdict
    if row.verdict == DIVERGED and (row.quantity == FREQUENCY or row.value > INVENTED):
        return DIVERGED
    text = f"{row.value:.3f}" if row.quantity == FREQUENCY else _percent(row.value)
    return f"{text} ({DIVERGED})" if row.verdict == DIVERGED else text
