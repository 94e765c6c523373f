"""Fit of a published machine to a measured frequency response, scored on the frequencies left out of the fit.

The columns of the file choose the machine: hub angle to voltage of the rotary flexible link of Quanser, or motor rate
to motor torque of the industrial axis of Wernholt and Gunnarsson.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
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
from flexman_gym.scene.rigid_body import LumpedMass
from flexman_gym.simulation.linearization import linearize
from flexman_gym.simulation.physical_parameters import PARAMETERS, varied_model

Response = NDArray[np.complex128]
COLUMNS = ("frequency (Hz)", "real (rad/V)", "imaginary (rad/V)")
AXIS_COLUMNS = ("frequency (Hz)", "real (rad/s/(N m))", "imaginary (rad/s/(N m))")
RECORD_COLUMNS = ("time (s)", "motor torque (N m)", "motor rate (rad/s)")
SEGMENTS, MIN_COHERENCE, BAND = 8, 0.9, 0.1  # 1, 1, fraction of the sampling rate; estimate of a response from a record
FITTED = ("link_stiffness_factor", "rotor_inertia", "viscous_friction", "link_damping")
AXIS_FITTED = (
    "inertia of the motor", "inertia of the gear", "inertia of the arm", "stiffness of the gear",
    "stiffness of the arm", "damping of the gear", "damping of the arm", "viscous friction",
)  # fmt: skip
LARGE_ERROR = 0.2  # 1; error of a fit that does not explain the response
MIN_FREQUENCIES = 12  # of a file; half of them are left out of the fit


class Machine(NamedTuple):
    """Machine with a measured response.

    Attributes:
        columns: columns of the file.
        fitted: names of the fitted factors.
        model: function of the factors (p,), relative to the nominal values, that returns the model.
        response: function of the factors and of frequencies (f,), Hz, that returns the response (f,).
        quantity: the response in words.
        source: source of the nominal values.
    """

    columns: tuple[str, ...]
    fitted: tuple[str, ...]
    model: Callable[[Array], Model]
    response: Callable[[Array, Array], Response]
    quantity: str
    source: str


class _ResponseFit(NamedTuple):
    """Fitted arm, and its error at the frequencies that were left out.

    Attributes:
        machine: the machine.
        factors: (p,) fitted values, relative to those of the catalogue.
        deviations: (p,) their standard deviations.
        error: root mean square of |computed - measured| / |measured| at the frequencies left out of the fit.
        before: this error of the arm of the catalogue.
        clamped: (2,) first frequencies of the fitted arm with the motor held, Hz.
    """

    machine: Machine
    factors: Array
    deviations: Array
    error: float
    before: float
    clamped: Array

    def __str__(self) -> str:
        """Return factors, clamped frequencies and error as text."""
        rows = [
            f"{name}: {factor:.4g} +- {deviation:.2g} times the value of the {self.machine.source}"
            for name, factor, deviation in zip(self.machine.fitted, self.factors, self.deviations, strict=True)
        ]
        bad = f"the fit does not explain the response: it must be {self.machine.quantity}"
        return "\n".join([
            *rows, f"clamped frequencies of the fitted arm: {self.clamped[0]:.3f} and {self.clamped[1]:.3f} Hz",
            f"root mean square of |computed / measured - 1| at the frequencies left out: {100 * self.error:.2g} % "
            f"({self.machine.source}: {100 * self.before:.3g} %)",
            *(bad,) * (self.error > LARGE_ERROR),
        ])  # fmt: skip


def _estimated_response(time: Array, torque: Array, rate: Array) -> tuple[Array, Response]:
    """Return frequencies (f,), Hz, and the response (f,) of the motor rate to a torque that is held between samples.

    The ratio of averaged cross and power spectra, where the coherence is above MIN_COHERENCE (Ljung, System
    Identification, 1999, chapter 6).
    """
    from scipy.signal import coherence, csd, welch

    rate_of_samples, length = (len(time) - 1) / (time[-1] - time[0]), max(2 * len(time) // (SEGMENTS + 1), 2)
    hertz, across = csd(torque, rate, rate_of_samples, nperseg=length)
    power = welch(torque, rate_of_samples, nperseg=length)[1]
    shared = coherence(torque, rate, rate_of_samples, nperseg=length)[1]
    used = (hertz > 0.0) & (hertz < BAND * rate_of_samples) & (shared > MIN_COHERENCE)
    phase = np.pi * hertz[used] / rate_of_samples
    hold = np.sinc(phase / np.pi) * np.exp(-1j * phase)  # of a sample
    return hertz[used], np.asarray(across[used] / (power[used] * hold))


def _read_record(name: str, values: Array) -> tuple[Array, Response]:
    """Return the estimated response of a record (t, 3) of time, torque and rate, after a check.

    Raises:
        ValueError: for values that are not finite, unequal intervals, and a response at too few frequencies.
    """
    steps = np.diff(values[:, 0])
    even = np.isfinite(values).all() and len(steps) > 1 and steps.min() > 0.0 and steps.max() < 1.01 * steps.min()
    if not even or not values[:, 1].any():
        raise value_error(f"rows of {name}", len(values), "finite numbers at equal intervals of time, with a torque")
    hertz, response = _estimated_response(*values.T)
    if len(hertz) < MIN_FREQUENCIES:
        allowed = f"at least {MIN_FREQUENCIES}: a longer record, or a torque with more frequencies"
        raise value_error(f"{name}: frequencies with a coherence above {MIN_COHERENCE}", len(hertz), allowed)
    return hertz, response


def read_response(path: Path) -> tuple[Array, Response, Machine]:
    """Return frequencies (f,), Hz, responses (f,), and the machine of a CSV file.

    Args:
        path: file with the columns of one of MACHINES, or a record with RECORD_COLUMNS, of the axis.

    Raises:
        ValueError: for other columns, too few or descending frequencies, and values that are not finite.
    """
    table = read_table(path)
    names = [" ".join(name.split()).lower() for name in table.headers or ()]
    if {each.lower() for each in RECORD_COLUMNS} <= {*names}:
        return *_read_record(path.name, table.values[:, [names.index(each.lower()) for each in RECORD_COLUMNS]]), AXIS
    machine = next((each for each in MACHINES if {name.lower() for name in each.columns} <= {*names}), None)
    if machine is None:
        allowed = "; or ".join(", ".join(each) for each in (*(each.columns for each in MACHINES), RECORD_COLUMNS))
        raise value_error(f"columns of {table_name(path)}", ", ".join(table.headers or ()), allowed)
    hertz, real, imaginary = (table.values[:, names.index(each.lower())] for each in machine.columns)
    for line, row in zip(table.lines, np.column_stack([hertz, real, imaginary]), strict=True):
        if not np.isfinite(row).all():
            raise value_error(f"{table_name(path)}: line {line}", row.tolist(), "3 finite numbers")
    response = real + 1j * imaginary
    if len(hertz) < MIN_FREQUENCIES or not (np.diff(hertz) > 0.0).all() or hertz[0] <= 0.0 or not response.all():
        raise value_error(
            f"rows of {path.name}", f"{len(hertz)}", f"at least {MIN_FREQUENCIES} ascending frequencies > 0 (Hz)"
        )
    return hertz, response, machine


def _hub_response(model: Model, hertz: Array) -> Response:
    """Return the response (f,) of the motor angle to a voltage at frequencies (f,) Hz, rad/V."""
    motor = model.arm.joints[0].motor
    assert motor is not None and motor.torque_per_volt is not None
    response = linearize(model, outputs=("motor_angles",)).frequency_response(hertz)
    return np.asarray(response[:, 0, 0] * motor.torque_per_volt, dtype=np.complex128)


@cache
def _rotary_model() -> Model:
    return build_model(catalog.quanser_rotary(), 8)


def _rotary_machine() -> Machine:
    """Return the rotary link of Quanser; the last factor is that of the torque per volt."""

    def changed(factors: Array) -> Model:
        model = _rotary_model()
        nominal = {name: np.array(PARAMETERS[name].nominal(model), dtype=float) for name in FITTED}
        return varied_model(model, **{name: f * nominal[name] for name, f in zip(FITTED, factors, strict=False)})

    def response(factors: Array, hertz: Array) -> Response:
        return np.asarray(factors[-1] * _hub_response(changed(factors), hertz))

    quantity = "that of the hub angle, rad, to the voltage of the motor, V"
    return Machine(COLUMNS, (*FITTED, "torque_per_volt"), changed, response, quantity, "data sheet")


def _scaled_inertia(body: LumpedMass, factor: float) -> LumpedMass:
    return replace(body, inertia=(factor * np.array(body.inertia)).tolist())


def _axis_machine() -> Machine:
    """Return the axis of Wernholt and Gunnarsson: chain of motor, gear and arm, with viscous friction of the motor."""

    def changed(factors: Array) -> Model:
        arm = catalog.wernholt_2006()
        (motor, gear), (inner, outer) = arm.joints, arm.links
        links = [replace(link, masses=[_scaled_inertia(each, factor) for each in link.masses])
                 for link, factor in zip((inner, outer), factors[1:3], strict=True)]  # fmt: skip
        joints = [
            replace(joint, stiffness=k * joint.stiffness, damping=d * joint.damping)
            for joint, k, d in zip((motor, gear), factors[3:5], factors[5:7], strict=True)
        ]
        joints[0] = replace(joints[0], rotor_inertia=factors[0] * motor.rotor_inertia,
                            viscous_friction=factors[7] * motor.viscous_friction)  # fmt: skip
        return build_model(replace(arm, links=links, joints=joints))

    def response(factors: Array, hertz: Array) -> Response:
        rates = linearize(changed(factors), outputs=("motor_rates",)).frequency_response(hertz)
        return np.asarray(rates[:, 0, 0], dtype=np.complex128)

    quantity = "that of the motor rate, rad/s, to the torque of the motor, N m, both on the side of the motor"
    return Machine(AXIS_COLUMNS, AXIS_FITTED, changed, response, quantity, "paper")


ROTARY, AXIS = MACHINES = (_rotary_machine(), _axis_machine())
"""Machines whose response a file may have."""


def fit_response(hertz: Array, response: Response, machine: Machine = ROTARY) -> _ResponseFit:
    """Fit the factors of a machine to a response.

    Every second frequency is fitted; the others are left out and score the fit. Errors are relative, so that resonances
    and antiresonances have equal weight.

    Args:
        hertz: (f,) Hz.
        response: (f,) in the unit of the columns of the machine.
        machine: one of MACHINES.
    """
    from scipy.optimize import least_squares

    fitted, left_out = slice(0, None, 2), slice(1, None, 2)

    def errors(logarithms: Array, part: slice) -> Array:
        relative = machine.response(np.exp(logarithms), hertz[part]) / response[part] - 1.0
        return np.concatenate([relative.real, relative.imag])

    def root_mean_square(logarithms: Array) -> float:
        return float(np.sqrt(2.0 * np.mean(errors(logarithms, left_out) ** 2)))

    start = np.zeros(len(machine.fitted))
    found = least_squares(errors, start, args=(fitted,), loss="soft_l1", f_scale=0.3)
    freedom = max(len(found.fun) - len(start), 1)
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * (found.fun @ found.fun) / freedom
    factors = np.exp(found.x)
    return _ResponseFit(
        machine, factors, factors * np.sqrt(np.diag(covariance)), root_mean_square(found.x), root_mean_square(start),
        frequencies(machine.model(factors), lock_joints=True)[:2],
    )  # fmt: skip
