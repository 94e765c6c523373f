"""Agents to be evaluated: baselines, controllers, objects with `predict`, and trained agents by name or folder."""

from collections.abc import Sequence

import numpy as np

from flexman_gym.agent.base_controllers import BASES, parse_kind
from flexman_gym.agent.controller import Controller, EpisodeInfo, Readings
from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.common.errors import value_error
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.agent_spec import INTERFACE, SIMPLE_AGENTS, AgentSpec, has_instrument_errors


def find_agent(agent: object) -> AgentSpec:
    """Return the specification of an agent.

    Args:
        agent: a name in BASELINES or of a shipped policy, a mapping as for the setting `base`, the folder of an
            exported policy or of a training run (its best policy, or the newest one of a run without evaluations), a
            Controller, or an object with a method `predict`, see `AgentSpec.from_predictor`.

    Raises:
        ValueError: for an unknown name.
        FileNotFoundError: for a folder that does not exist.
    """
    if isinstance(agent, AgentSpec):
        return agent
    if isinstance(agent, Controller) and not isinstance(agent, type):
        return AgentSpec(type(agent).__name__, None, {"base": agent})
    if isinstance(agent, dict):
        return AgentSpec(parse_kind("base", agent, BASES)[0], None, {"base": agent})
    if hasattr(agent, "predict") and not isinstance(agent, type):
        return AgentSpec.from_predictor(agent)
    name = str(agent)
    if name in BASES:
        return AgentSpec(name, None, {"base": name})
    if name == "zero":
        return AgentSpec(name)
    if name == "random":
        return AgentSpec(name, None, {"base": _RandomTorques()})
    if name.endswith(".zip"):
        allowed = "--trust, if you trust their author: they are pickles, which can run any code when they are read"
        raise ValueError(f"agent: the files of Stable-Baselines3 in {name} are not read; give {allowed}")
    from flexman_gym.evaluation.trained_agents import load_agent  # controllers need no files of policies and runs

    return load_agent(name)


def is_baseline(name: str) -> bool:
    """Return True for the name of an agent that needs no training, also that of a plug-in."""
    return name in BASES or name in SIMPLE_AGENTS


def common_environment(
    agents: Sequence[AgentSpec], named: Configuration | None = None, changes: Sequence[str] = ()
) -> Configuration:
    """Return the environment in which agents are compared, without the settings in INTERFACE.

    Sensors with errors stay: controllers read with them.

    The baseline "pd" has the gains of the first agent whose training had a PD controller.

    Args:
        agents: agents to be compared.
        named: environment selected by the user; None for the environment of the training of the agents.
        changes: changes "name=value" of settings of the environment, see `Configuration.changed`.

    Raises:
        ValueError: if no environment is named and the agents were trained in different environments, and for a change
            of a setting in INTERFACE.
    """
    return _change(_without_agent(named) if named is not None else _training_environment(agents), changes)


def _without_agent(environment: Configuration) -> Configuration:
    """Return an environment without the settings in INTERFACE, but with sensors whose errors concern controllers."""
    kept = ("sensors",) if has_instrument_errors(environment) else ()
    return environment.without([name for name in INTERFACE if name not in kept])


def _training_environment(agents: Sequence[AgentSpec]) -> Configuration:
    trained = [(each.name, each.environment, each.environment.to_plain()) for each in agents if each.environment]
    for name, _, plain in trained:
        if {**plain, "gains": None} != {**trained[0][2], "gains": None}:
            allowed = "policies of one environment, or name one with --env: "
            raise value_error("agent", name, f"{allowed}{trained[0][0]} was trained in another environment")
    with_gains = [environment for _, environment, plain in trained if plain.get("gains")]
    return next(iter([*with_gains, *(environment for _, environment, _ in trained)]), Configuration())


def _change(environment: Configuration, changes: Sequence[str]) -> Configuration:
    if not changes:
        return environment
    for change in changes:
        name = change.split("=")[0].split(".")[0]
        if name in INTERFACE:
            allowed = f"a setting of the environment: {', '.join(INTERFACE)} belong to the agent"
            raise value_error("--set", change, allowed)
    return _without_agent(environment.changed(changes))


class _RandomTorques:
    """Controller with independent random torques, uniform between the torque limits."""

    sensors = ()

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Start new episodes, with the same torques as before."""
        self._random = np.random.default_rng(0)

    def act(self, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return torques (b, n) as fractions of the torque limits."""
        return self._random.uniform(-1.0, 1.0, applied.shape).astype(np.float32).astype(np.float64)
