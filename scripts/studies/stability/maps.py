"""Stability maps: how every method follows a short motion, over step and what the study varies."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from flexman_gym.model.instant import frequencies
from flexman_gym.simulation.scenes import simulate
from flexman_gym.simulation.several import simulate_all
from flexman_gym.simulation.trajectory import Trajectory
from studies.methods import fixed_step_methods
from studies.stability.cases import CASES, SPIN, Case, parameters_of, spin_case, steps_of
from studies.stability.measure import DIVERGED, INACCURATE, INVENTED, LIMIT_TOLERANCE, OK, Row

ERROR, SPIN_LIMIT = "tip error, m", "spin limit, rad/s"
THRESHOLD = 1e-3  # m at the tip: a run that is further off is inaccurate
ABSURD = 2.0  # reaches of the arm from the base to the tip: the run diverged, whatever its status


def map_rows(study: str, quick: bool = False, parameters: Sequence[float] | None = None) -> Iterator[Row]:
    """The tip error and the verdict of every fixed-step method at every step and value of what the study varies."""
    cases = [CASES[study](parameter) for parameter in parameters or parameters_of(study, quick)]
    for group in [cases] if cases[0].varied is not None else [[case] for case in cases]:
        truths = [_truth(case) for case in group]
        for name in fixed_step_methods():
            for step in steps_of(study, quick):
                yield from map(_cell, group, truths, [(name, step)] * len(group), _runs(group, name, step))


def _truth(case: Case) -> Trajectory:
    result = simulate(case.scene, case.truth, "dop853", rtol=1e-9, atol=1e-12)
    if result.status != OK:
        raise RuntimeError(f"{case.study} {case.parameter:g}: the reference {result.status}")
    return result


def _runs(cases: list[Case], name: str, step: float) -> list[Trajectory]:
    """The motions of cases that differ by their start and by what is varied of the first one's model."""
    varied: dict[str, Any] = {
        field: np.array([(case.varied or {})[field] for case in cases]) for field in cases[0].varied or {}
    }
    return simulate_all([case.scene for case in cases], cases[0].model, name, step, **varied)


def _cell(case: Case, truth: Trajectory, method: tuple[str, float], result: Trajectory) -> Row:
    status, error = result.status, np.nan
    if status == OK:
        error = float(np.linalg.norm(result.tip - truth.tip, axis=1).max())
        far = np.linalg.norm(result.tip, axis=1).max() > ABSURD * case.model.constants.length.sum()
        invented = abs(result.energy_residual[-1]) > INVENTED * truth.energy_turnover[-1]
        status = DIVERGED if far or invented else OK if error <= THRESHOLD else INACCURATE
    return Row(case.study, case.parameter, *method, ERROR, error, None, status)


def spin_limit_row() -> Row:
    """The rate from which on the bent link of the spin maps grows tenfold within 5 s without stiffening, by `dop853`.

    Beside it stands the first frequency of the clamped link. The parameter is the tolerance of the rate (rad/s).
    """
    clamped = 2.0 * np.pi * float(frequencies(spin_case(0.0, False).model, lock_joints=True)[0])
    low, high, tolerance = 0.5 * clamped, 1.5 * clamped, 0.01
    while high - low > tolerance:
        rate = 0.5 * (low + high)
        case = spin_case(rate, False)
        result = simulate(replace(case.scene, duration=5.0, output_step=5.0), case.model, "dop853")
        grown = result.status != OK or np.abs(result.deflection[-1]).max() > 0.1
        low, high = (low, rate) if grown else (rate, high)
    verdict = OK if abs(low - clamped) <= LIMIT_TOLERANCE * clamped else INACCURATE
    return Row(SPIN, tolerance, "dop853", 0.0, SPIN_LIMIT, low, clamped, verdict)
