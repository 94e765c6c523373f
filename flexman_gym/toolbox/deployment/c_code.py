"""Export of a controller as C99: header, source, test program with recorded readings, and a page."""

import re
from collections.abc import Iterable
from copy import copy
from dataclasses import replace
from pathlib import Path
from string import Template
from textwrap import fill, wrap
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.agent.action_modes import TorqueMode
from flexman_gym.agent.controller import EpisodeInfo, torque_scales
from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import MAX_SIZE
from flexman_gym.common.errors import value_error
from flexman_gym.common.files import write_atomically
from flexman_gym.envs.config.base_and_mode import make_base_and_mode
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.episodes import Episodes, goal_path
from flexman_gym.envs.foundation import check_fixed
from flexman_gym.envs.sensors import find_sensors
from flexman_gym.evaluation.agent_spec import AgentSpec
from flexman_gym.evaluation.agents import common_environment, find_agent
from flexman_gym.evaluation.rollouts import TEST_SEEDS, RolloutLoop
from flexman_gym.model.model import Model
from flexman_gym.toolbox.controllers.range_check import (
    HOLDING_FALL,
    RangeCheckedController,
    compensated_model,
    holding_periods,
)
from flexman_gym.toolbox.deployment import c_templates as c
from flexman_gym.toolbox.deployment.c_programs import CProgram, has_c_program, read_program

EXPORTED = (
    "pd, pd-shaped, lqr, lqr-tracking, lqg, or a policy on one of the first four: others simulate arms while they run"
)
RECORDED_PERIODS = 100  # number of control periods whose readings and torques are stored in the test program
# names that are not those of a controller in C: its files would be main.c or replace a header of the compiler
RESERVED_NAMES = ("main", "features", "float", "limits", "math", "stddef", "stdio", "stdlib", "string", "time")
# words that follow the name of a controller in its header, and so are no names of readings
RESERVED_READINGS = (
    *("JOINTS", "READINGS", "PERIOD", "HOLDING_PERIODS", "H"),
    *("GOOD", "OUT_OF_RANGE", "NOT_FINITE", "NO_MOVE"),
)
MAX_NAME = 40  # characters of the name of a controller in C


class _Session(NamedTuple):
    """Agent of one arm at the start of an episode.

    Attributes:
        spec: specification of the agent.
        environment: environment without the settings of the agent.
        loop: rollout of an episode of one arm, after its reset.
        options: options of the reset.
        layout: name -> (first index, size, unit) of each reading.
        ranges: (size,) largest magnitude of each reading.
        move: start and goal, (n,) rad each.
        path: (T + 1, n) postures of a moving goal at the control periods, rad; None for a fixed goal.
    """

    spec: AgentSpec
    environment: Configuration
    loop: RolloutLoop
    options: dict[str, Any] | None
    layout: dict[str, tuple[int, int, str]]
    ranges: Array
    move: tuple[Array, Array]
    path: Array | None

    @property
    def episodes(self) -> Episodes:
        """Episode of one arm."""
        return self.loop.episodes

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
        limits, period = torque_scales(self.environment.torque_limit), self.environment.control_period
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

    def program(self) -> CProgram:
        """Return the program of the agent in the move of the session."""
        return read_program(self.episodes.agent, self.episodes.readings, self.environment.control_period)

    def record(self, periods: int) -> tuple[Array, Array]:
        """Simulate control periods from the start; return readings (T, size) and actions (T, n).

        Actions are fractions of the torque limits.
        """
        readings: list[Array] = []
        self.loop.begin(lambda _: readings.append(self.readings()), None, self.options)
        while len(readings) <= periods and not self.loop.over:
            self.loop.step()
        actions = self.loop.result().actions[0]
        return np.array(readings[: len(actions)]), actions


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
    check_fixed(bare.foundation, "only torques of the motors can be exported")
    interface = dict(spec.interface or {})
    base: Any = interface.get("base")
    if isinstance(base, str | dict):
        design = bare.replace(**interface)
        base = make_base_and_mode(design, resolve_fidelity(design).model)[0]
    if spec.law is None and hasattr(base, "linear_form"):
        base = base.linear_form()
    if (base is None and spec.law is None) or not has_c_program(base) or not has_c_program(spec.law):
        raise value_error("agent", spec.name, EXPORTED)
    if type(interface.get("actions", TorqueMode(1))) is not TorqueMode:
        raise value_error("agent", spec.name, f"{EXPORTED}, of a policy whose actions are torques")
    spec = replace(spec, interface=interface | {"base": base})
    options: dict[str, Any] | None = move or None
    loop = RolloutLoop(spec, bare, [seed], options=options)
    episodes = loop.episodes
    near = read_program(episodes.agent, episodes.readings, bare.control_period).near
    if near is not None and "start" not in move:
        goal = episodes.view.goal_angles[0].copy()
        options = {"start": goal - near, "goal_angles": goal}
        loop.begin(None, None, options)
    layout, ranges = _find_layout(episodes, spec.law is not None, bare)
    parameters, goal = episodes.view.episode_parameters, episodes.view.goal_angles[0].copy()
    path = goal_path(bare.task, parameters, episodes.max_periods, episodes.view)[0] if bare.task.moves else None
    return _Session(spec, bare, loop, options, layout, ranges, (parameters["start"][0].copy(), goal), path)


def _find_layout(
    episodes: Episodes, observes: bool, environment: Configuration
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


def _add_weight(program: CProgram, session: _Session) -> None:
    """Add the holding torques of refused periods, if the agent compensates the weight of its arm."""
    model, layout = session.gravity_model, session.layout
    if model is None:
        return
    if "motor_angles" in layout:
        posture = "readings[${P}_MOTOR_ANGLES + i]"
    elif "state" in layout:
        posture = "readings[${P}_STATE + motor_column[i]]"
        program.weight["motor_column"] = model.motor_columns
    else:
        posture = "move->goal_angles[row * N + i] - readings[${P}_ANGLE_ERRORS + i]"
        program.rows["goal_angles"] = session.move[1][None] if session.path is None else session.path
    constants, n = model.constants, model.n_joints
    outboard = np.append(np.cumsum(constants.mass[::-1])[::-1][1:], 0.0) + constants.payload_mass[0]  # kg
    moments = constants.first_moment + outboard[:, None] * constants.length[:, None] * np.eye(3)[0]
    moments[-1] += constants.payload_mass[0] * (constants.payload_mount.reshape(3, 3) @ constants.payload_offset[0])
    program.weight |= {"gravity": constants.gravity, "mount": constants.mount, "axis": constants.axis}
    program.weight["outboard_moment"] = moments
    program.weight["driven"] = (1 - model.constants.passive).astype(np.float64)
    program.memory["posture"] = (n,)
    program.step.insert(0, Template(c.POSTURE).safe_substitute(angle=posture))


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
    program = session.program()
    _add_weight(program, session)
    words = _words(session, program, _c_name(session.spec.name))
    source = c.SOURCE.replace("$step", "".join(program.step))
    files = {f"{words['p']}.h": c.HEADER, f"{words['p']}.c": source, "main.c": c.MAIN, "README.md": c.README}
    folder.mkdir(parents=True, exist_ok=True)
    for file, text in files.items():
        content = Template(text).substitute(words).encode()
        write_atomically(folder / file, lambda opened, content=content: opened.write(content))  # type: ignore[misc]
    return [folder / file for file in files]


def _words(session: _Session, program: CProgram, name: str) -> dict[str, Any]:
    """Return the parts of the files of a controller by their names in the templates."""
    environment, limits = session.environment, torque_scales(session.environment.torque_limit)
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
        "note": "" if program.near is None else c.LINEAR_NOTE, "environment": _one_line(environment.id),
        "arrays": "\n".join((_c_array("readings", readings), _c_array("expected", actions * limits))),
        "limits": limits.tolist(), "start": session.move[0].round(6).tolist(),
        "goal": session.move[1].round(6).tolist(),
        "table": "\n".join(
            f"| `{_one_line(each)}` | {first} to {first + size - 1} | {_one_line(unit)} | "
            f"{', '.join(f'{most:.9g}' for most in dict.fromkeys(session.ranges[first : first + size].tolist()))} |"
            for each, (first, size, unit) in session.layout.items()),
    }  # fmt: skip


def _holding_words(session: _Session, program: CProgram, name: str) -> dict[str, Any]:
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
