"""Stability page: the conclusions under the charts, whose numbers all come from the rows."""

import math
from collections import Counter
from collections.abc import Sequence

from flexman_gym.methods import METHODS
from flexman_gym.stability import (
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
    stability_limit,
)
from flexman_gym.stability_cases import (
    AMPLIFICATION,
    CASES,
    DAMPING,
    DAMPING_STEPS,
    DRIFT,
    ERROR,
    FREQUENCY,
    INVENTED,
    KEPT,
    LIMIT,
    LIMIT_STUDIES,
    MODES,
    PAYLOAD,
    RESTARTED,
    SPIN,
    SPIN_STIFFENED,
    SPRINGS,
    THRESHOLD,
)

IMPLICIT_METHODS = tuple(name for name in FIXED if name not in EXPLICIT_METHODS)


def summary(rows: Sequence[Row]) -> str:
    """How many rows of each study have which verdict."""
    lines = []
    for study in dict.fromkeys(row.study for row in rows):
        count = Counter(row.verdict for row in rows if row.study == study)
        lines.append(f"{study}: " + ", ".join(f"{count[verdict]} {verdict}" for verdict in VERDICTS if count[verdict]))
    limits = select(rows, quantity=LIMIT)
    return "\n".join([*lines, f"largest departure from a predicted limit: {_percent(worst_limit(limits))}"])


def worst_limit(limits: Sequence[Row]) -> float:
    """The largest relative departure of a measured limit from its prediction."""
    return max(abs(row.value / (row.expected or math.nan) - 1.0) for row in limits)


def page(machine: str, rows: Sequence[Row]) -> str:
    """The page as Markdown, from all rows; `machine` says what computed them."""
    lines = [
        "# Stability: where methods fail, and what they damp",
        "",
        "`python scripts/stability.py --folder docs` writes this page, its pictures and its rows "
        "([stability.csv](stability.csv)) anew; every number below comes from the rows, or from the coefficients of a "
        "method. Without MuJoCo on the machine, no other simulator stands beside these.",
        "",
        f"Computed with {machine}.",
        "",
        *_reading(),
        *_limits(rows),
        *_map(SPRINGS, rows, _springs(rows)),
        *_map(MODES, rows, _modes(rows)),
        *_map(PAYLOAD, rows, _payload(rows)),
        *_map(SPIN, rows, _spin(rows)),
        *_map(SPIN_STIFFENED, rows, _spin_stiffened(rows)),
        *_damping(rows),
        *_drift(rows),
    ]
    return "\n".join(lines).rstrip() + "\n"


def _reading() -> list[str]:
    return [
        "## How to read the maps",
        "",
        f"Every fixed-step method follows a short motion of which the tip is known from `dop853` at a tolerance of 1e-9. "
        f"A run is *ok* when its tip stays within {1e3 * THRESHOLD:g} mm of that, *inaccurate* when not. It has "
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
        "The prediction is c / omega_max with the highest natural frequency of the straight arm, its joints free. c is "
        f"the largest omega h at which a step multiplies a vibration by no more than 1 + {growth:.2g}: the growth that "
        "the measurement, the energy of a small vibration over 2000 steps, just tolerates.",
        "",
        "| method | c without any growth | c of the prediction | measured / predicted |",
        "| --- | --- | --- | --- |",
    ]
    for name in EXPLICIT_METHODS:
        ratios = [row.value / (row.expected or math.nan) for row in select(found, method=name)]
        method = METHODS[name]
        lines.append(
            f"| {name} | {stability_limit(method):.4g} | {stability_limit(method, growth):.4g} | "
            f"{min(ratios):.4f} to {max(ratios):.4f} |"
        )
    right = sum(row.verdict == OK for row in found)
    lines += [
        "",
        f"**{right} of {len(found)} predicted limits are right to {_percent(LIMIT_TOLERANCE)}; the worst is off by "
        f"{_percent(worst_limit(found))}.** One number of the model, its highest frequency, therefore decides the step of an "
        "explicit method. `dopri5` at a fixed step is a special case: strictly it has the smallest c, and beyond it "
        "grows at first so slowly that short runs do not show it.",
        "",
        "| other method | largest spectral radius | at omega h |",
        "| --- | --- | --- |",
    ]
    amplified = select(rows, study=AMPLIFICATION)
    lines += [f"| {row.method} | {row.value:.6f} | {row.parameter:.3g} |" for row in amplified]
    growing = [row.method for row in amplified if row.value > 1.0 + 1e-9]
    lines += [
        "",
        "No method of this second table has a limit in the sense of the first, but "
        f"{_names(growing)} multiply an undamped vibration by more than 1 in a band of omega h: what they gain in order, "
        "they pay with a slow growth that only damping of the arm, or a step away from the band, can hold.",
        "",
    ]
    return lines


def _map(study: str, rows: Sequence[Row], conclusion: str) -> list[str]:
    title = {SPRINGS: "Joint stiffness", MODES: "Modes", PAYLOAD: "Payload", SPIN: "Spin without stiffening",
             SPIN_STIFFENED: "Spin with stiffening"}[study]  # fmt: skip
    cells = select(rows, study=study, quantity=ERROR)
    lines = [f"## {title}", "", f"![{title}](stability_{study.replace(' ', '_')}.png)", ""]
    lines += ["| method | " + " | ".join(VERDICTS) + " | largest step that is ok everywhere (ms) |"]
    lines += ["| --- " * (len(VERDICTS) + 2) + "|"]
    for name in FIXED:
        own = select(cells, method=name)
        count = Counter(row.verdict for row in own)
        step = _ok_everywhere(own)
        lines.append(
            f"| {name} | " + " | ".join(str(count[verdict]) for verdict in VERDICTS) + f" | {_milliseconds(step)} |"
        )
    return [*lines, "", conclusion, ""]


def _springs(rows: Sequence[Row]) -> str:
    cells = select(rows, study=SPRINGS, quantity=ERROR)
    limits = select(rows, study=SPRINGS, quantity=LIMIT, method="rk4")
    soft, stiff = limits[0], limits[-1]
    return (
        f"**From {soft.parameter:.0e} to {stiff.parameter:.0e} N m/rad the limit of `rk4` falls from "
        f"{1e3 * soft.value:.3g} to {1e3 * stiff.value:.3g} ms; stiff springs, not the motion, then pay for every step.** "
        "On soft springs it hardly falls, because there link 1's torsion is faster than all springs. Of the other methods "
        f"{_failures(cells)}. `ros2` at 2.5 ms is off by "
        f"{_error(cells, 'ros2', 0.0025)}, at 20 ms by {_error(cells, 'ros2', 0.02)}."
    )


def _modes(rows: Sequence[Row]) -> str:
    cells = select(rows, study=MODES, quantity=ERROR)
    limits = {row.parameter: 1e3 * row.value for row in select(rows, study=MODES, quantity=LIMIT, method="rk4")}
    return (
        f"**The third mode of link 1, its torsion, takes the limit of `rk4` from {limits[2.0]:.3g} ms with 2 modes a link to "
        f"{limits[3.0]:.3g} ms with 3, and the full model to {limits[12.0]:.2g} ms.** Which modes are kept decides whether "
        f"an explicit method is possible. Of the other methods {_failures(cells)}; `ros2` at 2.5 ms is off "
        f"by {_error(cells, 'ros2', 0.0025)} whatever is kept."
    )


def _payload(rows: Sequence[Row]) -> str:
    limits = select(rows, study=PAYLOAD, quantity=LIMIT, method="rk4")
    values = [1e3 * row.value for row in limits]
    cells = select(rows, study=PAYLOAD, quantity=ERROR)
    return (
        f"**A payload up to {limits[-1].parameter:g} kg leaves the explicit limits alone** (`rk4`: {min(values):.3g} to "
        f"{max(values):.3g} ms): it slows the low modes, and the highest frequency is inside the arm. `ros2` at 20 ms is off "
        f"by {_error(cells, 'ros2', 0.02)}."
    )


def _spin(rows: Sequence[Row]) -> str:
    cells = select(rows, study=SPIN, quantity=ERROR)
    fine = [row for row in cells if row.step == min(row.step for row in cells)]
    broken = sorted({row.parameter for row in fine if row.verdict == DIVERGED})
    sound = sorted({row.parameter for row in fine if row.verdict == OK})
    wrong = sorted({row.parameter for row in fine if row.verdict == INACCURATE})
    return (
        "The true tip is that of the model with stiffening. **The linear frame fails here, not the methods: at the smallest "
        f"step it is ok at {_rates(sound)}, more than {1e3 * THRESHOLD:g} mm off at {_rates(wrong)}, and its deflection "
        f"grows without bound at {_rates(broken)}, with every method.** Its limit is the first bending frequency of the "
        "clamped link in the plane of rotation, 14.2 rad/s; no step helps."
    )


def _spin_stiffened(rows: Sequence[Row]) -> str:
    cells = select(rows, study=SPIN_STIFFENED, quantity=ERROR)
    fastest = max(row.parameter for row in cells)
    smallest = min(row.step for row in cells)
    sound = sum(row.verdict == OK for row in cells if row.step == smallest)
    return (
        f"**With stiffening {sound} of {len(select(cells, step=smallest))} runs at {1e3 * smallest:.3g} ms are ok, up to "
        f"{fastest:g} rad/s.** The stiffening is no part of the Jacobian of the linearly implicit methods, so that fast spin "
        f"limits them, too: of the methods that are not explicit {_failures(cells)}."
    )


def _damping(rows: Sequence[Row]) -> list[str]:
    lines = [
        "## Numerical damping",
        "",
        "![damping](stability_damping.png)",
        "",
        "The straight arm, cut to 2, 4 and 4 modes of its links (nothing above 136 Hz), vibrates with micrometres in its modes "
        "1, 2 and 3 at once, without any damping. Amplitude and frequency after 10 s, rotors of 1 kg m^2:",
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
    kept = [row for row in rows if row.quantity == KEPT and row.verdict in (OK, INACCURATE) and row.value > 1e-3]
    euler = max(abs(row.value - 1.0) for row in kept if row.method == "semi_implicit_euler")
    others = [row for row in kept if row.method != "semi_implicit_euler"]
    worst = max(abs(row.value / (row.expected or math.nan) - 1.0) for row in others)

    def share(name: str, step: float, mode: float, quantity: str = KEPT) -> str:
        wanted = {"study": f"{DAMPING} 1", "method": name, "step": step, "parameter": mode, "quantity": quantity}
        return _percent(select(rows, **wanted)[0].value)

    return [
        *lines,
        f"**At 5 ms `ros2` keeps {share('ros2', 0.005, 1.0)}, {share('ros2', 0.005, 2.0)} and {share('ros2', 0.005, 3.0)} of "
        f"modes 1, 2 and 3; at 20 ms {share('ros2', 0.02, 1.0)}, {share('ros2', 0.02, 2.0)} and "
        f"{share('ros2', 0.02, 3.0)}: a stable run that destroyed the vibration.** `implicit_midpoint` keeps "
        f"{share('implicit_midpoint', 0.02, 2.0)} of mode 2 at 20 ms, but it swings too slowly. "
        f"`extrapolated_euler_3` does the opposite at 5 ms: {share('extrapolated_euler_3', 0.005, 2.0)} of mode 2 are "
        '"left". `extrapolated_euler_5` is the most faithful of the linearly implicit ones at 5 ms '
        f"({share('extrapolated_euler_5', 0.005, 2.0)}).",
        "",
        f"The amplification factor predicts these amplitudes to {worst:.1e} of themselves (where more than 0.1 % is left); the "
        f"semi-implicit Euler method keeps them, but reads up to {_percent(euler)} off at an instant, because what it "
        "conserves is not quite the energy. Numerical damping can therefore be computed before a run.",
        "",
        "`generalised_alpha` carries an acceleration of its own from step to step. A `Simulator` starts it anew in every control "
        f"period of 20 ms, and of mode 2 at 5 ms {share('generalised_alpha', 0.005, 2.0, RESTARTED)} are then left instead of "
        f"{share('generalised_alpha', 0.005, 2.0)}; at 20 ms {share('generalised_alpha', 0.02, 2.0, RESTARTED)} instead of "
        f"{share('generalised_alpha', 0.02, 2.0)}. For control, count on the former.",
        "",
    ]


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
        + (f"{_names(lost)} diverged: modes in their band of growth took over. " if lost else "")
        + (f"The iteration of {_names(stuck)} failed on the way. " if stuck else "")
        + f"The energy of `ros2` is off by up to {last['ros2'].value:.1e}, that of `implicit_midpoint` by "
        f"{last['implicit_midpoint'].value:.1e} as far as it came.",
        "",
    ]


def _ok_everywhere(cells: Sequence[Row]) -> float:
    """The largest step from which down every cell is ok; NaN without one."""
    best = math.nan
    for step in sorted({row.step for row in cells}):
        if any(row.verdict != OK for row in cells if row.step == step):
            break
        best = step
    return best


def _failures(cells: Sequence[Row]) -> str:
    """Which methods that are not explicit fail, in how many cells, and at which steps."""
    texts = []
    for name in IMPLICIT_METHODS:
        own = select(cells, method=name)
        steps = sorted({1e3 * row.step for row in own if row.verdict in (DIVERGED, NOT_CONVERGED)})
        count = sum(row.verdict in (DIVERGED, NOT_CONVERGED) for row in own)
        if count:
            texts.append(
                f"`{name}` fails in {count} of {len(own)} cells ({', '.join(f'{step:.3g}' for step in steps)} ms)"
            )
    return ", ".join(texts) or "none fails"


def _error(cells: Sequence[Row], name: str, step: float) -> str:
    values = [1e3 * row.value for row in select(cells, method=name, step=step)]
    return f"{min(values):.2g} to {max(values):.2g} mm"


def _damped(row: Row) -> str:
    if math.isnan(row.value):
        return row.verdict
    if row.verdict == DIVERGED and (row.quantity == FREQUENCY or row.value > INVENTED):
        return DIVERGED
    text = f"{row.value:.3f}" if row.quantity == FREQUENCY else _percent(row.value)
    return f"{text} ({DIVERGED})" if row.verdict == DIVERGED else text


def _milliseconds(step: float) -> str:
    return "none" if math.isnan(step) else f"{1e3 * step:.3g}"


def _percent(value: float) -> str:
    return f"{100.0 * value:.3g} %" if value < 0.9 or value > 1.1 else f"{100.0 * value:.2f} %"


def _rates(values: Sequence[float]) -> str:
    return ", ".join(f"{value:g}" for value in values) + " rad/s" if values else "no rate"


def _names(names: Sequence[str]) -> str:
    quoted = [f"`{name}`" for name in names]
    return " and ".join([", ".join(quoted[:-1]), quoted[-1]] if len(quoted) > 1 else quoted)
