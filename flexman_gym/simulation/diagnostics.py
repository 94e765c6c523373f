"""Diagnostics of failed simulations: the first quantity out of bounds, and remedies."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.kernels import layout
from flexman_gym.model.dynamics import frequencies, stiffness_matrix
from flexman_gym.model.linearization import coordinate_scales
from flexman_gym.model.model import Model
from flexman_gym.simulation.integrator import Integrator
from flexman_gym.simulation.methods import Method
from flexman_gym.simulation.stability import explicit_limit

LARGE_RATE, LARGE_TWIST, LARGE_BEND = 100.0, 1.0, 0.25  # rad/s, rad, and parts of a link: no arm moves so
STIFFENING_BEND = 0.1  # bent by this part of its length, a link shortens visibly
STEPS_PER_PERIOD = 50  # of a period whose steps the method chooses


class Failure(NamedTuple):
    """A failure that is to be explained.

    Attributes:
        run: what moved the arm.
        model: the model.
        drive: (7, n + 6) table of the drive.
        moment: time (s) of the last good state, step (s) and steps that were to follow.
        state: (2 d + 2,) last good state and its ledger.
        status: "diverged", "not converged" or "ok".
    """

    run: Integrator
    model: Model
    drive: Array
    moment: tuple[float, float, int]
    state: Array
    status: str


class _Quantity(NamedTuple):
    """A quantity of an arm over some states: name, unit, values (r,) and how large none should be."""

    name: str
    unit: str
    values: Array
    largest: float


def explain_failure(failure: Failure) -> str:
    """Says what went first and what to change, by a second run from the last good state, step by step."""
    run, (time, step, substeps) = failure.run, failure.moment
    if run.tolerance[0] > 0.0:
        step, substeps = step * substeps / STEPS_PER_PERIOD, STEPS_PER_PERIOD
    rows, result = np.zeros((substeps, len(failure.state))), np.zeros((substeps, layout.OUTPUTS))
    status, valid, _ = run(failure.drive, (time, step, 1), failure.state.copy(), rows, result)
    states = np.vstack([failure.state, rows[:valid], *([] if status == layout.OK else [run.work.new_state])])
    with np.errstate(all="ignore"):
        first, row = _first_excess(failure.model, states[:, : 2 * failure.model.n_dof])
    size = f"{abs(first.values[row]):.4g} {first.unit} at {time + row * step:.6g} s"
    said = f"the simulation {failure.status}: {first.name} went first, {size}"
    return f"{said}. Try {'; or '.join(_advice(failure.model, run, failure.moment[1], states[: max(row, 1)]))}."


def explain_energy(model: Model, run: Integrator, step: float, time: float, states: Array) -> str:
    """Says which coordinate vibrates most where the energy is wrong, and what to change.

    Args:
        model: the model.
        run: what moved the arm.
        step: s.
        time: of the alarm, s.
        states: (r, 2 d) until then.
    """
    d, label, diagonal = model.n_dof, _coordinate_names(model), np.diag(stiffness_matrix(model))
    shares = {f"the rate of {label[i]}": states[:, d + i] ** 2 for i in range(model.n_joints)}
    if diagonal.any():  # potential energies are as large as kinetic ones, and need no mass
        first = model.n_joints + model.n_motors
        shares = {label[a]: diagonal[a] * states[:, a] ** 2 for a in range(first, d)}
        for i, motor in enumerate(model.constants.motor):
            if motor >= 0:
                twist = states[:, motor] - states[:, i]
                shares[f"the spring of joints[{i}]"] = model.constants.joint_stiffness[i] * twist**2
    name = max(shares, key=lambda each: float(shares[each].max()))
    said = f"the energy residual is beyond 1 % of the energy turned over at {time:.6g} s"
    return f"{said}: most of the vibration is in {name}. Try {'; or '.join(_advice(model, run, step, states))}."


def _coordinate_names(model: Model) -> list[str]:
    """Gives the name of each coordinate (d,), such as "coordinate 2 of links[0]"."""
    result = [f"joints[{i}]" for i in range(model.n_joints)]
    result += [f"the motor of joints[{i}]" for i in np.flatnonzero(model.constants.motor >= 0)]
    for link in range(model.n_joints):
        columns = model.elastic_columns(link)
        result += [f"elastic coordinate {a} of links[{link}]" for a in range(columns.stop - columns.start)]
    return result


def _quantities(model: Model, states: Array) -> Iterator[_Quantity]:
    """Gives rates of joints and motors, twists of springs, deflections of links and elastic coordinates."""
    d, n, label = model.n_dof, model.n_joints, _coordinate_names(model)
    for column in range(n + model.n_motors):
        yield _Quantity(f"the rate of {label[column]}", "rad/s", states[:, d + column], LARGE_RATE)
    for i, motor in enumerate(model.constants.motor):
        if motor >= 0:
            yield _Quantity(f"the twist of joints[{i}]", "rad", states[:, motor] - states[:, i], LARGE_TWIST)
    sizes, starts = coordinate_scales(model), model.constants.elastic_start
    for link in range(n):
        columns = model.elastic_columns(link)
        shapes = model.constants.tip_translation[starts[link] : starts[link + 1]]
        if len(shapes):
            deflection = np.linalg.norm(states[:, columns] @ shapes, axis=1) / model.constants.length[link]
            yield _Quantity(f"the deflection of links[{link}]", "of its length", deflection, LARGE_BEND)
        for column in range(columns.start, columns.stop):
            bend = states[:, column] / sizes[column]
            yield _Quantity(label[column], "rad or parts of the link's length", bend, LARGE_BEND)


def _advice(model: Model, run: Integrator, step: float, states: Array) -> list[str]:
    """Gives what to change, the most promising first."""
    method, d, result = run.method, model.n_dof, []
    highest, limit = frequencies(model).max(initial=0.0), _step_limit(method)
    if run.tolerance[0] > 0.0:
        result.append("a method with fixed steps, such as midpoint_3_sweeps")
    elif 2.0 * np.pi * highest * step > limit:
        stable = limit / (2.0 * np.pi * highest)
        result.append(f"a step of at most {stable:.2g} s, as {method.name} is unstable beyond at {highest:.4g} Hz")
        result.append("a linearly implicit method, such as midpoint_3_sweeps")
    else:
        result.append(f"a step shorter than {step:g} s")
    with np.errstate(all="ignore"):
        good = states[np.isfinite(states).all(axis=1)]
        bent = [
            q for q in _quantities(model, good) if q.largest == LARGE_BEND and np.abs(q.values).max() > STIFFENING_BEND
        ]
        locked = frequencies(model, lock_joints=True)
        spins = np.abs(good[:, d : d + model.n_joints]).max(initial=0.0)
    if not model.choice.stiffening and (bent or (len(locked) and spins > np.pi * locked[0])):
        result.append("stiffening=True, as links bend far or spin fast, which needs their foreshortening")
    if model.n_elastic and not model.constants.damping.any():
        result.append("damping of the links, modal_damping_ratio, as there is none")
    return [*result, "smaller torques"]


def _first_excess(model: Model, states: Array) -> tuple[_Quantity, int]:
    """Gives the quantity that is first larger than it should be, and the row; the largest one where none is."""
    result = list(_quantities(model, states))
    sizes = np.array([np.abs(each.values) / each.largest for each in result])
    sizes = np.nan_to_num(sizes, nan=np.inf, posinf=np.inf)
    late = np.flatnonzero((sizes > 1.0).any(axis=0))
    row = int(late[0]) if late.size else sizes.shape[1] - 1
    return result[int(np.argmax(sizes[:, row]))], row


def _step_limit(method: Method) -> float:
    return explicit_limit(method) if not method.adaptive else np.inf
