"""Stability drift: the energy of a free, undamped arm in a long run."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from flexman_gym.model.model import build_model
from flexman_gym.scene import catalog
from flexman_gym.simulation.scenes import simulate
from studies.methods import fixed_step_methods
from studies.stability.cases import motion
from studies.stability.measure import DIVERGED, INACCURATE, INVENTED, OK, Row, small_vibration

DRIFT, ENERGY = "drift", "energy error, relative"
DRIFT_STEP, DRIFT_STEPS, EVERY = 1e-3, 1_000_000, 100  # s; steps of a run, and from one output to the next


def drift_rows(steps: int = DRIFT_STEPS, names: Sequence[str] | None = None) -> Iterator[Row]:
    """The largest energy error up to 10, 100, 1000 ... steps of 1 ms of the paper's arm, cut to 2 modes a link.

    It is released bent, with energy in its first modes and turning joints; nothing drives or damps it. The energy error
    is relative to the first energy; the parameter is the number of steps.
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
                yield Row(DRIFT, float(done), name, DRIFT_STEP, ENERGY, largest, None, verdict)
        if run.status != OK:
            yield Row(DRIFT, float(EVERY * len(errors)), name, DRIFT_STEP, ENERGY, float(errors[-1]), None, run.status)
