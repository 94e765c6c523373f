"""Stability: what a method does to an undamped vibration, predicted from its coefficients, and rows of measurements."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from flexman_gym.arrays import Array
from flexman_gym.model.instant import frequencies, mass_matrix, stiffness_matrix
from flexman_gym.model.model import Model
from flexman_gym.simulation.amplification import stability_limit
from flexman_gym.simulation.families import Method
from flexman_gym.simulation.simulator import Simulator

OK, INACCURATE, DIVERGED, NOT_CONVERGED = "ok", "inaccurate", "diverged", "not converged"
VERDICTS = (OK, INACCURATE, DIVERGED, NOT_CONVERGED)
MODE_ENERGY = 1e-8  # J in each mode of a small vibration: a motion of micrometres, at which the arm is linear

STEPS, PERIODS = 100, 20  # of a run that decides whether a step is stable: 2000 steps
GROWTH = 10.0  # of its energy from the first half to the second, from which on it is not
BOUNDLESS = 1e4  # times the first energy: growth, too, that ended early in a motion of another kind
INVENTED = 10.0  # times the energy that the true motion turns over, or of the start: a run that gains it diverged
LIMIT_TOLERANCE = 0.05  # of a predicted limit
BISECTIONS = 9  # to a thousandth of the limit


@dataclass(frozen=True)
class Row:
    """One measurement.

    Attributes:
        study: what it belongs to.
        parameter: what the study varies, in the unit of its chart.
        method: a name from METHODS.
        step: s.
        quantity: what was measured, with its unit.
        value: the number.
        expected: what the theory predicts; None where it predicts nothing.
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
    """The growth of amplitude in a step that a run of `measured_limit` just tolerates."""
    return float(GROWTH ** (1.0 / (STEPS * PERIODS)) - 1.0)


def predicted_limit(model: Model, method: Method, growth: float = 0.0) -> float:
    """The largest stable step (s) of a method at the straight arm at rest, by its highest natural frequency."""
    return stability_limit(method, growth) / (2.0 * np.pi * float(frequencies(model)[-1]))


def measured_limit(model: Model, method: Method, guess: float) -> float:
    """The largest step (s) at which a small vibration does not grow in 2000 steps as `grows` says.

    The vibration is in all modes, mostly in the highest. Found by bisection between half and one and a half times a
    guess (s); NaN when it does not lie there.
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
    """Whether the undriven motion from a state (2 d,) fails within 2000 steps (s) or its energy grows tenfold.

    The largest energy of the second half counts against that of the first, and 1e4 times the first energy: the
    semi-implicit Euler method lets the energy of a vibration waver, the more the nearer its limit, and yet it stays
    bounded.
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
    """Angular frequencies (d,) rad/s, ascending, and shapes (d, d), columns of unit modal mass, of the straight arm.

    The first n are those of the arm that turns about its joints, of frequency 0.
    """
    mass = mass_matrix(model, model.initial_state(np.zeros(model.n_joints)))
    squares, shapes = eigh(stiffness_matrix(model), mass)
    squares[: model.n_joints] = 0.0
    return np.sqrt(np.maximum(squares, 0.0)), shapes


def small_vibration(model: Model, modes: Sequence[int] | None = None, energy: float = MODE_ENERGY) -> Array:
    """State (2 d,) of the straight arm, bent and at rest, with an energy (J) in each of these modes, counted from 1.

    None takes all; mode 1 is the lowest above the n of frequency 0.
    """
    omegas, shapes = natural_modes(model)
    n = model.n_joints
    columns = np.arange(n, model.n_dof) if modes is None else n - 1 + np.array(modes)
    start = model.initial_state(np.zeros(n))
    start[: model.n_dof] = shapes[:, columns] @ (math.sqrt(2.0 * energy) / omegas[columns])
    return start


def select(rows: Iterable[Row], **wanted: object) -> list[Row]:
    """The rows with these values of their fields."""
    return [row for row in rows if all(getattr(row, name) == value for name, value in wanted.items())]
