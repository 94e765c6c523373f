"""JointTrajectory messages of ROS, alone or in a goal, a RobotTrajectory or a DisplayTrajectory."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import mapping, number_array, sequence, whole_number
from flexman_gym.common.errors import value_error
from flexman_gym.toolbox.controllers.input_shaping.waypoints import DERIVATIVES, Waypoints

KNOWN_FIELDS = (*DERIVATIVES, "effort", "time_from_start")
CUT = "..."  # entry that ros2 topic echo writes in place of the rest of a list


def find_trajectory(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the JointTrajectory in a message.

    Raises:
        ValueError: for a message without joint_names and points, with several trajectories, and with one of links.
    """
    found = dict(_trajectories(data, ""))
    with_points = {place: each for place, each in found.items() if each["points"]}
    for place in with_points:
        if "multi_dof" in place:
            raise value_error(f"{place}.points", "a trajectory of links", "one of joints alone")
    if len(with_points) > 1:
        raise value_error("the trajectories", list(with_points), "a file with one of them")
    if not with_points:
        if found:
            raise value_error(f"{next(iter(found))}.points".lstrip("."), "no point", "points with positions")
        raise value_error("the fields", list(data), "joint_names and points of a JointTrajectory")
    return next(iter(with_points.values()))


def _trajectories(data: object, place: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the place and the content of each mapping with joint_names and points."""
    if isinstance(data, dict):
        if {"joint_names", "points"} <= data.keys():
            yield place, data
        else:
            for key, value in data.items():
                yield from _trajectories(value, f"{place}.{key}".lstrip("."))
    elif isinstance(data, list):
        for i, value in enumerate(data):
            yield from _trajectories(value, f"{place}[{i}]")


def read_trajectory(name: str, data: Mapping[str, Any]) -> tuple[Waypoints, tuple[int, ...]]:
    """Return the points of a JointTrajectory, and the numbers of derivatives that any of its points has.

    Raises:
        ValueError: as in `find_trajectory` and `Waypoints.of`, and for a point without positions or time.
    """
    message = find_trajectory(data)
    joints = len(sequence("joint_names", message["joint_names"]))
    points = sequence("points", message["points"])
    if CUT in points:
        given = f"{CUT!r} in place of points from {list(points).index(CUT)} on"
        raise value_error("points", given, "all points (ros2 topic echo --full-length)")
    times, values, has_effort = [], np.full((len(DERIVATIVES), len(points), joints), np.nan), False
    for i, each in enumerate(points):
        point = mapping(f"points[{i}]", each, KNOWN_FIELDS)
        times.append(_seconds(f"points[{i}].time_from_start", point.get("time_from_start")))
        for order, field in enumerate(DERIVATIVES):
            if order == 0 or point.get(field):
                allowed = f"{joints} finite numbers, one a joint"
                values[order, i] = number_array(f"points[{i}].{field}", point.get(field), (joints,), allowed)
        has_effort |= bool(point.get("effort"))
    orders = tuple(order for order in range(len(DERIVATIVES)) if np.isfinite(values[order]).any())
    result = Waypoints.of(name, np.array(times), values, "point")
    if has_effort:
        result = result._replace(notes=(*result.notes, "effort does not follow from the positions: left out"))
    return result, orders


def replace_points(data: dict[str, Any], times: Array, values: Mapping[int, Array]) -> None:
    """Replace the points of the JointTrajectory in a message.

    Args:
        data: the message.
        times: (T,) s.
        values: number of derivatives -> (T, n). Other fields of the first point are kept as empty lists.
    """
    message = find_trajectory(data)
    first = message["points"][0]
    message["points"] = [
        {
            field: values[DERIVATIVES.index(field)][row].tolist() if field in known else []
            for field in KNOWN_FIELDS[:-1]
            if field in known or field in first
        }
        | {"time_from_start": _duration(float(time), first["time_from_start"])}
        for known in [{DERIVATIVES[order] for order in values}]
        for row, time in enumerate(times)
    ]


def _seconds(name: str, value: object) -> float:
    """Return a duration of ROS, seconds and nanoseconds or a number, in s."""
    if isinstance(value, Mapping) and len(value) == 2:
        whole, parts = ("sec", "nanosec") if "sec" in value else ("secs", "nsecs")
        checked = mapping(name, value, (whole, parts))
        seconds, rest = checked.get(whole), checked.get(parts)
        return whole_number(f"{name}.{whole}", seconds, 0, 10**9) + 1e-9 * whole_number(
            f"{name}.{parts}", rest, 0, 10**9
        )
    return float(number_array(name, [value], (1,), "seconds, or sec and nanosec")[0])


def _duration(time: float, like: object) -> Any:
    """Return a time (s) in the form of another duration of ROS."""
    if not isinstance(like, Mapping):
        return round(time, 9)
    names = ("sec", "nanosec") if "sec" in like else ("secs", "nsecs")
    return dict(zip(names, divmod(round(1e9 * time), 10**9), strict=True))
