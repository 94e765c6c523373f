"""State space: a linear model with names, in other scalings, sampled, reduced, and as other libraries have it."""

from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import check_solvable, non_negative, positive, sequence, value_error
from flexman_gym.model.natural_modes import natural_modes


class SecondOrderForm(NamedTuple):
    """Forces of d coordinates in balance, mass a = forces [q, v, u], and what is read, y = rows [q, v, a].

    Attributes:
        mass: (d, d).
        forces: (d, 2 d + m) by coordinates q, speeds v and inputs u.
        rows: (p, 3 d) by coordinates, speeds and accelerations a.
    """

    mass: Array
    forces: Array
    rows: Array


@dataclass(frozen=True, eq=False)
class LinearModel:
    """The linear model x' = A x + B u, y = C x + D u for small departures from a state and its torques.

    A sampled one has x at the next instant in place of x'. It unpacks to A, B, C, D.

    Attributes:
        A: (s, s); B: (s, m); C: (p, s); D: (p, m).
        states: names with units of x, as in the head of a CSV file, such as "tip_x (m)".
        inputs: names with units of u.
        outputs: names with units of y.
        period: of a sampled model, s; None for a continuous one.
        balance: from which A, B, C and D were found; None of a model that was changed since.
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
        """Eigenvalues (s,) of A: 1/s of a continuous model, ascending in size."""
        values: Any = np.linalg.eigvals(self.scaled().A if self.balance else self.A)
        result: Array = values[np.argsort(np.abs(values), kind="stable")]
        return result

    def frequency_response(self, frequencies: Vector) -> Array:
        """Gives the complex gains (f, p, m) from inputs to outputs at frequencies (f,) in Hz.

        Raises:
            ValueError: for frequencies that are not finite numbers >= 0, and at a pole without damping.
        """
        given = sequence("frequencies", frequencies, "numbers")
        turns = [2.0 * np.pi * non_negative(f"frequencies[{i}]", each, "Hz") for i, each in enumerate(given)]
        model = self.scaled() if self.balance else self
        places = 1j * np.array(turns) if self.period is None else np.exp(1j * np.array(turns) * self.period)
        with check_solvable("gains at these frequencies"):
            inner = [np.linalg.solve(place * np.eye(len(model.A)) - model.A, model.B) for place in places]
        return np.array([model.C @ each + model.D for each in inner]).reshape(len(turns), *self.D.shape)

    def scaled(self) -> "LinearModel":
        """Gives the same model in the coordinates of its natural modes, frequency times displacement and speed.

        All states are then square roots of energies, and the entries of A are frequencies, not their squares. Solvers
        of Riccati and Lyapunov equations, which fail on the stiff entries of finite elements, work on it.

        Raises:
            ValueError: for a model that was scaled, sampled or reduced before.
        """
        mass, forces, rows = self._own_balance()
        d = len(mass)
        squares, shapes = natural_modes(mass, -(forces[:, :d] + forces[:, :d].T) / 2.0)
        sizes = np.sqrt(np.maximum(squares, squares[squares > 0.0].min(initial=1.0)))
        place = shapes / sizes
        onward = shapes.T @ np.hstack([forces[:, :d] @ place, forces[:, d : 2 * d] @ shapes, forces[:, 2 * d :]])
        here = np.hstack([rows[:, :d] @ place, rows[:, d : 2 * d] @ shapes])
        felt = rows[:, 2 * d :] @ shapes @ onward
        names = [f"{kind}_{i + 1} (J^0.5)" for kind in ("mode", "mode_rate") for i in range(d)]
        return replace(
            self,
            A=np.vstack([np.hstack([np.zeros((d, d)), np.diag(sizes)]), onward[:, : 2 * d]]),
            B=np.vstack([np.zeros((d, len(self.inputs))), onward[:, 2 * d :]]),
            C=here + felt[:, : 2 * d],
            D=felt[:, 2 * d :],
            states=tuple(names),
            balance=None,
        )

    def reduced(self, frequency: float) -> "LinearModel":
        """Gives the natural modes up to a frequency (Hz); the others follow at once, as their stiffness lets.

        Static gains stay what they are (singular perturbation: Kokotovic, Automatica 12, 1976). States are those of
        `scaled`.

        Raises:
            ValueError: for a frequency that is not positive, and for a model that was changed before.
        """
        whole, d = self.scaled(), len(self._own_balance().mass)
        sizes = np.diag(whole.A[:d, d:])
        slow = np.flatnonzero(sizes <= 2.0 * np.pi * positive("frequency", frequency, "Hz"))
        fast = np.setdiff1d(np.arange(d), slow)
        slow, fast = np.append(slow, d + slow), np.append(fast, d + fast)
        with check_solvable("static gains"):
            follow = -np.linalg.solve(
                whole.A[np.ix_(fast, fast)], np.hstack([whole.A[np.ix_(fast, slow)], whole.B[fast]])
            )
        inner, direct = follow[:, : len(slow)], follow[:, len(slow) :]
        return replace(
            whole,
            A=whole.A[np.ix_(slow, slow)] + whole.A[np.ix_(slow, fast)] @ inner,
            B=whole.B[slow] + whole.A[np.ix_(slow, fast)] @ direct,
            C=whole.C[:, slow] + whole.C[:, fast] @ inner,
            D=whole.D + whole.C[:, fast] @ direct,
            states=tuple(whole.states[i] for i in slow),
        )

    def discrete(self, period: float, delay: float = 0.0) -> "LinearModel":
        """Gives the model as a controller with sampled inputs meets it, exactly.

        It is the exponential of [[A, B], [0, 0]] (Van Loan, IEEE Trans. Automatic Control 23, 1978). Inputs on their
        way are further states, the newest first (Astrom and Wittenmark, Computer-Controlled Systems).

        Args:
            period: for which inputs stay, s.
            delay: by which they come late, s; any part of the period and more.

        Raises:
            ValueError: for a sampled model, a period that is not positive and a negative delay.
        """
        if self.period is not None:
            raise value_error("period", period, "a continuous model")
        period, late = positive("period", period, "s"), non_negative("delay", delay, "s")
        whole = int(np.ceil(late / period - 1e-9))
        part = max(whole * period - late, 0.0)  # of a period in which the newest input that has come already acts
        size, m = self.B.shape
        transition, newest = discretize(self.A, self.B, period if whole == 0 or part == 0.0 else part)
        if whole and part:
            rest, older = discretize(self.A, self.B, period - part)
            older, transition = transition @ older, transition @ rest
        names = [f"{name} late by {k + 1}" for k in range(whole) for name in self.inputs]
        A, B = np.zeros((size + whole * m, size + whole * m)), np.zeros((size + whole * m, m))
        A[:size, :size] = transition
        if whole == 0:
            B[:size] = newest
        else:
            B[size : size + m] = np.eye(m)
            A[size + m :, size:-m] = np.eye((whole - 1) * m)
            if part:
                (A if whole > 1 else B)[:size, slice(-2 * m, -m) if whole > 1 else slice(None)] = newest
            A[:size, -m:] = older if part else newest
        C = np.hstack([self.C, np.zeros((len(self.C), whole * m))])
        D = self.D
        if whole and D.any():  # what is read at once has come late too
            C[:, -m:], D = D, np.zeros_like(D)
        return replace(self, A=A, B=B, C=C, D=D, states=(*self.states, *names), period=period, balance=None)

    def to_control(self) -> Any:
        """Gives the model as a StateSpace of python-control, with the names.

        Raises:
            ModuleNotFoundError: without that library, which the extra "control" installs.
        """
        try:
            control = import_module("control")
        except ModuleNotFoundError:
            raise ModuleNotFoundError("to_control needs python-control: pip install flexman_gym[control]") from None
        names = {"inputs": list(self.inputs), "outputs": list(self.outputs), "states": list(self.states)}
        given = {name: each for name, each in names.items() if each}
        return control.ss(self.A, self.B, self.C, self.D, 0 if self.period is None else self.period, **given)

    def _own_balance(self) -> SecondOrderForm:
        if self.balance is None:
            raise value_error("model", "one that was changed", "the model that linearize gives")
        return self.balance


def discretize(A: Array, B: Array, period: float) -> tuple[Array, Array]:
    """Gives the transition of states (s, s) and of inputs (s, m) over a period (s) of constant inputs."""
    from scipy.linalg import expm

    size, m = B.shape
    block = np.zeros((size + m, size + m))
    block[:size, :size], block[:size, size:] = A, B
    result = expm(positive("period", period, "s") * block)
    return result[:size, :size], result[:size, size:]
