"""Export of a controller as C99: header, source, test program with recorded readings, and a page."""

import re
from collections.abc import Iterable
from copy import copy
from dataclasses import dataclass, field
from pathlib import Path
from string import Template
from textwrap import fill, wrap
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from flexman_gym.agent.action_modes import TorqueMode
from flexman_gym.agent.agent import Agent, history_length
from flexman_gym.agent.controller import EpisodeInfo, Readings
from flexman_gym.agent.network import MAX_INPUT, Network
from flexman_gym.agent.pd import PD
from flexman_gym.common.arrays import Array, BoolArray, IntArray
from flexman_gym.common.checks import MAX_SIZE
from flexman_gym.common.errors import value_error
from flexman_gym.common.files import write_atomically
from flexman_gym.envs.config.base_and_mode import make_base_and_mode
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.episodes import goal_path
from flexman_gym.envs.sensors import find_sensors
from flexman_gym.evaluation.agents import AgentSpec, common_environment, find_agent
from flexman_gym.evaluation.rollouts import TEST_SEEDS
from flexman_gym.model.model import Model
from flexman_gym.model.statics import rest_state
from flexman_gym.toolbox.controllers.input_shaping.shaped_controller import InputShapedController
from flexman_gym.toolbox.controllers.lqr import LQR, TrackingLQR
from flexman_gym.toolbox.controllers.observers.kalman_filter import KalmanFilter
from flexman_gym.toolbox.controllers.output_feedback import OutputFeedback
from flexman_gym.toolbox.controllers.range_check import (
    HOLDING_FALL,
    RangeCheckedController,
    compensated_model,
    holding_periods,
)
from flexman_gym.toolbox.controllers.tracking import Tracking
from flexman_gym.toolbox.deployment import c_templates as c

EXPORTED = (
    "pd, pd-shaped, lqr, lqr-tracking, lqg, or a policy on one of the first four: others simulate arms while they run"
)
NEAR = 0.05  # rad; default distance between start and goal of a controller that is linear about its goal
RECORDED_PERIODS = 100  # number of control periods whose readings and torques are stored in the test program
# names that are not those of a controller in C: its files would be main.c or replace a header of the compiler
RESERVED_NAMES = ("main", "features", "float", "limits", "math", "stddef", "stdio", "stdlib", "string", "time")
# words that follow the name of a controller in its header, and so are no names of readings
RESERVED_READINGS = (
    *("JOINTS", "READINGS", "PERIOD", "HOLDING_PERIODS", "H"),
    *("GOOD", "OUT_OF_RANGE", "NOT_FINITE", "NO_MOVE"),
)
MAX_NAME = 40  # characters of the name of a controller in C
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
        self.gravity_model = law.slews.model
        self._tables: dict[str, Array] = {}
        self._deviation: Array | None = None  # (2 d,) estimated deviation from the equilibrium; None before a reading

    def reset(self, arms: IntArray, episode: EpisodeInfo, count: int) -> None:
        """Linearise about the goal; arguments as in `Controller.reset`."""
        if len(episode.goal) != 1 or episode.reference is not None:
            raise value_error("lqg", "several arms, or a moving goal", "one arm with a fixed goal")
        goal, model = episode.goal[0], self.gravity_model
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
        weight: name -> array for the holding torques of refused periods; {} for a controller without them.
        posture: expression of a motor angle, rad, for these torques.
    """

    constants: dict[str, Array] = field(default_factory=dict)
    rows: dict[str, Array] = field(default_factory=dict)
    matrices: dict[str, Array] = field(default_factory=dict)
    memory: dict[str, tuple[int, ...]] = field(default_factory=dict)
    sizes: dict[str, int] = field(default_factory=dict)
    step: list[str] = field(default_factory=list)
    weight: dict[str, Array] = field(default_factory=dict)
    posture: str = ""


class _Session(NamedTuple):
    """Agent of one arm at the start of an episode.

    Attributes:
        spec: specification of the agent.
        environment: environment without the settings of the agent.
        episodes: episode of one arm, after its reset.
        layout: name -> (first index, size, unit) of each reading.
        ranges: (size,) largest magnitude of each reading.
        move: start and goal, (n,) rad each.
        path: (T + 1, n) postures of a moving goal at the control periods, rad; None for a fixed goal.
    """

    spec: AgentSpec
    environment: Configuration
    episodes: Any
    layout: dict[str, tuple[int, int, str]]
    ranges: Array
    move: tuple[Array, Array]
    path: Array | None

    @property
    def gravity_model(self) -> Model | None:
        """Model whose weight the agent compensates; None without gravity compensation."""
        return compensated_model(self.episodes.agent.base)

    def controller(self) -> RangeCheckedController:
        """Return the agent at the start of the move, for a loop of the user; C has the same torques for all readings.

        It shares its base controller with the episode of the session.
        """
        agent, (start, goal) = copy(self.episodes.agent), self.move
        ranges = {name: self.ranges[first : first + size] for name, (first, size, _) in self.layout.items()}
        limits, period = np.array(self.environment.torque_limit), self.environment.control_period
        result = RangeCheckedController(agent, ranges, limits, self.gravity_model)
        path = None if self.path is None else lambda: self.path[None]  # type: ignore[index]
        result.reset(np.zeros(1, dtype=np.int64), EpisodeInfo(start[None], goal[None], period, path), 1)
        return result

    def readings(self) -> Array:
        """Return the present readings (size,)."""
        measured, agent = self.episodes.measurements, self.episodes.agent
        observed, named = measured.read()[0], measured.readings if agent.mode.sensors else {}
        own = self.episodes.sensors.slices if self.spec.law else {}
        parts = [named[name][0] for name in self.layout if name not in own]
        return np.concatenate([observed, *parts] if own else parts)

    def record(self, periods: int) -> tuple[Array, Array]:
        """Simulate control periods; return readings (T, size), and actions (T, n) as fractions of the limits."""
        episodes, readings, actions = self.episodes, [self.readings()], []

        def callback() -> None:
            actions.append(episodes.view.action[0].copy())
            readings.append(self.readings())

        episodes.callback = callback
        while len(actions) < periods and not episodes.over.all():
            episodes.step()
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
    episodes.agent.set_law(law)
    layout, ranges = _find_layout(episodes, bool(law), bare)
    parameters, goal = episodes.view.episode_parameters, episodes.view.goal_angles[0].copy()
    path = goal_path(bare.task, parameters, episodes.max_periods, episodes.view)[0] if bare.task.moves else None
    return _Session(spec, bare, episodes, layout, ranges, (parameters["start"][0].copy(), goal), path)


def _find_layout(
    episodes: Any, observes: bool, environment: Configuration
) -> tuple[dict[str, tuple[int, int, str]], Array]:
    """Return name -> (first index, size, unit) of the readings of an agent, and their largest magnitudes (size,).

    Args:
        episodes: episode of one arm.
        observes: True for an agent with a policy, which reads the sensors of the environment, too.
        environment: environment of the episode.
    """
    sensors = episodes.sensors
    own = sensors.slices if observes else {}
    parts = [(each, places.stop - places.start, sensors.units[each], sensors.bound[places])
             for each, places in own.items()]  # fmt: skip
    for sensor in find_sensors(episodes.agent.mode.sensors):
        parts += sensor.entries(episodes.view, environment.limits)  # type: ignore[attr-defined]
    layout: dict[str, tuple[int, int, str]] = {}
    ranges: list[Array] = [np.zeros(0)]
    for each, size, unit, bound in parts:
        if each not in layout:
            layout[each] = sum(map(len, ranges)), size, unit
            ranges.append(np.minimum(np.ones(size) * np.asarray(bound), MAX_SIZE))
    return layout, np.concatenate(ranges)


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


def _add_weight(program: _Program, session: _Session) -> None:
    """Add the holding torques of refused periods, if the agent compensates the weight of its arm."""
    model, layout = session.gravity_model, session.layout
    if model is None:
        return
    if "motor_angles" in layout:
        program.posture = "readings[${P}_MOTOR_ANGLES + i]"
    elif "state" in layout:
        program.posture = "readings[${P}_STATE + motor_column[i]]"
        program.weight["motor_column"] = model.motor_columns
    else:
        program.posture = "move->goal_angles[row * N + i] - readings[${P}_ANGLE_ERRORS + i]"
        program.rows["goal_angles"] = session.move[1][None] if session.path is None else session.path
    constants, n = model.constants, model.n_joints
    outboard = np.append(np.cumsum(constants.mass[::-1])[::-1][1:], 0.0) + constants.payload_mass[0]  # kg
    moments = constants.first_moment + outboard[:, None] * constants.length[:, None] * np.eye(3)[0]
    moments[-1] += constants.payload_mass[0] * (constants.payload_mount.reshape(3, 3) @ constants.payload_offset[0])
    program.weight |= {"gravity": constants.gravity, "mount": constants.mount, "axis": constants.axis}
    program.weight["outboard_moment"] = moments
    program.memory["posture"] = (n,)
    program.step.insert(0, Template(c.POSTURE).safe_substitute(angle=program.posture))


def write_c(session: _Session, folder: Path) -> list[Path]:
    """Write a controller as C99: header, source, test program with recorded readings, and a page.

    Args:
        session: result of `begin_agent`.
        folder: folder of the files; it is created if it does not exist.

    Returns:
        Paths of the files.

    Raises:
        OSError: if a file cannot be written; earlier files of this name then remain unchanged.
    """
    program = read_program(session)
    _add_weight(program, session)
    words = _words(session, program, _c_name(session.spec.name))
    source = c.SOURCE.replace("$step", "".join(program.step))
    files = {f"{words['p']}.h": c.HEADER, f"{words['p']}.c": source, "main.c": c.MAIN, "README.md": c.README}
    folder.mkdir(parents=True, exist_ok=True)
    for file, text in files.items():
        content = Template(text).substitute(words).encode()
        write_atomically(folder / file, lambda opened, content=content: opened.write(content))  # type: ignore[misc]
    return [folder / file for file in files]


def _words(session: _Session, program: _Program, name: str) -> dict[str, Any]:
    """Return the parts of the files of a controller by their names in the templates."""
    environment, limits = session.environment, np.array(session.environment.torque_limit)
    readings, actions = session.record(RECORDED_PERIODS)
    count = max(map(len, program.rows.values()), default=1)
    tables = {each: np.pad(values, [(0, count - len(values)), *[(0, 0)] * (values.ndim - 1)], "edge")
              for each, values in program.rows.items()}  # fmt: skip
    tables |= program.matrices
    constants = program.constants | program.weight | {f"move_{each}": values for each, values in tables.items()}
    texts = [_c_array(f"{name}_torque_limit", limits, "const"), _c_array(f"{name}_range", session.ranges, "const"),
             *(_c_array(*each) for each in constants.items())]  # fmt: skip
    rows = dict(zip(session.layout, _enumerators(session.layout), strict=True))
    step, common = "".join(program.step), {"p": name, "P": name.upper()}
    return common | _holding_words(session, program, name) | {
        "title": _one_line(f"{session.spec.name}, controller of {environment.id}"), "largest": f"{MAX_SIZE:g}",
        "joints": len(limits), "size": readings.shape[1], "period": repr(environment.control_period), "rows": count,
        "readings": "\n".join(f"    {name.upper()}_{rows[each]} = {first}, /* {size} x {_one_line(unit)} */"
                              for each, (first, size, unit) in session.layout.items()),
        "tables": "\n".join(f"    const double *{each}; /* {' x '.join(map(str, values.shape))} */"
                            for each, values in tables.items()),
        "memory": "\n".join(f"    double {each}[{shape[0]}];" for each, shape in program.memory.items()),
        "sizes": "\n".join(f"#define {each} {value}" for each, value in program.sizes.items()),
        "constants": "\n".join(texts), "initial": "\n".join(f"    move_{each}," for each in tables),
        "checks": "".join(Template(c.CHECK).substitute(common, name=each, count=_c_count(values, each in program.rows))
                          for each, values in tables.items()),
        "dot": c.DOT if "dot(" in step or program.weight else "", "periods": len(actions),
        "note": c.LINEAR_NOTE if "K" in tables else "", "environment": _one_line(environment.id),
        "arrays": "\n".join((_c_array("readings", readings), _c_array("expected", actions * limits))),
        "limits": limits.tolist(), "start": session.move[0].round(6).tolist(),
        "goal": session.move[1].round(6).tolist(),
        "table": "\n".join(
            f"| `{_one_line(each)}` | {first} to {first + size - 1} | {_one_line(unit)} | "
            f"{', '.join(f'{most:.9g}' for most in dict.fromkeys(session.ranges[first : first + size].tolist()))} |"
            for each, (first, size, unit) in session.layout.items()),
    }  # fmt: skip


def _holding_words(session: _Session, program: _Program, name: str) -> dict[str, Any]:
    """Return the parts of the files that belong to the torques of refused periods."""
    common, model, count = {"p": name, "P": name.upper()}, session.gravity_model, 0
    torques, reason = c.ZERO_TORQUES, c.NO_HOLDING_REASON
    if model is not None:
        period = session.environment.control_period
        count, reach = holding_periods(model, period), float(model.constants.length.sum())
        torques = c.HOLDING_TORQUES.format(P=name.upper())
        reason = c.HOLDING_REASON.format(seconds=count * period, fall=HOLDING_FALL, reach=reach)
    return {
        "holding_periods": count, "holding_reason": fill(reason, 114, subsequent_indent="   "),
        "refused_torques": fill(torques, 92, subsequent_indent="   "),
        "refused_in_page": fill(torques, 85, subsequent_indent="  "), "weight": c.WEIGHT if model else "",
        "hold": Template(c.HOLD).substitute(common) if model else "",
    }  # fmt: skip


def _c_array(name: str, values: Array, kind: str = "static const") -> str:
    """Return the definition of a constant array in C, with numbers that are read back to the bit.

    Raises:
        ValueError: for a number that is not finite.
    """
    if not np.isfinite(values).all():
        raise value_error(name, "a number that is not finite", "an agent with finite numbers")
    values = np.asarray(values).ravel()
    word, values = ("int", values) if values.dtype.kind == "i" else ("double", values.astype(float))
    lines = "\n".join(wrap(", ".join(map(repr, values.tolist())), 116, initial_indent="    ",
                           subsequent_indent="    ", break_on_hyphens=False))  # fmt: skip
    return f"{kind} {word} {name}[{len(values)}] = {{\n{lines}\n}};"


def _c_count(values: Array, by_row: bool) -> str:
    """Return the number of entries of a table of a move as an expression in C."""
    return f"move->rows * {int(np.prod(values.shape[1:]))}" if by_row else f"{values.size}"


def _c_name(name: str) -> str:
    """Return the name of an agent as a prefix of identifiers in C and as the name of its files."""
    word = re.sub(r"[^a-z0-9_]", "_", name.lower())[:MAX_NAME]
    return word if word[:1].isalpha() and word not in RESERVED_NAMES else f"controller_{word}"


def _enumerators(names: Iterable[str]) -> list[str]:
    """Return a different identifier in C, without the prefix of the controller, for each name of a reading."""
    words: list[str] = []
    for name in names:
        word = re.sub(r"[^A-Z0-9_]", "_", name.upper())
        while word in words or word in RESERVED_READINGS:
            word += "_"
        words.append(word)
    return words


def _one_line(text: str) -> str:
    """Return a text on one line that can be part of a comment in C and of a table in Markdown."""
    text = "".join(each if each.isprintable() else "?" for each in " ".join(text.split()))
    return text.replace("*/", "* /").replace("/*", "/ *").replace("|", "/")
