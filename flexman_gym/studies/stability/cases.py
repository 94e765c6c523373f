"""Stability cases: maps of step and stiffness, limits, long runs and numerical damping, measured as rows."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.kernels.layout import KINETIC, OUTPUTS, STATUS
from flexman_gym.model.instant import frequencies
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene import catalog
from flexman_gym.scene.arm import Payload
from flexman_gym.scene.drive import drive_table
from flexman_gym.simulation.amplification import spectral_radius, vibration_factor
from flexman_gym.simulation.methods import METHODS
from flexman_gym.simulation.run import Run
from flexman_gym.simulation.simulator import Simulator
from flexman_gym.studies.stability.measure import (
    DIVERGED,
    EXPLICIT_METHODS,
    FIXED,
    INACCURATE,
    LIMIT_TOLERANCE,
    OK,
    Row,
    growth_per_step,
    measured_limit,
    natural_modes,
    predicted_limit,
    small_vibration,
)

ERROR, LIMIT, ENERGY, RADIUS = "tip error, m", "step limit, s", "energy error, relative", "spectral radius"
KEPT, IN_PERIODS, FREQUENCY = "amplitude kept", "amplitude kept, in control periods", "frequency, Hz"
NATURAL, SPIN_LIMIT = "natural frequency, Hz", "spin limit, rad/s"
SPRINGS, MODES, PAYLOAD, SPIN, SPIN_STIFFENED = (
    "joint stiffness", "modes", "payload", "spin", "spin with stiffening",
)  # fmt: skip
DRIFT, DAMPING, AMPLIFICATION = "drift", "damping", "amplification"

THRESHOLD = 1e-3  # m at the tip: a run that is further off is inaccurate
ABSURD = 2.0  # reaches of the arm from the base to the tip: the run diverged, whatever its status
INVENTED = 10.0  # times the energy that the true motion turns over: so did this one
PERIOD = 0.02  # s, the longest step; the others are halves of it, halves of those and so on
FULL_MODES = 12  # of a link with two elements
DRIFT_STEP, DRIFT_STEPS = 1e-3, 1_000_000
DAMPING_STEPS = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02)
DAMPING_TIME = 10.0  # s
GENERALISED = "generalised_alpha"  # starts anew with the acceleration of the model, unlike one-step methods
CUT = (2, 4, 4)  # modes of a link; without link 1's third, its torsion, the arm has nothing above 136 Hz


@dataclass(frozen=True, eq=False)
class Case:
    """One column of a map: a model and the motion that every method has to follow.

    study, parameter  as in Row
    model             what moves
    truth             what the tip should do: the same model, or a better one
    start             (2 d,) first state
    torque            (n,) N m
    prescribed        joints whose rates stay as they start
    periods           of 0.02 s
    """

    study: str
    parameter: float
    model: Model
    truth: Model
    start: Array
    torque: Sequence[float]
    prescribed: tuple[int, ...] = ()
    periods: int = 10


def spring_case(stiffness: float) -> Case:
    """The paper's arm from rest under 400 N m a joint, on joint springs of a stiffness (N m/rad)."""
    return _paper_case(SPRINGS, stiffness, build_model(catalog.paper_rrr(joint_stiffness=stiffness), 2, 4))


def mode_case(modes: float) -> Case:
    """The same with a number of loaded modes kept of a link; 12 is the full model of two elements."""
    kept = None if modes == FULL_MODES else int(modes)
    return _paper_case(MODES, modes, build_model(catalog.paper_rrr(), 2, kept))


def payload_case(mass: float) -> Case:
    """The same with a payload (kg)."""
    payload = Payload(mass) if mass > 0.0 else None
    return _paper_case(PAYLOAD, mass, build_model(catalog.paper_rrr(payload=payload), 2, 4))


def _paper_case(study: str, parameter: float, model: Model) -> Case:
    return Case(study, parameter, model, model, model.initial_state(np.zeros(3)), (400.0, 400.0, 400.0))


def spin_case(rate: float, stiffening: bool) -> Case:
    """One link at a constant rate (rad/s), bent by 1 cm in its plane of rotation; true is the model with stiffening."""
    models = [build_model(catalog.one_link(), 2, 4, stiffening=switch) for switch in (False, True)]
    start = models[0].initial_state([0.0], [rate])
    sideways = models[0].constants.tip_translation[:, 1]
    # of the loaded modes, which ascend in frequency, the first that moves the tip in the plane of rotation
    first = int(np.argmax(np.abs(sideways) > 0.1 * np.abs(sideways).max()))
    start[models[0].elastic_columns(0)][first] = 0.01 / sideways[first]
    study = SPIN_STIFFENED if stiffening else SPIN
    return Case(study, rate, models[stiffening], models[1], start, (0.0,), (0,), 50)


CASES: dict[str, Callable[[float], Case]] = {
    SPRINGS: spring_case,
    MODES: mode_case,
    PAYLOAD: payload_case,
    SPIN: partial(spin_case, stiffening=False),
    SPIN_STIFFENED: partial(spin_case, stiffening=True),
}
SPIN_RATES = (0.0, 5.0, 10.0, 13.0, 15.0, 20.0, 30.0, 60.0)
PARAMETERS: dict[str, Sequence[float]] = {
    SPRINGS: tuple(10.0 ** (0.5 * i) for i in range(4, 15)),
    MODES: (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 12.0),
    PAYLOAD: (0.0, 1.0, 5.0, 10.0, 20.0, 50.0),
    SPIN: SPIN_RATES,
    SPIN_STIFFENED: SPIN_RATES,
}
LIMIT_STUDIES = (SPRINGS, MODES, PAYLOAD)
HALVINGS = {SPRINGS: range(10), MODES: range(10), PAYLOAD: range(10), SPIN: range(8), SPIN_STIFFENED: range(8)}
QUICK_PARAMETERS: dict[str, Sequence[float]] = {
    SPRINGS: (1e3, 1e6), MODES: (2.0, 4.0), PAYLOAD: (10.0,), SPIN: (10.0, 20.0), SPIN_STIFFENED: (10.0, 20.0),
}  # fmt: skip
QUICK_HALVINGS = range(0, 7, 3)


@dataclass(frozen=True)
class _Truth:
    tips: Array  # (periods, 3)
    turnover: float


def map_rows(study: str, quick: bool = False) -> Iterator[Row]:
    """The tip error and the verdict of every fixed-step method at every step and value of what the study varies."""
    for parameter in (QUICK_PARAMETERS if quick else PARAMETERS)[study]:
        case = CASES[study](parameter)
        truth = _truth(case)
        for name in FIXED:
            for halving in QUICK_HALVINGS if quick else HALVINGS[study]:
                yield _cell(case, truth, name, PERIOD / 2**halving)


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


def limit_rows(study: str, quick: bool = False) -> Iterator[Row]:
    """The largest stable step of every explicit method, measured and predicted by the highest natural frequency."""
    for parameter in (QUICK_PARAMETERS if quick else PARAMETERS)[study]:
        model = CASES[study](parameter).model
        for name in EXPLICIT_METHODS:
            predicted = predicted_limit(model, METHODS[name], growth_per_step())
            measured = measured_limit(model, METHODS[name], predicted)
            verdict = OK if abs(measured - predicted) <= LIMIT_TOLERANCE * predicted else INACCURATE
            yield Row(study, parameter, name, predicted, LIMIT, measured, predicted, verdict)


def amplification_rows() -> Iterator[Row]:
    """The largest spectral radius of each other method for an undamped vibration; the parameter is its omega h."""
    angles = np.concatenate([np.arange(1, 1000) * 1e-2, np.geomspace(10.0, 1e4, 300)])
    for name in FIXED:
        if name not in EXPLICIT_METHODS:
            radii = [spectral_radius(METHODS[name], angle) for angle in angles]
            largest = int(np.argmax(radii))
            yield Row(AMPLIFICATION, float(angles[largest]), name, 0.0, RADIUS, radii[largest], None, OK)


def drift_rows(steps: int = DRIFT_STEPS) -> Iterator[Row]:
    """The largest energy error up to 10, 100, 1000 ... steps of 1 ms of the paper's arm, cut to 2 modes a link.

    It is released bent, with energy in its first modes and turning joints; nothing drives or damps it. The energy error
    is relative to the first energy; the parameter is the number of steps.
    """
    model = build_model(catalog.paper_rrr(), 2, 2)
    start = small_vibration(model, [1, 2, 3], energy=5.0)
    start[model.n_dof : model.n_dof + 3] = start[model.n_dof + model.motor_columns] = (0.2, 0.3, -0.4)
    counts = [10**power for power in range(2, 10) if 10**power <= steps]
    for name in FIXED:
        period = counts[0]
        simulator = Simulator(model, name, DRIFT_STEP, period * DRIFT_STEP)
        simulator.reset(state=start)
        first, largest, torque = simulator.energy, 0.0, np.zeros(3)
        for done in range(period, counts[-1] + 1, period):
            status = simulator.step(torque)
            if status == OK:
                largest = max(largest, abs(simulator.energy / first - 1.0))
            if status != OK or done in counts:
                verdict = status
                if status == OK:
                    verdict = OK if largest < 0.01 else INACCURATE if largest < INVENTED else DIVERGED
                yield Row(DRIFT, float(done), name, DRIFT_STEP, ENERGY, largest, None, verdict)
            if status != OK:
                break


def damping_rows(
    rotor_inertia: float, names: Sequence[str] = FIXED, steps: Sequence[float] = DAMPING_STEPS
) -> Iterator[Row]:
    """What a method leaves of a small vibration of the straight arm in its modes 1, 2 and 3 after 10 s, and how fast.

    Beside the share of the amplitude and the frequency (Hz) stands what the amplification factor of the method
    predicts. One run is not interrupted; the control periods of a Simulator start the generalised-alpha method anew,
    which stands in rows of its own. The study is "damping 1" or "damping 10" with the rotor inertia (kg m^2), the
    parameter the mode. The natural frequency of each mode comes first.
    """
    model = build_model(catalog.paper_rrr(rotor_inertia=rotor_inertia), 2, CUT)
    omegas, shapes = natural_modes(model)
    omegas, weights = omegas[3:6], np.asarray(np.linalg.inv(shapes)[3:6], dtype=np.float64)
    start, torque = small_vibration(model, [1, 2, 3]), np.zeros(3)
    study = f"{DAMPING} {rotor_inertia:g}"
    for mode, omega in enumerate(omegas, start=1):
        yield Row(study, float(mode), "", 0.0, NATURAL, float(omega / (2.0 * np.pi)), None, OK)
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
        found = _phasors(np.array(sampled), omegas, weights)
        yield from (
            replace(row, quantity=IN_PERIODS, expected=None)
            for row in _damping_cells(study, GENERALISED, step, omegas, found, simulator.status)
            if row.quantity == KEPT
        )


def _free_motion(model: Model, name: str, step: float, start: Array) -> tuple[Array, str]:
    """States (t, 2 d) every 0.02 s of one undriven run of 10 s, up to the last good one, and its status."""
    count, size = round(DAMPING_TIME / PERIOD), len(start)
    run = Run(model, METHODS[name], None, [])
    state, rows, found = np.append(start, [0.0, 0.0]), np.zeros((count + 1, size + 2)), np.zeros((count + 1, OUTPUTS))
    run.start(state, rows[0], found[0])
    substeps = round(PERIOD / step)
    drive = drive_table([None] * (model.n_joints + 6))
    outcome, valid, _ = run(drive, (0.0, PERIOD / substeps, substeps), state, rows[1:], found[1:])
    energies = found[: valid + 1, KINETIC:].sum(axis=1)
    grown = STATUS[outcome] == OK and not energies[-1] < INVENTED * energies[0]
    return rows[: valid + 1, :size], DIVERGED if grown else STATUS[outcome]


def _phasors(states: Array, omegas: Array, weights: Array) -> Array:
    """(t, 3) omega q - i q' of three modes, the rows of weights, at states (t, 2 d): it turns with the vibration."""
    d = weights.shape[1]
    return omegas * (states[:, :d] @ weights.T) - 1j * (states[:, d:] @ weights.T)


def _damping_cells(study: str, name: str, step: float, omegas: Array, found: Array, status: str) -> Iterator[Row]:
    """Rows of the phasors (t, 3) of three modes at every period."""
    turned = np.unwrap(np.angle(found), axis=0)[-1] - np.angle(found[0])
    for i, omega in enumerate(omegas):
        factor = vibration_factor(METHODS[name], omega * step)
        expected = float(abs(factor) ** (DAMPING_TIME / step)), float(np.angle(factor) / (2 * np.pi * step))
        kept, frequency = float(abs(found[-1, i] / found[0, i])), float(turned[i] / (2 * np.pi * DAMPING_TIME))
        verdicts = [status, status]
        if status == OK:
            verdicts = [OK if abs(kept - 1.0) <= 0.05 else INACCURATE]
            verdicts.append(OK if abs(frequency * 2 * np.pi / omega - 1.0) <= 0.01 else INACCURATE)
        elif len(found) <= round(DAMPING_TIME / PERIOD):
            kept, frequency = np.nan, np.nan
        for quantity, value, theory, verdict in zip(
            (KEPT, FREQUENCY), (kept, frequency), expected, verdicts, strict=True
        ):
            yield Row(study, float(i + 1), name, step, quantity, value, theory, verdict)
