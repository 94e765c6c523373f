"""Stability maps: how every method follows a short motion, over step and what the study varies."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.model.instant import frequencies
from flexman_gym.simulation.simulator import Simulator
from flexman_gym.studies.methods import fixed_step_methods
from flexman_gym.studies.stability.cases import CASES, PERIOD, SPIN, Case, parameters_of, spin_case, steps_of
from flexman_gym.studies.stability.measure import DIVERGED, INACCURATE, INVENTED, LIMIT_TOLERANCE, OK, Row

ERROR, SPIN_LIMIT = "tip error, m", "spin limit, rad/s"
THRESHOLD = 1e-3  # m at the tip: a run that is further off is inaccurate
ABSURD = 2.0  # reaches of the arm from the base to the tip: the run diverged, whatever its status


@dataclass(frozen=True)
class _Truth:
    tips: Array  # (periods, 3)
    turnover: float


def map_rows(study: str, quick: bool = False) -> Iterator[Row]:
    """The tip error and the verdict of every fixed-step method at every step and value of what the study varies."""
    for parameter in parameters_of(study, quick):
        case = CASES[study](parameter)
        truth = _truth(case)
        for name in fixed_step_methods():
            for step in steps_of(study, quick):
                yield _cell(case, truth, name, step)


def _truth(case: Case) -> _Truth:
    simulator = Simulator(case.truth, "dop853", None, PERIOD, 1e-9, 1e-12, case.prescribed)
    tips, status = _follow(simulator, case)
    if status != OK:
        raise RuntimeError(f"{case.study} {case.parameter:g}: the reference {status}")
    return _Truth(tips, simulator.energy_turnover)


def _follow(simulator: Simulator, case: Case) -> tuple[Array, str]:
    """The tip (p, 3) after every period up to the last good one, and the status."""
    simulator.reset(state=case.start)
    tips, status = [], OK
    for _ in range(case.periods):
        status = simulator.step(case.torque)
        if status != OK:
            break
        tips.append(simulator.tip.copy())
    return np.array(tips).reshape(-1, 3), status


def _cell(case: Case, truth: _Truth, name: str, step: float) -> Row:
    simulator = Simulator(case.model, name, step, PERIOD, prescribed=case.prescribed)
    tips, status = _follow(simulator, case)
    error = float(np.linalg.norm(tips - truth.tips[: len(tips)], axis=1).max()) if status == OK else np.nan
    if status == OK:
        reach = ABSURD * case.model.constants.length.sum()
        far = np.linalg.norm(tips, axis=1).max() > reach
        invented = abs(simulator.energy_residual) > INVENTED * truth.turnover
        status = DIVERGED if far or invented else OK if error <= THRESHOLD else INACCURATE
    return Row(case.study, case.parameter, name, step, ERROR, error, None, status)


def spin_limit_row() -> Row:
    """The rate from which on the bent link of the spin maps grows tenfold within 5 s without stiffening, by `dop853`.

    Beside it stands the first frequency of the clamped link. The parameter is the tolerance of the rate (rad/s).
    """
    clamped = 2.0 * np.pi * float(frequencies(spin_case(0.0, False).model, lock_joints=True)[0])
    low, high, tolerance = 0.5 * clamped, 1.5 * clamped, 0.01
    while high - low > tolerance:
        rate = 0.5 * (low + high)
        case = spin_case(rate, False)
        simulator = Simulator(case.model, "dop853", None, 5.0, 1e-6, 1e-9, case.prescribed)
        simulator.reset(state=case.start)
        grown = simulator.step(case.torque) != OK or np.abs(simulator.deflection).max() > 0.1
        low, high = (low, rate) if grown else (rate, high)
    verdict = OK if abs(low - clamped) <= LIMIT_TOLERANCE * clamped else INACCURATE
    return Row(SPIN, tolerance, "dop853", 0.0, SPIN_LIMIT, low, clamped, verdict)
