"""Active effects of a randomisation: draws of each episode, and their action on signals and parameters."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.common.checks import check_member_names, value_error
from flexman_gym.envs.config.randomisation import Randomisation, range_name
from flexman_gym.envs.effects import HOOKS, SIGNALS, EffectContext
from flexman_gym.envs.random_streams import RandomStreams
from flexman_gym.model.model import Model
from flexman_gym.simulation.parameters import LINK, PARAMETERS, RENAMED_PARAMETERS


class ActiveEffects:
    """The effects of a randomisation on b arms.

    An effect's stream of an arm is seeded by the name of the effect and the seed of the arm's generator, from which
    nothing is drawn. It gives one draw an episode; what happens within an episode comes from a generator that this draw
    seeds.

    Attributes:
        drawn: effect -> values (b, ...) of the episodes that the arms are in: physical parameters in their units,
            torque_limit (N m), sensor_noise, delay (periods) and initial_vibration (b, n, 2), m along y and z of each
            link's beam frame. Impulses are drawn on the way and are not in it. A new dict of new arrays after every
            reset.

    Raises:
        ValueError: for an effect that the model or the limits leave no room for.
    """

    state_fields = ("drawn", "_streams", "_signals")

    def __init__(self, randomisation: Randomisation, stage: EffectContext) -> None:
        self._batch, self._ranges = stage.batch, randomisation.ranges
        model, arms, period = stage.batch.model, len(stage.batch.rows), stage.batch.control_period
        if stage.impulse_gap < period:
            raise value_error(
                "Randomisation.impulse_gap", stage.impulse_gap, f"at least the control period, {period} s"
            )
        self._signals: dict[str, Any] = {}
        shapes: dict[str, tuple[int, ...]] = {}
        for name, span in self._ranges.items():
            if name in PARAMETERS:
                _check_room(name, span, model)
                shapes[name] = PARAMETERS[name].shape(model.n_joints)
            else:
                signal = self._signals[name] = SIGNALS[name](stage, span)
                check_member_names(name, signal, HOOKS, ("checked", "shape", "draw"))
                if signal.shape is not None:
                    shapes[name] = signal.shape
        kinds = {name: signal.kind for name, signal in self._signals.items()}
        self.drawn = {name: np.zeros((arms, *shape), dtype=kinds.get(name, float)) for name, shape in shapes.items()}
        self._streams = RandomStreams([_stream_name(name) for name in self._ranges], arms)
        self._hooks = {hook: self._with(hook) for hook in HOOKS}

    @property
    def drawn(self) -> dict[str, NDArray[Any]]:
        """Values (b, ...) of the present episodes by the name of the effect, see the class."""
        return self._drawn

    @drawn.setter
    def drawn(self, values: dict[str, NDArray[Any]]) -> None:
        self._drawn = {
            RENAMED_PARAMETERS.get(name, name): each for name, each in values.items()
        }  # states of release 0.2

    def _with(self, hook: str) -> list[Any]:
        """The hooks of that name of the effects that have one, with the effect's name for `begin`."""
        result = [(name, getattr(signal, hook)) for name, signal in self._signals.items() if hasattr(signal, hook)]
        return result if hook == "begin" else [method for _, method in result]

    def draw(
        self, arms: IntArray, randoms: Sequence[np.random.Generator], given: Mapping[str, Array]
    ) -> dict[str, Array]:
        """Draws for new episodes of the arms (r,); returns the physical parameters that differ, for `Batch.vary`.

        `given` parameters (r, ...) take the place of drawn ones, which are drawn all the same.
        """
        self.drawn = {name: values.copy() for name, values in self.drawn.items()}
        for row, (arm, random) in enumerate(zip(arms.tolist(), randoms, strict=True)):
            streams = self._streams.of(arm, random)
            for name in self._ranges:
                value = self._value(name, arm, streams[_stream_name(name)])
                if name in self.drawn:
                    self.drawn[name][arm] = given[name][row] if name in given else value
        for name, begin in self._hooks["begin"]:
            begin(arms, self.drawn[name])
        return {name: self.drawn[name][arms] for name in PARAMETERS if name in self.drawn} | dict(given)

    def _value(self, name: str, arm: int, stream: np.random.Generator) -> Any:
        """The value that an arm's episode draws of an effect."""
        if name in self._signals:
            return self._signals[name].draw(arm, stream)
        row, model, nominal = PARAMETERS[name], self._batch.model, self._batch.nominal[name]
        values = stream.uniform(*self._ranges[name], nominal.shape or None)
        drawn = values * nominal if row.factor else values
        return np.where(row.fixed(model), nominal, drawn) if nominal.shape else drawn

    def of(self, arm: int) -> dict[str, Any]:
        """What the episode of one arm drew, plain numbers and arrays that are the caller's."""
        drawn = {name: values[arm] for name, values in self.drawn.items()}
        return {name: value.item() if value.ndim == 0 else value.copy() for name, value in drawn.items()}

    def follow(self, randoms: Sequence[np.random.Generator | None]) -> None:
        """Takes the generators of all arms as those whose streams are in use, after these were given back."""
        self._streams.follow(randoms)

    def change_start(self, arms: IntArray, states: Array) -> None:
        """Changes the states (r, 2 d) from which the episodes of the arms (r,) start."""
        for change in self._hooks["change_start"]:
            change(arms, states)

    def motor_actions(self, actions: Array) -> Array:
        """What reaches the motors of the actions (b, n)."""
        for arriving in self._hooks["motor_actions"]:
            actions = arriving(actions)
        return actions

    def disturb(self, forces: Array, accelerations: Array, over: BoolArray) -> None:
        """Writes forces (b, 3) N on the tips and accelerations (b, 3) m/s^2 of the bases during this period.

        Nothing disturbs arms whose episode is over.
        """
        for hook, values in (("add_tip_forces", forces), ("add_base_accelerations", accelerations)):
            if self._hooks[hook]:
                values[:] = 0.0
                for add in self._hooks[hook]:
                    add(values, over)

    @property
    def measures(self) -> bool:
        """Whether something changes what is measured."""
        return bool(self._hooks["measure"])

    def measure(self, values: Array, arms: IntArray) -> Array:
        """What is measured of the values (r, size) of the arms (r,)."""
        for measure in self._hooks["measure"]:
            values = measure(values, arms)
        return values


def _stream_name(effect: str) -> str:
    """Return the name that seeds the stream of an effect, which is older than the suffix of factors."""
    return effect.removesuffix("_factor")


def _check_room(name: str, span: tuple[float, float], model: Model) -> None:
    """Refuses a parameter that nothing of the model has."""
    row, field = PARAMETERS[name], f"Randomisation.{range_name(name)}"
    if row.of == LINK and not (np.diff(model.constants.elastic_start) > 0).any():
        raise value_error(field, span, "None: every link of this arm is rigid")
    if row.shape(model.n_joints) and row.fixed(model).all():
        raise value_error(field, span, f"None: every joint of this arm is {row.lacking}")
    if row.factor and not np.any(row.nominal(model)):
        raise value_error(field, span, "None: this arm has none of it, of which a factor is a part")
