"""Rows of the stability study: step limits, numerical damping, energy drift, stability maps."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.parallel import Workers, parallel_map
from flexman_gym.envs.vector_env import compile_kernels
from flexman_gym.model.dynamics import frequencies
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene import catalog
from flexman_gym.simulation.methods import METHODS
from flexman_gym.simulation.scene_simulation import simulate, simulate_all
from flexman_gym.simulation.simulator import Simulator
from flexman_gym.simulation.stability import spectral_radii
from flexman_gym.simulation.trajectory import Trajectory
from studies.methods import explicit_methods, fixed_step_methods, implicit_methods, vibration_factor
from studies.stability.measure import (
    CASES,
    DIVERGED,
    INACCURATE,
    INVENTED,
    LIMIT_TOLERANCE,
    MODES,
    OK,
    PAYLOAD,
    PERIOD,
    SPIN,
    SPRINGS,
    StabilityCase,
    StabilityRow,
    growth_per_step,
    measured_limit,
    motion,
    natural_modes,
    parameters_of,
    predicted_limit,
    small_vibration,
    spin_case,
    steps_of,
)

DAMPING = "damping"
KEPT, IN_PERIODS, FREQUENCY = "amplitude kept", "amplitude kept, in control periods", "frequency, Hz"
NATURAL = "natural frequency, Hz"
DAMPING_STEPS = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02)
DAMPING_TIME, WINDOW = 10.0, 1.0  # s; duration of a run, and of the windows in which the amplitude is measured
GENERALISED = "generalised_alpha"  # has an auxiliary acceleration, unlike one-step methods
CUT = (2, 4, 4)  # modes per link; without the torsional mode of link 1 all frequencies are below 136 Hz


def damping_rows(
    rotor_inertia: float, names: Sequence[str] | None = None, steps: Sequence[float] = DAMPING_STEPS
) -> Iterator[StabilityRow]:
    """Yield amplitude and frequency of small vibrations of the straight arm in modes 1, 2 and 3 after 10 s.

    The expected values are those of the amplification factor of the method. Each run is uninterrupted; separate rows
    hold the generalised-alpha method in a Simulator, which carries its acceleration over control periods. The study is
    "damping 1" or "damping 10" by the rotor inertia (kg m^2), the parameter the mode. The natural frequency of each
    mode comes first. `names` defaults to all fixed-step methods.
    """
    model = build_model(catalog.paper_rrr(rotor_inertia=rotor_inertia), 2, CUT)
    omegas, shapes = natural_modes(model)
    omegas, weights = omegas[3:6], np.asarray(np.linalg.inv(shapes)[3:6], dtype=np.float64)
    start, torque = small_vibration(model, [1, 2, 3]), np.zeros(3)
    study = f"{DAMPING} {rotor_inertia:g}"
    for mode, omega in enumerate(omegas, start=1):
        yield StabilityRow(study, float(mode), "", 0.0, NATURAL, float(omega / (2.0 * np.pi)), None, OK)
    names = fixed_step_methods() if names is None else names
    for name in names:
        for step in steps:
            states, status = _free_motion(model, name, step, start)
            yield from _damping_cells(study, name, step, omegas, _phasors(states, omegas, weights), status)
    for step in steps if GENERALISED in names else ():
        simulator = Simulator(model, GENERALISED, step, PERIOD)
        simulator.reset(state=start)
        sampled = [simulator.state.copy()]
        for _ in range(round(DAMPING_TIME / PERIOD)):
            simulator.step(torque)
            sampled.append(simulator.state.copy())
        result = _phasors(np.array(sampled), omegas, weights)
        yield from (
            replace(row, quantity=IN_PERIODS, expected=None)
            for row in _damping_cells(study, GENERALISED, step, omegas, result, simulator.status)
            if row.quantity == KEPT
        )


def _free_motion(model: Model, name: str, step: float, start: Array) -> tuple[Array, str]:
    """Return the states (t, 2 d) every 0.02 s of an undriven run of 10 s, up to a failure, and the status."""
    scene = motion(model, start, (0.0,) * model.n_joints, round(DAMPING_TIME / PERIOD))
    run = simulate(scene, model, name, step)
    grown = run.status == OK and not run.moving_energy[-1] < INVENTED * run.moving_energy[0]
    return run.states, DIVERGED if grown else run.status


def _phasors(states: Array, omegas: Array, weights: Array) -> Array:
    """Return the phasors omega q - i q' (t, 3) of three modes, with the rows of weights, at states (t, 2 d)."""
    d = weights.shape[1]
    return omegas * (states[:, :d] @ weights.T) - 1j * (states[:, d:] @ weights.T)


def _damping_cells(
    study: str, name: str, step: float, omegas: Array, result: Array, status: str
) -> Iterator[StabilityRow]:
    """Yield the rows of the phasors (t, 3) of three modes at all periods."""
    turned = np.unwrap(np.angle(result), axis=0)[-1] - np.angle(result[0])
    for i, omega in enumerate(omegas):
        factor = vibration_factor(METHODS[name], omega * step)
        expected = float(abs(factor) ** (DAMPING_TIME / step)), float(np.angle(factor) / (2 * np.pi * step))
        kept, frequency = remaining(np.abs(result[:, i])), float(turned[i] / (2 * np.pi * DAMPING_TIME))
        verdicts = [status, status]
        if status == OK:
            verdicts = [OK if abs(kept - 1.0) <= 0.05 else INACCURATE]
            verdicts.append(OK if abs(frequency * 2 * np.pi / omega - 1.0) <= 0.01 else INACCURATE)
        elif len(result) <= round(DAMPING_TIME / PERIOD):
            kept, frequency = np.nan, np.nan
        for quantity, value, theory, verdict in zip(
            (KEPT, FREQUENCY), (kept, frequency), expected, verdicts, strict=True
        ):
            yield StabilityRow(study, float(i + 1), name, step, quantity, value, theory, verdict)


def remaining(amplitudes: Array) -> float:
    """Return the share of an amplitude (t,) that is left at the end of a run of `DAMPING_TIME`, sampled every period.

    It is the ratio of the root mean squares over the last and the first second, raised to the power that turns a decay
    between these windows into one over the whole run, so that a bounded oscillation of the amplitude counts as neither
    decay nor growth.
    """
    count = round(WINDOW / PERIOD)
    first, last = (float(np.sqrt(np.mean(each**2))) for each in (amplitudes[:count], amplitudes[-count:]))
    return (last / first) ** ((len(amplitudes) - 1) / (len(amplitudes) - count))


DRIFT, ENERGY = "drift", "energy error, relative"
DRIFT_STEP, DRIFT_STEPS, EVERY = 1e-3, 1_000_000, 100  # s; steps of a run; steps per output


def drift_rows(steps: int = DRIFT_STEPS, names: Sequence[str] | None = None) -> Iterator[StabilityRow]:
    """Yield the largest energy error up to 10, 100, 1000 ... steps of 1 ms of the paper's arm with 2 modes per link.

    The undriven, undamped arm starts deflected in its first modes, with turning joints. Energy errors are relative to
    the initial energy; the parameter is the number of steps.
    """
    model = build_model(catalog.paper_rrr(), 2, 2)
    start = small_vibration(model, [1, 2, 3], energy=5.0)
    start[model.n_dof : model.n_dof + 3] = start[model.n_dof + model.motor_columns] = (0.2, 0.3, -0.4)
    counts = [10**power for power in range(2, 10) if 10**power <= steps]
    scene = replace(
        motion(model, start, (0.0,) * 3, 1), duration=counts[-1] * DRIFT_STEP, output_step=EVERY * DRIFT_STEP
    )
    for name in names or fixed_step_methods():
        run = simulate(scene, model, name, DRIFT_STEP)
        errors = np.maximum.accumulate(np.abs(run.energy / run.energy[0] - 1.0))
        for done in counts:
            if done <= EVERY * (len(errors) - 1):
                largest = float(errors[done // EVERY])
                verdict = OK if largest < 0.01 else INACCURATE if largest < INVENTED else DIVERGED
                yield StabilityRow(DRIFT, float(done), name, DRIFT_STEP, ENERGY, largest, None, verdict)
        if run.status != OK:
            yield StabilityRow(
                DRIFT, float(EVERY * len(errors)), name, DRIFT_STEP, ENERGY, float(errors[-1]), None, run.status
            )


LIMIT, RADIUS, AMPLIFICATION = "step limit, s", "spectral radius", "amplification"
LIMIT_STUDIES = (SPRINGS, MODES, PAYLOAD)


def limit_rows(study: str, quick: bool = False, parameters: Sequence[float] | None = None) -> Iterator[StabilityRow]:
    """Yield the largest stable step of every explicit method, measured and predicted from the highest frequency."""
    for parameter in parameters or parameters_of(study, quick):
        model = CASES[study](parameter).model
        for name in explicit_methods():
            predicted = predicted_limit(model, METHODS[name], growth_per_step())
            measured = measured_limit(model, METHODS[name], predicted)
            verdict = OK if abs(measured - predicted) <= LIMIT_TOLERANCE * predicted else INACCURATE
            yield StabilityRow(study, parameter, name, predicted, LIMIT, measured, predicted, verdict)


def amplification_rows() -> Iterator[StabilityRow]:
    """Yield the largest spectral radius of every implicit method without damping; the parameter is its omega h."""
    angles = np.concatenate([np.arange(1, 1000) * 1e-2, np.geomspace(10.0, 1e4, 300)])
    for name in implicit_methods():
        radii = spectral_radii(METHODS[name], angles)
        largest = int(np.argmax(radii))
        yield StabilityRow(AMPLIFICATION, float(angles[largest]), name, 0.0, RADIUS, float(radii[largest]), None, OK)


ERROR, SPIN_LIMIT = "tip error, m", "spin limit, rad/s"
THRESHOLD = 1e-3  # m; tip error from which a run counts as inaccurate
ABSURD = 2.0  # distance of the tip, relative to the reach, from which a run counts as diverged


def map_rows(study: str, quick: bool = False, parameters: Sequence[float] | None = None) -> Iterator[StabilityRow]:
    """Yield tip error and verdict of every fixed-step method at every step and parameter value of a study."""
    cases = [CASES[study](parameter) for parameter in parameters or parameters_of(study, quick)]
    for group in [cases] if cases[0].varied is not None else [[case] for case in cases]:
        references = [_reference(case) for case in group]
        for name in fixed_step_methods():
            for step in steps_of(study, quick):
                yield from map(_cell, group, references, [(name, step)] * len(group), _runs(group, name, step))


def _reference(case: StabilityCase) -> Trajectory:
    result = simulate(case.scene, case.reference, "dop853", rtol=1e-9, atol=1e-12)
    if result.status != OK:
        raise RuntimeError(f"{case.study} {case.parameter:g}: the reference {result.status}")
    return result


def _runs(cases: list[StabilityCase], name: str, step: float) -> list[Trajectory]:
    """Return the motions of cases that differ in initial state and varied parameters only."""
    varied: dict[str, Any] = {
        field: np.array([(case.varied or {})[field] for case in cases]) for field in cases[0].varied or {}
    }
    return simulate_all([case.scene for case in cases], cases[0].model, name, step, **varied)


def _cell(case: StabilityCase, reference: Trajectory, method: tuple[str, float], result: Trajectory) -> StabilityRow:
    status, error = result.status, np.nan
    if status == OK:
        error = float(np.linalg.norm(result.tip - reference.tip, axis=1).max())
        far = np.linalg.norm(result.tip, axis=1).max() > ABSURD * case.model.constants.length.sum()
        invented = abs(result.energy_residual[-1]) > INVENTED * reference.energy_turnover[-1]
        status = DIVERGED if far or invented else OK if error <= THRESHOLD else INACCURATE
    return StabilityRow(case.study, case.parameter, *method, ERROR, error, None, status)


def _spin_limit_row() -> StabilityRow:
    """Return the rate from which the bent link grows tenfold within 5 s without stiffening, integrated by `dop853`.

    The expected value is the first frequency of the clamped link, the parameter the tolerance of the rate (rad/s).
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
    return StabilityRow(SPIN, tolerance, "dop853", 0.0, SPIN_LIMIT, low, clamped, verdict)


QUICK_METHODS, QUICK_STEPS = ("ros2", "implicit_midpoint"), (0.005, 0.02)
MAKERS: dict[str, Callable[..., Iterator[StabilityRow]]] = {
    "amplification": amplification_rows,
    "limits": limit_rows,
    "spin limit": lambda: iter([_spin_limit_row()]),
    "map": map_rows,
    "damping": damping_rows,
    "drift": drift_rows,
}


class _StabilityCell(NamedTuple):
    """Group of rows measured together: name of the generating function and its arguments."""

    maker: str
    arguments: tuple[Any, ...] = ()


def cells(quick: bool = False) -> list[_StabilityCell]:
    """Return all cells, or those of a small grid."""
    result = [_StabilityCell("amplification")]
    result += [
        _StabilityCell("limits", (study, quick, (each,)))
        for study in LIMIT_STUDIES
        for each in parameters_of(study, quick)
    ]
    result.append(_StabilityCell("spin limit"))
    for study in CASES:
        every = tuple(parameters_of(study, quick))
        together = CASES[study](every[0]).varied is not None  # simulated as one batch
        result += [
            _StabilityCell("map", (study, quick, part))
            for part in ([every] if together else [(each,) for each in every])
        ]
    result += [_StabilityCell("damping", (inertia, *(QUICK_METHODS, QUICK_STEPS) * quick)) for inertia in (1.0, 10.0)]
    return result + [
        _StabilityCell("drift", (10_000 if quick else DRIFT_STEPS, (name,))) for name in fixed_step_methods()
    ]


def rows_of(cell: _StabilityCell) -> list[dict[str, Any]]:
    """Return the rows of a cell as plain data."""
    return [asdict(row) for row in MAKERS[cell.maker](*cell.arguments)]


def all_rows(quick: bool = False, workers: Workers | int = 1, kept: Path | None = None) -> list[StabilityRow]:
    """Return all rows, or a small grid; `workers` and `kept`: see `common.parallel.parallel_map_unordered`."""
    return [
        StabilityRow(**row)
        for rows in parallel_map(rows_of, cells(quick), workers, kept, compile_kernels)
        for row in rows
    ]
