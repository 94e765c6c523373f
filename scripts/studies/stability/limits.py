"""Stability limits: the largest stable steps of explicit methods, and the spectral radii of the others."""

from collections.abc import Iterator, Sequence

import numpy as np

from flexman_gym.simulation.amplification import spectral_radii
from flexman_gym.simulation.methods import METHODS
from studies.methods import explicit_methods, implicit_methods
from studies.stability.cases import CASES, MODES, PAYLOAD, SPRINGS, parameters_of
from studies.stability.measure import (
    INACCURATE,
    LIMIT_TOLERANCE,
    OK,
    Row,
    growth_per_step,
    measured_limit,
    predicted_limit,
)

LIMIT, RADIUS, AMPLIFICATION = "step limit, s", "spectral radius", "amplification"
LIMIT_STUDIES = (SPRINGS, MODES, PAYLOAD)


def limit_rows(study: str, quick: bool = False, parameters: Sequence[float] | None = None) -> Iterator[Row]:
    """The largest stable step of every explicit method, measured and predicted by the highest natural frequency."""
    for parameter in parameters or parameters_of(study, quick):
        model = CASES[study](parameter).model
        for name in explicit_methods():
            predicted = predicted_limit(model, METHODS[name], growth_per_step())
            measured = measured_limit(model, METHODS[name], predicted)
            verdict = OK if abs(measured - predicted) <= LIMIT_TOLERANCE * predicted else INACCURATE
            yield Row(study, parameter, name, predicted, LIMIT, measured, predicted, verdict)


def amplification_rows() -> Iterator[Row]:
    """The largest spectral radius of each other method for an undamped vibration; the parameter is its omega h."""
    angles = np.concatenate([np.arange(1, 1000) * 1e-2, np.geomspace(10.0, 1e4, 300)])
    for name in implicit_methods():
        radii = spectral_radii(METHODS[name], angles)
        largest = int(np.argmax(radii))
        yield Row(AMPLIFICATION, float(angles[largest]), name, 0.0, RADIUS, float(radii[largest]), None, OK)
