"""Active effects: disturbances such as noise or delay, and draws of parameters, enabled by a randomisation."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.common.checks import check_member_names
from flexman_gym.common.errors import value_error
from flexman_gym.envs.config.randomisation import Randomisation
from flexman_gym.envs.effects import SIGNALS, EffectContext
from flexman_gym.envs.effects.effect import HOOKS
from flexman_gym.envs.random_streams import RandomStreams
from flexman_gym.model.model import Model
from flexman_gym.simulation.physical_parameters import LINK, PARAMETERS


class ActiveEffects:
    """Disturbances and parameter draws of b arms, enabled by a randomisation.

    Each effect has a separate random generator per arm, its stream, seeded by the name of the effect and the seed of
    the arm. An effect draws once per episode from its stream; random events during the episode use a generator seeded
    by this draw. The arm's own generator is not used, so that enabling an effect does not change start and goal.

    Args:
        randomisation: enabled effects and their ranges.
        context: arms and signals changed by the effects.

    Attributes:
        drawn: effect -> values (b, ...) drawn for the current episodes: physical parameters in their units,
            torque_limit (N m), sensor_noise, delay (control periods) and initial_vibration (b, n, 2), m along y and z
            of the beam frame of each link. Impulses, which are drawn during the episode, are not included. Each reset
            makes a new dict of new arrays.

    Raises:
        ValueError: for an effect that does not apply to the model, or whose range exceeds the limits of the motion.
    """

    state_fields = ("drawn", "_streams", "_signals")

    def __init__(self, randomisation: Randomisation, context: EffectContext) -> None:
        self._batch, self._ranges = context.batch, randomisation.ranges
        model, arms, period = context.batch.model, len(context.batch.rows), context.batch.control_period
        if context.impulse_gap < period:
            raise value_error(
                "Randomisation.impulse_gap", context.impulse_gap, f"at least the control period, {period} s"
            )
        self._signals: dict[str, Any] = {}
        shapes: dict[str, tuple[int, ...]] = {}
        for name, span in self._ranges.items():
            if name in PARAMETERS:
                _check_parameter(name, span, model)
                shapes[name] = PARAMETERS[name].shape(model.n_joints)
            else:
                signal = self._signals[name] = SIGNALS[name](context, span)
                check_member_names(name, signal, HOOKS, ("checked", "shape", "draw"))
                if signal.shape is not None:
                    shapes[name] = signal.shape
        kinds = {name: getattr(signal, "kind", float) for name, signal in self._signals.items()}
        self._drawn = {name: np.zeros((arms, *shape), dtype=kinds.get(name, float)) for name, shape in shapes.items()}
        self._streams = RandomStreams([_stream_name(name) for name in self._ranges], arms)
        self._hooks = {hook: [getattr(each, hook) for each in self._signals.values() if hasattr(each, hook)]
                       for hook in HOOKS}  # fmt: skip

    @property
    def drawn(self) -> dict[str, NDArray[Any]]:
        """Values (b, ...) drawn for the current episodes, by the name of the effect; see the class."""
        return self._drawn

    @drawn.setter
    def drawn(self, values: dict[str, NDArray[Any]]) -> None:
        if values.keys() != self._drawn.keys():  # of a saved state
            raise value_error("effects.drawn", sorted(values), f"the effects {', '.join(self._drawn)}")
        self._drawn = values

    def draw(
        self, arms: IntArray, randoms: Sequence[np.random.Generator], given: Mapping[str, Array]
    ) -> dict[str, Array]:
        """Draw the values of all effects for new episodes; return physical parameters (r, ...) by name.

        Args:
            arms: (r,) indices of the arms.
            randoms: random generator of each of these arms.
            given: physical parameters (r, ...) by name that replace drawn values. The values are drawn nevertheless,
                so that later draws do not change.
        """
        self.drawn = {name: values.copy() for name, values in self.drawn.items()}
        for row, (arm, random) in enumerate(zip(arms.tolist(), randoms, strict=True)):
            streams = self._streams.generators(arm, random)
            for name in self._ranges:
                value = self._value(name, arm, streams[_stream_name(name)])
                if name in self.drawn:
                    self.drawn[name][arm] = given[name][row] if name in given else value
        for name, signal in self._signals.items():
            if hasattr(signal, "begin"):
                signal.begin(arms, self.drawn[name])
        return {name: self.drawn[name][arms] for name in PARAMETERS if name in self.drawn} | dict(given)

    def _value(self, name: str, arm: int, stream: np.random.Generator) -> Any:
        """Draw the value of an effect for an episode of an arm."""
        if name in self._signals:
            return self._signals[name].draw(arm, stream)
        row, model, nominal = PARAMETERS[name], self._batch.model, self._batch.nominal[name]
        values = stream.uniform(*self._ranges[name], nominal.shape or None)
        drawn = values * nominal if row.factor else values
        return np.where(row.fixed(model), nominal, drawn) if nominal.shape else drawn

    def drawn_for(self, arm: int) -> dict[str, Any]:
        """Return the drawn values of one arm by the name of the effect, as new numbers and arrays."""
        drawn = {name: values[arm] for name, values in self.drawn.items()}
        return {name: value.item() if value.ndim == 0 else value.copy() for name, value in drawn.items()}

    def set_generators(self, randoms: Sequence[np.random.Generator | None]) -> None:
        """Set the generators of the arms after a restored state, so that the restored streams are not made again."""
        self._streams.set_generators(randoms)

    def change_start(self, arms: IntArray, states: Array) -> None:
        """Change the initial states (r, 2 d) of the arms (r,) in place."""
        for change in self._hooks["change_start"]:
            change(arms, states)

    def motor_actions(self, actions: Array) -> Array:
        """Return the torques (b, n) that reach the motors for commanded torques (b, n), as fractions of the limits."""
        for hook in self._hooks["motor_actions"]:
            actions = hook(actions)
        return actions

    def disturb(self, pushes: Array, forces: Array, accelerations: Array, over: BoolArray) -> None:
        """Write the disturbances of this control period.

        Args:
            pushes: (b, 3) forces at the tips without effects, N, see `Episodes.push`.
            forces: (b, 3) forces at the tips, N; overwritten.
            accelerations: (b, 3) accelerations of the bases, m/s^2; overwritten.
            over: (b,) True for arms without a running episode, which are not disturbed.
        """
        places = ("add_tip_forces", forces, pushes), ("add_base_accelerations", accelerations, 0.0)
        for hook, values, without in places:
            if self._hooks[hook]:
                values[:] = without
                for add in self._hooks[hook]:
                    add(values, over)

    @property
    def acts(self) -> bool:
        """True if an effect changes signals during an episode; False if all of them only set parameters and start."""
        return any(self._hooks[hook] for hook in HOOKS if hook not in ("begin", "change_start"))

    @property
    def measures(self) -> bool:
        """True if an effect changes measurements."""
        return bool(self._hooks["measure"])

    def measure(self, values: Array, arms: IntArray) -> Array:
        """Return the measured values (r, size) of the arms (r,) for true values (r, size)."""
        for measure in self._hooks["measure"]:
            values = measure(values, arms)
        return values


def _stream_name(effect: str) -> str:
    """Return the name that seeds the stream of an effect: without the suffix "_factor" of relative ranges."""
    return effect.removesuffix("_factor")


def _check_parameter(name: str, span: tuple[float, float], model: Model) -> None:
    """Raise ValueError if the model lacks the parameter or its nominal value is zero."""
    row, field = PARAMETERS[name], f"Randomisation.{Randomisation.range_name(name)}"
    if row.of == LINK and not (np.diff(model.constants.elastic_start) > 0).any():
        raise value_error(field, span, "None: every link of this arm is rigid")
    if row.shape(model.n_joints) and row.fixed(model).all():
        raise value_error(field, span, f"None: every joint of this arm is {row.lacking}")
    if row.factor and not np.any(row.nominal(model)):
        raise value_error(field, span, "None: the nominal value of this arm is zero")
