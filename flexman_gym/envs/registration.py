"""Ids of the named environments and names of their conditions, and their registration with Gymnasium."""

from pathlib import Path
from typing import Any, NoReturn

from gymnasium.envs.registration import register

ENVIRONMENT_FOLDER = Path(__file__).parent / "named"  # files ID.yaml: default settings of a named environment
CONDITION_FOLDER = Path(__file__).parent / "conditions"  # files ARM/CONDITION.yaml: changed settings
IDS = (
    "FlexRRR-v0",
    "FlexRRR-Track-v0",
    "FlexRRR-Hold-v0",
    "FlexRRR-Gravity-v0",
    "FlexPlanar-v0",
    "FlexPlanar-Track-v0",
    "FlexPlanar-Hold-v0",
    "FlexOne-v0",
    "FlexQuanser-v0",
    "FlexRotary-v0",
    "FlexCrane-v0",
    "FlexTwoMass-v0",
    "FlexGantry-v0",
    "FlexDeck-v0",
)
NOMINAL = "nominal"  # name of the condition without changes
CONDITIONS = (NOMINAL, *sorted({path.stem for path in CONDITION_FOLDER.glob("*/*.yaml")}))


def register_environments() -> None:
    """Register the named environments with Gymnasium, without loading them."""
    for name in IDS:
        register(
            id=name,
            entry_point="flexman_gym.envs.env:FlexManEnv",
            vector_entry_point="flexman_gym.envs.vector_env:FlexManVectorEnv",
            kwargs={"name": name},
        )
        for condition in CONDITIONS:
            register(
                id=f"{name}/{condition}",
                entry_point="flexman_gym.envs.registration:refuse_condition",
                vector_entry_point="flexman_gym.envs.registration:refuse_condition",
                kwargs={"name": name, "condition": condition},
            )


def refuse_condition(name: str, condition: str, **settings: Any) -> NoReturn:
    """Raise ValueError for an id such as "FlexRRR-v0/delay", which is valid for `rollout` but not for `gym.make`."""
    from flexman_gym.common.errors import value_error

    raise value_error("id", f"{name}/{condition}", f'gym.make("{name}", condition="{condition}")')
