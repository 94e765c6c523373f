"""Specification of an agent: policy function and the settings of an environment that belong to the agent."""

from dataclasses import dataclass, field, replace
from inspect import signature
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from flexman_gym.agent.agent import Law
from flexman_gym.agent.base_controllers import BASES, parse_kind
from flexman_gym.envs.config.base_and_mode import make_base_and_mode
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.sensors.instrument import Instrument

if TYPE_CHECKING:
    from flexman_gym.evaluation.action_clock import ActionClock

INTERFACE = ("base", "action_repeat", "sensors", "history", "actions")  # settings that belong to the agent
SIMPLE_AGENTS = {"zero": "no torque at all", "random": "random torques"}  # agents without controller -> description
BASELINES = (*BASES, *SIMPLE_AGENTS)
"""Names of the agents that need no training."""


@dataclass(frozen=True)
class AgentSpec:
    """Specification of an agent: name, policy function, and the settings of an environment that belong to the agent.

    Attributes:
        name: name in tables.
        law: policy function from observations (b, size) to actions (b, k) between -1 and 1; None for zero actions, so
            that only the base controller acts.
        interface: settings in INTERFACE and the gains of the base controller, by name; None for the settings of the
            environment in which the agent acts.
        environment: environment of the training, without these settings; None for an agent without training.
    """

    name: str
    law: Law | None = None
    interface: dict[str, Any] | None = field(default_factory=dict)
    environment: Configuration | None = None

    @classmethod
    def from_predictor(cls, model: Any, environment: Configuration | None = None) -> Self:
        """Return the specification of an object whose method `predict` maps observations (b, size) to actions (b, n).

        For a model of Stable-Baselines3, the environment of the training is the environment of the model, and
        observations are normalised by its `VecNormalize`, if any. For any other object the observations come from the
        environment in which it acts. Actions are clipped to [-1, 1].

        Args:
            model: the object; `predict` may also return a tuple whose first entry is the actions.
            environment: environment of the training, for a model without an environment.
        """
        normaliser = getattr(model, "get_vec_normalize_env", lambda: None)()
        venv = getattr(model, "get_env", lambda: None)()
        if environment is None and venv is not None:
            environment = venv.get_attr("configuration")[0]
        bare, interface = (None, None) if environment is None else split_interface(environment)

        options = {"deterministic": True}
        try:
            signature(model.predict).bind(None, **options)
        except TypeError:
            options = {}  # a `predict` without the argument `deterministic`

        def law(observations: NDArray[np.float32]) -> NDArray[np.floating]:
            inputs = observations if normaliser is None else normaliser.normalize_obs(observations)
            outputs = model.predict(inputs, **options)
            actions = np.asarray(outputs[0] if isinstance(outputs, tuple) else outputs, dtype=np.float32)
            return np.clip(actions, -1, 1).reshape(len(observations), -1)

        return cls(type(model).__name__, law, interface, bare)

    @classmethod
    def from_network(cls, name: str, network: Law, environment: Configuration, base_in_use: object = None) -> Self:
        """Return the specification of an agent whose policy function is a network.

        Args:
            name: name of the agent.
            network: policy function, from observations to actions.
            environment: environment of the training, with the settings of the agent. Base controller and action mode
                are designed for this environment, even if the agent is evaluated in a different one.
            base_in_use: base controller that replaces the base controller of the training; it is designed for the
                environment of the evaluation. None for the base controller of the training.
        """
        bare, interface = split_interface(environment)
        agent = cls(name, network, interface, bare)
        if base_in_use is None:
            return agent.designed(environment)
        parse_kind("base", base_in_use, BASES)
        interface.pop("gains", None)
        return replace(agent, interface={**interface, "base": base_in_use})

    def timed(self, environment: Configuration) -> "tuple[Self, ActionClock | None]":
        """Return the agent designed for an environment, and the clock that measures its CPU time.

        The second result is None for an agent that computes nothing, such as "zero".
        """
        if self.interface is None or (self.law is None and "base" not in self.interface):
            return self, None
        designed = self.designed(environment)
        assert designed.interface is not None
        from flexman_gym.evaluation.action_clock import ActionClock, TimedMode

        clock = ActionClock()
        mode = TimedMode(designed.interface["actions"], clock)
        law: Law | None = clock.timed(designed.law) if designed.law else None
        return replace(designed, law=law, interface={**designed.interface, "actions": mode}), clock

    def designed(self, environment: Configuration) -> Self:
        """Return the agent with base controller and action mode as objects, designed for a given environment.

        A controller given by its name would be designed for the environment in which the agent acts, with the delay,
        noise, friction and ranges there. Controllers and action modes that are objects are not changed.
        """
        if self.interface is None:
            return self
        design = environment.replace(**self.interface)
        base, mode = make_base_and_mode(design, resolve_fidelity(design).model)
        settings = {name: value for name, value in self.interface.items() if name != "gains"}
        return replace(self, interface={**settings, "base": base, "actions": mode})


def has_instrument_errors(environment: Configuration) -> bool:
    """Return True for sensors with errors, which also concern the readings of controllers."""
    return any(isinstance(each, Instrument) and each.settings() for each in environment.sensors)


def split_interface(environment: Configuration) -> tuple[Configuration, dict[str, Any]]:
    """Split a configuration into an environment without the settings in INTERFACE, and these settings by name.

    The gains of a PD controller are in both results: a policy needs the gains of its training, and the environment
    needs gains for the baseline "pd".
    """
    interface = {name: value for name, value in environment.given.items() if name in INTERFACE}
    if environment.base == "pd":
        interface["gains"] = environment.to_plain(strict=False)["gains"]
    return environment.without(INTERFACE), interface
