"""Page of the stability study: step limits of explicit methods, and numerical damping."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence

from flexman_gym.common.markdown import markdown_table
from flexman_gym.simulation.methods import DEFAULT_METHOD, METHODS, IteratedGauss
from flexman_gym.simulation.stability import amplitude_range
from studies.methods import largest_growth, methods_of
from studies.screen import picture, screen
from studies.stability.charts import PICTURE, mapped_rows
from studies.stability.measure import (
    DIVERGED,
    LIMIT_TOLERANCE,
    MODES,
    OK,
    SPIN_STIFFENED,
    SPRINGS,
    VERDICTS,
    StabilityRow,
    select,
)
from studies.stability.rows import DAMPING, ERROR, FREQUENCY, KEPT, LIMIT, SPIN_LIMIT

ROTORS = f"{DAMPING} 1"  # study of the arm with rotors of 1 kg m^2

SHOWN = ("ros2", "generalised_alpha", "extrapolated_euler_3", "midpoint_corrected_3", "implicit_midpoint", "gauss_3")
STEPS = (0.001, 0.005, 0.02)  # s; steps of the table
MESSAGE = "Stiffer joints and more modes shorten the stable step, a payload does not"
QUESTION = "How long may the step of a method be, and how much does the method damp a vibration?"
ANSWER = """**The highest natural frequency of the model predicts the longest stable step of an explicit method:
{right} of {count} predicted limits are correct to {tolerance}.** Implicit methods have no such limit, but some damp
what they do not resolve."""
BODY = """{picture}

Stiff joint springs ({soft:.0e} to {stiff:.0e} N m/rad) lower the limit of `rk4` from {first:.3g} to {last:.3g} ms, more
modes from {two:.3g} (2 per link) to {full:.2g} ms. The table has the amplitude left of mode 2 after 10 s of an
undamped vibration. In a band of omega h, angular frequency times step, `extrapolated_euler_3` amplifies a vibration
by up to {growth:.2g} % per step.

{table}

Amplitudes are root mean squares over a second. Under `{default}` they oscillate meanwhile by at most (omega h)^2 / 12:
at 20 ms from {low:.4g} to {high:.4g} %.

Without stiffening a spinning link diverges above {spin:.2f} rad/s with any method, as theory predicts; with
stiffening {sound} of {all} runs at the smallest step are accurate to 1 mm.

A [map](../accuracy_and_speed.md#where-methods-fail) has up to {mapped} runs a cell. {failed}"""


def summary(rows: Sequence[StabilityRow]) -> str:
    """Return the numbers of rows of each study by verdict."""
    lines = []
    for study in dict.fromkeys(row.study for row in rows):
        count = Counter(row.verdict for row in rows if row.study == study)
        lines.append(f"{study}: " + ", ".join(f"{count[verdict]} {verdict}" for verdict in VERDICTS if count[verdict]))
    return "\n".join(lines)


def page(rows: Sequence[StabilityRow], files: Mapping[str, str]) -> str:
    """Return the page as Markdown; `files` is the file of the rows with its comment."""
    limits = select(rows, quantity=LIMIT)
    springs = select(limits, study=SPRINGS, method="rk4")
    modes = {row.parameter: 1e3 * row.value for row in select(limits, study=MODES, method="rk4")}
    stiffened = select(rows, study=SPIN_STIFFENED, quantity=ERROR)
    fine = select(stiffened, step=min(row.step for row in stiffened))
    answer = ANSWER.format(
        right=len(select(limits, verdict=OK)), count=len(limits), tolerance=f"{100 * LIMIT_TOLERANCE:g} %"
    )
    low, high = amplitude_bounds(rows, STEPS[-1])
    body = BODY.format(
        picture=picture(MESSAGE, PICTURE),
        soft=springs[0].parameter, stiff=springs[-1].parameter, first=1e3 * springs[0].value,
        last=1e3 * springs[-1].value, two=modes[2.0], full=modes[max(modes)], table="\n".join(_table(rows)),
        growth=100 * (largest_growth(METHODS["extrapolated_euler_3"])[0] - 1),
        default=DEFAULT_METHOD, low=100 * low, high=100 * high,
        mapped=_largest_cell(rows), failed=_failures(rows),
        spin=select(rows, quantity=SPIN_LIMIT)[0].value, sound=len(select(fine, verdict=OK)), all=len(fine),
    )  # fmt: skip
    return screen("Stability and numerical damping", QUESTION, answer, body, files, "stability")


def _largest_cell(rows: Sequence[StabilityRow]) -> int:
    """Return the number of runs of the largest cell of the map."""
    return max(Counter((row.method, row.step) for row in mapped_rows(rows)).values())


def _failures(rows: Sequence[StabilityRow]) -> str:
    """Return a sentence on the runs of the default method on the map that diverge."""
    mine = select(mapped_rows(rows), method=DEFAULT_METHOD)
    diverged = Counter(row.step for row in mine if row.verdict == DIVERGED)
    if not diverged:
        return f"None of the {len(mine)} runs of `{DEFAULT_METHOD}` diverges."
    steps = " and ".join(f"{1e3 * step:.3g} ms" for step in sorted(diverged))
    return f"Diverged runs of `{DEFAULT_METHOD}`: {diverged.total()} of {len(mine)}, at steps of {steps}."


def amplitude_bounds(rows: Sequence[StabilityRow], step: float, mode: float = 2.0) -> tuple[float, float]:
    """Return the bounds of the amplitude of a mode relative to its start, under the default method with a step (s).

    The frequency of the mode is that of `gauss_3` at the shortest step.
    """
    found = select(rows, study=ROTORS, parameter=mode, quantity=FREQUENCY, method="gauss_3")
    frequency = min(found, key=lambda row: row.step).value
    method = METHODS[DEFAULT_METHOD]
    assert isinstance(method, IteratedGauss)
    return amplitude_range(method, 2.0 * math.pi * frequency * step)


def _table(rows: Sequence[StabilityRow]) -> list[str]:
    """Return the table of amplitudes of mode 2 of the arm with rotors of 1 kg m^2."""
    kept = select(rows, study=ROTORS, parameter=2.0, quantity=KEPT)
    cells = [
        (name, *(_share(select(kept, method=name, step=step)[0]) for step in STEPS))
        for name in SHOWN if name in methods_of(kept)
    ]  # fmt: skip
    return markdown_table(("method", *(f"step {1e3 * step:g} ms" for step in STEPS)), cells)


def _share(row: StabilityRow) -> str:
    if math.isnan(row.value):
        return row.verdict
    text = f"{100.0 * row.value:.3g} %"
    return f"{text} ({DIVERGED})" if row.verdict == DIVERGED else text
