"""Ring-down, default: how far the environments' default, and other methods beside it, are from converged runs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexman_gym.envs.setup import Setup, build
from flexman_gym.verification.markdown import markdown_table
from studies.ringdown.cases import BENT, DURATION, IMPULSE, PERIOD, RELEASE, SLEW, Cases, cases
from studies.ringdown.measure import REFERENCE, differences, outcome, percentiles

# Beside the default: what takes as long, and what is truer.
OTHERS = (("gauss_3_sweeps", PERIOD), ("midpoint_2_sweeps", PERIOD / 5), ("gauss_2_sweeps", PERIOD / 2),
          ("gauss_3_sweeps", PERIOD / 2))  # fmt: skip
KINDS, EARLY, WITHIN = (RELEASE, BENT, IMPULSE, SLEW), 1.0, 0.02  # s; part of the energy


@dataclass(frozen=True)
class Errors:
    """Errors of a method and step on arms of one kind.

    Attributes:
        method, step: of integration; s.
        kind: what the arms do; see `cases`.
        time: after which they are compared, s.
        arms: how many.
        cpu: microseconds of the processor for a control period of an arm.
        within: the part of them whose energy is off by at most 2 %.
        energy_median, energy_90, energy_99, tip_median, tip_90, tip_95, tip_99: see `measure.Row`.
    """

    method: str
    step: float
    kind: str
    time: float
    arms: float
    cpu: float
    within: float
    energy_median: float
    energy_90: float
    energy_99: float
    tip_median: float
    tip_90: float
    tip_95: float
    tip_99: float


def errors_of_default(count: int) -> list[Errors]:
    """Compares so many arms of each kind after a second and at the end, by the default and by others."""
    chosen, result = build(Setup()), []
    for kind in KINDS:
        each = cases(kind, count)
        for time in (EARLY, DURATION[kind]):
            part = Cases(each.states, each.drives[: round(time / PERIOD)])
            truth = outcome(chosen.model, part, REFERENCE, None)
            for method, step in ((str(chosen.method), float(chosen.step or 0.0)), *OTHERS):
                ours = outcome(chosen.model, part, method, step)
                energy, tip = differences(ours, truth)
                cpu = 1e6 * ours.seconds / (count * len(part.drives))
                within = float((energy <= WITHIN).mean())
                result.append(Errors(method, step, kind, time, float(count), cpu, within, **percentiles(energy, tip)))
    return result


def methods_table(rows: Sequence[Errors]) -> list[str]:
    """The table of docs/accuracy.md that has a row for each method and step."""
    heads = ("method", "step", "cost", "slew: tip, half", "95 %", "impulse: tip, half", "release, 1 s: energy, 90 %",
             "release, 3 s: within 2 %", "tip, 90 %", "both planes, 3 s: within 2 %", "tip, 90 %")  # fmt: skip
    cases = {(row.method, row.step, row.kind, row.time): row for row in rows}
    kinds = [(kind, time) for kind in KINDS for time in (EARLY, DURATION[kind])]
    ways = list(dict.fromkeys((row.method, row.step) for row in rows))
    lines = []
    for way in ways:
        slew, impulse, released, bent = (cases[*way, kind, DURATION[kind]] for kind in (SLEW, IMPULSE, RELEASE, BENT))
        cost = np.median([cases[*way, *case].cpu / cases[*ways[0], *case].cpu for case in kinds])
        tips = slew.tip_median, slew.tip_95, impulse.tip_median, released.tip_90, bent.tip_90
        half, most, hit, free, both = (f"{1e3 * tip:.3g} mm" for tip in tips)
        early = f"{100 * cases[*way, RELEASE, EARLY].energy_90:.1f} %"
        shares = f"{released.within:.0%}", f"{bent.within:.0%}"
        step = f"{1e3 * way[1]:.3g} ms"
        lines.append((f"`{way[0]}`", step, f"{cost:.2f}", half, most, hit, early, shares[0], free, shares[1], both))
    return markdown_table(heads, lines)
