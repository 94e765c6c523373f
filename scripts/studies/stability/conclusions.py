"""Stability conclusions: what the maps say, with numbers from their rows."""

from collections import Counter
from collections.abc import Sequence

from flexman_gym.verification.markdown import markdown_table
from studies.methods import methods_of
from studies.stability.cases import MODES, PAYLOAD, SPIN, SPIN_STIFFENED, SPRINGS
from studies.stability.limits import LIMIT
from studies.stability.maps import ERROR, SPIN_LIMIT
from studies.stability.measure import DIVERGED, NOT_CONVERGED, OK, VERDICTS, Row, select

TITLES = {
    SPRINGS: "Joint stiffness",
    MODES: "Modes",
    PAYLOAD: "Payload",
    SPIN: "Spin without stiffening",
    SPIN_STIFFENED: "Spin with stiffening",
}
HEADS = ("method", *VERDICTS, "largest step that is ok everywhere, ms", "steps that fail somewhere, ms")

# The limits are those of `rk4`, in ms; an error is a smallest and a largest one.
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


def map_sections(rows: Sequence[Row]) -> list[str]:
    """Lines of Markdown: a section a map, with its picture, counts and conclusion."""
    conclusions = {SPRINGS: _springs, MODES: _modes, PAYLOAD: _payload, SPIN: _spin, SPIN_STIFFENED: _spin_stiffened}
    return [line for study, conclude in conclusions.items() for line in _map(study, rows, conclude(rows))]


def _map(study: str, rows: Sequence[Row], conclusion: str) -> list[str]:
    title = TITLES[study]
    cells = select(rows, study=study, quantity=ERROR)
    lines = [f"## {title}", "", f"![{title}](stability_{study.replace(' ', '_')}.png)", ""]
    lines += markdown_table(HEADS, (_counts(name, select(cells, method=name)) for name in methods_of(cells)))
    return [*lines, "", conclusion, ""]


def _counts(name: str, cells: Sequence[Row]) -> list[str]:
    """How many cells of a method have which verdict, the largest step from which down all are ok, and steps that fail.

    A run fails when it diverges or does not converge.
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


def _springs(rows: Sequence[Row]) -> str:
    cells = select(rows, study=SPRINGS, quantity=ERROR)
    limits = select(rows, study=SPRINGS, quantity=LIMIT, method="rk4")
    soft, stiff = limits[0], limits[-1]
    numbers = {"soft": soft.parameter, "stiff": stiff.parameter, "first": 1e3 * soft.value, "last": 1e3 * stiff.value}
    texts = {"short": _error(cells, 0.0025), "long": _error(cells, 0.02)}
    return ON_SPRINGS.format(**numbers, **texts)


def _modes(rows: Sequence[Row]) -> str:
    cells = select(rows, study=MODES, quantity=ERROR)
    limits = {row.parameter: 1e3 * row.value for row in select(rows, study=MODES, quantity=LIMIT, method="rk4")}
    numbers = {"two": limits[2.0], "three": limits[3.0], "full": limits[12.0]}
    return WITH_MODES.format(**numbers, short=_error(cells, 0.0025))


def _payload(rows: Sequence[Row]) -> str:
    cells = select(rows, study=PAYLOAD, quantity=ERROR)
    limits = select(rows, study=PAYLOAD, quantity=LIMIT, method="rk4")
    values = [1e3 * row.value for row in limits]
    numbers = {"heaviest": limits[-1].parameter, "lowest": min(values), "highest": max(values)}
    return WITH_PAYLOAD.format(**numbers, long=_error(cells, 0.02))


def _spin(rows: Sequence[Row]) -> str:
    cells = select(rows, study=SPIN, quantity=ERROR)
    fine = select(cells, step=min(row.step for row in cells))
    limit = select(rows, quantity=SPIN_LIMIT)[0]
    text = IN_SPIN.format(limit=limit.value, frequency=limit.expected)
    rates = ((verdict, _rates(select(fine, verdict=verdict))) for verdict in VERDICTS)
    return "\n".join([text, "", *markdown_table(("verdict", "spin, rad/s"), (each for each in rates if each[1]))])


def _spin_stiffened(rows: Sequence[Row]) -> str:
    cells = select(rows, study=SPIN_STIFFENED, quantity=ERROR)
    smallest = min(row.step for row in cells)
    fine = select(cells, step=smallest)
    numbers = {"sound": len(select(fine, verdict=OK)), "count": len(fine), "step": 1e3 * smallest}
    numbers["fastest"] = max(row.parameter for row in cells)
    return IN_SPIN_STIFFENED.format(**numbers)


def _error(cells: Sequence[Row], step: float, name: str = "ros2") -> str:
    values = [1e3 * row.value for row in select(cells, method=name, step=step)]
    return RANGE.format(least=min(values), most=max(values))


def _rates(cells: Sequence[Row]) -> str:
    rates = sorted({row.parameter for row in cells})
    return ", ".join(f"{rate:g}" for rate in rates)


def percent(value: float) -> str:
    """A share in percent, with more digits near 100."""
    return f"{100.0 * value:.3g} %" if value < 0.9 or value > 1.1 else f"{100.0 * value:.2f} %"
