"""Stability drift: the energy of a free, undamped arm in a long run."""

from collections.abc import Iterator

import numpy as np

from flexman_gym.model.model import build_model
from flexman_gym.scene import catalog
from flexman_gym.simulation.simulator import Simulator
from flexman_gym.studies.methods import fixed_step_methods
from flexman_gym.studies.stability.measure import DIVERGED, INACCURATE, INVENTED, OK, Row, small_vibration

DRIFT, ENERGY = "drift", "energy error, relative"
DRIFT_STEP, DRIFT_STEPS = 1e-3, 1_000_000


def drift_rows(steps: int = DRIFT_STEPS) -> Iterator[Row]:
    """The largest energy error up to 10, 100, 1000 ... steps of 1 ms of the paper's arm, cut to 2 modes a link.

    It is released bent, with energy in its first modes and turning joints; nothing drives or damps it. The energy error
    is relative to the first energy; the parameter is the number of steps.
    """
    model = build_model(catalog.paper_rrr(), 2, 2)
    start = small_vibration(model, [1, 2, 3], energy=5.0)
    start[model.n_dof : model.n_dof + 3] = start[model.n_dof + model.motor_columns] = (0.2, 0.3, -0.4)
    counts = [10**power for power in range(2, 10) if 10**power <= steps]
    for name in fixed_step_methods():
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
