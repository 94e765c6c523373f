"""Settings of a training run: hyperparameters, schedules, recipes, and the record in the folder of the run."""

import json
import os
import platform
import sys
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, field, fields, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

from flexman_gym.common import files
from flexman_gym.common.checks import (
    finite,
    flag,
    mapping,
    one_of,
    positive,
    sequence,
    set_fields,
    short_path,
    value_error,
    whole_number,
)
from flexman_gym.common.renamed import RUN_SETTINGS, deprecated_arguments, rename_keys
from flexman_gym.common.run_folder import SETTINGS, read_settings
from flexman_gym.control.base_controllers import parse_base
from flexman_gym.envs.config.configuration import Configuration

ALGORITHMS = ("ppo", "sac", "dagger")
DEFAULT_ENVS = {"ppo": 64, "sac": 16, "dagger": 128}
MAX_ENVS, MAX_STEPS, MAX_SEED, MAX_WIDTH = 4096, 10**10, 2**31, 10**5
WHOLE_HYPERPARAMETERS = (
    "n_steps",
    "batch_size",
    "n_epochs",
    "learning_starts",
    "buffer_size",
    "updates",
    "iterations_kept",
)
FRACTION_HYPERPARAMETERS = ("gamma", "gae_lambda", "tau")
ACTIVATIONS = ("tanh", "relu")
SCHEDULES = {"learning_rate": ALGORITHMS, "log_std": ("ppo",), "target_entropy": ("sac",)}  # name -> algorithms
EXPLORATION_SCHEDULES = ("log_std", "target_entropy")  # of PPO, of SAC
DEFAULT_HYPERPARAMETERS: dict[str, dict[str, Any]] = {
    # one batch a large part of the rollout: with small ones the optimiser, not the simulator, takes the time
    "ppo": {"n_steps": 128, "batch_size": 1024, "n_epochs": 5, "gamma": 0.999, "gae_lambda": 0.99},
    "sac": {"batch_size": 256, "gamma": 0.99, "learning_starts": 2000},
    "dagger": {
        "teacher": "privileged-lqr",
        "updates": 400,
        "batch_size": 512,
        "iterations_kept": 12,
        "net_arch": [256, 256],
        "activation": "tanh",
        "learning_rate": 0.001,
    },
}


@dataclass(frozen=True)
class Schedule:
    """A number that changes with training: linearly from one value to another, then constant.

    Attributes:
        start: the first value.
        end: the last value.
        until: part of the training after which the value stays.

    Raises:
        ValueError: for something else than finite numbers, and an `until` outside 0 to 1.
    """

    start: float
    end: float
    until: float = 1.0

    def __post_init__(self) -> None:
        for each in fields(self):
            finite(f"schedule.{each.name}", getattr(self, each.name))
        if not 0.0 < self.until <= 1.0:
            raise value_error("schedule.until", self.until, "a part of the training > 0, at most 1")

    def at(self, progress: float) -> float:
        """Gives the value when a part of the training, 0 to 1, is done."""
        return self.start + (self.end - self.start) * min(1.0, progress / self.until)

    def __call__(self, remaining: float) -> float:
        """Gives the value for the part of the training that remains, as Stable-Baselines3 asks."""
        return self.at(1.0 - remaining)


@dataclass(frozen=True)
class Settings:
    """What a training run needs to be repeated.

    Attributes:
        algo: "ppo", "sac", or "dagger" for imitation, see `Imitation`.
        environment: a Configuration, or the mapping of one; base and action_repeat belong to the agent.
        steps: actions of all arms together; with action_repeat=5 each takes five control periods.
        seed: of environments, exploration and weights; see `seeds`.
        envs: arms side by side; None takes 64 for PPO and 16 for SAC.
        hyperparameters: of the algorithm, as Stable-Baselines3 names them; net_arch and log_std_init go to the policy.
        schedules: "learning_rate"; of the exploration "log_std" of PPO, which is then not learned, and "target_entropy"
            of SAC; name -> mapping with start, end and until.
        normalise_reward: divide rewards by a running standard deviation of the return; observations always are
            normalised.
        eval_every: steps between evaluations on the seeds of `seeds.SELECTION`, by which the best policy is kept; 0
            for none.
        value_warmup: actions of all arms at the beginning, from which the value function of PPO alone learns.
        base_in_use: what acts beside the policy when it is used, in place of the base with which it learned; it is made
            for the arm on which it acts. None for the one with which it learned.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    algo: str = "ppo"
    environment: Configuration = field(default_factory=Configuration)
    steps: int = 1_000_000
    seed: int = 0
    envs: int = None  # type: ignore[assignment]
    hyperparameters: Mapping[str, Any] = field(default_factory=dict)
    schedules: Mapping[str, Any] = field(default_factory=dict)
    normalise_reward: bool = True
    eval_every: int = 0
    value_warmup: int = 0
    base_in_use: Any = None

    def __post_init__(self) -> None:
        set_fields(self, algo=one_of("algo", self.algo, ALGORITHMS))
        if not isinstance(self.environment, Configuration | dict):
            raise value_error("environment", self.environment, "a mapping")
        for name in ("hyperparameters", "schedules"):
            if not isinstance(getattr(self, name), dict):
                raise value_error(name, getattr(self, name), "a mapping")
        for name in self.schedules:
            if self.algo not in SCHEDULES[one_of("schedules", name, SCHEDULES)]:
                raise value_error(f"schedules.{name}", self.algo, f"it with {' and '.join(SCHEDULES[name])} only")
            self.schedule(name)
        if self.base_in_use is not None:
            parse_base(self.base_in_use)
        for name, value in self.hyperparameters.items():
            _check(f"hyperparameters.{name}", name, value)
        environment = self.environment
        if isinstance(environment, dict):
            environment = Configuration.from_plain(environment)
        set_fields(
            self,
            environment=environment,
            steps=whole_number("steps", self.steps, 1, MAX_STEPS),
            seed=whole_number("seed", self.seed, 0, MAX_SEED),
            envs=whole_number("envs", DEFAULT_ENVS[self.algo] if self.envs is None else self.envs, 1, MAX_ENVS),
            normalise_reward=flag("normalise_reward", self.normalise_reward),
            eval_every=whole_number("eval_every", self.eval_every, 0, MAX_STEPS if self.algo != "dagger" else 0),
            value_warmup=whole_number("value_warmup", self.value_warmup, 0, MAX_STEPS if self.algo == "ppo" else 0),
        )

    def schedule(self, name: str) -> Schedule | None:
        """Gives a schedule, None where there is none."""
        data = self.schedules.get(name)
        if data is None:
            return None
        if not isinstance(data, dict) or not {"start", "end"} <= data.keys() <= {"start", "end", "until"}:
            raise value_error(f"schedules.{name}", data, "a mapping with start, end and, if wanted, until")
        return Schedule(**data)

    @classmethod
    def from_dict(cls, data: object, field: str = "settings") -> Self:
        """Gives the settings in a mapping, each of which is checked."""
        present = rename_keys(data, RUN_SETTINGS) if isinstance(data, dict) else data
        return cls(**mapping(field, present, [each.name for each in fields(cls)]))

    @classmethod
    def recipe(cls, path: str | Path) -> Self:
        """Reads a recipe: a file (.yaml, .yml or .json) with a mapping of settings.

        Raises:
            FileNotFoundError: when there is none.
            ValueError: one line with file, field, value and what is allowed.
        """
        try:
            data = files.read_data(Path(path))
            if isinstance(data, dict) and isinstance(data.get("environment"), dict):
                data["environment"] = Configuration.from_plain(data["environment"], Path(path).parent, warn=True)
            return cls.from_dict(data)
        except ValueError as error:
            raise ValueError(f"{short_path(path)}: {error}") from None

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Return the settings of the training run in a folder.

        Raises:
            FileNotFoundError, ValueError: one line with the file and the fault.
        """
        record = read_settings(folder)
        try:
            record = {"base_in_use": None, "value_warmup": 0, **record}  # of runs before there were any
            return cls.from_dict({name: record[name] for name in (each.name for each in fields(cls))})
        except (KeyError, TypeError, ValueError) as error:
            said = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise ValueError(f"{short_path(folder / SETTINGS)}: {said}; give the settings of a training run") from None

    def plain(self) -> dict[str, Any]:
        """Return all settings as a mapping for JSON."""
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        return deepcopy(values | {"environment": self.environment.to_plain()})

    def with_seed(self, seed: int) -> Self:
        """Gives the same with another seed."""
        return replace(self, seed=seed)


Settings.__init__ = deprecated_arguments(**RUN_SETTINGS)(Settings.__init__)  # type: ignore[method-assign]


def _check(field: str, name: str, value: object) -> None:
    """Refuses a hyperparameter that would stop a training after it has begun; their names belong to the algorithm."""
    if name in WHOLE_HYPERPARAMETERS:
        whole_number(field, value, 1 - (name == "learning_starts"), MAX_STEPS)
    elif name in FRACTION_HYPERPARAMETERS and not positive(field, value) <= 1.0:
        raise value_error(field, value, "a number > 0, at most 1")
    elif name == "learning_rate":
        positive(field, value)
    elif name == "activation":
        one_of(field, value, ACTIVATIONS)
    elif name == "ortho_init":
        flag(field, value)
    elif name == "teacher":
        parse_base(value)
    elif name == "net_arch" and not isinstance(value, dict):
        for i, width in enumerate(sequence(field, value, "widths of layers")):
            whole_number(f"{field}[{i}]", width, 1, MAX_WIDTH)


RECIPE_FOLDER = Path(__file__).parent / "recipes"
RECIPES = sorted(path.stem for path in RECIPE_FOLDER.glob("*.yaml"))


def find_recipe(name: str) -> Settings:
    """Gives the settings of a recipe by its name, or of a file of one's own.

    Raises:
        FileNotFoundError, ValueError: one line with what is wrong and what is allowed.
    """
    if name in RECIPES:
        return Settings.recipe(RECIPE_FOLDER / f"{name}.yaml")
    if not os.path.isfile(name):  # whatever the name is
        raise FileNotFoundError(
            f"recipe: {short_path(name)} is not allowed; give a file, or one of {', '.join(RECIPES)}"
        )
    return Settings.recipe(name)


RECORDED_PACKAGES = ("flexman_gym", "gymnasium", "numba", "numpy", "scipy", "stable-baselines3", "torch")


def check_new_folder(folder: Path) -> None:
    """Refuses a folder that holds a run already."""
    if (folder / SETTINGS).exists():
        raise ValueError(f"folder: {folder} is not allowed; give a new one, or resume the run in it")


def write_settings(settings: Settings, folder: Path, done: int) -> None:
    """Writes the settings of a run that goes on after `done` steps, with the versions of all its parts."""
    now = {name: version(name) for name in RECORDED_PACKAGES} | {"python": platform.python_version()}
    path = folder / SETTINGS
    kept = read_settings(folder) if path.is_file() else {}
    earlier, last = kept.get("earlier_versions", []), kept.get("versions", now)
    if last != now and isinstance(last, dict):
        names = [name for name in now | last if now.get(name) != last.get(name)]
        said = ", ".join(f"{name} {now.get(name)} instead of {last.get(name)}" for name in names)
        print(f"Since {folder} was written: {said}; its bits may be others from here on.", file=sys.stderr)
        earlier = [*earlier, last | {"until_step": done}]
    record = settings.plain() | {"versions": now} | ({"earlier_versions": earlier} if earlier else {})
    files.write_atomically(path, lambda file: file.write((json.dumps(record, indent=1) + "\n").encode()))
