"""Options of a reset: start and goal as joint angles or, by inverse kinematics, as tip positions, and parameters."""

import numbers
from collections.abc import Mapping
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import one_of, sequence, value_error, vector
from flexman_gym.envs.view import View
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.parameters import PARAMETERS

TIP_OPTIONS = {
    "start_tip": "start",
    "goal_tip": "goal_angles",
}  # option with a tip position -> posture in its place
STARTS, MAX_ITERATIONS = 24, 20  # start postures of the search; corrections for the sag under gravity
TOLERANCE = 1e-8  # accepted distance of the tip, fraction of the reach


def inverse_kinematics(field: str, place: Array, near: Array, view: View) -> Array:
    """Return motor angles (n,), rad, at which the tip rests at a position (3,) in the base frame, m.

    Newton's method starts from `near` and from 24 fixed postures. Of several solutions the closest to `near` (least sum
    of squared angle differences) is rechanges.

    Args:
        field: name of the field in the error message.
        place: (3,) position of the tip, m.
        near: (n,) rad.
        view: view of the arm, bent by its nominal weight.

    Returns:
        The motor angles.

    Raises:
        ValueError: if no start leads to a solution.
    """
    starts = near + np.random.default_rng(0).uniform(-np.pi, np.pi, (STARTS, len(near)))
    found = [angles for start in (near, *starts) if (angles := _solve(place, start, view)) is not None]
    if not found:
        span = f"{view.reach:.4g} m of links"
        raise value_error(field, place.tolist(), f"a position of the tip (m, base frame) within reach of {span}")
    changes = np.array(found) - near
    changes -= 2.0 * np.pi * np.round(changes / (2.0 * np.pi))
    result: Array = near + changes[np.argmin((changes**2).sum(axis=1))]
    return result


def _solve(place: Array, start: Array, view: View) -> Array | None:
    """Return the solution found from a start; None if there is none."""
    angles, goal = start, place
    for _ in range(MAX_ITERATIONS):
        (angles,), _ = view.inverse_kinematics(goal[None], angles)
        error = place - view.rest_tips(angles[None])[0] if np.isfinite(angles).all() else np.full(3, np.inf)
        if not np.linalg.norm(error) > TOLERANCE * view.reach:
            return angles
        if not np.isfinite(error).all():
            return None
        goal = goal + (error if view.has_gravity else 0.0)
    return None


def parse_reset_options(
    options: Mapping[str, Any] | None, plan: Mapping[str, Array], size: tuple[int, int]
) -> dict[str, Any]:
    """Return the options with a leading axis for the arms.

    Args:
        options: options of a reset.
        plan: drawn plans by name, whose entries the options may replace.
        size: (b, n) number of arms and joints.
    """
    names = [*plan, *(name for name, posture in TIP_OPTIONS.items() if posture in plan), "parameters"]
    if options is not None and not isinstance(options, dict):
        raise value_error("options", options, f"a dict with {', '.join(names[:-1])} or {names[-1]}")
    given: dict[str, Any] = {}
    for name, value in (options or {}).items():
        field = f"options[{name!r}]"
        if one_of("options", name, names) == "parameters":
            given[name] = _parameters(field, value, size)
        else:
            if TIP_OPTIONS.get(name) in given or name in [TIP_OPTIONS.get(other) for other in given]:
                raise value_error(field, value, "either a posture or a position of the tip")
            shape = (3,) if name in TIP_OPTIONS else plan[name].shape[1:]
            given[name] = _each(
                field, value, shape, size[0], "m" if name in TIP_OPTIONS else "rad" * (shape == size[1:])
            )
    return given


def check_parameters(options: object, batch: Batch) -> None:
    """Check parameters in the options before a reset changes anything."""
    if isinstance(options, dict) and "parameters" in options:
        field, arms, model = "options['parameters']", len(batch.rows), batch.model
        for name, values in _parameters(field, options["parameters"], (arms, model.n_joints)).items():
            PARAMETERS[name].checked(f"{field}[{name!r}]", values, model, arms)


def _each(field: str, value: object, shape: tuple[int, ...], arms: int, unit: str) -> Array:
    """Return numbers (b, ...) of all arms from those of one arm, or of each."""
    if len(shape) != 1:
        return _numbers(field, value, (arms, *shape))
    entries = sequence(field, value, "numbers")
    if not entries or not isinstance(entries[0], list | tuple | np.ndarray):
        return np.tile(vector(field, value, shape[0], unit), (arms, 1))
    if len(entries) != arms:
        allowed = f"{shape[0]} numbers ({unit}), or a list of {arms} such lists, one for each arm"
        raise value_error(field, value, allowed)
    return np.array([vector(f"{field}[{i}]", entry, shape[0], unit) for i, entry in enumerate(entries)])


def _parameters(field: str, value: object, size: tuple[int, int]) -> dict[str, Array]:
    """Return the parameters of all arms by name."""
    if not isinstance(value, dict):
        raise value_error(field, value, f"a dict with some of {', '.join(PARAMETERS)}")
    given = {}
    for name, values in value.items():
        shape = PARAMETERS[one_of(field, name, PARAMETERS)].shape(size[1])
        given[name] = _numbers(f"{field}[{name!r}]", values, (size[0], *shape))
    return given


def _numbers(field: str, value: object, shape: tuple[int, ...]) -> Array:
    """Return numbers of a shape, broadcast from those of one arm."""
    allowed = f"numbers of the shape {shape}, or {shape[1:]}"
    try:
        listed = value if isinstance(value, numbers.Real | np.ndarray) else sequence(field, value)  # limits its length
        values = np.broadcast_to(np.asarray(listed), shape)
    except Exception:  # wrong shape, ragged lists, or an object of any class
        raise value_error(field, value, allowed) from None
    if values.dtype.kind not in "fiu":
        raise value_error(field, value, allowed)
    return values
