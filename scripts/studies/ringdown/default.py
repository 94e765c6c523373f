"""Ring-down, default: how far energy and tip of the environments' default are from converged runs, on many arms."""

from dataclasses import dataclass

from flexman_gym.envs.setup import Setup, build
from studies.ringdown.cases import BENT, DURATION, IMPULSE, PERIOD, RELEASE, SLEW, Cases, cases
from studies.ringdown.measure import REFERENCE, differences, outcome, percentiles

KINDS, EARLY, WITHIN = (RELEASE, BENT, IMPULSE, SLEW), 1.0, 0.02  # s; part of the energy


@dataclass(frozen=True)
class Errors:
    """Errors of the default's method and step on arms of one kind.

    Attributes:
        kind: what the arms do; see `cases`.
        time: after which they are compared, s.
        arms: how many.
        within: the part of them whose energy is off by at most 2 %.
        energy_median, energy_90, energy_99, tip_median, tip_90, tip_95, tip_99: see `measure.Row`.
    """

    kind: str
    time: float
    arms: float
    within: float
    energy_median: float
    energy_90: float
    energy_99: float
    tip_median: float
    tip_90: float
    tip_95: float
    tip_99: float


def errors_of_default(count: int) -> list[Errors]:
    """Compares so many arms of each kind after a second and at the end."""
    chosen, result = build(Setup()), []
    for kind in KINDS:
        each = cases(kind, count)
        for time in (EARLY, DURATION[kind]):
            part = Cases(each.states, each.drives[: round(time / PERIOD)])
            ours, truth = (
                outcome(chosen.model, part, *how) for how in ((str(chosen.method), chosen.step), (REFERENCE, None))
            )
            energy, tip = differences(ours, truth)
            within = float((energy <= WITHIN).mean())
            result.append(Errors(kind, time, float(count), within, **percentiles(energy, tip)))
    return result
