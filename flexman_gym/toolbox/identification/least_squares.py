"""Least-squares problem of a fit: logarithms of free parameters, residuals, their Jacobian, and the solution."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import one_of
from flexman_gym.common.errors import value_error
from flexman_gym.common.progress import Progress
from flexman_gym.model.dynamics import mass_matrix
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene.arm import Arm
from flexman_gym.simulation.physical_parameters import (
    ARM,
    PARAMETERS,
    ScalarParameter,
    nominal_parameters,
    select_parts,
    varied_arm,
)
from flexman_gym.toolbox.identification.measurement import Filter, SimulatedResponse
from flexman_gym.toolbox.identification.ringing import Ringing

MAX_LOG_CHANGE = 7.0  # largest change of the logarithm of a parameter from its start: a factor of 1100
MAX_DAMPING_RATIO = 0.99  # dimensionless; largest modal damping ratio of a link
RELATIVE_STEP = 1e-6  # dimensionless; relative step of parameters in forward differences
TYPICAL_RATE = 2.0 * np.pi  # rad/s; motor rate at which friction is estimated below
# Start of a parameter that is 0 in the arm, from the model and the joint inertias (n,), kg m^2.
TYPICAL_VALUES: dict[str, Callable[[Model, Array], Array | float]] = {
    "payload_mass": lambda model, inertia: 0.1 * sum(link.mass for link in model.arm.links),
    "joint_damping": lambda model, inertia: 0.02 * np.sqrt(model.constants.joint_stiffness * inertia),
    "rotor_inertia": lambda model, inertia: 0.1 * inertia,
    "viscous_friction": lambda model, inertia: 0.02 * TYPICAL_RATE * inertia,
    "coulomb_friction": lambda model, inertia: 0.01 * TYPICAL_RATE**2 * inertia,
    "static_excess": lambda model, inertia: np.full(model.n_joints, 0.1),
    "backlash": lambda model, inertia: np.full(model.n_joints, 1e-3),
    "ripple_torque": lambda model, inertia: 0.01 * TYPICAL_RATE**2 * inertia,
    "link_damping": lambda model, inertia: np.full(model.n_joints, 0.01),
}


class FreeParameters:
    """Free parameters of an arm, as a vector.

    Args:
        arm: the initial arm.
        free: names of parameters, see `fit`.

    Attributes:
        by_name: the scalars of each name passed to `fit`.
        numbers: all p free scalars.
        arm: initial arm, with a typical value wherever a free parameter was 0.
        start: initial values (p,).
        highest: largest increase (p,) of the logarithms of the free values.
    """

    def __init__(self, arm: Arm, free: str | Sequence[str]) -> None:
        names = [free] if isinstance(free, str) else list(free)
        if not names:
            raise value_error("free", free, f"at least one of {', '.join(PARAMETERS)}")
        model = build_model(arm, 1, flexible_links=False)
        self.by_name = {str(name): _numbers(str(name), model) for name in names}
        self.numbers = list(dict.fromkeys(number for some in self.by_name.values() for number in some))
        self.arm, self._base = arm, nominal_parameters(model)
        inertia = np.diag(mass_matrix(model, np.zeros(2 * model.n_dof)))[: model.n_joints]
        start = self.select(self._base)
        for i in np.flatnonzero(start == 0.0):
            number = self.numbers[i]
            typical = np.ravel(TYPICAL_VALUES[number.name](model, inertia))
            start[i] = typical[number.part or 0]
        self.start, self.arm = start, self.build_arm(start)
        ratios = np.array([number.name == "link_damping" for number in self.numbers])
        self.highest = np.where(ratios, np.log(MAX_DAMPING_RATIO / start), MAX_LOG_CHANGE)

    def select(self, parameters: Mapping[str, Any]) -> Array:
        """Return the values (p,) of the free scalars from parameters by name."""
        return np.array([np.ravel(parameters[each.name])[each.part or 0] for each in self.numbers], dtype=float)

    def parameters(self, values: Array, rest: float = 1.0) -> dict[str, Array]:
        """Return parameters by name: free values (p,), and `rest` times the initial values for all other entries."""
        result = {each.name: rest * np.array(self._base[each.name], ndmin=1) for each in self.numbers}
        for number, value in zip(self.numbers, values, strict=True):
            result[number.name][number.part or 0] = value
        return {name: each if PARAMETERS[name].of != ARM else each[0] for name, each in result.items()}

    def build_arm(self, values: Array) -> Arm:
        """Return the arm with values (p,) of the free scalars."""
        return varied_arm(self.arm, self.parameters(values))

    def perturbed(self, model: Model, departures: Array) -> dict[str, Array]:
        """Perturb the parameters of a model for forward differences.

        Args:
            model: model of an arm.
            departures: logarithms (p,) of the ratios of free values to values of the model, for all arms; in the
                perturbed arms one of the values is increased by the fraction RELATIVE_STEP.

        Returns:
            Parameters (1 + p, ...) by name: values of the unperturbed arm, then for each free scalar the values of the
            arm with its increased value.
        """
        count, nominal = 1 + len(self.numbers), nominal_parameters(model)
        result = {each.name: np.array([nominal[each.name]] * count) for each in self.numbers}
        for i, number in enumerate(self.numbers):
            factors = np.full(count, np.exp(departures[i]))
            factors[1 + i] *= 1.0 + RELATIVE_STEP
            column = () if number.part is None else (number.part,)
            result[number.name][(slice(None), *column)] *= factors
        return result


def _numbers(name: str, model: Model) -> list[ScalarParameter]:
    """Return the free scalars of a name passed to `fit`, such as joint_stiffness or joint_stiffness[1]."""
    kind, _, index = name.partition("[")
    if PARAMETERS[one_of("free", kind, PARAMETERS)].of == ARM:
        if index:
            raise value_error("free", name, kind)
        return [ScalarParameter(kind, None)]
    elastic = kind in ("joint_stiffness", "joint_damping")
    indices = np.flatnonzero(model.constants.motor >= 0).tolist() if elastic else list(range(model.n_joints))
    indices = select_parts("free", name, indices, model.n_joints)
    if not indices:
        raise value_error("free", name, "a parameter that this arm has: the joint is rigid")
    return [ScalarParameter(kind, each) for each in indices]


INITIAL_NOISE = 0.1  # dimensionless; standard deviation of noise before the first fit, relative to the signal's
MIN_NOISE = 1e-12  # in the unit of the signal; least standard deviation of noise, the size of rounding errors
FAILED_RESIDUAL = 1e3  # standard deviations; residual of an arm whose simulation fails
MAX_ROUNDS = 4  # largest number of alternations of solving for the parameters and updating noise and model
MAX_EVALUATIONS = 40  # largest number of evaluations in a round
ROUND_TOLERANCE = 1e-4  # change of the parameter vector below which a round is the last
STEP_TOLERANCE = 0.5  # standard deviations; largest change of a parameter by halving the time step
MIN_RELATIVE_NOISE = 1e-3  # dimensionless; least noise for this test, relative to the standard deviation of the signal
MAX_HALVINGS = 5  # largest number of halvings of the time step
BOUND_MARGIN = 1e-3  # least distance of the start of a solution from the bounds of the parameter vector
FILTER_DAMPING_RATIO = 0.7  # dimensionless; damping ratio of the assumed filter of an output


class _ResidualBlock(NamedTuple):
    """Residuals of one output of a record, or of the frequencies and damping ratios at one posture.

    Attributes:
        record: index of the record, -1 for frequencies.
        name: name of the output.
        measured: measured values (m,).
        sigma: assumed standard deviations (m,).
        known: True if the standard deviations are given by the user.
        gain: index of the gain among the nuisance parameters, or -1.
        offset: index of the offset among the nuisance parameters, or -1.
        corner: index of the cut-off frequency of an assumed filter among the nuisance parameters, or -1.
    """

    record: int
    name: str
    measured: Array
    sigma: Array
    known: bool
    gain: int = -1
    offset: int = -1
    corner: int = -1


class LeastSquaresProblem:
    """Residuals of an arm as a function of the parameter vector.

    The parameter vector (u,) has the logarithms (p,) of the ratios of the free values to their initial values, then the
    nuisance parameters: gains and offsets of sensors, and the logarithm of the cut-off frequency (rad/s) of a filter.

    Args:
        free: the free parameters.
        ringing: measured frequencies and damping ratios.
        responses: simulated responses of the records.
        choice: numbers of elements and modes of the model.
        corner: name of an output with an assumed low-pass filter; "" for none.

    Attributes:
        free: the free parameters.
        ringing: measured frequencies and damping ratios.
        responses: simulated responses of the records.
        choice: numbers of elements and modes of the model.
        blocks: residual blocks.
        nuisances: names of the nuisance parameters.
        start: initial parameter vector (u,).
    """

    def __init__(
        self,
        free: FreeParameters,
        ringing: list[Ringing],
        responses: list[SimulatedResponse],
        choice: dict[str, Any],
        corner: str = "",
    ) -> None:
        self.free, self.ringing, self.responses, self.choice = free, ringing, responses, choice
        self.nuisances: list[str] = []
        start = [0.0] * len(free.numbers)
        self.blocks = [_ResidualBlock(-1, "ringing", each.measured, each.deviations, True) for each in ringing]
        for number, response in enumerate(responses):
            data = response.measurement
            for name, values in data.outputs.items():
                measured = values[data.compared]
                indices = [-1, -1, -1]
                wanted = (name in data.gains, name in data.offsets, name == corner)
                labels = (f"gain of {name}", f"offset of {name} in record {number}", f"corner of {name}")
                sizes = (1.0, 0.0, np.log(2.0 * np.pi * 0.02 / data.period))
                for i, (label, size) in enumerate(zip(labels, sizes, strict=True)):
                    if wanted[i] and label not in self.nuisances:
                        self.nuisances.append(label)
                        start.append(float(size))
                    indices[i] = self.nuisances.index(label) if wanted[i] else -1
                known = name in data.deviations
                size = data.deviations[name] if known else max(INITIAL_NOISE * float(np.std(measured)), MIN_NOISE)
                sigma = np.full(len(measured), size)
                self.blocks.append(_ResidualBlock(number, name, measured, sigma, known, *indices))
        self.start = np.array(start)
        self._last: tuple[Array, Array, Array] | None = None
        self._progress = Progress("evaluations of the fit")
        self._model_point, self._model = self.start, self.model(self.start)

    def model(self, x: Array) -> Model:
        """Return the model of the arm at a parameter vector."""
        return build_model(self.free.build_arm(self.values(x)), **self.choice)

    def values(self, x: Array) -> Array:
        """Return the free values (p,) at a parameter vector."""
        return np.asarray(self.free.start * np.exp(x[: len(self.free.start)]))

    def evaluate(self, x: Array) -> tuple[Array, Array]:
        """Return the residuals (m,), computed minus measured, in standard deviations, and their Jacobian (m, u)."""
        if self._last is None or not np.array_equal(self._last[0], x):
            self._last = (x.copy(), *self._evaluate(x))
            self._progress.count()
        return self._last[1], self._last[2]

    def _evaluate(self, x: Array) -> tuple[Array, Array]:
        p, model = len(self.free.numbers), self._model
        perturbed = self.free.perturbed(model, (x - self._model_point)[:p])
        ringing = [each.predict(model, perturbed, RELATIVE_STEP) for each in self.ringing]
        signals = [response.signals(model, perturbed) for response in self.responses]
        names = [list(response.measurement.outputs) for response in self.responses]
        residuals, rows = [], []
        for number, block in enumerate(self.blocks):
            jacobian = np.zeros((len(block.measured), len(x)))
            if block.record < 0:
                computed, jacobian[:, :p] = ringing[number]
            else:
                own = signals[block.record][:, names[block.record].index(block.name)]
                computed = self._predict(x, block, own, jacobian)
            if np.isfinite(computed).all() and np.isfinite(jacobian).all():
                residuals.append((computed - block.measured) / block.sigma)
                rows.append(jacobian / block.sigma[:, None])
            else:
                residuals.append(np.full(len(block.measured), FAILED_RESIDUAL))
                rows.append(np.zeros_like(jacobian))
        return np.concatenate(residuals), np.vstack(rows)

    def _predict(self, x: Array, block: _ResidualBlock, signals: Array, jacobian: Array) -> Array:
        """Return the output of the sensor of a block from signals (1 + p, T); fill in its Jacobian."""
        p, data = len(self.free.numbers), self.responses[block.record].measurement
        if block.corner >= 0:
            corner, h = x[p + block.corner], 0.01
            shifted = [_low_pass(corner + sign * h).applied(signals[0], data.period) for sign in (1.0, -1.0)]
            signals = _low_pass(corner).applied(signals, data.period)
        signals = signals[:, data.compared]
        gain = x[p + block.gain] if block.gain >= 0 else 1.0
        jacobian[:, :p] = gain * (signals[1:] - signals[0]).T / RELATIVE_STEP
        if block.gain >= 0:
            jacobian[:, p + block.gain] = signals[0]
        if block.offset >= 0:
            jacobian[:, p + block.offset] = 1.0
        if block.corner >= 0:
            jacobian[:, p + block.corner] = gain * ((shifted[0] - shifted[1]) / (2.0 * h))[data.compared]
        return np.asarray(gain * signals[0] + (x[p + block.offset] if block.offset >= 0 else 0.0))

    def split(self, rows: Array) -> list[Array]:
        """Divide an array (m, ...) with the rows of all residuals into one array for each block."""
        return np.split(rows, np.cumsum([len(block.measured) for block in self.blocks])[:-1])

    def solve(self, x: Array) -> Array:
        """Return the least-squares parameter vector, from a start x, by Gauss-Newton steps in a trust region (SciPy).

        The solution alternates with updates of the model and of unknown noise levels, one per output over all records.
        """
        from scipy.optimize import least_squares

        low, high = np.full(len(x), -np.inf), np.full(len(x), np.inf)
        low[: len(self.free.numbers)], high[: len(self.free.numbers)] = -MAX_LOG_CHANGE, self.free.highest
        self._update_model(x)
        x = self._solve_sensors(x)
        for _ in range(MAX_ROUNDS):
            before = x
            found = least_squares(
                lambda y: self.evaluate(y)[0], np.clip(x, low + BOUND_MARGIN, high - BOUND_MARGIN),
                lambda y: self.evaluate(y)[1], (low, high), max_nfev=MAX_EVALUATIONS, xtol=1e-7, ftol=1e-8, gtol=1e-12,
            )  # fmt: skip
            x = found.x
            self._estimate_noise(x)
            self._update_model(x)
            if np.abs(x - before).max() < ROUND_TOLERANCE:
                break
        return np.asarray(x)

    def _update_model(self, x: Array) -> None:
        """Rebuild the model at a parameter vector.

        Component modes and modal damping are constant between updates, as the Jacobian assumes.
        """
        self._model_point, self._model, self._last = x.copy(), self.model(x), None

    def refine(self, x: Array) -> Array:
        """Halve time steps until halving changes no parameter by half a standard deviation; return the solution.

        The change of a parameter, in its standard deviations, is at most the norm of the change of the signals in
        standard deviations of the signals.
        """
        nominal = nominal_parameters(self.model(x))
        nominal_only = {"payload_mass": np.array([nominal["payload_mass"]])}
        for _ in range(MAX_HALVINGS):
            coarse = False
            for number, response in enumerate(self.responses):
                model, blocks = self.model(x), [block for block in self.blocks if block.record == number]
                before = response.signals(model, nominal_only)[0]
                response.step /= 2.0
                moved = (response.signals(model, nominal_only)[0] - before)[:, response.measurement.compared]
                sizes = [max(block.sigma[0], MIN_RELATIVE_NOISE * float(np.std(block.measured))) for block in blocks]
                fine = all(
                    np.linalg.norm(each) < STEP_TOLERANCE * size for each, size in zip(moved, sizes, strict=True)
                )
                response.step *= 2.0 if fine else 1.0
                coarse = coarse or not fine
            if not coarse:
                break
            self._last = None
            x = self.solve(x)
        return x

    def _solve_sensors(self, x: Array) -> Array:
        """Return a parameter vector with least-squares gains and offsets, on which the residuals depend linearly."""
        linear = [len(self.free.numbers) + i for i, name in enumerate(self.nuisances) if not name.startswith("corner")]
        result = x.copy()
        if linear:
            residuals, jacobian = self.evaluate(x)
            result[linear] -= np.linalg.lstsq(jacobian[:, linear], residuals, rcond=None)[0]
        return np.asarray(result)

    def _estimate_noise(self, x: Array) -> None:
        """Estimate the noise level of each output from its residuals."""
        rows, pooled = self.split(self.evaluate(x)[0]), {}
        for block in self.blocks:
            if not block.known:
                own = [r * b.sigma for r, b in zip(rows, self.blocks, strict=True) if b.name == block.name]
                rms = float(np.sqrt(np.mean(np.concatenate(own) ** 2)))
                pooled[block.name] = max(rms, MIN_NOISE)
        self.blocks = [
            block if block.known else block._replace(sigma=np.full(len(block.measured), pooled[block.name]))
            for block in self.blocks
        ]


def _low_pass(corner: float) -> Filter:
    """Return a low-pass filter for the logarithm of its cut-off frequency (rad/s)."""
    return Filter.low_pass(float(np.exp(np.clip(corner, -20.0, 20.0))) / (2.0 * np.pi), FILTER_DAMPING_RATIO)
