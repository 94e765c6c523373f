"""Recipes: settings of training runs that are known to work, plain files in the folder of that name."""

import os
from pathlib import Path

from flexman_agents.settings import Settings
from flexman_gym.checks import shown_path

FOLDER = Path(__file__).parent / "recipes"
NAMES = sorted(path.stem for path in FOLDER.glob("*.yaml"))


def find_recipe(name: str) -> Settings:
    """Gives the settings of a recipe by its name, or of a file of one's own.

    Raises:
        FileNotFoundError, ValueError: one line with what is wrong and what is allowed.
    """
    if name in NAMES:
        return Settings.recipe(FOLDER / f"{name}.yaml")
    if not os.path.isfile(name):  # whatever the name is
        raise FileNotFoundError(f"recipe: {shown_path(name)} is not allowed; give a file, or one of {', '.join(NAMES)}")
    return Settings.recipe(name)
