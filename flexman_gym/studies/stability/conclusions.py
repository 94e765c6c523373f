"""Stability conclusions: what the maps say, with numbers from their rows."""

import math
from collections import Counter
from collections.abc import Sequence

from flexman_gym.studies.stability.cases import (
    ERROR,
    LIMIT,
    MODES,
    PAYLOAD,
    SPIN,
    SPIN_LIMIT,
    SPIN_STIFFENED,
    SPRINGS,
    THRESHOLD,
)
from flexman_gym.studies.stability.measure import (
    DIVERGED,
    EXPLICIT_METHODS,
    FIXED,
    INACCURATE,
    NOT_CONVERGED,
    OK,
    VERDICTS,
    Row,
    select,
)

IMPLICIT_METHODS = tuple(name for name in FIXED if name not in EXPLICIT_METHODS)
TITLES = {SPRINGS: "Joint stiffness", MODES: "Modes", PAYLOAD: "Payload", SPIN: "Spin without stiffening",
          SPIN_STIFFENED: "Spin with stiffening"}  # fmt: skip


def map_sections(rows: Sequence[Row]) -> list[str]:
    """Lines of Markdown: a section a map, with its picture, counts and conclusion."""
    conclusions = {SPRINGS: _springs, MODES: _modes, PAYLOAD: _payload, SPIN: _spin, SPIN_STIFFENED: _spin_stiffened}
    return [line for study, conclude in conclusions.items() for line in _map(study, rows, conclude(rows))]


def _map(study: str, rows: Sequence[Row], conclusion: str) -> list[str]:
    title = TITLES[study]
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
        f"{1e3 * soft.value:.3g} to {1e3 * stiff.value:.3g} ms; stiff springs, not the motion, then pay for every "
        "step.** On soft springs it hardly falls, because there link 1's torsion is faster than all springs. Of the "
        f"other methods {_failures(cells)}. `ros2` at 2.5 ms is off by {_error(cells, 'ros2', 0.0025)}, at 20 ms by "
        f"{_error(cells, 'ros2', 0.02)}."
    )


def _modes(rows: Sequence[Row]) -> str:
    cells = select(rows, study=MODES, quantity=ERROR)
    limits = {row.parameter: 1e3 * row.value for row in select(rows, study=MODES, quantity=LIMIT, method="rk4")}
    return (
        f"**The third mode of link 1, its torsion, takes the limit of `rk4` from {limits[2.0]:.3g} ms with 2 modes a "
        f"link to {limits[3.0]:.3g} ms with 3, and the full model to {limits[12.0]:.2g} ms.** Which modes are kept "
        f"decides whether an explicit method is possible. Of the other methods {_failures(cells)}; `ros2` at 2.5 ms "
        f"is off by {_error(cells, 'ros2', 0.0025)} whatever is kept."
    )


def _payload(rows: Sequence[Row]) -> str:
    limits = select(rows, study=PAYLOAD, quantity=LIMIT, method="rk4")
    values = [1e3 * row.value for row in limits]
    cells = select(rows, study=PAYLOAD, quantity=ERROR)
    return (
        f"**A payload up to {limits[-1].parameter:g} kg leaves the explicit limits alone** (`rk4`: {min(values):.3g} "
        f"to {max(values):.3g} ms): it slows the low modes, and the highest frequency is inside the arm. `ros2` at 20 "
        f"ms is off by {_error(cells, 'ros2', 0.02)}."
    )


def _spin(rows: Sequence[Row]) -> str:
    cells = select(rows, study=SPIN, quantity=ERROR)
    limit = select(rows, quantity=SPIN_LIMIT)[0]
    fine = [row for row in cells if row.step == min(row.step for row in cells)]
    broken = sorted({row.parameter for row in fine if row.verdict == DIVERGED})
    sound = sorted({row.parameter for row in fine if row.verdict == OK})
    wrong = sorted({row.parameter for row in fine if row.verdict == INACCURATE})
    return (
        "The true tip is that of the model with stiffening. **The linear frame fails here, not the methods: at the "
        f"smallest step it is ok at {_rates(sound)}, more than {1e3 * THRESHOLD:g} mm off at {_rates(wrong)}, and its "
        f"deflection has grown absurd within 1 s at {_rates(broken)}, with every method.** Within 5 s it grows "
        f"tenfold from {limit.value:.2f} rad/s on; the first frequency of the clamped link is {limit.expected:.2f} "
        "rad/s. No step helps."
    )


def _spin_stiffened(rows: Sequence[Row]) -> str:
    cells = select(rows, study=SPIN_STIFFENED, quantity=ERROR)
    fastest = max(row.parameter for row in cells)
    smallest = min(row.step for row in cells)
    sound = sum(row.verdict == OK for row in cells if row.step == smallest)
    return (
        f"**With stiffening {sound} of {len(select(cells, step=smallest))} runs at {1e3 * smallest:.3g} ms are ok, up "
        f"to {fastest:g} rad/s.** In fast spin long steps fail nevertheless; no method here has the stiffening in its "
        f"Jacobian. Of the methods that are not explicit {_failures(cells)}."
    )


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


def _milliseconds(step: float) -> str:
    return "none" if math.isnan(step) else f"{1e3 * step:.3g}"


def percent(value: float) -> str:
    return f"{100.0 * value:.3g} %" if value < 0.9 or value > 1.1 else f"{100.0 * value:.2f} %"


def _rates(values: Sequence[float]) -> str:
    return ", ".join(f"{value:g}" for value in values) + " rad/s" if values else "no rate"


def names_of(names: Sequence[str]) -> str:
    quoted = [f"`{name}`" for name in names]
    return " and ".join([", ".join(quoted[:-1]), quoted[-1]] if len(quoted) > 1 else quoted)
