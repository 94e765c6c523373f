"""Stability page: the conclusions under the charts, whose numbers all come from the rows."""

import math
from collections import Counter
from collections.abc import Sequence
from functools import partial

from flexman_gym.simulation.amplification import stability_limit
from flexman_gym.simulation.methods import METHODS
from flexman_gym.studies.stability.cases import (
    AMPLIFICATION,
    DAMPING,
    DAMPING_STEPS,
    DRIFT,
    FREQUENCY,
    IN_PERIODS,
    INVENTED,
    KEPT,
    LIMIT,
    NATURAL,
    THRESHOLD,
)
from flexman_gym.studies.stability.conclusions import map_sections, names_of, percent
from flexman_gym.studies.stability.measure import (
    DIVERGED,
    EXPLICIT_METHODS,
    FIXED,
    INACCURATE,
    LIMIT_TOLERANCE,
    NOT_CONVERGED,
    OK,
    VERDICTS,
    Row,
    growth_per_step,
    select,
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
    lines = [
        "# Stability: where methods fail, and what they damp",
        "",
        "`python scripts/stability.py --folder docs` writes this page, its pictures and its rows "
        "([stability.csv](stability.csv)) anew; every number below comes from the rows, or from the coefficients of "
        "a method. Without MuJoCo on the machine, no other simulator stands beside these.",
        "",
        f"Computed with {machine}.",
        "",
        *_reading(),
        *_limits(rows),
        *map_sections(rows),
        *_damping(rows),
        *_drift(rows),
    ]
    return "\n".join(lines).rstrip() + "\n"


def _reading() -> list[str]:
    return [
        "## How to read the maps",
        "",
        "Every fixed-step method follows a short motion of which the tip is known from `dop853` at a tolerance of "
        f"1e-9. A run is *ok* when its tip stays within {1e3 * THRESHOLD:g} mm of that, *inaccurate* when not. It has "
        "*diverged* when its status says so, when its tip is further than two reaches away, or when it invented ten "
        "times the energy turned over. *Not converged* is the status of an implicit method whose iteration failed.",
        "",
    ]


def _limits(rows: Sequence[Row]) -> list[str]:
    found = select(rows, quantity=LIMIT)
    growth = growth_per_step()
    lines = [
        "## Limits of explicit methods",
        "",
        "![limits](stability_step_limit.png)",
        "",
        "The prediction is c / omega_max with the highest natural frequency of the straight arm, its joints free. c "
        f"is the largest omega h at which a step multiplies a vibration by no more than 1 + {growth:.2g}: the growth "
        "that the measurement, the energy of a small vibration over 2000 steps, just tolerates.",
        "",
        "| method | c without any growth | c of the prediction | measured / predicted |",
        "| --- | --- | --- | --- |",
    ]
    for name in EXPLICIT_METHODS:
        ratios = [row.value / (row.expected or math.nan) for row in select(found, method=name)]
        method = METHODS[name]
        lines.append(
            f"| {name} | {stability_limit(method):.4g} | {stability_limit(method, growth):.4g} | {min(ratios):.4f} to "
            f"{max(ratios):.4f} |"
        )
    right = sum(row.verdict == OK for row in found)
    lines += [
        "",
        f"**{right} of {len(found)} predicted limits are right to {percent(LIMIT_TOLERANCE)}; the worst is off by "
        f"{percent(worst_limit(found))}.** One number of the model, its highest frequency, therefore decides the step "
        "of an explicit method. `dopri5` at a fixed step is a special case: strictly it has the smallest c, and "
        "beyond it grows at first so slowly that short runs do not show it.",
        "",
        "| other method | largest spectral radius | at omega h |",
        "| --- | --- | --- |",
    ]
    amplified = select(rows, study=AMPLIFICATION)
    lines += [f"| {row.method} | {row.value:.6f} | {row.parameter:.3g} |" for row in amplified]
    growing = [row.method for row in amplified if row.value > 1.0 + 1e-9]
    lines += [
        "",
        f"No method of this second table has a limit in the sense of the first, but {names_of(growing)} multiply an "
        "undamped vibration by more than 1 in a band of omega h: what they gain in order, they pay with a slow "
        "growth that only damping of the arm, or a step away from the band, can hold.",
        "",
    ]
    return lines


def _damping(rows: Sequence[Row]) -> list[str]:
    lines = [
        "## Numerical damping",
        "",
        "![damping](stability_damping.png)",
        "",
        "The straight arm, cut to 2, 4 and 4 modes of its links (without link 1's torsion), vibrates with micrometres "
        "in its modes 1, 2 and 3 at once, without any damping. Amplitude and frequency after 10 s, rotors of 1 kg m^2:",
        "",
    ]
    for quantity, unit in ((KEPT, "amplitude of mode 2 kept"), (FREQUENCY, "frequency of mode 2 (Hz)")):
        lines += [f"| {unit} | " + " | ".join(f"{1e3 * step:g} ms" for step in DAMPING_STEPS) + " |"]
        lines += ["| --- " * (len(DAMPING_STEPS) + 1) + "|"]
        for name in FIXED:
            own = {row.step: row for row in select(rows, study=f"{DAMPING} 1", method=name, parameter=2.0,
                                                   quantity=quantity)}  # fmt: skip
            texts = [_damped(own[step]) for step in DAMPING_STEPS]
            lines.append(f"| {name} | " + " | ".join(texts) + " |")
        lines.append("")
    return [*lines, *_damping_conclusions(rows), *_amplitude_conclusions(rows)]


def _damping_conclusions(rows: Sequence[Row]) -> list[str]:
    natural = select(rows, study=f"{DAMPING} 1", quantity=NATURAL, parameter=2.0)[0].value
    slow = {"method": "implicit_midpoint", "step": 0.02, "parameter": 2.0, "quantity": FREQUENCY}
    frequency = select(rows, study=f"{DAMPING} 1", **slow)[0].value

    diverged = ", ".join(
        f"`{row.method}` at {1e3 * row.step:g} ms"
        for row in select(rows, study=f"{DAMPING} 1", quantity=KEPT, parameter=2.0, verdict=DIVERGED)
        if row.method not in EXPLICIT_METHODS
    )

    share = partial(_share, rows)
    return [
        f"**At 5 ms `ros2` keeps {share('ros2', 0.005, 1.0)}, {share('ros2', 0.005, 2.0)} and "
        f"{share('ros2', 0.005, 3.0)} of modes 1, 2 and 3; at 20 ms {share('ros2', 0.02, 1.0)}, "
        f"{share('ros2', 0.02, 2.0)} and {share('ros2', 0.02, 3.0)}: a stable run that destroyed the vibration.** "
        f"`implicit_midpoint` keeps {share('implicit_midpoint', 0.02, 2.0)} of mode 2 at 20 ms, but it swings at "
        f"{frequency:.3g} Hz instead of {natural:.3g}. `extrapolated_euler_3` does the opposite at 5 ms: "
        f"{share('extrapolated_euler_3', 0.005, 2.0)} of mode 2 are "
        '"left". `extrapolated_euler_5` is the most faithful of the linearly implicit ones at 5 ms '
        f"({share('extrapolated_euler_5', 0.005, 2.0)}), and yet it and its kin diverge at other steps ({diverged}), "
        "where some mode falls into their band of growth.",
        "",
    ]


def _amplitude_conclusions(rows: Sequence[Row]) -> list[str]:
    kept = [row for row in rows if row.quantity == KEPT and row.verdict in (OK, INACCURATE) and row.value > 1e-3]
    euler = max(abs(row.value - 1.0) for row in kept if row.method == "semi_implicit_euler")
    others = [row for row in kept if row.method != "semi_implicit_euler"]
    worst = max(abs(row.value / (row.expected or math.nan) - 1.0) for row in others)
    share = partial(_share, rows)
    return [
        f"The amplification factor predicts these amplitudes to {worst:.1e} of themselves (where more than 0.1 % is "
        f"left); the semi-implicit Euler method keeps them, but reads up to {percent(euler)} off at an instant, "
        "because what it conserves is not quite the energy. Numerical damping can therefore be computed before a run.",
        "",
        "`generalised_alpha` carries an acceleration of its own from step to step, and a `Simulator` keeps it from one "
        f"control period of 20 ms to the next: of mode 2 at 5 ms {share('generalised_alpha', 0.005, 2.0, IN_PERIODS)} "
        f"are then left, as in one run ({share('generalised_alpha', 0.005, 2.0)}).",
        "",
    ]


def _share(rows: Sequence[Row], name: str, step: float, mode: float, quantity: str = KEPT) -> str:
    """What a method leaves of a mode of the arm with rotors of 1 kg m^2."""
    wanted = {"study": f"{DAMPING} 1", "method": name, "step": step, "parameter": mode, "quantity": quantity}
    return percent(select(rows, **wanted)[0].value)


def _drift(rows: Sequence[Row]) -> list[str]:
    found = select(rows, study=DRIFT)
    lines = [
        "## Long runs",
        "",
        "![drift](stability_drift.png)",
        "",
        "| method | steps of 1 ms | largest energy error (relative) | verdict |",
        "| --- | --- | --- | --- |",
    ]
    last = {name: select(found, method=name)[-1] for name in FIXED}
    lines += [f"| {name} | {row.parameter:.3g} | {row.value:.1e} | {row.verdict} |" for name, row in last.items()]
    finished = [row for row in last.values() if row.verdict in (OK, INACCURATE)]
    best = min(finished, key=lambda row: row.value)
    lost = [name for name, row in last.items() if row.verdict == DIVERGED]
    stuck = [name for name, row in last.items() if row.verdict == NOT_CONVERGED]
    return [
        *lines,
        "",
        f"**Of {len(last)} methods {len(finished)} reach {best.parameter:.0e} steps; the smallest energy error is "
        f"{best.value:.1e}, of `{best.method}`.** "
        + (f"{names_of(lost)} diverged: modes in their band of growth took over. " if lost else "")
        + (f"The iteration of {names_of(stuck)} failed on the way. " if stuck else "")
        + f"The energy of `ros2` is off by up to {last['ros2'].value:.1e}, that of `implicit_midpoint` by "
        f"{last['implicit_midpoint'].value:.1e} as far as it came.",
        "",
    ]


def _damped(row: Row) -> str:
    if math.isnan(row.value):
        return row.verdict
    if row.verdict == DIVERGED and (row.quantity == FREQUENCY or row.value > INVENTED):
        return DIVERGED
    text = f"{row.value:.3f}" if row.quantity == FREQUENCY else percent(row.value)
    return f"{text} ({DIVERGED})" if row.verdict == DIVERGED else text
