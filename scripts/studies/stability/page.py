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
    "**Stiff springs, not the motion, limit the step of an explicit method.** The springs have {soft:.0e} to "
    "{stiff:.0e} N m/rad. The limit of `rk4` falls from {first:.3g} ms on the softest to {last:.3g} ms on the "
    "stiffest. On soft springs it hardly changes, since the torsion of link 1 has a higher frequency than all springs. "
    "The error of `ros2` is {short} at 2.5 ms and {long} at 20 ms."
)
WITH_MODES = (
    "**The third mode of link 1, its torsion, reduces the limit of `rk4` from {two:.3g} to {three:.3g} ms.** The full "
    "model has a limit of {full:.2g} ms. The choice of modes therefore decides whether an explicit method is feasible. "
    "The error of `ros2` at 2.5 ms is {short} with any number of modes."
)
WITH_PAYLOAD = (
    "**A payload up to {heaviest:g} kg does not change the explicit limits.** The limit of `rk4` stays "
    "between {lowest:.3g} and {highest:.3g} ms. A payload lowers the low frequencies, whereas the highest "
    "frequency is a property of the links. The error of `ros2` at 20 ms is {long}."
)
IN_SPIN = (
    "The reference is the model with stiffening. **The linear model without stiffening fails here, not the methods.** "
    "Its deflection grows tenfold within 5 s above {limit:.2f} rad/s; the first frequency of the clamped link is "
    "{frequency:.2f} rad/s. The verdicts of all methods at the smallest step:"
)
IN_SPIN_STIFFENED = (
    "**With stiffening {sound} of {count} runs at {step:.3g} ms are ok.** The fastest spin is {fastest:g} rad/s. "
    "Some methods fail there at long steps, since no method has the stiffening in its Jacobian."
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
    "This page has the stability limits of all methods and their numerical damping. The highest frequency of the model "
    "determines and predicts the longest stable step of an explicit method. Stiff springs and fine meshes reduce this "
    "step, a payload does not. `ros2` is stable at far longer steps and damps modes that it does not resolve. "
    "Extrapolations amplify undamped vibrations in a band of steps."
)
HEAD = (
    "`python scripts/stability.py --folder docs/evidence` rewrites this page, its plots and its rows "
    "([stability.csv](stability.csv)). All numbers below are computed from the rows or from the coefficients of the "
    "methods. [ring_down.md](ring_down.md) compares our methods with MuJoCo."
)
COMPUTER = "Computed with {computer}."
READING = (
    "Every fixed-step method simulates a short motion. The reference tip is that of `dop853` at a tolerance of 1e-9. "
    "Each run has one of these verdicts:"
)
MEANINGS = {
    OK: "the tip stays within {threshold:g} mm of the reference",
    INACCURATE: "the tip error exceeds this threshold",
    DIVERGED: 'status "diverged", tip beyond two reaches, or energy error above ten times the energy turned over',
    NOT_CONVERGED: "the iteration of an implicit method failed",
}
PREDICTION = (
    "A step multiplies a vibration by at most 1 + {growth:.2g} while omega h is at most c. The predicted limit is c "
    "divided by the highest natural frequency of the straight arm with free joints. The measured limit is the step at "
    "which the energy of a small vibration just grows at this rate over 2000 steps."
)
LIMIT_HEADS = ("method", "c without any growth", "c of the prediction", "measured / predicted")
PREDICTED = (
    "**{right} of {count} predicted limits are correct to {tolerance}.** The largest error is {worst}. One property "
    "of the model, its highest frequency, therefore determines the step of an explicit method. `dopri5` at a fixed "
    "step has the smallest c. Slightly above it a vibration grows so slowly that short runs do not reveal it."
)
RADIUS_HEADS = ("method", "largest spectral radius", "at omega h")
GROWING = (
    "None of these methods has a stability limit of this kind, but a spectral radius above 1 slowly amplifies an "
    "undamped vibration in a band of omega h."
)
VIBRATION = (
    "The straight arm has the 2, 4 and 4 lowest modes of its links, without the torsion of link 1. Modes 1, 2 and 3 "
    "of the arm vibrate together, by micrometres and without damping. The rotors have 1 kg m^2. The tables contain "
    "the amplitudes and frequencies after 10 s."
)
DAMPED = (
    "**At 20 ms `ros2` is stable and leaves {ros2} of mode 2.** At this step `implicit_midpoint` preserves the "
    "amplitude, but vibrates at {frequency:.3g} Hz instead of {natural:.3g}. `extrapolated_euler_3` amplifies mode 2 "
    "at 5 ms, to {third_order}. If an extrapolation diverged, a mode was in its band of growth."
)
AMPLITUDES = (
    "The amplification factor predicts these amplitudes with a relative error of {worst:.1e}, if more than 0.1 % "
    "remains. Numerical damping can therefore be computed in advance. The semi-implicit Euler method and the corrected "
    "midpoint rules preserve amplitudes on average, but deviate by up to {euler} and {corrected} at an instant, since "
    "their conserved quantity is not exactly the energy."
)
IN_CONTROL_PERIODS = (
    "`generalised_alpha` has an auxiliary acceleration, which a `Simulator` carries over from one control period of "
    "20 ms to the next. At 5 ms the second mode retains {in_periods} in control periods and {in_one_run} in an "
    "uninterrupted run."
)
DRIFT_HEADS = ("method", "steps of 1 ms", "largest energy error (relative)", "verdict")
FINISHED = (
    "**Of {count} methods {finished} reach {steps:.0e} steps.** The smallest energy error is {error:.1e}, of `{best}`."
)
LOST = "Methods diverged if modes were in their band of growth."


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
        "# Stability and numerical damping",
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
    for quantity, head in ((KEPT, "amplitude of mode 2"), (FREQUENCY, "frequency of mode 2 (Hz)")):
        result = select(rows, study=f"{DAMPING} 1", parameter=2.0, quantity=quantity)
        cells = []
        for name in methods_of(result):
            own = {row.step: row for row in select(result, method=name)}
            cells.append([name, *(_damped(own[step]) for step in DAMPING_STEPS)])
        lines += [*markdown_table([head, *steps], cells), ""]
    shares = ((f"mode {mode}", *(_share(rows, "ros2", step, mode) for step in DAMPING_STEPS)) for mode in (1, 2, 3))
    lines += [*markdown_table(["amplitude with ros2", *steps], shares), ""]
    return [*lines, _damping_conclusion(rows), "", *_amplitude_conclusions(rows)]


def _damping_conclusion(rows: Sequence[StabilityRow]) -> str:
    result = select(rows, study=f"{DAMPING} 1", parameter=2.0)
    slow = select(result, method="implicit_midpoint", step=0.02, quantity=FREQUENCY)[0]
    natural = select(result, quantity=NATURAL)[0].value
    shares = {"ros2": _share(rows, "ros2", 0.02), "third_order": _share(rows, "extrapolated_euler_3", 0.005)}
    return DAMPED.format(**shares, frequency=slow.value, natural=natural)


def _amplitude_conclusions(rows: Sequence[StabilityRow]) -> list[str]:
    kept = [row for row in rows if row.quantity == KEPT and row.verdict in (OK, INACCURATE) and row.value > 1e-3]
    euler, corrected = (
        max(abs(row.value - 1.0) for row in kept if row.method.startswith(name))
        for name in ("semi_implicit_euler", "midpoint_corrected")
    )
    others = [row for row in kept if not row.method.startswith(("semi_implicit_euler", "midpoint_corrected"))]
    worst = max(abs(row.value / (row.expected or math.nan) - 1.0) for row in others)
    share = partial(_share, rows, "generalised_alpha", 0.005)
    periods = IN_CONTROL_PERIODS.format(in_periods=share(quantity=IN_PERIODS), in_one_run=share())
    return [AMPLITUDES.format(worst=worst, euler=_percent(euler), corrected=_percent(corrected)), "", periods, ""]


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
