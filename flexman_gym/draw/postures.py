"""Postures: natural frequencies over the workspace, and over the rate at which an arm spins."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from flexman_gym.arrays import Array, Vector
from flexman_gym.checks import refusal, vector, whole_number
from flexman_gym.draw.style import DARK, LIGHT, MIDDLE, new_figure
from flexman_gym.model.instant import frequencies, inertial_forces, mass_matrix, stiffness_matrix
from flexman_gym.model.linear import linearize
from flexman_gym.model.model import Model, checked_model

FINE = 41  # postures along an axis of the map
ROUNDS, WILD = 200, 1e3  # of the search for the arm that spins; coordinates with which it ends
MULTIPLES = (1, 2, 3)  # of the spin rate, which a rotating arm is excited with


def frequency_map(model: Model, path: str | Path, mode: int = 1, span: float = np.pi) -> Path:
    """Draws a natural frequency with held motors over the angles of the last two joints, the others at zero.

    Gravity is left out, as in `frequencies`. An arm of one joint has a line.

    Args:
        model: the arm.
        path: of the picture.
        mode: counted from 1, the lowest.
        span: rad, of the angles either way.

    Raises:
        ImportError: without Matplotlib.
        ValueError: for a mode that does not exist.
    """
    n, path, angles = checked_model(model).n_joints, Path(path), np.linspace(-span, span, FINE)
    number = whole_number("mode", mode, 1, max(model.n_dof - n, 1)) - 1
    two = min(n, 2)
    places = np.stack(np.meshgrid(*[angles] * two, indexing="ij"), axis=-1).reshape(-1, two)
    postures = np.hstack([np.zeros((len(places), n - two)), places])
    if model.n_dof == n:
        raise refusal("model", "this one", "an arm with flexible links or joints")
    values = frequencies(model, postures, lock_joints=True)[:, number]
    figure = new_figure((6.4, 5.2), 120.0, layout="constrained")
    axes = figure.add_subplot()
    if two == 1:
        axes.plot(np.degrees(angles), values, color=DARK)
        axes.set(xlabel="joint 1 (degrees)", ylabel="frequency (Hz)")
    else:
        table, ends = values.reshape(FINE, FINE), np.degrees([-span, span] * 2)
        shown = axes.imshow(table.T, origin="lower", extent=ends, cmap="viridis", interpolation="bilinear")
        if np.ptp(table) > 1e-6 * table.max():
            lines = axes.contour(np.degrees(angles), np.degrees(angles), table.T, 8, colors="white", linewidths=0.7)
            axes.clabel(lines, fmt="%.3g", fontsize=8)
        figure.colorbar(shown, label="frequency (Hz)", shrink=0.9)
        axes.set(xlabel=f"joint {n - 1} (degrees)", ylabel=f"joint {n} (degrees)")
    axes.set_title(f"natural frequency {mode}, motors held", fontsize=11)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    return path


def spin_frequencies(model: Model, rates: Vector, joint_angles: Vector | None = None) -> Array:
    """Gives the frequencies (r, k) in Hz with which an arm rings that spins about its first joint, ascending.

    The motors keep their rates: the first turns, the others stand still; gravity is left out. The arm is where the
    spin stretches and bends it to, and its links stiffen where the model has foreshortening. A row is nan where the
    arm does not bear the spin. Where fewer modes ring the last are nan.

    Args:
        model: the arm.
        rates: (r,) rad/s.
        joint_angles: (n,) rad, zero by default.

    Raises:
        ValueError: for wrong shapes and values that are not finite.
    """
    d, n, result = checked_model(model).n_dof, model.n_joints, []
    light = replace(model, constants=model.constants._replace(gravity=np.zeros(3)))
    others = np.setdiff1d(np.arange(d), model.motor_columns)
    kept, k = np.concatenate([others, d + others]), len(others)
    for rate in vector("rates", rates, unit="rad/s"):
        row = np.full(k, np.nan)
        spinning = _spun(light, np.zeros(n) if joint_angles is None else joint_angles, rate)
        if spinning is not None:
            state, torque = spinning
            mass = mass_matrix(light, state)
            with np.errstate(over="ignore"):  # of the slope of friction, which spin leaves behind
                whole = linearize(light, state=state, torque=torque).A[d:]
            demands = (mass @ whole)[np.ix_(others, kept)]
            slopes = np.linalg.solve(mass[np.ix_(others, others)], demands)  # whatever torques hold the motors
            rings = np.linalg.eigvals(np.block([[np.zeros((k, k)), np.eye(k)], [slopes]])).imag
            found = np.sort(rings[rings > 0.0]) / (2 * np.pi)  # of each pair its upper half
            row[: len(found)] = found
        result.append(row)
    return np.array(result).reshape(-1, k)


def _spun(model: Model, angles: Vector, rate: float) -> tuple[Array, Array] | None:
    """Gives the state (2 d,) in which an arm spins without ringing, and its torques (n,); None where there is none."""
    d, n = model.n_dof, model.n_joints
    state, motors = model.initial_state(angles, np.eye(n)[0] * rate), model.motor_columns
    others, stiffness, forces = np.setdiff1d(np.arange(d), motors), stiffness_matrix(model), inertial_forces(model)
    inner = stiffness[np.ix_(others, others)]
    for _ in range(ROUNDS):
        balance = forces(state[:d], state[d:], np.zeros(d)) + stiffness @ state[:d]
        moved = np.linalg.solve(inner, balance[others])
        state[others] -= moved
        if not np.isfinite(state).all() or np.abs(state).max() > WILD:
            return None
        if np.abs(moved).max(initial=0.0) < 1e-12 * max(1.0, float(np.abs(state).max())):
            return state, balance[motors]
    return None


def campbell_diagram(model: Model, rates: Vector, path: str | Path, count: int = 6) -> Path:
    """Draws `spin_frequencies` over the spin rate, with the multiples of the rate as rays (Campbell, 1924).

    Args:
        model: the arm; build it with stiffening.
        rates: (r,) rad/s.
        path: of the picture.
        count: frequencies at most.

    Raises:
        ImportError: without Matplotlib.
        ValueError: as of `spin_frequencies`.
    """
    path, turns = Path(path), np.array(vector("rates", rates, unit="rad/s")) / (2 * np.pi)
    values = spin_frequencies(model, rates)[:, :count]
    figure = new_figure((6.8, 5.0), 120.0, layout="constrained")
    axes = figure.add_subplot()
    axes.plot(turns, values, color=DARK, linewidth=1.5)
    top = float(np.nanmax(values)) * 1.08 if np.isfinite(values).any() else 1.0
    for multiple in MULTIPLES:
        axes.plot(turns, multiple * turns, "--", color=MIDDLE, linewidth=0.9)
        if multiple * turns[-1] < top:
            axes.annotate(f"{multiple}x", (turns[-1], multiple * turns[-1]), color=MIDDLE, fontsize=9)
    axes.set(xlabel="spin rate (turns a second)", ylabel="frequency (Hz)", ylim=(0.0, top), xlim=(turns[0], turns[-1]))
    words = "" if model.choice.stiffening else ", links without foreshortening"
    axes.set_title(f"Campbell diagram: motors keep their rates{words}", fontsize=11)
    axes.grid(color=LIGHT, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    return path
