"""Record: the settings of a run in its folder, with the versions of all that it was made with."""

import json
import platform
import sys
from importlib.metadata import version
from pathlib import Path

from flexman_agents.settings import Settings
from flexman_gym.evaluation.folder import SETTINGS, read_settings, write

PACKAGES = ("flexman_gym", "gymnasium", "numba", "numpy", "scipy", "stable-baselines3", "torch")


def check_new(folder: Path) -> None:
    """Refuses a folder that holds a run already."""
    if (folder / SETTINGS).exists():
        raise ValueError(f"folder: {folder} is not allowed; give a new one, or resume the run in it")


def keep_settings(settings: Settings, folder: Path, done: int) -> None:
    """Writes the settings of a run that goes on after `done` steps, with the versions of all its parts."""
    now = {name: version(name) for name in PACKAGES} | {"python": platform.python_version()}
    path = folder / SETTINGS
    kept = read_settings(folder) if path.is_file() else {}
    earlier, last = kept.get("earlier_versions", []), kept.get("versions", now)
    if last != now and isinstance(last, dict):
        names = [name for name in now | last if now.get(name) != last.get(name)]
        said = ", ".join(f"{name} {now.get(name)} instead of {last.get(name)}" for name in names)
        print(f"Since {folder} was written: {said}; its bits may be others from here on.", file=sys.stderr)
        earlier = [*earlier, last | {"until_step": done}]
    record = settings.plain() | {"versions": now} | ({"earlier_versions": earlier} if earlier else {})
    write(path, lambda file: file.write((json.dumps(record, indent=1) + "\n").encode()))
