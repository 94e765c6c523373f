"""Controllers and policy networks as programs in C99: tables, memory and statements of a control period.

A class names its function here by an attribute `c_program`, "module:function". In the statements, $r stands for the
array of the readings, $p and $P for the name of the controller in small and in capital letters.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from string import Template
from typing import Any

import numpy as np

from flexman_gym.agent.agent import Agent, history_length
from flexman_gym.agent.network import MAX_INPUT, Network
from flexman_gym.agent.pd import PD
from flexman_gym.common.arrays import Array
from flexman_gym.common.errors import value_error
from flexman_gym.common.registry import load_entry

NEAR = 0.05  # rad; default distance between start and goal of a controller that is linear about its goal


@dataclass
class CProgram:
    """Parts of a controller in C.

    Attributes:
        constants: name -> array that does not depend on the move.
        rows: name -> (rows, ...) table of the move, with a row for each control period.
        matrices: name -> array of the move.
        memory: name -> shape of an array in the state.
        sizes: name -> whole number.
        step: statements of the step.
        near: distance between start and goal, rad, of a controller that is linear about its goal; None for any.
        weight: name -> array for the holding torques of refused periods; {} for a controller without them.
    """

    constants: dict[str, Array] = field(default_factory=dict)
    rows: dict[str, Array] = field(default_factory=dict)
    matrices: dict[str, Array] = field(default_factory=dict)
    memory: dict[str, tuple[int, ...]] = field(default_factory=dict)
    sizes: dict[str, int] = field(default_factory=dict)
    step: list[str] = field(default_factory=list)
    near: float | None = None
    weight: dict[str, Array] = field(default_factory=dict)


def has_c_program(part: object) -> bool:
    """Return True if a controller or a law has a C program, as has the controller inside it; None has one.

    A program that a class inherits does not count: the actions of the class may differ from those of the program.
    """
    while part is not None:
        if "c_program" not in vars(type(part)):
            return False
        part = getattr(part, "inner", None)
    return True


def read_program(agent: Agent, readings: Iterable[str], period: float) -> CProgram:
    """Return the program of an agent of a single arm in its present move.

    Args:
        agent: agent whose base controller and law have C programs, with torques as actions.
        readings: names of the readings of its base controller.
        period: control period, s.
    """
    base: Any = agent.base
    own: Any = agent.law
    program = CProgram() if base is None else _filled(load_entry(base.c_program)(base, readings), "readings")
    if own is not None:
        law = load_entry(own.c_program)(own, agent, period)
        joined = {name: getattr(program, name) | getattr(law, name) for name in ("constants", "memory", "sizes")}
        program = replace(program, **joined, step=program.step + law.step)
    return program


def _filled(program: CProgram, array: str) -> CProgram:
    """Return a program that takes its readings from an array with this name."""
    return replace(program, step=[Template(each).safe_substitute(r=array) for each in program.step])


def pd_program(pd: PD, readings: Iterable[str]) -> CProgram:
    """Return the program of a PD controller."""
    rows = pd.move_tables()
    holding = " + move->holding[row * N + i]" if "holding" in rows else ""
    step = Template(PD_STEP).safe_substitute(holding=holding)
    return CProgram({"stiffness": pd.stiffness, "damping": pd.damping}, rows, step=[step])


def lqr_program(lqr: Any, readings: Iterable[str]) -> CProgram:
    """Return the program of an `LQR` or a `TrackingLQR`."""
    rows = lqr.move_tables()
    gains = rows.pop("gains")
    sizes = {"GAINS": len(gains), "STATES": rows["states"].shape[1]}
    return CProgram(rows=rows, matrices={"gains": gains}, sizes=sizes, step=[LQR_STEP])


def lqg_program(lqg: Any, readings: Iterable[str]) -> CProgram:
    """Return the program of a `LinearOutputFeedback`."""
    tables = lqg.move_tables()
    sizes = dict(zip(("MEASUREMENTS", "STATES"), tables["C"].shape, strict=True))
    memory = {"deviation": tables["rest"].shape}
    step = Template(LQG_STEP).safe_substitute(posture=lqg.posture.upper())
    return CProgram(matrices=tables, memory=memory, sizes=sizes, step=[step], near=NEAR)


def shaped_program(shaped: Any, readings: Iterable[str]) -> CProgram:
    """Return the program of an `InputShapedController`, whose inner controller reads the shaped command."""
    inner = load_entry(shaped.inner.c_program)(shaped.inner, readings)
    if any("double shaped[" in each for each in inner.step):
        raise value_error("agent", "an input shaper of an input shaper", "one input shaper, to be exported")
    tables = shaped.move_tables(readings)
    lines = [Template(SHIFTED).safe_substitute(size=values.shape[1], reading=name, READING=name.upper())
             for name, values in tables.items()]  # fmt: skip
    shift = Template(SHIFT).safe_substitute(shifts="\n".join(lines))
    rows = {f"{name}_shift": each for name, each in tables.items()} | inner.rows
    return replace(inner, rows=rows, step=[shift, *_filled(inner, "shaped").step])


def network_program(network: Network, agent: Agent, period: float) -> CProgram:
    """Return the program of a policy network with the history, action repeat and strength of its agent."""
    length = history_length(agent.history)
    sizes = [network.size, *(len(bias) for _, bias in network.layers)]
    counts = {"OBSERVED": network.size // length, "HISTORY": length, "REPEAT": agent.action_repeat, "WIDTH": max(sizes)}
    constants = {"mean": network.mean, "scale": network.scale}
    update = "*entry = *(entry - OBSERVED)"
    if not isinstance(agent.history, int):
        interval = agent.action_repeat * period
        constants["rate"] = np.append(1.0, 1.0 - np.exp(-interval / np.array(agent.history)))
        update = "*entry += rate[k] * (readings[j] - *entry)"
    layers = []
    for i, (weights, bias) in enumerate(network.layers):
        constants |= {f"weights_{i + 1}": weights, f"bias_{i + 1}": bias}
        value = f"dot({sizes[i]}, weights_{i + 1} + i * {sizes[i]}, values[{i % 2}]) + bias_{i + 1}[i]"
        if i + 1 < len(network.layers):
            function = "tanh(sum)" if network.activation == "tanh" else "sum < 0.0 ? 0.0 : sum"
            parts = {"outputs": sizes[i + 1], "target": (i + 1) % 2, "sum": value, "function": function}
            layers.append(Template(LAYER).substitute(parts))
    output, command = f"tanh({value})" if network.squashed else f"clip({value}, 1.0)", "state->command[i]"
    if isinstance(strength := agent.mode.strength, np.ndarray):  # type: ignore[attr-defined]
        constants["strength"], command = strength, "clip(state->command[i] * strength[i], 1.0)"
    memory: dict[str, tuple[int, ...]] = {"history": (length * counts["OBSERVED"],), "command": (network.joints,)}
    text = Template(NETWORK).safe_substitute(update=update, most=MAX_INPUT, layers="\n".join(layers))
    step = Template(text).safe_substitute(output=output, command=command)
    return CProgram(constants, memory=memory, sizes=counts, step=[step])


SHIFT = """
    /* Input shaping: readings of the goal become readings of the shaped command. */
    double shaped[${P}_READINGS];
    for (int i = 0; i < ${P}_READINGS; i++)
        shaped[i] = readings[i];
$shifts
"""

SHIFTED = """    for (int i = 0; i < $size; i++)
        shaped[${P}_$READING + i] += move->${reading}_shift[$size * row + i];"""

PD_STEP = """
    /* PD controller of the motors; single precision at the end as in Python. */
    for (int i = 0; i < N; i++) {
        const double slip = $r[${P}_MOTOR_RATES + i] - $r[${P}_GOAL_RATES + i];
        const double sum = stiffness[i] * $r[${P}_ANGLE_ERRORS + i] - damping[i] * slip$holding;
        base[i] = (double)(float)clip(sum / ${p}_torque_limit[i], 1.0);
    }
"""

LQR_STEP = """
    /* Feed-forward and feedback of the state, with gains interpolated along the move. */
    {
        const double position = fmin(fmax(move->positions[row], 0.0), GAINS - 1);
        const int most = GAINS > 2 ? GAINS - 2 : 0, whole = (int)position;
        const int lower = whole < most ? whole : most, upper = lower + 1 < GAINS ? lower + 1 : GAINS - 1;
        for (int i = 0; i < N; i++) {
            const double *first = move->gains + (lower * N + i) * STATES;
            const double *last = move->gains + (upper * N + i) * STATES;
            double sum = move->torques[row * N + i];
            for (int j = 0; j < STATES; j++) {
                const double gain = first[j] + (position - lower) * (last[j] - first[j]);
                sum -= gain * ($r[${P}_STATE + j] - move->states[row * STATES + j]);
            }
            base[i] = clip(sum / ${p}_torque_limit[i], 1.0);
        }
    }
"""

LQG_STEP = """
    /* Kalman filter with a fixed gain; deviation from the equilibrium at the goal. */
    {
        double predicted[STATES], error[MEASUREMENTS], input[N];
        for (int i = 0; i < N; i++)
            input[i] = state->started ? state->torque[i] - move->holding[i] : $r[${P}_$posture + i] - move->goal[i];
        for (int i = 0; i < STATES; i++)
            predicted[i] = state->started ? dot(STATES, move->A + i * STATES, state->deviation)
                + dot(N, move->B + i * N, input) : dot(N, move->from_angles + i * N, input);
        for (int i = 0; i < MEASUREMENTS; i++)
            error[i] = state->started ? $r[i] - dot(STATES, move->C + i * STATES, move->rest)
                - dot(STATES, move->C + i * STATES, predicted) : 0.0;
        for (int i = 0; i < STATES; i++)
            state->deviation[i] = predicted[i] + dot(MEASUREMENTS, move->L + i * MEASUREMENTS, error);
        for (int i = 0; i < N; i++) {
            const double sum = move->holding[i] - dot(STATES, move->K + i * STATES, state->deviation);
            base[i] = clip(sum / ${p}_torque_limit[i], 1.0);
        }
    }
"""

NETWORK = """
    /* Policy network, once in REPEAT periods; observations and commands in single precision as in Python. */
    if (state->phase == 0) {
        double values[2][WIDTH];
        for (int j = 0; j < OBSERVED; j++) {
            for (int k = HISTORY - 1; k > 0; k--) {
                double *entry = &state->history[k * OBSERVED + j];
                if (!state->started)
                    *entry = readings[j];
                else
                    $update;
            }
            state->history[j] = readings[j];
        }
        for (int j = 0; j < HISTORY * OBSERVED; j++)
            values[0][j] = clip(((double)(float)state->history[j] - mean[j]) * scale[j], $most);
$layers
        for (int i = 0; i < N; i++)
            state->command[i] = (double)(float)($output);
    }
    state->phase = (state->phase + 1) % REPEAT;
    for (int i = 0; i < N; i++)
        command[i] = $command;
"""

LAYER = """        for (int i = 0; i < $outputs; i++) {
            const double sum = $sum;
            values[$target][i] = $function;
        }"""
