"""Export of a controller as C99: header, source, test program with recorded readings, and a page."""

import re
from dataclasses import dataclass, field
from pathlib import Path
from string import Template
from textwrap import wrap
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.common.checks import value_error
from flexman_gym.control.actions import TorqueMode
from flexman_gym.control.agent import Agent, history_length
from flexman_gym.control.controller import EpisodeInfo, Readings
from flexman_gym.control.input_shaping.shaped_controller import InputShapedController
from flexman_gym.control.lqr import LQR, TrackingLQR
from flexman_gym.control.network import MAX_INPUT, Network
from flexman_gym.control.observers.kalman_filter import KalmanFilter
from flexman_gym.control.pd import PD
from flexman_gym.control.tracking import OutputFeedback, Tracking
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.specification import make_base_and_mode
from flexman_gym.envs.sensors import find_sensors
from flexman_gym.evaluation import c_templates as c
from flexman_gym.evaluation.agent import AgentSpec, common_environment, find_agent
from flexman_gym.evaluation.rollout import TEST_SEEDS
from flexman_gym.model.statics import rest_state

EXPORTED = (
    "pd, pd-shaped, lqr, lqr-tracking, lqg, or a policy on one of the first four: others simulate arms while they run"
)
NEAR = 0.05  # rad; default distance between start and goal of a controller that is linear about its goal
RECORDED_PERIODS = 100  # number of control periods whose readings and torques are stored in the test program
POSTURE_STEP = 1e-4  # rad; central difference of the equilibrium state with respect to motor angles


class _LinearOutputFeedback:
    """Linear output feedback about the goal of one arm: Kalman filter and LQR with fixed gains.

    Args:
        observer: Kalman filter from which the linear filter is computed.
        law: tracking law whose gain at the goal is used.
    """

    def __init__(self, observer: KalmanFilter, law: Tracking) -> None:
        self._observer, self._law = observer, law
        self.sensors: tuple[str, ...] = tuple(observer.sensors)
        self._tables: dict[str, Array] = {}
        self._deviation: Array | None = None  # (2 d,) estimated deviation from the equilibrium; None before a reading

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Linearise about the goal; arguments as in `Controller.reset`."""
        if len(episode.goal) != 1 or episode.reference is not None:
            raise value_error("lqg", "several arms, or a moving goal", "one arm with a fixed goal")
        goal, model = episode.goal[0], self._law.slews.model
        steps = POSTURE_STEP * np.eye(len(goal))
        rows = (rest_state(model, goal + steps) - rest_state(model, goal - steps)) / (2.0 * POSTURE_STEP)
        gain = {"K": self._law.holding_gain(goal), "from_angles": rows.T, "goal": goal}
        self._tables, self._deviation = self._observer.linear(goal) | gain, None

    def move_tables(self) -> dict[str, Array]:
        """Return the matrices of the present goal by name, see `KalmanFilter.linear`."""
        return self._tables

    def act(self, readings: Readings, applied: Array, active: BoolArray) -> Array:
        """Return the action (1, n); arguments as in `Controller.act`."""
        t, limits = self._tables, self._law.limits
        if self._deviation is None:
            self._deviation = t["from_angles"] @ (readings["motor_angles"][0] - t["goal"])
        else:
            predicted = t["A"] @ self._deviation + t["B"] @ (applied[0] * limits - t["holding"])
            measured = np.concatenate([readings[name][0] for name in self._observer.quantities])
            self._deviation = predicted + t["L"] @ (measured - t["C"] @ (t["rest"] + predicted))
        return np.clip((t["holding"] - t["K"] @ self._deviation) / limits, -1.0, 1.0)[None]


@dataclass
class _Program:
    """Parts of a controller in C.

    Attributes:
        constants: name -> array that does not depend on the move.
        rows: name -> (rows, ...) table of the move, with a row for each control period.
        matrices: name -> array of the move.
        memory: name -> shape of an array in the state.
        sizes: name -> whole number.
        step: statements of the step.
    """

    constants: dict[str, Array] = field(default_factory=dict)
    rows: dict[str, Array] = field(default_factory=dict)
    matrices: dict[str, Array] = field(default_factory=dict)
    memory: dict[str, tuple[int, ...]] = field(default_factory=dict)
    sizes: dict[str, int] = field(default_factory=dict)
    step: list[str] = field(default_factory=list)


class _Session(NamedTuple):
    """Agent of one arm at the start of an episode.

    Attributes:
        spec: specification of the agent.
        environment: environment without the settings of the agent.
        episodes: episode of one arm, after its reset; the law is not part of its agent.
        layout: name -> (first index, size, unit) of each reading.
        move: start and goal, (n,) rad each.
    """

    spec: AgentSpec
    environment: Configuration
    episodes: Any
    layout: dict[str, tuple[int, int, str]]
    move: tuple[Array, Array]

    def readings(self) -> Array:
        """Return the present readings (size,)."""
        measured, agent = self.episodes.measurements, self.episodes.agent
        observed, named = measured.read()[0], measured.readings if agent.mode.sensors else {}
        own = self.episodes.sensors.slices if self.spec.law else {}
        parts = [named[name][0] for name in self.layout if name not in own]
        return np.concatenate([observed, *parts] if own else parts)

    def record(self, periods: int) -> tuple[Array, Array]:
        """Simulate control periods; return readings (T, size), and actions (T, n) as fractions of the limits."""
        episodes, law = self.episodes, self.spec.law
        readings, actions = [self.readings()], []

        def callback() -> None:
            actions.append(episodes.view.action[0].copy())
            readings.append(self.readings())

        episodes.callback = callback
        while len(actions) < periods and not episodes.over.all():
            outputs = np.zeros((1, len(episodes.agent.mode.names)))
            if law is not None:
                outputs = np.asarray(law(episodes.agent.observations.copy()), dtype=np.float32).astype(float)
            episodes.step(outputs)
        return np.array(readings[: len(actions)]), np.array(actions)


def begin_agent(name: object, environment: str = "", seed: int = TEST_SEEDS[0], **move: Any) -> _Session:
    """Start an episode of one arm with an agent that can be exported.

    Args:
        name: agent, see `find_agent`.
        environment: see `Configuration.find`; "" for the environment of the training of a policy.
        seed: seed of the episode.
        **move: "start" and "goal_angles", (n,) rad each, in place of values drawn with the seed.

    Raises:
        ValueError: for an agent that cannot be exported.
    """
    spec = find_agent(name)
    bare = common_environment([spec], Configuration.find(environment) if environment else None)
    if bare.safety:
        raise value_error("safety", True, "False: the safety filter cannot be exported")
    interface, law = dict(spec.interface or {}), spec.law
    if isinstance(base := interface.get("base"), str | dict):
        design = bare.replace(**interface)
        base = interface["base"] = make_base_and_mode(design, resolve_fidelity(design).model)[0]
    if isinstance(base, OutputFeedback) and type(base.observer) is KalmanFilter and law is None:
        base = interface["base"] = _LinearOutputFeedback(base.observer, base.law)
    inner = base.inner if isinstance(base, InputShapedController) else base
    known = type(inner) in (PD, LQR, TrackingLQR, _LinearOutputFeedback) or (inner is None and law is not None)
    if not known or not isinstance(law, Network | None):
        raise value_error("agent", spec.name, EXPORTED)
    if not isinstance(interface.get("actions", TorqueMode(1)), TorqueMode):
        raise value_error("agent", spec.name, f"{EXPORTED}, of a policy whose actions are torques")
    venv: Any = gym.make_vec(bare.id, 1, "vector_entry_point", **bare.keywords(), **interface)
    venv.reset(seed=[seed], options=dict(move) or None)
    episodes: Any = venv.unwrapped.episodes
    if isinstance(base, _LinearOutputFeedback) and "start" not in move:
        goal = episodes.view.goal_angles[0].copy()
        venv.reset(seed=[seed], options={"start": goal - NEAR, "goal_angles": goal})
    episodes.agent.check_law(law)
    parts = [(each, episodes.sensors.units[each], columns.stop - columns.start)
             for each, columns in episodes.sensors.slices.items() if law]  # fmt: skip
    for sensor in find_sensors(episodes.agent.mode.sensors):
        parts += [(each, unit, size) for each, size, unit, _ in sensor.entries(episodes.view, bare.limits)]  # type: ignore[attr-defined]
    layout: dict[str, tuple[int, int, str]] = {}
    for each, unit, size in parts:
        layout.setdefault(each, (sum(size for _, size, _ in layout.values()), size, unit))
    start = episodes.view.episode_parameters["start"][0].copy()
    return _Session(spec, bare, episodes, layout, (start, episodes.view.goal_angles[0].copy()))


def read_program(session: _Session) -> _Program:
    """Return the parts of the agent of a session."""
    program, agent, mode = _Program(), session.episodes.agent, session.episodes.agent.mode
    base, readings = agent.base, "readings"
    if isinstance(base, InputShapedController):
        shifts = base.move_tables(session.episodes.measurements.readings)
        program.rows |= {f"{name}_shift": each for name, each in shifts.items()}
        lines = [Template(c.SHIFTED).safe_substitute(size=values.shape[1], reading=name, READING=name.upper())
                 for name, values in shifts.items()]  # fmt: skip
        program.step.append(Template(c.SHIFT).safe_substitute(shifts="\n".join(lines)))
        base, readings = base.inner, "shaped"
    if isinstance(base, PD):
        program.constants |= {"stiffness": base.stiffness, "damping": base.damping}
        program.rows |= base.move_tables()
        holding = " + move->holding[row * N + i]" if "holding" in program.rows else ""
        program.step.append(Template(c.PD).safe_substitute(holding=holding, r=readings))
    elif isinstance(base, LQR):
        tables = base.move_tables()
        program.matrices["gains"] = tables.pop("gains")
        program.rows |= tables
        program.sizes |= {"GAINS": len(program.matrices["gains"]), "STATES": tables["states"].shape[1]}
        program.step.append(Template(c.LQR).safe_substitute(r=readings))
    elif isinstance(base, _LinearOutputFeedback):
        program.matrices |= base.move_tables()
        program.sizes |= dict(zip(("MEASUREMENTS", "STATES"), program.matrices["C"].shape, strict=True))
        program.memory["deviation"] = program.matrices["rest"].shape
        program.step.append(Template(c.LQG).safe_substitute(r=readings))
    if isinstance(session.spec.law, Network):
        _add_network(program, session.spec.law, agent, mode.strength, session.environment.control_period)
    return program


def _add_network(program: _Program, network: Network, agent: Agent, strength: float | Array, period: float) -> None:
    """Add a policy network with the history, action repeat and strength of its agent."""
    length = history_length(agent.history)
    sizes = [network.size, *(len(bias) for _, bias in network.layers)]
    program.sizes |= {"OBSERVED": network.size // length, "HISTORY": length, "REPEAT": agent.action_repeat}
    program.sizes["WIDTH"] = max(sizes)
    program.constants |= {"mean": network.mean, "scale": network.scale}
    update = "*entry = *(entry - OBSERVED)"
    if not isinstance(agent.history, int):
        interval = agent.action_repeat * period
        program.constants["rate"] = np.append(1.0, 1.0 - np.exp(-interval / np.array(agent.history)))
        update = "*entry += rate[k] * (readings[j] - *entry)"
    layers = []
    for i, (weights, bias) in enumerate(network.layers):
        program.constants |= {f"weights_{i + 1}": weights, f"bias_{i + 1}": bias}
        value = f"dot({sizes[i]}, weights_{i + 1} + i * {sizes[i]}, values[{i % 2}]) + bias_{i + 1}[i]"
        if i + 1 < len(network.layers):
            function = "tanh(sum)" if network.activation == "tanh" else "sum < 0.0 ? 0.0 : sum"
            parts = {"outputs": sizes[i + 1], "target": (i + 1) % 2, "sum": value, "function": function}
            layers.append(Template(c.LAYER).substitute(parts))
    output = f"tanh({value})" if network.squashed else f"clip({value}, 1.0)"
    command = "state->command[i]"
    if isinstance(strength, np.ndarray):
        program.constants["strength"], command = strength, "clip(state->command[i] * strength[i], 1.0)"
    program.memory |= {"history": (length * program.sizes["OBSERVED"],), "command": (network.joints,)}
    text = Template(c.NETWORK).safe_substitute(update=update, most=MAX_INPUT, layers="\n".join(layers))
    program.step.append(Template(text).safe_substitute(output=output, command=command))


def write_c(session: _Session, folder: Path) -> list[Path]:
    """Write a controller as C99: header, source, test program with recorded readings, and a page.

    Args:
        session: result of `begin_agent`.
        folder: folder of the files; it is created if it does not exist.

    Returns:
        Paths of the files.
    """
    program, environment = read_program(session), session.environment
    readings, actions = session.record(RECORDED_PERIODS)
    limits, name = np.array(environment.torque_limit), re.sub(r"\W", "_", session.spec.name.lower())
    name = name if name[0].isalpha() else f"controller_{name}"
    count = max(map(len, program.rows.values()), default=1)
    tables = {each: np.pad(values, [(0, count - len(values)), *[(0, 0)] * (values.ndim - 1)], "edge")
              for each, values in program.rows.items()}  # fmt: skip
    tables |= program.matrices
    constants = program.constants | {f"move_{each}": values for each, values in tables.items()}
    texts = [_c_array(f"{name}_torque_limit", limits, "const"), *(_c_array(*each) for each in constants.items())]
    step = "".join(program.step)
    words = {
        "title": f"{session.spec.name}, controller of {environment.id}", "p": name, "P": name.upper(),
        "joints": len(limits), "size": readings.shape[1], "period": repr(environment.control_period), "rows": count,
        "readings": "\n".join(f"    {name.upper()}_{each.upper()} = {first}, /* {size} x {unit} */"
                              for each, (first, size, unit) in session.layout.items()),
        "tables": "\n".join(f"    const double *{each}; /* {' x '.join(map(str, values.shape))} */"
                            for each, values in tables.items()),
        "memory": "\n".join(f"    double {each}[{shape[0]}];" for each, shape in program.memory.items()),
        "sizes": "\n".join(f"#define {each} {value}" for each, value in program.sizes.items()),
        "constants": "\n".join(texts), "initial": "\n".join(f"    move_{each}," for each in tables),
        "dot": c.DOT if "dot(" in step else "", "periods": len(actions), "note": c.LINEAR_NOTE if "K" in tables else "",
        "arrays": "\n".join((_c_array("readings", readings), _c_array("expected", actions * limits))),
        "environment": environment.id, "limits": limits.tolist(),
        "start": session.move[0].round(6).tolist(), "goal": session.move[1].round(6).tolist(),
        "table": "\n".join(f"| `{each}` | {first} to {first + size - 1} | {unit} |"
                           for each, (first, size, unit) in session.layout.items()),
    }  # fmt: skip
    source = c.SOURCE.replace("$step", step)
    files = {f"{name}.h": c.HEADER, f"{name}.c": source, "main.c": c.MAIN, "README.md": c.README}
    folder.mkdir(parents=True, exist_ok=True)
    for file, text in files.items():
        (folder / file).write_text(Template(text).substitute(words), encoding="utf-8")
    return [folder / file for file in files]


def _c_array(name: str, values: Array, kind: str = "static const") -> str:
    """Return the definition of a constant array in C, with numbers that are read back to the bit."""
    numbers = ", ".join(map(repr, np.asarray(values, dtype=float).ravel().tolist()))
    lines = "\n".join(wrap(numbers, 116, initial_indent="    ", subsequent_indent="    ", break_on_hyphens=False))
    return f"{kind} double {name}[{np.size(values)}] = {{\n{lines}\n}};"
