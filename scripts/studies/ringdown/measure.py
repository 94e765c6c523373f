"""Ring-down study: cases, errors of methods and steps, errors of the default."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.effects.signals import static_shape
from flexman_gym.kernels import layout
from flexman_gym.kernels.layout import IntArray
from flexman_gym.model.model import Model, build_model
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.methods import EXPLICIT, METHODS, IteratedGauss, LinearlyImplicit
from studies.methods import fixed_step_methods

RELEASE, IMPULSE, SLEW, UNDAMPED, BENT = "release", "impulse", "slew", "release, undamped", "both planes"
DURATION = {RELEASE: 3.0, IMPULSE: 3.0, SLEW: 2.4, UNDAMPED: 3.0, BENT: 3.0}  # s
PERIOD = 0.02  # s, a control period
LARGEST_DEFLECTION, LARGEST_IMPULSE, LARGEST_TORQUE, HOLD = 0.05, 50.0, 300.0, 20  # m, N s, N m, periods
SPREAD, NARROW = np.array([np.pi, 1.5, 2.0]), 0.9  # rad; range of the initial joint angles; `NARROW` for BENT


class _Cases(NamedTuple):
    """Initial states (b, 2 d) and drives (periods, b, n + 6) of b arms, see `Batch.step`."""

    states: Array
    drives: Array


@cache
def default_model(undamped: bool = False) -> Model:
    """Return the model of FlexRRR-v0, optionally without damping."""
    model = resolve_fidelity(Configuration()).model
    if not undamped:
        return model
    choice = vars(model.choice)
    return build_model(replace(model.arm, modal_damping_ratio=0.0), **choice)


def cases(kind: str, count: int, seed: int = 0) -> _Cases:
    """Draw random arms of a kind of motion.

    In a release the tips of all links are deflected by 0 to 5 cm in random directions across the beams, in the shape
    of a static tip force; in "both planes" by up to 5 cm in each plane, from postures within 0.9 rad. An impulse of 0
    to 50 N s is a force on the tip during the first control period. A slew has random torques up to 300 N m that
    change every 0.4 s. The motors are free in all cases.
    """
    model = default_model(kind == UNDAMPED)
    random, n = np.random.default_rng([seed, list(DURATION).index(kind)]), model.n_joints
    states = model.at_rest(random.uniform(-1.0, 1.0, (count, n)) * (NARROW if kind == BENT else SPREAD))
    drives = np.zeros((round(DURATION[kind] / PERIOD), count, n + 6))
    if kind in (RELEASE, UNDAMPED):
        for link in range(n):
            size, angle = random.uniform(0.0, LARGEST_DEFLECTION, count), random.uniform(0.0, 2.0 * np.pi, count)
            tips = size * np.array([np.cos(angle), np.sin(angle)])
            states[:, model.elastic_columns(link)] = (static_shape(model, link) @ tips).T
    elif kind == BENT:
        for link in range(n):
            tips = random.uniform(-LARGEST_DEFLECTION, LARGEST_DEFLECTION, (2, count))
            states[:, model.elastic_columns(link)] = (static_shape(model, link) @ tips).T
    elif kind == IMPULSE:
        impulse = random.normal(size=(count, 3))
        impulse *= random.uniform(0.0, LARGEST_IMPULSE, (count, 1)) / np.linalg.norm(impulse, axis=1, keepdims=True)
        drives[0, :, n : n + 3] = impulse / PERIOD
    else:
        for first in range(0, len(drives), HOLD):
            drives[first : first + HOLD, :, :n] = LARGEST_TORQUE * random.uniform(-1.0, 1.0, (count, n))
    return _Cases(states, drives)


PARTS, FINE_PARTS = (1, 2, 3, 4, 8, 16), (20, 40, 80)  # steps per control period; `FINE_PARTS` of explicit methods
REFERENCE, RTOL = "dop853", 1e-8
FLOOR = 0.02  # share of the energy at the start, lower bound of the scale of energy errors


@dataclass(frozen=True)
class RingDownRow:
    """Results of arms of one kind of motion with one method and step.

    Attributes:
        kind: kind of motion, see `cases`.
        code: simulator.
        method: integration method.
        step: step, s.
        arms: number of arms.
        cpu: CPU time per simulated second of one arm.
        energy_median, energy_90, energy_99: percentiles of the energy error, relative to the reference energy at the
            end or, if larger, 2 % of the energy at the start; infinite for failed arms.
        tip_median, tip_90, tip_95, tip_99: percentiles of the tip error at the end, m.
        kept: median of the energy at the end relative to the start, over arms without failure.
        failed: share of failed arms.
    """

    kind: str
    code: str
    method: str
    step: float
    arms: float
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


class _Outcome(NamedTuple):
    """Tips (b, 3) m and energies (b,) J at the end, largest energies in the first period, status, and CPU time (s)."""

    tip: Array
    energy: Array
    first: Array
    status: IntArray
    seconds: float


def _moving_energy(batch: Batch) -> Array:
    """Return the sum of kinetic and elastic energy (b,) J."""
    return batch.outputs[:, layout.KINETIC : layout.GRAVITATIONAL].sum(axis=1)


def outcome(model: Model, each: _Cases, method: str, step: float | None) -> _Outcome:
    """Simulate arms with a method and a step (s); None for adaptive steps."""
    batch = Batch(model, method, step, PERIOD, RTOL, 1e-2 * RTOL, arms=len(each.states))
    batch.reset(np.arange(len(each.states)), each.states)
    first, started = _moving_energy(batch), time.process_time()
    for period, drive in enumerate(each.drives):
        batch.step(drive)
        if period == 0:
            first = np.maximum(first, _moving_energy(batch))
    seconds = time.process_time() - started
    tips = batch.outputs[:, layout.TIP].copy()
    return _Outcome(tips, _moving_energy(batch), first, batch.status.copy(), seconds)


def settings(method: str) -> Sequence[int]:
    """Return the numbers of steps in a control period for a method."""
    return FINE_PARTS if METHODS[method].kind == EXPLICIT else PARTS


def rows(kind: str, count: int, few: int) -> Iterator[RingDownRow]:
    """Measure every fixed-step method: batched methods on `count` arms, other methods on `few`."""
    model, each = default_model(kind == UNDAMPED), cases(kind, count)
    reference = outcome(model, each, REFERENCE, None)
    if (reference.status != layout.OK).any():
        raise RuntimeError(f"{kind}: the reference fails")
    for method in fixed_step_methods():
        many = count if isinstance(METHODS[method], LinearlyImplicit | IteratedGauss) else few
        own = _Cases(each.states[:many], each.drives[:, :many])
        for parts in settings(method):
            yield row(kind, method, PERIOD / parts, outcome(model, own, method, PERIOD / parts), reference)


def row(kind: str, method: str, step: float, result: _Outcome, reference: _Outcome) -> RingDownRow:
    """Return the row of arms compared with the first arms of the reference."""
    b, failed = len(result.tip), result.status != layout.OK
    energy, tip = _differences(result, reference)
    kept = median_kept(result.energy / np.maximum(result.first, 1e-12), failed)
    cpu = result.seconds / (b * DURATION[kind])
    shares = percentiles(energy, tip)
    return RingDownRow(kind, "flexman_gym", method, step, b, cpu, kept=kept, failed=float(failed.mean()), **shares)


def _differences(result: _Outcome, reference: _Outcome) -> tuple[Array, Array]:
    """Return the relative errors of energy (b,) and the errors of the tip (b,) m; infinite for failed arms."""
    b, failed = len(result.tip), result.status != layout.OK
    scale = np.maximum(reference.energy[:b], FLOOR * reference.first[:b])
    energy = np.where(failed, np.inf, np.abs(result.energy - reference.energy[:b]) / scale)
    return energy, np.where(failed, np.inf, np.linalg.norm(result.tip - reference.tip[:b], axis=1))


def median_kept(kept: Array, failed: BoolArray) -> float:
    """Return the median over the arms without failure; NaN if all failed."""
    return np.nan if failed.all() else float(np.median(kept[~failed]))


def percentiles(energy: Array, tip: Array) -> dict[str, float]:
    """Return the percentiles of a row; each is one of the values, since some may be infinite."""

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


# Compared with the default: methods of similar cost or higher accuracy.
OTHERS = (("midpoint_3", PERIOD / 3), ("gauss_3", PERIOD), ("midpoint_2", PERIOD / 5), ("gauss_2", PERIOD / 2),
          ("gauss_3", PERIOD / 2))  # fmt: skip
KINDS, EARLY, WITHIN = (RELEASE, BENT, IMPULSE, SLEW), 1.0, 0.02  # s; share of the energy


@dataclass(frozen=True)
class Errors:
    """Errors of a method and step on arms of one kind of motion.

    Attributes:
        method, step: integration method and step, s.
        kind: kind of motion, see `cases`.
        time: time of the comparison, s.
        arms: number of arms.
        cpu: CPU time per control period and arm, microseconds.
        within: share of arms with an energy error of at most 2 %.
        energy_median, energy_90, energy_99, tip_median, tip_90, tip_95, tip_99: see `RingDownRow`.
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
    """Return the errors of the default and similar methods after 1 s and at the end, for each kind of motion."""
    chosen, result = resolve_fidelity(Configuration()), []
    for kind in KINDS:
        each = cases(kind, count)
        for end in (EARLY, DURATION[kind]):
            part = _Cases(each.states, each.drives[: round(end / PERIOD)])
            reference = outcome(chosen.model, part, REFERENCE, None)
            for method, step in ((str(chosen.method), float(chosen.step or 0.0)), *OTHERS):
                ours = outcome(chosen.model, part, method, step)
                energy, tip = _differences(ours, reference)
                cpu = 1e6 * ours.seconds / (count * len(part.drives))
                within = float((energy <= WITHIN).mean())
                result.append(Errors(method, step, kind, end, float(count), cpu, within, **percentiles(energy, tip)))
    return result
