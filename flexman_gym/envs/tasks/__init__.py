"""Tasks: start, goal, reward and sensors that observe the goal."""

from dataclasses import asdict, fields, is_dataclass, replace
from inspect import signature
from typing import Any

from flexman_gym.common.checks import check_member_names, mapping, one_of, text
from flexman_gym.common.errors import suggestion, value_error
from flexman_gym.common.registry import Registry
from flexman_gym.envs.tasks.hold import Hold
from flexman_gym.envs.tasks.rewards import REWARDS
from flexman_gym.envs.tasks.slew import Slew
from flexman_gym.envs.tasks.task import OPTIONAL_TASK_MEMBERS, TASK_MEMBERS, Goal, Task
from flexman_gym.envs.tasks.track import Track

TASKS: Registry[type[Any]] = Registry("task", {"slew": Slew, "track": Track, "hold": Hold})
"""Named tasks: name -> class."""


def find_task(value: object) -> Task:
    """Return the task specified by its name, by a mapping with its name at "kind" and its arguments, or an object."""
    if isinstance(value, str):
        value = {"kind": value}
    if isinstance(value, dict) and "kind" in value:
        kind = TASKS[one_of("task", text("task.kind", value["kind"]), TASKS)]
        arguments = {name: each for name, each in value.items() if name != "kind"}
        value = kind(**mapping("task", arguments, _arguments(kind)))
    if not isinstance(value, Task) or isinstance(value, type):
        allowed = f"one of {', '.join(TASKS)}, a mapping with that at kind, or a task such as Slew()"
        raise value_error("task", value, f"{allowed}: an object with {', '.join(TASK_MEMBERS)}")
    check_member_names("task", value, OPTIONAL_TASK_MEMBERS, TASK_MEMBERS)
    return value


def with_named_reward(given: dict[str, Any], task: Task) -> dict[str, Any]:
    """Return the settings of an environment with a reward given by its name as an argument of the task.

    Args:
        given: settings, name -> value.
        task: task of the environment for settings without one.

    Raises:
        ValueError: for a name that is not a reward of the task.
    """
    name = given.get("reward")
    if not isinstance(name, str):
        return given
    task = find_task(task if given.get("task") is None else given["task"])
    names = tuple(REWARDS) if isinstance(task, Slew) else ("distance",) if isinstance(task, Track | Hold) else ()
    if name not in names:
        allowed = ", ".join([*names, "a mapping of weights of the task's terms, or a function of a View"])
        raise value_error("reward", name, allowed + suggestion(name, names))
    rest = {key: value for key, value in given.items() if key != "reward"}
    return {**rest, "task": replace(task, reward=name)} if isinstance(task, Slew) else rest


def _arguments(kind: type[Any]) -> list[str]:
    """Return the names of the arguments of a class of tasks."""
    return [each.name for each in fields(kind)] if is_dataclass(kind) else [*signature(kind).parameters]


def plain_task(task: Any) -> dict[str, Any]:
    """Return a task as JSON-compatible data: a mapping from which `find_task` makes an equal task.

    Args:
        task: a task of this library.

    Raises:
        ValueError: for a task of a class defined by the user.
    """
    for name, kind in TASKS.items():
        if type(task) is kind and is_dataclass(kind):
            return {"kind": name, **asdict(task)}
    raise value_error("task", task, "a task with a name; a file cannot hold an object of the user")


__all__ = ["TASKS", "Goal", "Hold", "Slew", "Task", "Track"]
