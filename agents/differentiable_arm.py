"""Control periods of arms with exact gradients in PyTorch, for back-propagation through a motion."""

from collections.abc import Callable, Mapping
from functools import partial
from math import prod
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd import Function

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import one_of
from flexman_gym.common.errors import value_error
from flexman_gym.kernels import layout
from flexman_gym.model.model import Model
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.methods import DEFAULT_METHOD, Method
from flexman_gym.simulation.period_map import PeriodMap
from flexman_gym.simulation.physical_parameters import ARM, PARAMETERS, ScalarParameter, varied_model
from flexman_gym.toolbox.sensitivity.differentiation import constant_derivatives


class DifferentiableArm:
    """Arms of one model whose control periods PyTorch differentiates with respect to state, torques and parameters.

    If an input requires a gradient, `step` also computes the Jacobian of each arm, in forward mode
    (`kernels.tangents`), and keeps it for the backward pass. The gradient is that of the computed motion, without
    finite differences. States and outputs have the bits of `Batch.step`. d is the number of coordinates, n of joints.

    Attributes:
        model: the model.

    Args:
        model: model of all arms.
        method: method of fixed steps, a Method or a name from `METHODS`.
        step: integration step, s; it divides the control period. "auto" selects the longest divisor up to 5 ms.
        control_period: s.
    """

    def __init__(
        self,
        model: Model,
        method: str | Method = DEFAULT_METHOD,
        step: float | str = "auto",
        control_period: float = 0.02,
    ) -> None:
        self.model, self._settings = model, (method, step, control_period)
        self._batch = Batch(model, *self._settings)
        self._batch_key: tuple[int, tuple[str, ...]] = 1, ()  # number of arms and names of parameters of the batch
        self._maps: dict[int, tuple[Any, PeriodMap]] = {}  # arm -> its parameters and its map; one for all without them
        self._map(0, {})  # checks the method

    def step(self, state: Tensor, torque: Tensor, **parameters: Tensor) -> tuple[Tensor, Tensor]:
        """Integrate b arms over a control period under constant torques.

        Args:
            state: (b, 2 d) coordinates and speeds; order in `kernels.layout`.
            torque: (b, n) motor torques, N m.
            **parameters: values by their name in `physical_parameters.PARAMETERS`, in the units there: (b,) for an
                arm, (b, n) for its joints or links; () or (n,) for all arms. Component modes do not change with them.

        Returns:
            State (b, 2 d) and outputs (b, OUTPUTS) at the end of the period: tip, deflection and energies; columns in
            `kernels.layout`.

        Raises:
            ValueError: for a wrong shape, a tensor that is not float64 on the CPU, and for parameters as in
                `Batch.vary`.
            RuntimeError: if an arm diverges, and in a backward pass with create_graph=True.
        """
        n, count = self.model.n_joints, len(state) if isinstance(state, Tensor) and state.dim() == 2 else 1
        inputs = [_checked("state", state, (count, 2 * self.model.n_dof)), _checked("torque", torque, (count, n))]
        for name, value in parameters.items():
            shape = PARAMETERS[one_of("parameters", name, PARAMETERS)].shape(n)
            inputs.append(_checked(name, value, (count, *shape), shape).expand(count, *shape))
        if torch.is_grad_enabled() and any(each.requires_grad for each in inputs):
            return _Period.apply(partial(self._differentiate, tuple(parameters)), *inputs)  # type: ignore[no-untyped-call]
        state_end, outputs = self._simulate(tuple(parameters), *(each.detach().numpy() for each in inputs))
        return torch.from_numpy(state_end), torch.from_numpy(outputs)

    def _simulate(self, names: tuple[str, ...], state: Array, torque: Array, *values: Array) -> tuple[Array, Array]:
        """Return the states and outputs at the end of the period without derivatives."""
        key, every = (len(state), names), np.arange(len(state))
        if self._batch_key != key:
            self._batch, self._batch_key = Batch(self.model, *self._settings, arms=len(state)), key
        self._batch.vary(every, **dict(zip(names, values, strict=True)))
        self._batch.place(every, state)
        self._batch.step(np.hstack([torque, np.zeros((len(torque), 6))]))
        _check_status(self._batch.status != layout.OK)
        return self._batch.state.copy(), self._batch.outputs.copy()

    def _differentiate(
        self, names: tuple[str, ...], state: Array, torque: Array, *values: Array
    ) -> tuple[Array, Array, Array]:
        """Return states (b, 2 d), outputs (b, OUTPUTS) and their derivatives at the end of the period.

        The derivatives (b, p, 2 d + OUTPUTS) are with respect to state, torque and values, p numbers of an arm.
        """
        size, n = state.shape[1], torque.shape[1]
        directions = np.eye(size + n + sum(prod(each.shape[1:]) for each in values))
        rows, drives = (np.zeros((len(directions), width)) for width in (size + 2, n + 6))
        rows[:, :size], drives[:, :n] = directions[:, :size], directions[:, size : size + n]
        ends = [
            self._map(arm, {name: each[arm] for name, each in zip(names, values, strict=True)}).advance(
                np.append(state[arm], (0.0, 0.0)), np.append(torque[arm], np.zeros(6)), rows, drives
            )
            for arm in range(len(state))
        ]
        _check_status(np.array([end.diverged for end in ends]))
        derivatives = np.array([np.hstack([end.rows[:, :size], end.derivatives]) for end in ends])
        return np.array([end.row[:size] for end in ends]), np.array([end.outputs for end in ends]), derivatives

    def _map(self, arm: int, values: Mapping[str, Array]) -> PeriodMap:
        """Return the map of an arm with given parameters, made anew if they differ from those of the last call."""
        arm, key = arm if values else -1, [(name, value.tobytes()) for name, value in values.items()]
        if arm not in self._maps or self._maps[arm][0] != key:
            derivatives: list[dict[str, Array]] = [{}] * (2 * self.model.n_dof + self.model.n_joints)
            for name in values:
                fixed = PARAMETERS[name].fixed(self.model)
                for part in [None] if PARAMETERS[name].of == ARM else range(self.model.n_joints):
                    own, constant = ScalarParameter(name, part), part is not None and fixed[part]
                    derivatives.append({} if constant else constant_derivatives(self.model, own, values))
            constants = varied_model(self.model, **values).constants
            period = self._batch.control_period, self._batch.substeps
            self._maps[arm] = key, PeriodMap(self.model, self._batch.method, period, derivatives, constants)
        return self._maps[arm][1]


class _Period(Function):
    """Control period of the arms; its backward pass multiplies gradients by the Jacobian of the forward pass."""

    @staticmethod
    def forward(ctx: Any, differentiate: Callable[..., Any], *inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Return state and outputs, and keep their derivatives."""
        results = differentiate(*(each.detach().numpy() for each in inputs))
        state, outputs, derivatives = map(torch.from_numpy, results)
        ctx.save_for_backward(derivatives)
        ctx.shapes = [each.shape for each in inputs]
        return state, outputs

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        """Return the gradients of state, torque and parameters from those of state and outputs."""
        if torch.is_grad_enabled():
            raise RuntimeError("create_graph: an arm has derivatives of first order only; give False")
        (derivatives,) = ctx.saved_tensors
        product = torch.einsum("bpo,bo->bp", derivatives, torch.cat(gradients, dim=1))
        parts = torch.split(product, [prod(shape[1:]) for shape in ctx.shapes], dim=1)
        return None, *(part.reshape(shape) for part, shape in zip(parts, ctx.shapes, strict=True))


def _checked(name: str, value: object, *shapes: tuple[int, ...]) -> Tensor:
    """Return a float64 tensor on the CPU that has one of the shapes."""
    if not isinstance(value, Tensor) or value.dtype != torch.float64 or value.device.type != "cpu":
        found: object = f"{value.dtype} on {value.device}" if isinstance(value, Tensor) else value
        raise value_error(name, found, "a float64 tensor on the CPU")
    if tuple(value.shape) not in shapes:
        raise value_error(name, tuple(value.shape), f"a tensor of shape {' or '.join(map(str, shapes))}")
    return value


def _check_status(failed: Array) -> None:
    """Raise an error for arms (b,) that diverge."""
    if failed.any():
        arms = ", ".join(map(str, np.flatnonzero(failed)[:10]))
        raise RuntimeError(f"arms [{arms}] diverge in this control period; give smaller torques, other states or a "
                           "shorter step")  # fmt: skip
