"""Base class of `FlexManEnv` and `FlexManVectorEnv`: saving, restoring, copying and pickling of the complete state."""

from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from flexman_gym.common.errors import key_error, value_error
from flexman_gym.common.snapshot import get_state, set_state
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.episodes import Episodes

Observations = NDArray[np.float32]


class StatefulEnv:
    """Base class of the single and the vector environment, with methods to get, set and copy the complete state."""

    state_fields: ClassVar[tuple[str, ...]]
    spaces: ClassVar[tuple[str, ...]]
    configuration: Configuration
    episodes: Episodes
    spec: Any
    _arguments: dict[str, Any]  # arguments of the constructor

    def get_state(self) -> dict[str, Any]:
        """Return the complete state as dicts and lists of arrays, numbers and strings.

        The state contains the motion, the episode and the parameters of every arm, the state of effects and agent, and
        all random generators. A second environment with the same arguments continues from this state bit for bit.
        """
        spaces = {name: get_state(getattr(self, name)._np_random) for name in self.spaces}
        fields = {name: get_state(getattr(self, name)) for name in self.state_fields}
        return {**fields, **spaces, "episodes": get_state(self.episodes), "agent": get_state(self.episodes.agent)}

    def set_state(self, state: dict[str, Any]) -> Observations:
        """Set the complete state from `get_state` of an environment with the same arguments.

        Args:
            state: result of `get_state`.

        Returns:
            Observations (b, size) of the arms.

        Raises:
            ValueError: for the state of a different environment; the episodes are then over.
        """
        names = {*self.state_fields, *self.spaces, "episodes", "agent"}
        if not isinstance(state, dict) or state.keys() != names:
            result = sorted(map(str, state)) if isinstance(state, dict) else state
            raise key_error("state", result, f"a result of get_state: {', '.join(sorted(names))}")
        fields = {name: set_state(f"state.{name}", getattr(self, name), state[name]) for name in self.state_fields}
        spaces = {name: set_state(f"state.{name}", None, state[name]) for name in self.spaces}
        for name, random in {**fields, **spaces}.items():
            if not isinstance(random, list | int | np.random.Generator | None):
                raise value_error(f"state.{name}", random, "a result of get_state")
        self.episodes.set_state(state["episodes"], state["agent"], self._generators(fields))
        for name, value in fields.items():
            setattr(self, name, value)
        for name, random in spaces.items():
            getattr(self, name)._np_random = random
        return self.episodes.agent.observations.copy()

    @contextmanager
    def _restored_on_error(self, options: object) -> Iterator[None]:
        """Restore the state if a reset with options fails; the reset episodes remain over.

        A reset without options fails if the drawn start is not feasible. The state is then not restored, so that the
        next reset draws a different start.
        """
        before = None if options is None or (isinstance(options, dict) and not options) else self.get_state()
        try:
            yield
        except Exception:
            if before is not None:
                over = self.episodes.over.copy()
                self.set_state(before)
                self.episodes.over[:] = over
            raise

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return _restored(type(self), deepcopy(self._arguments, memo), self.spec, self.get_state())

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (type(self), self._arguments, self.spec, self.get_state())  # for pickle

    def __copy__(self) -> Self:
        return deepcopy(self)  # also for a shallow copy: two environments never share arms

    def _generators(self, restored: dict[str, Any]) -> list[np.random.Generator | None]:
        """Return the random generator of each arm from restored values of `state_fields`."""
        raise NotImplementedError


def _restored(kind: type[Any], arguments: dict[str, Any], spec: Any, state: dict[str, Any]) -> Any:
    """Return an environment of a class with the given arguments, EnvSpec and state."""
    result = kind(**arguments)
    result.spec = spec
    result.set_state(state)
    return result
