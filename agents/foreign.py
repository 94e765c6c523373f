"""Foreign: policies in files of Stable-Baselines3, which can run any code and are read only where they are trusted."""

import pickle
import zipfile
from dataclasses import replace
from pathlib import Path

from stable_baselines3.common.vec_env import VecNormalize

from flexman_agents.algorithm import ALGORITHMS, acting, environments
from flexman_agents.settings import Settings
from flexman_gym.evaluation.entrants import Entrant, parted
from flexman_gym.evaluation.folder import FOREIGN, SETTINGS, existing

STATISTICS, BEST = "normalisation.pkl", "best"


def load_foreign(folder: Path) -> Entrant:
    """Loads the policy of a run of an earlier version: model.zip, normalisation.pkl and settings.json.

    Both files are pickles. Whoever made them decides what runs here.

    Raises:
        FileNotFoundError, ValueError: one clear line.
    """
    path = existing(folder / SETTINGS)
    settings = Settings.from_json(path, path.read_bytes().decode("utf-8", errors="replace"))
    place = folder / BEST if (folder / BEST / FOREIGN).is_file() else folder
    try:
        model = ALGORITHMS[settings.algo].load(existing(place / FOREIGN), device="cpu")
        arms = environments(replace(settings, envs=1))
        statistics = VecNormalize.load(str(existing(place / STATISTICS)), arms)
    except FileNotFoundError:
        raise
    except (ValueError, KeyError, TypeError, AttributeError, EOFError, OSError, RuntimeError, AssertionError,
            pickle.UnpicklingError, zipfile.BadZipFile) as error:  # fmt: skip
        said = " ".join(str(error).split())[:120] or type(error).__name__
        raise ValueError(f"{place}: this is not a run of Stable-Baselines3 ({said})") from None
    environment, interface = parted(settings.description)
    return Entrant(folder.name, acting(model, statistics), interface, environment)
