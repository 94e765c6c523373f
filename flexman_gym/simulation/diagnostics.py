"""Diagnostics of failed simulations and energy alarms: the quantity that first exceeds its bound, and remedies."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.kernels import layout
from flexman_gym.model.dynamics import frequencies, stiffness_matrix
from flexman_gym.model.linearization import coordinate_scales
from flexman_gym.model.model import Model
from flexman_gym.simulation.integrator import Integrator
from flexman_gym.simulation.methods import DEFAULT_METHOD, EXPLICIT
from flexman_gym.simulation.stability import NEGLIGIBLE_GROWTH, stability_limit

LARGE_RATE = 100.0  # rad/s; bound of joint and motor rates
LARGE_TWIST = 1.0  # rad; bound of joint twists (motor angle minus link-side angle)
LARGE_DEFLECTION = 0.25  # dimensionless; bound of the deflection of a link relative to its length
STIFFENING_DEFLECTION = 0.1  # deflection / length of the link, above which foreshortening matters
OUTPUTS_PER_INTERVAL = 50  # outputs of the second simulation if the method chooses its steps


class _Quantity(NamedTuple):
    """Quantity of an arm over r states: name, unit, values (r,) and the bound of its magnitude."""

    name: str
    unit: str
    values: Array
    largest: float


def explain_failure(
    integrator: Integrator, model: Model, drive: Array, grid: tuple[float, float, int], state: Array, status: str
) -> str:
    """Return sentences with the quantity that first exceeds its bound and with remedies.

    The last interval is integrated again from the last valid state.

    Args:
        integrator: the integrator of the arm.
        model: the model.
        drive: (7, n + 6) drive table of `kernels.layout`.
        grid: time of the last valid state (s), step (s), and number of remaining steps.
        state: (2 d + 2,) last valid state (2 d), then work and dissipation, J.
        status: "diverged", "not converged" or "ok".

    Returns:
        One or two sentences: the fact, then "Try ...".
    """
    time, step, substeps = grid
    if integrator.tolerance[0] > 0.0:
        step, substeps = step * substeps / OUTPUTS_PER_INTERVAL, OUTPUTS_PER_INTERVAL
    rows, result = np.zeros((substeps, len(state))), np.zeros((substeps, layout.OUTPUTS))
    outcome, valid, _ = integrator(drive, (time, step, 1), state.copy(), rows, result)
    states = np.vstack([state, rows[:valid], *([] if outcome == layout.OK else [integrator.work.new_state])])
    with np.errstate(all="ignore"):
        first, row = _first_excess(model, states[:, : 2 * model.n_dof])
    size = f"{abs(first.values[row]):.4g} {first.unit} at {time + row * step:.6g} s"
    advice = "; or ".join(_advice(model, integrator, grid[1], states[: max(row, 1)]))
    return f"the simulation {status}: the first quantity out of bounds is {first.name}, {size}. Try {advice}."


def explain_bending(model: Model, states: Array) -> str:
    """Return a sentence on the link that bends most if it bends by more than a tenth of its length, with remedies.

    Args:
        model: the model.
        states: (r, 2 d) states of a motion.

    Returns:
        One or two sentences, or "" for small deflections.
    """
    ratios = {link: each.max(initial=0.0) for link, each in _link_deflections(model, states).items()}
    link = max(ratios, key=lambda each: ratios[each], default=0)
    if not ratios or ratios[link] <= STIFFENING_DEFLECTION:
        return ""
    remedies = ["stiffening=True"] * (not model.choice.stiffening)
    remedies.append("stiffer links or smaller loads; the error of the model grows with the square of the bending")
    return (
        f"link {link + 1} bends by up to {ratios[link]:.0%} of its length; beyond {STIFFENING_DEFLECTION:.0%} a model "
        f"of small deflections is inaccurate. Try {'; or '.join(remedies)}."
    )


def explain_energy(model: Model, integrator: Integrator, step: float, time: float, states: Array) -> str:
    """Return sentences with the coordinate of the largest vibration energy up to an energy alarm and with remedies.

    Args:
        model: the model.
        integrator: the integrator of the arm.
        step: integration step, s.
        time: time of the alarm, s.
        states: (r, 2 d) states up to the alarm.

    Returns:
        One or two sentences: the fact, then "Try ...".
    """
    d, label, diagonal = model.n_dof, _coordinate_names(model), np.diag(stiffness_matrix(model))
    energies = {f"the rate of {label[i]}": states[:, d + i] ** 2 for i in range(model.n_joints)}
    if diagonal.any():  # mean potential and kinetic energy of a vibration are equal, and stiffness is constant
        first = model.n_joints + model.n_motors
        energies = {label[a]: diagonal[a] * states[:, a] ** 2 for a in range(first, d)}
        for i, motor in enumerate(model.constants.motor):
            if motor >= 0:
                twist = states[:, motor] - states[:, i]
                energies[f"the spring of joints[{i}]"] = model.constants.joint_stiffness[i] * twist**2
    name = max(energies, key=lambda each: float(energies[each].max()))
    fact = f"the energy residual exceeds 1 % of the energy turnover at {time:.6g} s"
    return f"{fact}: most of the vibration is in {name}. Try {'; or '.join(_advice(model, integrator, step, states))}."


def _coordinate_names(model: Model) -> list[str]:
    """Return the name of each coordinate (d,), such as "elastic coordinate 2 of links[0]"."""
    result = [f"joints[{i}]" for i in range(model.n_joints)]
    result += [f"the motor of joints[{i}]" for i in np.flatnonzero(model.constants.motor >= 0)]
    for link in range(model.n_joints):
        columns = model.elastic_columns(link)
        result += [f"elastic coordinate {a} of links[{link}]" for a in range(columns.stop - columns.start)]
    return result


def _link_deflections(model: Model, states: Array) -> dict[int, Array]:
    """Return flexible link -> deflections (r,) of its tip in states (r, 2 d), as parts of its length."""
    starts, result = model.constants.elastic_start, {}
    for link in np.flatnonzero(np.diff(starts)).tolist():
        shapes = model.constants.tip_translation[starts[link] : starts[link + 1]]
        away = np.linalg.norm(states[:, model.elastic_columns(link)] @ shapes, axis=1)
        result[link] = away / model.constants.length[link]
    return result


def _quantities(model: Model, states: Array) -> Iterator[_Quantity]:
    """Yield joint and motor rates, joint twists, link deflections and elastic coordinates of states (r, 2 d)."""
    d, n, label = model.n_dof, model.n_joints, _coordinate_names(model)
    for column in range(n + model.n_motors):
        yield _Quantity(f"the rate of {label[column]}", "rad/s", states[:, d + column], LARGE_RATE)
    for i, motor in enumerate(model.constants.motor):
        if motor >= 0:
            yield _Quantity(f"the twist of joints[{i}]", "rad", states[:, motor] - states[:, i], LARGE_TWIST)
    sizes = coordinate_scales(model)
    for link, deflection in _link_deflections(model, states).items():
        yield _Quantity(f"the deflection of links[{link}]", "of its length", deflection, LARGE_DEFLECTION)
        columns = model.elastic_columns(link)
        for column in range(columns.start, columns.stop):
            relative = states[:, column] / sizes[column]
            yield _Quantity(label[column], "rad or parts of the link's length", relative, LARGE_DEFLECTION)


def _advice(model: Model, integrator: Integrator, step: float, states: Array) -> list[str]:
    """Return remedies for a failed simulation with given states (r, 2 d), the most promising first."""
    method, d, result = integrator.method, model.n_dof, []
    highest = frequencies(model).max(initial=0.0)
    limit = stability_limit(method, NEGLIGIBLE_GROWTH) if method.kind == EXPLICIT else np.inf
    if integrator.tolerance[0] > 0.0:
        result.append(f"a method with fixed steps, such as {DEFAULT_METHOD}")
    elif 2.0 * np.pi * highest * step > limit:
        stable = limit / (2.0 * np.pi * highest)
        result.append(f"a step of at most {stable:.2g} s, the stability limit of {method.name} at {highest:.4g} Hz")
        result.append(f"a linearly implicit method, such as {DEFAULT_METHOD}")
    else:
        result.append(f"a step shorter than {step:g} s")
    with np.errstate(all="ignore"):
        valid = states[np.isfinite(states).all(axis=1)]
        deflections = (each for each in _quantities(model, valid) if each.largest == LARGE_DEFLECTION)
        large = any(np.abs(each.values).max() > STIFFENING_DEFLECTION for each in deflections)
        locked = frequencies(model, lock_joints=True)
        fastest = np.abs(valid[:, d : d + model.n_joints]).max(initial=0.0)
    if not model.choice.stiffening and (large or (len(locked) and fastest > np.pi * locked[0])):
        result.append("stiffening=True, as the foreshortening of links matters at large bends and fast rotation")
    if model.n_elastic and not model.constants.damping.any():
        result.append("a modal_damping_ratio of the links, which are undamped")
    return [*result, "smaller torques"]


def _first_excess(model: Model, states: Array) -> tuple[_Quantity, int]:
    """Return the quantity that first exceeds its bound, and its row; if none does, the relatively largest quantity."""
    result = list(_quantities(model, states))
    sizes = np.array([np.abs(each.values) / each.largest for each in result])
    sizes = np.nan_to_num(sizes, nan=np.inf, posinf=np.inf)
    late = np.flatnonzero((sizes > 1.0).any(axis=0))
    row = int(late[0]) if late.size else sizes.shape[1] - 1
    return result[int(np.argmax(sizes[:, row]))], row
