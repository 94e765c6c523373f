"""Fit of the rotary flexible link to a measured frequency response, scored on the frequencies left out of the fit."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array
from flexman_gym.common.errors import value_error
from flexman_gym.common.tables import read_table, table_name
from flexman_gym.model.dynamics import frequencies
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene import catalog
from flexman_gym.simulation.linearization import linearize
from flexman_gym.simulation.physical_parameters import PARAMETERS, varied_model

COLUMNS = ("frequency (Hz)", "real (rad/V)", "imaginary (rad/V)")
FITTED = ("link_stiffness_factor", "rotor_inertia", "viscous_friction", "link_damping")
LARGE_ERROR = 0.2  # 1; error of a fit that does not explain the response
BAD_FIT = "the fit does not explain the response: it must be that of the hub angle, rad, to the voltage of the motor, V"
MIN_FREQUENCIES = 12  # of a file; half of them are left out of the fit


class _ResponseFit(NamedTuple):
    """Fitted arm, and its error at the frequencies that were left out.

    Attributes:
        factors: (5,) fitted values of FITTED and of the torque per volt, relative to those of the catalogue.
        deviations: (5,) their standard deviations.
        error: root mean square of |computed - measured| / |measured| at the frequencies left out of the fit.
        before: this error of the arm of the catalogue.
        clamped: (2,) first frequencies of the fitted arm with the hub held, Hz.
    """

    factors: Array
    deviations: Array
    error: float
    before: float
    clamped: Array

    def __str__(self) -> str:
        """Return factors, clamped frequencies and error as text."""
        rows = [
            f"{name}: {factor:.4g} +- {deviation:.2g} times the value of the data sheet"
            for name, factor, deviation in zip((*FITTED, "torque_per_volt"), self.factors, self.deviations, strict=True)
        ]
        return "\n".join([
            *rows, f"clamped frequencies of the fitted arm: {self.clamped[0]:.3f} and {self.clamped[1]:.3f} Hz",
            f"root mean square of |computed / measured - 1| at the frequencies left out: {100 * self.error:.2g} % "
            f"(data sheet: {100 * self.before:.3g} %)",
            *(BAD_FIT,) * (self.error > LARGE_ERROR),
        ])  # fmt: skip


def read_response(path: Path) -> tuple[Array, NDArray[np.complex128]]:
    """Return frequencies (f,), Hz, and responses (f,) of the hub angle to the voltage, rad/V, of a CSV file.

    Args:
        path: file with the columns COLUMNS.

    Raises:
        ValueError: for other columns, too few or descending frequencies, and values that are not finite.
    """
    table = read_table(path)
    names = [" ".join(name.split()).lower() for name in table.headers or ()]
    if not {each.lower() for each in COLUMNS} <= {*names}:
        raise value_error(f"columns of {table_name(path)}", ", ".join(table.headers or ()), ", ".join(COLUMNS))
    hertz, real, imaginary = (table.values[:, names.index(each.lower())] for each in COLUMNS)
    for line, row in zip(table.lines, np.column_stack([hertz, real, imaginary]), strict=True):
        if not np.isfinite(row).all():
            raise value_error(f"{table_name(path)}: line {line}", row.tolist(), "3 finite numbers")
    response = real + 1j * imaginary
    if len(hertz) < MIN_FREQUENCIES or not (np.diff(hertz) > 0.0).all() or hertz[0] <= 0.0 or not response.all():
        raise value_error(
            f"rows of {path.name}", f"{len(hertz)}", f"at least {MIN_FREQUENCIES} ascending frequencies > 0 (Hz)"
        )
    return hertz, response


def _hub_response(model: Model, hertz: Array) -> NDArray[np.complex128]:
    """Return the response (f,) of the motor angle to a voltage at frequencies (f,) Hz, rad/V."""
    motor = model.arm.joints[0].motor
    assert motor is not None and motor.torque_per_volt is not None
    response = linearize(model, outputs=("motor_angles",)).frequency_response(hertz)
    return np.asarray(response[:, 0, 0] * motor.torque_per_volt, dtype=np.complex128)


def fit_response(hertz: Array, response: NDArray[np.complex128]) -> _ResponseFit:
    """Fit stiffness, inertia, friction and damping of the rotary link and the torque per volt to a response.

    Every second frequency is fitted; the others are left out and score the fit. Errors are relative, so that resonances
    and antiresonances have equal weight.

    Args:
        hertz: (f,) Hz.
        response: (f,) rad/V.
    """
    from scipy.optimize import least_squares

    model = build_model(catalog.quanser_rotary(), 8)
    nominal = {name: np.array(PARAMETERS[name].nominal(model), dtype=float) for name in FITTED}
    fitted, left_out = slice(0, None, 2), slice(1, None, 2)

    def changed(logarithms: Array) -> Model:
        factors = np.exp(logarithms[:-1])
        return varied_model(model, **{name: f * nominal[name] for name, f in zip(FITTED, factors, strict=True)})

    def errors(logarithms: Array, part: slice) -> Array:
        computed = np.exp(logarithms[-1]) * _hub_response(changed(logarithms), hertz[part])
        relative = computed / response[part] - 1.0
        return np.concatenate([relative.real, relative.imag])

    def root_mean_square(logarithms: Array) -> float:
        return float(np.sqrt(2.0 * np.mean(errors(logarithms, left_out) ** 2)))

    start = np.zeros(len(FITTED) + 1)
    found = least_squares(errors, start, args=(fitted,), loss="soft_l1", f_scale=0.3)
    freedom = max(len(found.fun) - len(start), 1)
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * (found.fun @ found.fun) / freedom
    factors = np.exp(found.x)
    return _ResponseFit(
        factors, factors * np.sqrt(np.diag(covariance)), root_mean_square(found.x), root_mean_square(start),
        frequencies(changed(found.x), lock_joints=True)[:2],
    )  # fmt: skip
