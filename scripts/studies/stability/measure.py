"""Stability measurements: cases, growth per step, step limits."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.linalg import eigh

from flexman_gym.common.arrays import Array
from flexman_gym.model.dynamics import frequencies, mass_matrix, stiffness_matrix
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene import catalog
from flexman_gym.scene.rigid_body import Payload
from flexman_gym.scene.scene import Initial, Scene
from flexman_gym.scene.signals import ConstantTorque, Signal
from flexman_gym.simulation.methods import Method
from flexman_gym.simulation.simulator import Simulator
from flexman_gym.simulation.stability import stability_limit

OK, INACCURATE, DIVERGED, NOT_CONVERGED = "ok", "inaccurate", "diverged", "not converged"
VERDICTS = (OK, INACCURATE, DIVERGED, NOT_CONVERGED)
MODE_ENERGY = 1e-8  # J; energy per mode of a small vibration (micrometres), for which the arm is linear

STEPS, PERIODS = 100, 20  # steps per period, periods of a stability test (2000 steps)
GROWTH = 10.0  # energy ratio of the second half to the first, from which the step counts as unstable
BOUNDLESS = 1e4  # energy relative to the start that counts as growth at any time
INVENTED = 10.0  # spurious energy, relative to the energy turned over or at the start, of a diverged run
LIMIT_TOLERANCE = 0.05  # relative error of a correctly predicted limit
BISECTIONS = 9  # resolves the limit to 0.1 %


@dataclass(frozen=True)
class StabilityRow:
    """One measurement.

    Attributes:
        study: name of the study.
        parameter: value of the varied parameter, in the unit of the chart.
        method: method name from METHODS.
        step: step, s.
        quantity: measured quantity with its unit.
        value: measured value.
        expected: theoretical value; None without a prediction.
        verdict: "ok", "inaccurate", "diverged" or "not converged".
    """

    study: str
    parameter: float
    method: str
    step: float
    quantity: str
    value: float
    expected: float | None
    verdict: str


def growth_per_step() -> float:
    """Return the relative growth of the amplitude per step that `measured_limit` just tolerates."""
    return float(GROWTH ** (1.0 / (STEPS * PERIODS)) - 1.0)


def predicted_limit(model: Model, method: Method, growth: float = 0.0) -> float:
    """Return the largest stable step (s) for the straight arm at rest, from its highest natural frequency."""
    return stability_limit(method, growth) / (2.0 * np.pi * float(frequencies(model)[-1]))


def measured_limit(model: Model, method: Method, guess: float) -> float:
    """Return the largest step (s) at which a small vibration does not grow within 2000 steps, see `grows`.

    The vibration excites all modes, mostly the highest. The step is found by bisection between 0.5 and 1.5 times a
    guess (s); NaN if it lies outside.
    """
    start = small_vibration(model, [model.n_dof - model.n_joints]) + small_vibration(model, energy=1e-3 * MODE_ENERGY)
    low, high = 0.5 * guess, 1.5 * guess
    if grows(model, method, low, start) or not grows(model, method, high, start):
        return math.nan
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if grows(model, method, middle, start) else (middle, high)
    return 0.5 * (low + high)


def grows(model: Model, method: Method, step: float, start: Array) -> bool:
    """Return whether the undriven motion from a state (2 d,) fails within 2000 steps (s) or its energy grows tenfold.

    The largest energy of the second half is compared with that of the first half, and with 1e4 times the initial
    energy, since the energy of the semi-implicit Euler method oscillates within bounds, more strongly near its limit.
    """
    simulator = Simulator(model, method, step, control_period=STEPS * step)
    simulator.reset(state=start)
    energies, torque, most = [], np.zeros(model.n_joints), BOUNDLESS * simulator.energy
    for _ in range(PERIODS):
        if simulator.step(torque) != OK or not simulator.energy < most:
            return True
        energies.append(simulator.energy)
    half = PERIODS // 2
    return not max(energies[half:]) < GROWTH * max(energies[:half])


def natural_modes(model: Model) -> tuple[Array, Array]:
    """Return angular frequencies (d,) rad/s, ascending, and mode shapes (d, d) of unit modal mass of the straight arm.

    The first n are the rigid-body modes of the joints, with frequency 0.
    """
    mass = mass_matrix(model, model.initial_state(np.zeros(model.n_joints)))
    squares, shapes = eigh(stiffness_matrix(model), mass)
    squares[: model.n_joints] = 0.0
    return np.sqrt(np.maximum(squares, 0.0)), shapes


def small_vibration(model: Model, modes: Sequence[int] | None = None, energy: float = MODE_ENERGY) -> Array:
    """Return a state (2 d,) of the straight arm, deflected and at rest, with an energy (J) in each of the given modes.

    Modes are counted from 1, the lowest above the n modes of frequency 0; None selects all modes.
    """
    omegas, shapes = natural_modes(model)
    n = model.n_joints
    columns = np.arange(n, model.n_dof) if modes is None else n - 1 + np.array(modes)
    start = model.initial_state(np.zeros(n))
    start[: model.n_dof] = shapes[:, columns] @ (math.sqrt(2.0 * energy) / omegas[columns])
    return start


def select(rows: Iterable[StabilityRow], **wanted: object) -> list[StabilityRow]:
    """Return the rows with the given field values."""
    return [row for row in rows if all(getattr(row, name) == value for name, value in wanted.items())]


SPRINGS, MODES, PAYLOAD, SPIN, SPIN_STIFFENED = (
    "joint stiffness", "modes", "payload", "spin", "spin with stiffening",
)  # fmt: skip
PERIOD = 0.02  # s; longest step; the others are obtained by repeated halving
FULL_MODES = 12  # coordinates of a link with two elements


@dataclass(frozen=True, eq=False)
class StabilityCase:
    """One column of a map: a model and its motion.

    Attributes:
        study, parameter: see `StabilityRow`.
        model: simulated model.
        reference: model of the reference motion, the same or a better one.
        scene: motion, with an output every 0.02 s.
        varied: physical parameters (n,) in which the case differs from the first case of the study; None if its model
            differs otherwise.
    """

    study: str
    parameter: float
    model: Model
    reference: Model
    scene: Scene
    varied: dict[str, Array] | None = None


def motion(model: Model, start: Array, torque: Sequence[float], periods: int, held: bool = False) -> Scene:
    """Return the scene of a motion from a state (2 d,) for some periods, optionally with all joint rates held constant.

    There is an output after each period.
    """
    prescribed = [Signal()] * model.n_joints if held else None
    rest = [0.0] * model.n_joints
    initial = Initial(rest, rest, start.tolist())
    drive = ConstantTorque(torque)
    return Scene(model.arm, model.choice, drive, initial, periods * PERIOD, PERIOD, prescribed=prescribed)


def _spring_case(stiffness: float) -> StabilityCase:
    """Return the paper's arm from rest under 400 N m per joint, with a joint stiffness (N m/rad)."""
    model = build_model(catalog.paper_rrr(joint_stiffness=stiffness), 2, 4)
    return _paper_case(SPRINGS, stiffness, model, {"joint_stiffness": np.full(3, stiffness)})


def _mode_case(modes: float) -> StabilityCase:
    """Return the paper's arm with a number of loaded modes per link; 12 is the full model of two elements."""
    kept = None if modes == FULL_MODES else int(modes)
    return _paper_case(MODES, modes, build_model(catalog.paper_rrr(), 2, kept))


def _payload_case(mass: float) -> StabilityCase:
    """Return the paper's arm with a payload (kg), which is included in its modes."""
    payload = Payload(mass) if mass > 0.0 else None
    return _paper_case(PAYLOAD, mass, build_model(catalog.paper_rrr(payload=payload), 2, 4))


def _paper_case(study: str, parameter: float, model: Model, varied: dict[str, Array] | None = None) -> StabilityCase:
    scene = motion(model, model.initial_state(np.zeros(3)), (400.0, 400.0, 400.0), 10)
    return StabilityCase(study, parameter, model, model, scene, varied)


def spin_case(rate: float, stiffening: bool) -> StabilityCase:
    """Return a link at a constant rate (rad/s), bent by 1 cm in its plane of rotation; reference: with stiffening."""
    models = [build_model(catalog.one_link(), 2, 4, stiffening=switch) for switch in (False, True)]
    start = models[0].initial_state([0.0], [rate])
    sideways = models[0].constants.tip_translation[:, 1]
    # lowest loaded mode that moves the tip in the plane of rotation
    first = int(np.argmax(np.abs(sideways) > 0.1 * np.abs(sideways).max()))
    start[models[0].elastic_columns(0)][first] = 0.01 / sideways[first]
    study = SPIN_STIFFENED if stiffening else SPIN
    return StabilityCase(study, rate, models[stiffening], models[1], motion(models[0], start, (0.0,), 50, True), {})


CASES: dict[str, Callable[[float], StabilityCase]] = {
    SPRINGS: _spring_case,
    MODES: _mode_case,
    PAYLOAD: _payload_case,
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
HALVINGS = {SPRINGS: range(10), MODES: range(10), PAYLOAD: range(10), SPIN: range(8), SPIN_STIFFENED: range(8)}
QUICK_PARAMETERS: dict[str, Sequence[float]] = {
    SPRINGS: (1e3, 1e6), MODES: (2.0, 4.0), PAYLOAD: (10.0,), SPIN: (10.0, 20.0), SPIN_STIFFENED: (10.0, 20.0),
}  # fmt: skip
QUICK_HALVINGS = range(0, 7, 3)


def parameters_of(study: str, quick: bool = False) -> Sequence[float]:
    """Return the parameter values of a study, or a few of them."""
    return (QUICK_PARAMETERS if quick else PARAMETERS)[study]


def steps_of(study: str, quick: bool = False) -> list[float]:
    """Return the steps (s) of the map of a study, or a few of them."""
    return [PERIOD / 2**halving for halving in (QUICK_HALVINGS if quick else HALVINGS[study])]
