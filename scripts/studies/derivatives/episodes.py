"""Episodes of which a parameter is changed, for derivatives of episodes."""

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import flexman_gym as fm
from flexman_gym.agent import network
from flexman_gym.common.arrays import Array
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.episodes import Episodes
from flexman_gym.evaluation.agent_spec import AgentSpec
from flexman_gym.evaluation.agents import find_agent
from flexman_gym.kernels import layout
from flexman_gym.simulation.batch import Batch

SEED = 3
OUTPUTS = ("tip", "joint_rates", "elastic_energy", "gravitational_energy", "tip_error", "tip_vibration", "readings",
           "actions", "torques", "reward_terms", "return")  # fmt: skip
SIZES = {
    "payload_mass": 0.1, "joint_stiffness": 50.0, "joint_damping": 0.4, "rotor_inertia": 0.05, "viscous_friction": 0.8,
    "coulomb_friction": 0.1, "link_stiffness_factor": 1.0, "link_damping": 0.04, "initial_joint_angles": 0.3,
    "initial_joint_rates": 0.3, "motor_torques": 0.3, "tip_force": 3.0, "base_acceleration": 5.0, "stiffness": 10.0,
    "damping": 3.0,
}  # fmt: skip
ACTION_SIZE = 0.5  # size of an action
ROUNDED = ("agent.pd", "agent.agent", "evaluation.rollouts")  # modules that round actions or observations to float32


class _Numpy:
    """NumPy in which float32 is float64."""

    float32 = np.float64

    def __getattr__(self, name: str) -> Any:
        return getattr(np, name)


@contextmanager
def unrounded() -> Iterator[None]:
    """Run episodes without the rounding of actions and observations to seven digits, which hides small changes."""
    modules = [sys.modules[f"flexman_gym.{name}"] for name in ROUNDED]
    try:
        for module in modules:
            vars(module)["np"] = _Numpy()
        yield
    finally:
        for module in modules:
            vars(module)["np"] = np


def environment(id: str = "FlexPlanar-v0", periods: int = 20, **settings: Any) -> Configuration:
    """Return an environment with one mode per link and episodes of a few control periods."""
    named = Configuration(id, {})
    return Configuration(id, {"horizon": periods * named.control_period, "modes": 1, **settings})


def policy(size: int, outputs: int, algo: str = "ppo", **interface: Any) -> AgentSpec:
    """Return an agent whose policy is a network with random weights."""
    random = np.random.default_rng(0)
    first, last = ("actor.latent_pi.", "actor.mu") if algo == "sac" else ("mlp_extractor.policy_net.", "action_net")
    shapes = {f"{first}0": (8, size), f"{first}2": (8, 8), last: (outputs, 8)}
    arrays = {f"{name}.weight": random.normal(0.0, 0.4, shape) for name, shape in shapes.items()}
    arrays |= {f"{name}.bias": random.normal(0.0, 0.1, shape[:1]) for name, shape in shapes.items()}
    law = network.Network(algo, None, arrays, {"mean": np.zeros(size), "var": np.full(size, 0.5)})
    return AgentSpec(algo, law, interface)


@dataclass(frozen=True)
class ChangedEpisode:
    """Episodes of an agent, equal but for changes of one parameter.

    Attributes:
        agent: agent, as in `rollout`.
        world: environment.
    """

    agent: Any
    world: Configuration

    def outputs(self, text: str, changes: Array) -> Array:
        """Return the outputs (c, T, m), in the order of OUTPUTS, with changes (c,) of a parameter."""
        name, _, part = text.partition("[")
        index = int(part[:-1]) if part else None
        if name in ("stiffness", "damping"):
            agents = [with_gain(self.agent, name, index or 0, change) for change in changes.tolist()]
            return np.concatenate([outputs_of(agent, self.world, 1) for agent in agents])
        if name[-1].isdigit():
            agent = with_action(self.agent, int(name[-1]) - 1, index or 0, changes)
            return outputs_of(agent, self.world, len(changes))
        return outputs_of(self.agent, self.world, len(changes), lambda batch: change_plant(batch, name, index, changes))


def size_of(text: str) -> float:
    """Return the size of a parameter."""
    return SIZES.get(text.partition("[")[0], ACTION_SIZE)


def change_plant(batch: Batch, name: str, index: int | None, changes: Array) -> None:
    """Change a parameter of each arm of a batch."""
    model: Any = batch.model
    n, d, changed = model.n_joints, model.n_dof, vars(batch)
    if name in batch.nominal:
        values = np.repeat(batch.nominal[name][None], len(changes), axis=0)
        values[(slice(None),) if index is None else (slice(None), index)] += changes
        batch.vary(np.arange(len(changes)), **{name: values})
    elif name.startswith("initial"):
        reset, first = batch.reset, d * name.endswith("rates")
        columns = sorted({first + index, first + int(model.motor_columns[index])})
        units = np.eye(2 * d)[columns].sum(axis=0)
        changed["reset"] = lambda arms, states: reset(arms, states + changes[:, None] * units)
    else:
        step = batch.step
        column = {"motor_torques": 0, "tip_force": n, "base_acceleration": n + 3}[name] + (index or 0)

        def changed_step(drive: Array, moving: Any) -> None:
            drive[:, column] = changes + drive[:, column] * (column < n)  # forces are not overwritten in each period
            step(drive, moving)

        changed["step"] = changed_step


def with_gain(agent: Any, name: str, index: int, change: float) -> Any:
    """Return an agent with a changed gain of its controller or of its servo."""
    given = dict(agent if isinstance(agent, dict) else agent.interface["actions"])
    given[name] = [each + change * (i == index) for i, each in enumerate(given[name])]
    return given if isinstance(agent, dict) else replace(agent, interface={**agent.interface, "actions": given})


def with_action(agent: Any, column: int, number: int, changes: Array) -> AgentSpec:
    """Return an agent of which each arm has one action changed."""
    spec, count = find_agent(agent), [0]
    given: Any = spec.law

    def law(observations: Any) -> Any:
        result = np.zeros((len(changes), 2)) if given is None else np.array(given(observations))
        result[:, column] += changes * (count[0] == number)
        count[0] += 1
        return result

    return replace(spec, law=law)


def outputs_of(agent: Any, world: Configuration, count: int, set_plant: Callable[[Batch], None] | None = None) -> Array:
    """Return the outputs (count, T, m) of equal episodes, in the order of OUTPUTS."""
    parts: Mapping[str, list[Array]] = {name: [] for name in OUTPUTS}

    def record(episodes: Episodes) -> None:
        view, outputs = episodes.view, episodes.batch.outputs.copy()
        begun, d = len(parts["tip"]) > 0, episodes.batch.model.n_dof
        reward = begun * episodes.rewards()[:, None]
        now = {
            "tip": outputs[:, layout.TIP],
            "joint_rates": episodes.batch.rows[:, d : d + view.n_joints],
            "elastic_energy": outputs[:, [layout.LINK_ENERGY, layout.JOINT_ENERGY]].sum(axis=1, keepdims=True),
            "gravitational_energy": outputs[:, [layout.GRAVITATIONAL]],
            "tip_error": view.tip_error[:, None],
            "tip_vibration": view.tip_vibration[:, None],
            "readings": episodes.measurements.read(),
            "actions": begun * view.action,
            "torques": begun * episodes.motors.torques,
            "reward_terms": begun * np.transpose([each * np.ones(count) for each in episodes.reward_terms.values()]),
            "return": reward + (parts["return"][-1] if begun else 0.0),
        }
        for name, values in now.items():
            parts[name].append(values.copy())

    fm.rollout(agent, world, [SEED] * count, record, set_plant)
    return np.concatenate([np.array(each) for each in parts.values()], axis=2).swapaxes(0, 1)
