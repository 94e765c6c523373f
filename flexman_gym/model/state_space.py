"""Linear state-space model with named inputs and outputs: order reduction, discretisation, export; natural modes."""

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import check_solvable, non_negative, positive, sequence
from flexman_gym.common.computer import optional_module
from flexman_gym.common.errors import value_error

SHIFT = 1e-9  # spectral shift / largest scaled stiffness; it makes K positive definite despite rigid-body modes
ZERO_SQUARE = 1e-10  # dimensionless; squared frequency / shift, below which the frequency is a rounded zero
MAX_SHIFTS = 6  # number of attempts, each with a shift 100 times as large as the last


class SecondOrderForm(NamedTuple):
    """Linear equations of motion of d coordinates q with speeds v, accelerations a, m inputs u and p outputs y.

    The equations are mass a = forces [q, v, u] and y = rows [q, v, a], with stacked vectors in brackets. q is the
    deviation from an operating point; all matrices are in SI units.

    Attributes:
        mass: (d, d) mass matrix.
        forces: (d, 2 d + m) Jacobian of the generalised forces by q, v and u.
        rows: (p, 3 d) Jacobian of the outputs by q, v and a.
    """

    mass: Array
    forces: Array
    rows: Array


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Linear model dx/dt = A x + B u, y = C x + D u for small deviations from a state and its torques.

    A discrete-time model is x[k + 1] = A x[k] + B u[k], y[k] = C x[k] + D u[k]. A model unpacks to A, B, C, D.

    Attributes:
        A: (s, s) state matrix.
        B: (s, m) input matrix.
        C: (p, s) output matrix.
        D: (p, m) feedthrough matrix.
        states: names of x with units, as in the header of a CSV file, such as "tip_x (m)".
        inputs: names of u with units.
        outputs: names of y with units.
        period: sampling period, s; None for a continuous-time model.
        balance: second-order form (equations of motion) from which `linearize` computed A, B, C and D; None in all
            derived models.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    states: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    period: float | None = None
    balance: SecondOrderForm | None = field(default=None, repr=False)

    def __iter__(self) -> Any:
        return iter((self.A, self.B, self.C, self.D))

    def __repr__(self) -> str:
        kind = "continuous" if self.period is None else f"sampled every {self.period:g} s"
        lines = [f"<LinearModel: {kind}, {len(self.A)} states"]
        for name in ("inputs", "outputs"):
            names = getattr(self, name)
            lines.append(f"  {len(names)} {name}: {', '.join(names[:8])}{', ...' if len(names) > 8 else ''}")
        return "\n".join(lines) + ">"

    @property
    def poles(self) -> Array:
        """Eigenvalues (s,) of A, sorted by modulus; 1/s for a continuous-time model, 1 for a discrete-time model."""
        values: Any = np.linalg.eigvals(self.scaled().A if self.balance else self.A)
        result: Array = values[np.argsort(np.abs(values), kind="stable")]
        return result

    def frequency_response(self, frequencies: Vector) -> Array:
        """Return the complex frequency response (f, p, m) from the m inputs to the p outputs.

        Args:
            frequencies: (f,) Hz, not negative.

        Raises:
            ValueError: for the frequency of an undamped pole.
        """
        checked = sequence("frequencies", frequencies, "numbers")
        omega = [2.0 * np.pi * non_negative(f"frequencies[{i}]", each, "Hz") for i, each in enumerate(checked)]
        model = self.scaled() if self.balance else self
        points = 1j * np.array(omega) if self.period is None else np.exp(1j * np.array(omega) * self.period)
        with check_solvable("gains at these frequencies"):
            responses = [np.linalg.solve(point * np.eye(len(model.A)) - model.A, model.B) for point in points]
        return np.array([model.C @ each + model.D for each in responses]).reshape(len(omega), *self.D.shape)

    def scaled(self) -> "LinearModel":
        """Return the model with omega_i eta_i and deta_i/dt as states, for the modal coordinate eta_i of each mode.

        All states then have the unit J^0.5, and the entries of A are natural frequencies omega_i instead of their
        squares. Solvers of Riccati and Lyapunov equations fail in the coordinates of finite elements, but work in the
        modal coordinates. Only the model returned by `linearize` can be scaled.
        """
        mass, forces, rows = self._second_order_form()
        d = len(mass)
        squares, shapes = natural_modes(mass, -(forces[:, :d] + forces[:, :d].T) / 2.0)
        omega = np.sqrt(np.maximum(squares, squares[squares > 0.0].min(initial=1.0)))
        displacements = shapes / omega
        parts = forces[:, :d] @ displacements, forces[:, d : 2 * d] @ shapes, forces[:, 2 * d :]
        acceleration_rows = shapes.T @ np.hstack(parts)
        output_rows = np.hstack([rows[:, :d] @ displacements, rows[:, d : 2 * d] @ shapes])
        feedthrough = rows[:, 2 * d :] @ shapes @ acceleration_rows
        names = [f"{kind}_{i + 1} (J^0.5)" for kind in ("mode", "mode_rate") for i in range(d)]
        return replace(
            self,
            A=np.vstack([np.hstack([np.zeros((d, d)), np.diag(omega)]), acceleration_rows[:, : 2 * d]]),
            B=np.vstack([np.zeros((d, len(self.inputs))), acceleration_rows[:, 2 * d :]]),
            C=output_rows + feedthrough[:, : 2 * d],
            D=feedthrough[:, 2 * d :],
            states=tuple(names),
            balance=None,
        )

    def reduced(self, frequency: float) -> "LinearModel":
        """Return the model reduced to the natural modes up to a frequency; faster modes are quasi-static.

        Singular perturbation preserves the static gains (Kokotovic, Automatica 12, 1976). The states are modal, as in
        `scaled`, and only the model returned by `linearize` can be reduced.

        Args:
            frequency: largest natural frequency of a retained mode, Hz.
        """
        scaled, d = self.scaled(), len(self._second_order_form().mass)
        omega = np.diag(scaled.A[:d, d:])
        slow = np.flatnonzero(omega <= 2.0 * np.pi * positive("frequency", frequency, "Hz"))
        fast = np.setdiff1d(np.arange(d), slow)
        slow, fast = np.append(slow, d + slow), np.append(fast, d + fast)
        with check_solvable("static gains"):
            static = -np.linalg.solve(
                scaled.A[np.ix_(fast, fast)], np.hstack([scaled.A[np.ix_(fast, slow)], scaled.B[fast]])
            )
        static_states, static_inputs = static[:, : len(slow)], static[:, len(slow) :]
        return replace(
            scaled,
            A=scaled.A[np.ix_(slow, slow)] + scaled.A[np.ix_(slow, fast)] @ static_states,
            B=scaled.B[slow] + scaled.A[np.ix_(slow, fast)] @ static_inputs,
            C=scaled.C[:, slow] + scaled.C[:, fast] @ static_states,
            D=scaled.D + scaled.C[:, fast] @ static_inputs,
            states=tuple(scaled.states[i] for i in slow),
        )

    def discrete(self, period: float, delay: float = 0.0) -> "LinearModel":
        """Return the zero-order-hold discretisation of the model, with delayed inputs.

        It uses the exponential of [[A, B], [0, 0]] (Van Loan, IEEE Trans. Automatic Control 23, 1978). Past inputs are
        additional states, the latest first (Astrom and Wittenmark, Computer-Controlled Systems).

        Args:
            period: sampling period, s.
            delay: delay of all inputs, s; not necessarily a multiple of the period.
        """
        if self.period is not None:
            raise value_error("period", period, "a continuous model")
        period, delay = positive("period", period, "s"), non_negative("delay", delay, "s")
        periods = int(np.ceil(delay / period - 1e-9))
        part = max(periods * period - delay, 0.0)  # s; time in a period during which the later of two inputs acts
        size, m = self.B.shape
        transition, newest_input = discretize(self.A, self.B, period if periods == 0 or part == 0.0 else part)
        if periods and part:
            rest, older_input = discretize(self.A, self.B, period - part)
            older_input, transition = transition @ older_input, transition @ rest
        names = [f"{name} late by {k + 1}" for k in range(periods) for name in self.inputs]
        A, B = np.zeros((size + periods * m, size + periods * m)), np.zeros((size + periods * m, m))
        A[:size, :size] = transition
        if periods == 0:
            B[:size] = newest_input
        else:
            B[size : size + m] = np.eye(m)
            A[size + m :, size:-m] = np.eye((periods - 1) * m)
            if part:
                (A if periods > 1 else B)[:size, slice(-2 * m, -m) if periods > 1 else slice(None)] = newest_input
            A[:size, -m:] = older_input if part else newest_input
        C = np.hstack([self.C, np.zeros((len(self.C), periods * m))])
        D = self.D
        if periods and D.any():  # the feedthrough is delayed as well
            C[:, -m:], D = D, np.zeros_like(D)
        return replace(self, A=A, B=B, C=C, D=D, states=(*self.states, *names), period=period, balance=None)

    def to_control(self) -> Any:
        """Return the model as a StateSpace of python-control, with its names.

        Raises:
            ImportError: if python-control is not installed, see the extra "control".
        """
        control = optional_module("control", "to_control", "control")
        names = {"inputs": list(self.inputs), "outputs": list(self.outputs), "states": list(self.states)}
        given = {name: each for name, each in names.items() if each}
        return control.ss(self.A, self.B, self.C, self.D, 0 if self.period is None else self.period, **given)

    def _second_order_form(self) -> SecondOrderForm:
        """Return the second-order form of a model from `linearize`; raise ValueError for a derived model."""
        if self.balance is None:
            raise value_error("model", "a changed model", "the continuous-time model of linearize")
        return self.balance


def discretize(A: Array, B: Array, period: float) -> tuple[Array, Array]:
    """Return state matrix (s, s) and input matrix (s, m) of the zero-order-hold discretisation.

    Args:
        A: (s, s) state matrix in continuous time.
        B: (s, m) input matrix in continuous time.
        period: sampling period, s.
    """
    from scipy.linalg import expm

    size, m = B.shape
    block = np.zeros((size + m, size + m))
    block[:size, :size], block[:size, size:] = A, B
    result = expm(positive("period", period, "s") * block)
    return result[:size, :size], result[:size, size:]


def natural_modes(mass: Array, stiffness: Array) -> tuple[Array, Array]:
    """Return squared natural frequencies (d,), rad^2/s^2, ascending, and mass-normalised mode shapes as columns (d, d).

    The error of a general eigenvalue solver is proportional to the largest squared frequency, which is huge for finite
    elements. Here the inverse frequencies are the singular values of L_M^T L_K^-T, with the Cholesky factors L_M and
    L_K of mass and stiffness, so that the lowest frequencies are the most accurate. Squared frequencies are negative
    where gravity makes the equilibrium unstable.

    Args:
        mass: mass matrix (d, d), positive definite, in SI units.
        stiffness: stiffness matrix (d, d), symmetric, in SI units.

    Raises:
        ValueError: for matrices without Cholesky factors in double precision.
    """
    from scipy.linalg import cholesky, solve_triangular, svd

    scale = np.sqrt(np.diag(mass))
    scaled_mass, scaled_stiffness = mass / np.outer(scale, scale), stiffness / np.outer(scale, scale)
    shift = SHIFT * max(np.abs(np.diag(scaled_stiffness)).max(initial=0.0), 1e-6)
    with check_solvable("natural modes"):
        mass_factor = cholesky(scaled_mass, lower=True)
        for _ in range(MAX_SHIFTS):
            try:
                stiffness_factor = cholesky(scaled_stiffness + shift * scaled_mass, lower=True)
                break
            except np.linalg.LinAlgError:
                shift *= 100.0
        else:
            raise np.linalg.LinAlgError
        left, inverse_frequencies, _ = svd(solve_triangular(stiffness_factor, mass_factor, lower=True).T)
        shapes = solve_triangular(mass_factor.T, left) / scale[:, None]
    squares = 1.0 / inverse_frequencies**2 - shift
    squares[np.abs(squares) < ZERO_SQUARE * shift] = 0.0
    order = np.argsort(squares, kind="stable")
    return squares[order], shapes[:, order]


def first_order_lag(period: float, bandwidth: float) -> tuple[float, float]:
    """Return the response of a first-order lag to a command that is constant over a period.

    Args:
        period: s.
        bandwidth: bandwidth of the lag, Hz.

    Returns:
        Difference of command and output at the end of the period and its mean over the period, as fractions of the
        initial difference.
    """
    decay = 2.0 * np.pi * bandwidth * period  # control period over time constant
    return float(np.exp(-decay)), float(-np.expm1(-decay) / decay)
