"""Foreign: policies in files of Stable-Baselines3, which can run any code and are read only where they are trusted."""

import pickle
import zipfile
from dataclasses import replace
from pathlib import Path

from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.save_util import load_from_zip_file
from stable_baselines3.common.vec_env import VecNormalize

from flexman_agents.algorithm import ALGORITHMS, acting, environments
from flexman_agents.settings import Settings
from flexman_gym.checks import one_of
from flexman_gym.envs.description import Description
from flexman_gym.evaluation.entrants import Entrant, parted, predicting
from flexman_gym.evaluation.folder import FOREIGN, SETTINGS, existing, settings_text

STATISTICS, BEST = "normalisation.pkl", "best"
# by which a zip is told apart
POLICIES: dict[str, type[BaseAlgorithm]] = {"ActorCriticPolicy": PPO, "SACPolicy": SAC, "TD3Policy": TD3}
BROKEN = (
    ValueError, KeyError, TypeError, AttributeError, EOFError, OSError, RuntimeError, AssertionError, ImportError,
    pickle.UnpicklingError, zipfile.BadZipFile,
)  # fmt: skip


def load_foreign(folder: Path) -> Entrant:
    """Loads the policy of a run of an earlier version: model.zip, normalisation.pkl and settings.json.

    Both files are pickles. Whoever made them decides what runs here.

    Raises:
        FileNotFoundError, ValueError: one clear line.
    """
    settings = Settings.from_json(folder / SETTINGS, settings_text(folder))
    place = folder / BEST if (folder / BEST / FOREIGN).is_file() else folder
    try:
        model = ALGORITHMS[settings.algo].load(existing(place / FOREIGN), device="cpu")
        arms = environments(replace(settings, envs=1))
        statistics = VecNormalize.load(str(existing(place / STATISTICS)), arms)
    except FileNotFoundError:
        raise
    except BROKEN as error:
        said = " ".join(str(error).split())[:120] or type(error).__name__
        raise ValueError(f"{place}: this is not a run of Stable-Baselines3 ({said})") from None
    environment, interface = parted(settings.description)
    return Entrant(folder.name, acting(model, statistics), interface, environment)


def load_zip(path: Path, described: Description | None = None) -> Entrant:
    """Loads a policy that `save` of Stable-Baselines3 has written, with the statistics in a file .pkl beside it.

    Both are pickles. Whoever made them decides what runs here.

    Args:
        path: of the zip.
        described: the environment that it learned in, with its sensors, base and hold; None for that in which it acts.

    Raises:
        FileNotFoundError, ValueError: one clear line.
    """
    statistics = existing(path).with_suffix(".pkl")
    try:
        kind = load_from_zip_file(path)[0]["policy_class"].__name__  # type: ignore[index]
        model: BaseAlgorithm = POLICIES[one_of("policy", kind, POLICIES)].load(path, device="cpu")
        entrant = predicting(model, described)
        if statistics.is_file():
            with statistics.open("rb") as file:
                normaliser = pickle.load(file)
            act = entrant.act
            return replace(
                entrant,
                name=path.stem,
                act=lambda seen, shape: act(normaliser.normalize_obs(seen), shape),
            )
    except BROKEN as error:
        said = " ".join(str(error).split())[:120] or type(error).__name__
        raise ValueError(f"{path}: this is not a policy of Stable-Baselines3 ({said})") from None
    return replace(entrant, name=path.stem)
