"""Ring-down, measure: energy and tip of methods beside those of converged runs, as rows."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from flexman_gym.arrays import Array, Flags
from flexman_gym.kernels import layout
from flexman_gym.kernels.layout import IntArray
from flexman_gym.model.model import Model
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.families import EXPLICIT, LinearlyImplicit, Sweeps
from flexman_gym.simulation.methods import METHODS
from studies.methods import fixed_step_methods
from studies.ringdown.cases import DURATION, PERIOD, UNDAMPED, Cases, cases, default_model

PARTS, FINE_PARTS = (1, 2, 3, 4, 8, 16), (20, 40, 80)  # steps in a control period; the latter of explicit methods
REFERENCE, RTOL = "dop853", 1e-8
FLOOR = 0.02  # of the energy at the start: what is left of less is not asked for more digits


@dataclass(frozen=True)
class Row:
    """Arms of one kind by one method and step.

    Attributes:
        kind: what the arms do; see `cases`.
        code: whose arm it is.
        method: of integration.
        step: s.
        cpu: seconds of the processor for a simulated second of one arm.
        energy_median, energy_90, energy_99: percentiles of the energy error, relative to the energy that should be left
            or 2 % of that at the start; infinite where an arm failed.
        tip_median, tip_90, tip_95, tip_99: percentiles of the distance of the tip from the converged one at the end, m.
        kept: median of the energy left at the end by the arms that did not fail, as a part of that at the start.
        failed: part of the arms that failed.
    """

    kind: str
    code: str
    method: str
    step: float
    cpu: float
    energy_median: float
    energy_90: float
    energy_99: float
    tip_median: float
    tip_90: float
    tip_95: float
    tip_99: float
    kept: float
    failed: float


class Outcome(NamedTuple):
    """Tips (b, 3) m and energies (b,) J at the end, the largest energies of start and first period, status, seconds."""

    tip: Array
    energy: Array
    first: Array
    status: IntArray
    seconds: float


def moving_energy(batch: Batch) -> Array:
    """Gives kinetic and elastic energy (b,) J."""
    return batch.outputs[:, layout.KINETIC : layout.GRAVITATIONAL].sum(axis=1)


def outcome(model: Model, each: Cases, method: str, step: float | None) -> Outcome:
    """Moves arms by a method with a step (s), or by an adaptive one (None)."""
    batch = Batch(model, method, step, PERIOD, RTOL, 1e-2 * RTOL, arms=len(each.states))
    batch.reset(np.arange(len(each.states)), each.states)
    first, started = moving_energy(batch), time.process_time()
    for period, drive in enumerate(each.drives):
        batch.step(drive)
        if period == 0:
            first = np.maximum(first, moving_energy(batch))
    seconds = time.process_time() - started
    tips = batch.outputs[:, layout.TIP].copy()
    return Outcome(tips, moving_energy(batch), first, batch.status.copy(), seconds)


def settings(method: str) -> Sequence[int]:
    """Gives the numbers of steps in a control period that a method is tried with."""
    return FINE_PARTS if METHODS[method].kind == EXPLICIT else PARTS


def rows(kind: str, count: int, few: int) -> Iterator[Row]:
    """Measures every method of fixed steps: those that move arms abreast on `count` arms, the others on a `few`."""
    model, each = default_model(kind == UNDAMPED), cases(kind, count)
    truth = outcome(model, each, REFERENCE, None)
    if (truth.status != layout.OK).any():
        raise RuntimeError(f"{kind}: the reference fails")
    for method in fixed_step_methods():
        many = count if isinstance(METHODS[method], LinearlyImplicit | Sweeps) else few
        own = Cases(each.states[:many], each.drives[:, :many])
        for parts in settings(method):
            yield row(kind, method, PERIOD / parts, outcome(model, own, method, PERIOD / parts), truth)


def row(kind: str, method: str, step: float, result: Outcome, truth: Outcome) -> Row:
    """Compares arms with the first of the converged ones."""
    b, failed = len(result.tip), result.status != layout.OK
    energy, tip = differences(result, truth)
    kept = median_kept(result.energy / np.maximum(result.first, 1e-12), failed)
    cpu = result.seconds / (b * DURATION[kind])
    shares = percentiles(energy, tip)
    return Row(kind, "flexman_gym", method, step, cpu, kept=kept, failed=float(failed.mean()), **shares)


def differences(result: Outcome, truth: Outcome) -> tuple[Array, Array]:
    """Gives the relative errors of energy (b,) and those of the tip (b,) m; infinite where an arm failed."""
    b, failed = len(result.tip), result.status != layout.OK
    scale = np.maximum(truth.energy[:b], FLOOR * truth.first[:b])
    energy = np.where(failed, np.inf, np.abs(result.energy - truth.energy[:b]) / scale)
    return energy, np.where(failed, np.inf, np.linalg.norm(result.tip - truth.tip[:b], axis=1))


def median_kept(kept: Array, failed: Flags) -> float:
    """Gives the median of the arms that did not fail; NaN where all did."""
    return np.nan if failed.all() else float(np.median(kept[~failed]))


def percentiles(energy: Array, tip: Array) -> dict[str, float]:
    """Gives those of a row. Each is one of the values, as some may be infinite."""

    def of(values: Array, q: float) -> float:
        return float(np.percentile(values, q, method="lower"))

    return {
        "energy_median": of(energy, 50),
        "energy_90": of(energy, 90),
        "energy_99": of(energy, 99),
        "tip_median": of(tip, 50),
        "tip_90": of(tip, 90),
        "tip_95": of(tip, 95),
        "tip_99": of(tip, 99),
    }
