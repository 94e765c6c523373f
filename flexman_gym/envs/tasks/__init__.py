"""Tasks: start, goal, reward and observed goal of an episode."""

from dataclasses import asdict, fields
from typing import Any

from flexman_gym.common.checks import check_member_names, mapping, one_of, text, value_error
from flexman_gym.envs.tasks.hold import Hold
from flexman_gym.envs.tasks.slew import Slew
from flexman_gym.envs.tasks.task import OPTIONAL_TASK_MEMBERS, TASK_MEMBERS, Goal, Task
from flexman_gym.envs.tasks.track import Track

TASKS: dict[str, type[Any]] = {"slew": Slew, "track": Track, "hold": Hold}
"""Tasks that have a name: name -> class."""


def find_task(value: object) -> Any:
    """Return a task from its name, a mapping with its name at "kind" and its arguments, or a Task object."""
    entries = {"kind": value} if isinstance(value, str) else value
    if not isinstance(entries, dict) or "kind" not in entries:
        raise value_error("task", value, f"one of {', '.join(TASKS)}, or a mapping with that at kind, or a task")
    kind = TASKS[one_of("task", text("task.kind", entries["kind"]), TASKS)]
    arguments = {name: each for name, each in entries.items() if name != "kind"}
    return kind(**mapping("task", arguments, [each.name for each in fields(kind)]))


def plain_task(task: Any) -> dict[str, Any]:
    """Return the mapping of a task from which `find_task` makes an equal one.

    Raises:
        ValueError: for a task of the user's own class.
    """
    for name, kind in TASKS.items():
        if type(task) is kind:
            return {"kind": name, **asdict(task)}
    raise value_error("task", task, "something with a name: an object of one's own cannot be kept in a file")


def check_task(task: Task) -> None:
    """Check that no member of a task is a misspelt optional one."""
    check_member_names("task", task, OPTIONAL_TASK_MEMBERS, TASK_MEMBERS)


__all__ = ["TASKS", "Goal", "Hold", "Slew", "Task", "Track", "check_task", "find_task", "plain_task"]
