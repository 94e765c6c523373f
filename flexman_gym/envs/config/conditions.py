"""Conditions: named changes of a named environment, a folder of files for each arm."""

from pathlib import Path
from typing import Any, NoReturn

from flexman_gym.common import files
from flexman_gym.common.checks import one_of, value_error
from flexman_gym.envs.config.named_environments import NAMED

NOMINAL = "nominal"  # the condition without changes
CONDITION_FOLDER = Path(__file__).parents[1] / "conditions"  # arm/condition.yaml: changes of settings
CONDITIONS = (NOMINAL, *sorted({path.stem for path in CONDITION_FOLDER.glob("*/*.yaml")}))


def condition_settings(id: str, condition: object) -> dict[str, Any]:
    """Return the settings of a named environment under one of its conditions; {} for the nominal one.

    Raises:
        ValueError: for another condition, and for an environment without conditions.
    """
    named = NAMED[one_of("id", id, NAMED)]
    if not named.conditions:
        known = [each for each, named in NAMED.items() if named.conditions]
        raise value_error("condition", f"{id}/{condition}", f"one for {', '.join(known)}")
    folder = CONDITION_FOLDER / named.conditions
    own = sorted(path.stem for path in folder.glob("*.yaml"))
    if one_of("condition", condition, (NOMINAL, *own)) == NOMINAL:
        return {}
    changes = files.read_data(folder / f"{condition}.yaml")
    return {name: _merged(named.plain(name), change) for name, change in changes.items()}


def refuse_condition(name: str, condition: str, **settings: Any) -> NoReturn:
    """Refuse an id with a condition behind it, which `rollout` and the commands take and Gymnasium does not.

    Raises:
        ValueError: one line with the keyword of `gym.make` and `gym.make_vec` in its place.
    """
    raise value_error("id", f"{name}/{condition}", f'gym.make("{name}", condition="{condition}")')


def _merged(old: object, change: object) -> object:
    """Return a value with a change.

    Mappings are merged; of a list of mappings each takes its own entry of a list of numbers.
    """
    if isinstance(old, dict) and isinstance(change, dict):
        return {**old, **{name: _merged(old.get(name, {}), each) for name, each in change.items()}}
    if isinstance(old, list) and isinstance(change, dict):
        return [
            {**entry, **{name: each[i] if isinstance(each, list) else each for name, each in change.items()}}
            for i, entry in enumerate(old)
        ]
    return change
