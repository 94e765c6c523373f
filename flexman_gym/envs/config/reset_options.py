"""Options of a reset: start and goal as joint angles or, by inverse kinematics, as tip positions, and parameters."""

import numbers
from collections.abc import Mapping
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import one_of, sequence, vector
from flexman_gym.common.errors import value_error
from flexman_gym.envs.view import View
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.physical_parameters import PARAMETERS

TIP_OPTIONS = {"start_tip": "start", "goal_tip": "goal_angles"}  # option with a tip position -> option it replaces
INITIAL_POSTURES = 24  # number of initial postures of the inverse kinematics, in addition to the given one
MAX_ITERATIONS = 20  # largest number of corrections for the sag under gravity
TOLERANCE = 1e-8  # fraction of the reach; accepted tip error


def _inverse_kinematics(field: str, position: Array, near: Array, view: View) -> Array:
    """Return motor angles (n,), rad, at which the tip of the arm at rest has a position (3,) in the base frame, m.

    Newton's method begins at `near` and at 24 fixed postures. Of several solutions within the angle ranges of the
    joints the one with the smallest sum of squared angle differences from `near` is returned.

    Args:
        field: name of the field in the error message.
        position: (3,) position of the tip, m.
        near: (n,) motor angles, rad.
        view: named quantities of the arms, see `View`. Under gravity the arm at rest is deformed by its nominal weight.

    Raises:
        ValueError: if no initial posture leads to a solution, or to none within the angle ranges.
    """
    starts = near + np.random.default_rng(0).uniform(-np.pi, np.pi, (INITIAL_POSTURES, len(near)))
    found = [angles for start in (near, *starts) if (angles := _solve(position, start, view)) is not None]
    if not found:
        allowed = f"a position of the tip (m, base frame) within the reach of the arm, {view.reach:.4g} m"
        raise value_error(field, position.tolist(), allowed)
    changes = np.array(found) - near
    changes -= 2.0 * np.pi * np.round(changes / (2.0 * np.pi))
    ranges = view.postures
    within = [angles for change in changes if ranges.contains(angles := ranges.turned_into(near + change))]
    if not within:
        allowed = "a position of the tip (m, base frame) that the arm reaches within the angle ranges of its joints"
        raise value_error(field, position.tolist(), allowed)
    return min(within, key=lambda angles: float(((angles - near) ** 2).sum()))


def _solve(position: Array, start: Array, view: View) -> Array | None:
    """Return the motor angles (n,) found from an initial posture (n,); None if the iteration does not converge."""
    angles, goal = start, position
    for _ in range(MAX_ITERATIONS):
        (angles,), _ = view.inverse_kinematics(goal[None], angles)
        error = position - view.rest_tips(angles[None])[0] if np.isfinite(angles).all() else np.full(3, np.inf)
        if not np.linalg.norm(error) > TOLERANCE * view.reach:
            return angles
        if not np.isfinite(error).all():
            return None
        goal = goal + (error if view.has_gravity else 0.0)
    return None


def parse_reset_options(
    options: Mapping[str, Any] | None, parameters: Mapping[str, Array], size: tuple[int, int]
) -> dict[str, Any]:
    """Return the options of a reset by name, with a leading axis for the b arms.

    Args:
        options: options of a reset.
        parameters: name -> (b, ...) drawn episode parameters, which the options may replace.
        size: (b, n) numbers of arms and joints.
    """
    names = [*parameters, *(name for name, posture in TIP_OPTIONS.items() if posture in parameters), "parameters"]
    if options is not None and not isinstance(options, dict):
        raise value_error("options", options, f"a dict with {', '.join(names[:-1])} or {names[-1]}")
    given: dict[str, Any] = {}
    for name, value in (options or {}).items():
        field = f"options[{name!r}]"
        if one_of("options", name, names) == "parameters":
            given[name] = _parameters(field, value, size)
        else:
            if TIP_OPTIONS.get(name) in given or name in [TIP_OPTIONS.get(earlier) for earlier in given]:
                raise value_error(field, value, "either a posture or a position of the tip")
            shape = (3,) if name in TIP_OPTIONS else parameters[name].shape[1:]
            given[name] = _each(
                field, value, shape, size[0], "m" if name in TIP_OPTIONS else "rad" * (shape == size[1:])
            )
    return given


def replace_tip_positions(parameters: Mapping[str, Array], view: View) -> dict[str, Array]:
    """Return episode parameters with postures (r, n), rad, in place of tip positions (r, 3), m, see TIP_OPTIONS.

    The inverse kinematics of a goal begins at the start posture, the inverse kinematics of a start at the middle
    of the angle ranges.
    """
    result = dict(parameters)
    for name, posture in TIP_OPTIONS.items():
        if name in parameters:
            near = result["start"] if posture != "start" else np.tile(view.postures.home, (len(parameters[name]), 1))
            pairs = zip(result.pop(name), near, strict=True)
            result[posture] = np.array([_inverse_kinematics(f"options[{name!r}]", *pair, view) for pair in pairs])
    return result


def check_parameters(options: object, batch: Batch) -> None:
    """Raise ValueError for physical parameters in the options that are not allowed, before a reset changes the arms."""
    if isinstance(options, dict) and "parameters" in options:
        field, arms, model = "options['parameters']", len(batch.rows), batch.model
        for name, values in _parameters(field, options["parameters"], (arms, model.n_joints)).items():
            PARAMETERS[name].checked(f"{field}[{name!r}]", values, model, arms)


def _each(field: str, value: object, shape: tuple[int, ...], arms: int, unit: str) -> Array:
    """Return an array (b, ...) from a value (...) that applies to all arms, or (b, ...) with one value per arm."""
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
    """Return name -> (b, ...) physical parameters of all arms."""
    if not isinstance(value, dict):
        raise value_error(field, value, f"a dict with some of {', '.join(PARAMETERS)}")
    given = {}
    for name, values in value.items():
        shape = PARAMETERS[one_of(field, name, PARAMETERS)].shape(size[1])
        given[name] = _numbers(f"{field}[{name!r}]", values, (size[0], *shape))
    return given


def _numbers(field: str, value: object, shape: tuple[int, ...]) -> Array:
    """Return numbers broadcast to a shape (b, ...)."""
    allowed = f"numbers of the shape {shape}, or {shape[1:]}"
    try:
        listed = value if isinstance(value, numbers.Real | np.ndarray) else sequence(field, value)  # limits its length
        values = np.broadcast_to(np.asarray(listed), shape)
    except Exception:  # wrong shape, ragged lists, or an object of any class
        raise value_error(field, value, allowed) from None
    if values.dtype.kind not in "fiu":
        raise value_error(field, value, allowed)
    return values
