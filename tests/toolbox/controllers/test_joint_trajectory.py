"""Tests of messages of ROS: a trajectory is found in its wrappers, and its fields come back or are told."""

import json

import numpy as np
import pytest

from flexman_gym.common.files import read_data, write_data
from flexman_gym.toolbox.controllers.input_shaping.joint_trajectory import find_trajectory
from flexman_gym.toolbox.controllers.input_shaping.motion import Motion

from oracles.assertions import refusal

QUINTIC = np.polynomial.Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])
TIMES = np.append(0.125 * np.arange(8), 0.9375)
EMPTY = {"joint_names": [], "points": []}


def point(time, **changes):
    """A point of the quintic that ends at the last of the times."""
    part = time / TIMES[-1]
    derivatives = (QUINTIC(part), QUINTIC.deriv(1)(part) / TIMES[-1], QUINTIC.deriv(2)(part) / TIMES[-1] ** 2)
    fields = {name: [float(each), -0.5 * float(each)] for name, each in zip(
        ("positions", "velocities", "accelerations"), derivatives, strict=True)}  # fmt: skip
    sec, nanosec = divmod(round(1e9 * float(time)), 10**9)
    return fields | {"effort": [], "time_from_start": {"sec": sec, "nanosec": nanosec}} | changes


def message(times=TIMES, **changes):
    """A JointTrajectory."""
    return {"joint_names": ["a", "b"], "points": [point(time, **changes) for time in times]}


WRAPPERS = {
    "JointTrajectory": lambda inner: {"header": {"frame_id": "base"}} | inner,
    "RobotTrajectory": lambda inner: {"joint_trajectory": inner, "multi_dof_joint_trajectory": EMPTY},
    "FollowJointTrajectory goal": lambda inner: {"trajectory": inner, "goal_tolerance": [], "multi_dof_tr": EMPTY},
    "action goal": lambda inner: {"goal_id": {"id": "1"}, "goal": {"trajectory": inner}},
    "ExecuteTrajectory goal": lambda inner: {"trajectory": {"joint_trajectory": inner}},
    "DisplayTrajectory": lambda inner: {"model_id": "arm", "trajectory": [{"joint_trajectory": inner}], "start": {}},
}  # fmt: skip


@pytest.mark.parametrize("wrapper", WRAPPERS)
@pytest.mark.parametrize("ending", ["", "---\n"])
def test_wrappers_are_read_and_written_with_all_their_fields(wrapper, ending, tmp_path):
    write_data(tmp_path / "in.yaml", WRAPPERS[wrapper](message()))
    with (tmp_path / "in.yaml").open("a") as file:
        file.write(ending)
    motion = Motion.read(tmp_path / "in.yaml")
    assert motion.period == pytest.approx(0.125) and motion.orders == (0, 0, 1, 1, 2, 2)
    motion.write(tmp_path / "out.yaml")
    written, given = (read_data(tmp_path / name) for name in ("out.yaml", "in.yaml"))
    points = find_trajectory(written)["points"]
    assert [each["time_from_start"]["nanosec"] for each in points] == [125_000_000 * i % 10**9 for i in range(9)]
    for before, after in zip(message()["points"][:8], points, strict=False):
        assert after.keys() == before.keys()
        for field, value in before.items():
            assert field == "time_from_start" or after[field] == pytest.approx(value, abs=1e-12)
    for each in (written, given):
        find_trajectory(each)["points"] = []
    assert written == given


def read(tmp_path, data):
    """The motion in a JSON file with a message."""
    (tmp_path / "in.json").write_text(json.dumps(data))
    return Motion.read(tmp_path / "in.json")


def test_a_bare_first_point_loses_no_field_of_the_others(tmp_path):
    data = message()
    data["points"][0] |= {"velocities": [], "accelerations": []}
    motion = read(tmp_path, data)
    assert motion.orders == (0, 0, 1, 1, 2, 2)
    given = [[*each["velocities"], *each["accelerations"]] for each in data["points"][1:8]]
    assert motion.values[1:8, 2:] == pytest.approx(np.array(given), abs=1e-12)
    assert motion.remarks[:2] == (
        "in.json: velocities of the first point are missing: taken as 0",
        "in.json: accelerations of 1 point(s) are missing: those of the curve",
    )


def test_efforts_are_told_and_written_as_empty_lists(tmp_path):
    motion = read(tmp_path, message(effort=[1.0, 2.0]))
    assert "in.json: effort does not follow from the positions: left out" in motion.remarks
    motion.write(tmp_path / "out.json")
    assert all(each["effort"] == [] for each in find_trajectory(read_data(tmp_path / "out.json"))["points"])


@pytest.mark.parametrize("form", ["ROS 1", "numbers"])
def test_durations_keep_their_form(form, tmp_path):
    data = message()
    for each, time in zip(data["points"], TIMES.tolist(), strict=True):
        sec, nanosec = divmod(round(1e9 * time), 10**9)
        each["time_from_start"] = time if form == "numbers" else {"secs": sec, "nsecs": nanosec}
    read(tmp_path, data).write(tmp_path / "out.json")
    last = find_trajectory(read_data(tmp_path / "out.json"))["points"][-1]["time_from_start"]
    assert last == (1.0 if form == "numbers" else {"secs": 1, "nsecs": 0})


def test_several_messages_are_refused(tmp_path):
    text = json.dumps(message())
    (tmp_path / "in.yaml").write_text(f"{text}\n---\n{text}\n---\n")
    assert refusal(Motion.read, tmp_path / "in.yaml") == (
        "in.yaml: 2 documents separated by --- are not allowed; give one"
    )


@pytest.mark.parametrize(
    ("data", "line"),
    [
        ({"a": 1}, "the fields: ['a'] is not allowed; give joint_names and points of a JointTrajectory"),
        ({"trajectory": EMPTY}, "trajectory.points: 'no point' is not allowed; give points with positions"),
        (
            {"trajectory": [{"joint_trajectory": message()}] * 2},
            "the trajectories: ['trajectory[0].joint_trajectory', 'trajectory[1].joint_trajectory'] is not allow",
        ),
        (
            {"multi_dof_joint_trajectory": message()},
            "multi_dof_joint_trajectory.points: 'a trajectory of links' is not al",
        ),
        (
            {"joint_names": ["a"], "points": [*message()["points"][:3], "..."]},
            "points: \"'...' in place of points from 3",
        ),
        (message(positions=[]), "points[0].positions: [] is not allowed; give 2 finite numbers, one a joint"),
        (message(velocities=[1.0]), "points[0].velocities: [1.0] is not allowed; give 2 finite numbers, one a joint"),
        (message(time_from_start=None), "points[0].time_from_start: [None] is not allowed; give seconds, or sec and"),
    ],
)
def test_other_messages_are_refused_in_one_line(data, line, tmp_path):
    assert refusal(read, tmp_path, data).startswith(f"in.json: {line}")
