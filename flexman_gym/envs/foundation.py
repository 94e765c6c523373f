"""Foundations of arms that move: protocol, table of the kinds, and their JSON-compatible data."""

from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any, Protocol, runtime_checkable

from flexman_gym.agent.action_modes import ActionMode
from flexman_gym.agent.controller import Controller
from flexman_gym.common.checks import mapping, one_of, text
from flexman_gym.common.errors import value_error
from flexman_gym.common.registry import load_entry
from flexman_gym.simulation.batch import Batch

_PLACE = "flexman_gym.toolbox.foundations"
FOUNDATIONS = {
    "travel": f"{_PLACE}.travel:Travel",
    "sea": f"{_PLACE}.base_motion:Sea",
    "record": f"{_PLACE}.base_record:Record",
}
"""Kinds of foundations: name -> place of the class of their settings."""


@runtime_checkable
class Foundation(Protocol):
    """Protocol of the settings of a foundation, a dataclass with a kind of FOUNDATIONS.

    Attributes:
        kind: name of the kind.
        names: names of the entries of an action that command the foundation; () for a prescribed motion.
        rotates: True for a base that rotates.
        range: largest distance of the base from its middle, m.
    """

    kind: str

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the entries of an action that command the foundation."""
        ...

    @property
    def rotates(self) -> bool:
        """True for a base that rotates."""
        ...

    @property
    def range(self) -> float:
        """Largest distance of the base from its middle, m."""
        ...

    def make(self, batch: Batch) -> Any:
        """Return the foundations of the arms of a batch, see `toolbox.foundations`."""
        ...

    def make_mode(self, mode: ActionMode, base: Controller | None) -> ActionMode:
        """Return the action mode of an agent that also commands the foundation."""
        ...


def find_foundation(value: object) -> Any:
    """Return the foundation of a mapping with its kind at "kind" and its arguments, or of an object; None for None."""
    if value is None or (isinstance(value, Foundation) and not isinstance(value, type)):
        return value
    if not isinstance(value, Mapping) or "kind" not in value:
        raise value_error("foundation", value, f"None, or a mapping with one of {', '.join(FOUNDATIONS)} at kind")
    kind = load_entry(FOUNDATIONS[one_of("foundation.kind", text("foundation.kind", value["kind"]), FOUNDATIONS)])
    given = {name: each for name, each in value.items() if name != "kind"}
    return kind(**mapping("foundation", given, [each.name for each in fields(kind)]))


def plain_foundation(value: Any) -> dict[str, Any] | None:
    """Return a foundation, or None, as JSON-compatible data, from which `find_foundation` makes an equal one."""
    return None if value is None else {"kind": value.kind, **asdict(value)}


def check_fixed(foundation: Any, reason: str) -> None:
    """Raise ValueError for a foundation that moves, with the reason why it is not allowed."""
    if foundation is not None:
        raise value_error("foundation", foundation.kind, f"None: {reason}")


def check_foundation(settings: Any, passive: bool) -> None:
    """Check what a moving foundation excludes.

    Args:
        settings: object with the settings foundation, safety and task of an environment.
        passive: True for an arm with passive joints.

    Raises:
        ValueError: for a setting that is not allowed.
    """
    if settings.foundation is None:
        return
    if settings.safety:
        raise value_error("safety", settings.safety, "False: the foundation of the arm moves")
    if settings.task.moves:
        raise value_error("task", settings.task, "a task whose goal rests: the foundation of the arm moves")
    if settings.foundation.rotates and passive:
        raise value_error("foundation", settings.foundation, "one that does not rotate: a joint of the arm is passive")
