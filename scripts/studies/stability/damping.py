"""Stability damping: what methods leave of a small vibration, and how fast it then is."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene import catalog
from flexman_gym.simulation.amplification import vibration_factor
from flexman_gym.simulation.methods import METHODS
from flexman_gym.simulation.scenes import simulate
from flexman_gym.simulation.simulator import Simulator
from studies.methods import fixed_step_methods
from studies.stability.cases import PERIOD, motion
from studies.stability.measure import (
    DIVERGED,
    INACCURATE,
    INVENTED,
    OK,
    Row,
    natural_modes,
    small_vibration,
)

DAMPING = "damping"
KEPT, IN_PERIODS, FREQUENCY = "amplitude kept", "amplitude kept, in control periods", "frequency, Hz"
NATURAL = "natural frequency, Hz"
DAMPING_STEPS = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02)
DAMPING_TIME = 10.0  # s
GENERALISED = "generalised_alpha"  # starts anew with the acceleration of the model, unlike one-step methods
CUT = (2, 4, 4)  # modes of a link; without link 1's third, its torsion, the arm has nothing above 136 Hz


def damping_rows(
    rotor_inertia: float, names: Sequence[str] | None = None, steps: Sequence[float] = DAMPING_STEPS
) -> Iterator[Row]:
    """What a method leaves of a small vibration of the straight arm in its modes 1, 2 and 3 after 10 s, and how fast.

    Beside the share of the amplitude and the frequency (Hz) stands what the amplification factor of the method
    predicts. One run is not interrupted; the control periods of a Simulator start the generalised-alpha method anew,
    which stands in rows of its own. The study is "damping 1" or "damping 10" with the rotor inertia (kg m^2), the
    parameter the mode. The natural frequency of each mode comes first. Without `names` all methods take part.
    """
    model = build_model(catalog.paper_rrr(rotor_inertia=rotor_inertia), 2, CUT)
    omegas, shapes = natural_modes(model)
    omegas, weights = omegas[3:6], np.asarray(np.linalg.inv(shapes)[3:6], dtype=np.float64)
    start, torque = small_vibration(model, [1, 2, 3]), np.zeros(3)
    study = f"{DAMPING} {rotor_inertia:g}"
    for mode, omega in enumerate(omegas, start=1):
        yield Row(study, float(mode), "", 0.0, NATURAL, float(omega / (2.0 * np.pi)), None, OK)
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
    """States (t, 2 d) every 0.02 s of one undriven run of 10 s, up to the last good one, and its status."""
    scene = motion(model, start, (0.0,) * model.n_joints, round(DAMPING_TIME / PERIOD))
    run = simulate(scene, model, name, step)
    grown = run.status == OK and not run.moving_energy[-1] < INVENTED * run.moving_energy[0]
    return run.states, DIVERGED if grown else run.status


def _phasors(states: Array, omegas: Array, weights: Array) -> Array:
    """(t, 3) omega q - i q' of three modes, the rows of weights, at states (t, 2 d): it turns with the vibration."""
    d = weights.shape[1]
    return omegas * (states[:, :d] @ weights.T) - 1j * (states[:, d:] @ weights.T)


def _damping_cells(study: str, name: str, step: float, omegas: Array, result: Array, status: str) -> Iterator[Row]:
    """Rows of the phasors (t, 3) of three modes at every period."""
    turned = np.unwrap(np.angle(result), axis=0)[-1] - np.angle(result[0])
    for i, omega in enumerate(omegas):
        factor = vibration_factor(METHODS[name], omega * step)
        expected = float(abs(factor) ** (DAMPING_TIME / step)), float(np.angle(factor) / (2 * np.pi * step))
        kept, frequency = float(abs(result[-1, i] / result[0, i])), float(turned[i] / (2 * np.pi * DAMPING_TIME))
        verdicts = [status, status]
        if status == OK:
            verdicts = [OK if abs(kept - 1.0) <= 0.05 else INACCURATE]
            verdicts.append(OK if abs(frequency * 2 * np.pi / omega - 1.0) <= 0.01 else INACCURATE)
        elif len(result) <= round(DAMPING_TIME / PERIOD):
            kept, frequency = np.nan, np.nan
        for quantity, value, theory, verdict in zip(
            (KEPT, FREQUENCY), (kept, frequency), expected, verdicts, strict=True
        ):
            yield Row(study, float(i + 1), name, step, quantity, value, theory, verdict)
