"""Settings of a training run: hyperparameters, schedules, recipes, and their record in the run folder."""

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

from flexman_gym.agent.base_controllers import BASES, parse_kind
from flexman_gym.common import files
from flexman_gym.common.checks import finite, flag, mapping, one_of, positive, sequence, set_fields, whole_number
from flexman_gym.common.errors import unknown_name, value_error
from flexman_gym.common.run_folder import NO_SETTINGS, SETTINGS, read_settings
from flexman_gym.envs.config.configuration import Configuration

OPTIONAL = ("training_horizon", "arms")  # settings that a file lacks where they are None
RECORDED_PACKAGES = ("flexman_gym", "gymnasium", "numba", "numpy", "scipy", "stable-baselines3", "torch")
OFF_POLICY = ("sac", "tqc", "crossq")  # algorithms with a replay buffer, actor, critics, and entropy coefficient
ALGORITHMS = ("ppo", *OFF_POLICY, "dagger")
CONTRIB = "sb3-contrib"  # package of TQC and CrossQ
CONTRIB_ALGORITHMS = ("tqc", "crossq")
DEFAULT_ENVS = {"ppo": 64, **dict.fromkeys(OFF_POLICY, 16), "dagger": 128}  # algorithm -> parallel arms
MAX_ENVS, MAX_STEPS, MAX_SEED, MAX_WIDTH = 4096, 10**10, 2**31, 10**5
WHOLE_HYPERPARAMETERS = (  # whole numbers
    "n_steps", "batch_size", "n_epochs", "learning_starts", "buffer_size", "updates", "iterations_kept", "policy_delay",
    "n_critics", "n_quantiles", "top_quantiles_to_drop_per_net",
)  # fmt: skip
MAY_BE_ZERO = ("learning_starts", "top_quantiles_to_drop_per_net")
FRACTION_HYPERPARAMETERS = ("gamma", "gae_lambda", "tau")  # numbers > 0, at most 1
ACTIVATIONS = ("tanh", "relu")
NET_ARCH_KEYS = {"ppo": ("pi", "vf"), **dict.fromkeys(OFF_POLICY, ("pi", "qf"))}  # names of networks: policy, critic
SCHEDULES = {"learning_rate": ALGORITHMS, "log_std": ("ppo",), "target_entropy": OFF_POLICY}  # name -> its algorithms
EXPLORATION_SCHEDULES = ("log_std", "target_entropy")  # for PPO, for OFF_POLICY
QUANTILES, DROPPED = 25, 2  # of each critic of TQC, defaults of sb3-contrib: number, and largest ones left out
DEFAULT_HYPERPARAMETERS: dict[str, dict[str, Any]] = {
    # large batches: with small batches the optimiser takes more time than the simulation
    "ppo": {"n_steps": 128, "batch_size": 1024, "n_epochs": 5, "gamma": 0.999, "gae_lambda": 0.99},
    **{algo: {"batch_size": 256, "gamma": 0.99, "learning_starts": 2000} for algo in OFF_POLICY},
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
    """Hyperparameter that changes linearly during the training and is constant afterwards.

    Attributes:
        start: value at the beginning.
        end: value at the end.
        until: fraction of the training, > 0 and at most 1, at which `end` is reached.
    """

    start: float
    end: float
    until: float = 1.0

    def __post_init__(self) -> None:
        for each in fields(self):
            finite(f"schedule.{each.name}", getattr(self, each.name))
        if not 0.0 < self.until <= 1.0:
            raise value_error("schedule.until", self.until, "a fraction of the training, > 0 and at most 1")

    def at(self, progress: float) -> float:
        """Return the value at a progress of the training, a fraction from 0 to 1."""
        return self.start + (self.end - self.start) * min(1.0, progress / self.until)

    def __call__(self, remaining: float) -> float:
        """Return the value for the remaining fraction of the training, the argument that Stable-Baselines3 passes."""
        return self.at(1.0 - remaining)


@dataclass(frozen=True)
class Settings:
    """Settings of a training run, complete enough to repeat it.

    Attributes:
        algo: "ppo", "sac", "tqc", "crossq", or "dagger" for imitation learning (see `imitation.DAgger`).
        environment: Configuration, or its mapping; `base` and `action_repeat` in it belong to the agent.
        steps: environment steps, or actions, summed over all arms; an action lasts `action_repeat` control periods.
        seed: seed of the episodes, the exploration and the initial network parameters.
        envs: number of parallel arms; None for 64 with PPO, 128 with DAgger and 16 otherwise.
        hyperparameters: hyperparameters under their names in Stable-Baselines3; net_arch, activation, log_std_init,
            ortho_init, n_critics and n_quantiles are passed to the policy. critic_norm is True for layer normalisation
            in the critics of SAC and TQC. Hyperparameters of DAgger: teacher, updates (gradient steps per
            iteration), batch_size, iterations_kept (latest iterations in the training set), net_arch, activation,
            learning_rate.
        schedules: name -> mapping with start, end and until. Names: "learning_rate"; "log_std" of PPO, which is then
            not learned; "target_entropy" of SAC, TQC and CrossQ.
        normalise_reward: True to divide rewards by the running standard deviation of the return; observations are
            always normalised.
        eval_every: environment steps between evaluations on the selection seeds, by which the best policy is saved; 0
            for none.
        value_warmup: environment steps at the beginning during which PPO updates only its value function.
        base_in_use: base controller that replaces the one of the training when the policy is used, designed for the arm
            on which it is used; None for the base controller of the training.
        training_horizon: time after which an episode of the training is truncated, s; None for the horizon of the
            environment, which evaluations have. DAgger has that of the environment.
        arms: number of random arms that replace the arm of the environment in the training with PPO, see
            `generalist.arm_environments`; None for the arm of the environment.
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
    training_horizon: float | None = None
    arms: int | None = None

    def __post_init__(self) -> None:
        set_fields(self, algo=one_of("algo", self.algo, ALGORITHMS))
        if not isinstance(self.environment, Configuration | dict):
            raise value_error("environment", self.environment, "a mapping")
        for name in ("hyperparameters", "schedules"):
            if not isinstance(getattr(self, name), dict):
                raise value_error(name, getattr(self, name), "a mapping")
        for name in self.schedules:
            if self.algo not in SCHEDULES[one_of("schedules", name, SCHEDULES)]:
                raise value_error(f"schedules.{name}", self.algo, f"it with {', '.join(SCHEDULES[name])} only")
            self.schedule(name)
        if self.base_in_use is not None:
            parse_kind("base", self.base_in_use, BASES)
        for name, value in self.hyperparameters.items():
            _check(f"hyperparameters.{name}", name, value, self.algo)
        self._check_quantiles()
        if self.training_horizon is not None:
            if self.algo == "dagger":
                raise value_error("training_horizon", self.training_horizon, "None for dagger")
            set_fields(self, training_horizon=positive("training_horizon", self.training_horizon, "s"))
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
        self._check_arms()

    def _check_arms(self) -> None:
        """Check the settings of a training over random arms, if it is one."""
        if self.arms is None:
            return
        arms = whole_number("arms", self.arms, 1, self.envs)
        for name, allowed in (("training_horizon", None), ("eval_every", 0), ("algo", "ppo")):
            if getattr(self, name) != allowed:
                raise value_error(name, getattr(self, name), f"{allowed} for a training over random arms")
        if self.envs % arms:
            raise value_error("envs", self.envs, f"a multiple of the number of arms, {arms}")

    def _check_quantiles(self) -> None:
        """Raise ValueError if TQC leaves out all quantiles of its critics."""
        count = self.hyperparameters.get("n_quantiles", QUANTILES)
        name = "top_quantiles_to_drop_per_net"
        if self.algo == "tqc" and (dropped := self.hyperparameters.get(name, DROPPED)) >= count:
            raise value_error(f"hyperparameters.{name}", dropped, f"a whole number below n_quantiles, {count}")

    @property
    def training_environment(self) -> Configuration:
        """Configuration of the episodes of the training."""
        if self.training_horizon is None:
            return self.environment
        return self.environment.replace(horizon=self.training_horizon)

    def schedule(self, name: str) -> Schedule | None:
        """Return a schedule by name, None if there is none."""
        data = self.schedules.get(name)
        if data is None:
            return None
        if not isinstance(data, dict) or not {"start", "end"} <= data.keys() <= {"start", "end", "until"}:
            raise value_error(f"schedules.{name}", data, "a mapping with start, end and, optionally, until")
        return Schedule(**data)

    @classmethod
    def from_dict(cls, data: object, field: str = "settings") -> Self:
        """Return checked settings from a mapping."""
        return cls(**mapping(field, data, [each.name for each in fields(cls)]))

    @classmethod
    def recipe(cls, path: str | Path) -> Self:
        """Return the settings of a recipe, a file (.yaml, .yml or .json) with a mapping of settings."""
        with files.naming(path):
            data = files.read_data(Path(path))
            if isinstance(data.get("environment"), dict):
                data["environment"] = Configuration.from_plain(data["environment"], Path(path).parent)
            return cls.from_dict(data)

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read the settings of a training run.

        Args:
            folder: folder of the run.

        Raises:
            FileNotFoundError: if the folder has no settings.
            ValueError: if they are not settings of a training run.
        """
        record = read_settings(folder)
        with files.reading(folder / SETTINGS, NO_SETTINGS):
            names = [each.name for each in fields(cls) if each.name in record or each.name not in OPTIONAL]
            return cls.from_dict({name: record[name] for name in names})

    def check_run(self, folder: Path) -> None:
        """Raise ValueError if a folder, which may be missing, holds a run with different settings."""
        if not (folder / SETTINGS).exists():
            return
        own = type(self).load(folder)
        changed = [each.name for each in fields(self) if getattr(own, each.name) != getattr(self, each.name)]
        if changed:
            raise value_error("folder", str(folder), f"a new one: the run in it has different {', '.join(changed)}")

    def plain(self) -> dict[str, Any]:
        """Return all settings as JSON-compatible data."""
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        values = {name: each for name, each in values.items() if each is not None or name not in OPTIONAL}
        return deepcopy(values | {"environment": self.environment.to_plain()})

    def write(self, folder: Path, done: int) -> None:
        """Write the settings, with the versions of the packages, to the folder of a run.

        Args:
            folder: folder of the run.
            done: environment steps so far, for which the versions recorded earlier were used.
        """
        packages = (*RECORDED_PACKAGES, *([CONTRIB] if self.algo in CONTRIB_ALGORITHMS else []))
        now = {name: version(name) for name in packages} | {"python": platform.python_version()}
        path = folder / SETTINGS
        kept = read_settings(folder) if path.is_file() else {}
        earlier, last = kept.get("earlier_versions", []), kept.get("versions", now)
        if last != now and isinstance(last, dict):
            names = [name for name in now | last if now.get(name) != last.get(name)]
            changes = ", ".join(f"{name} {now.get(name)} instead of {last.get(name)}" for name in names)
            print(f"Versions since {folder} was written: {changes}; results may differ from here on.", file=sys.stderr)
            earlier = [*earlier, last | {"until_step": done}]
        record = self.plain() | {"versions": now} | ({"earlier_versions": earlier} if earlier else {})
        files.write_atomically(path, lambda file: file.write((json.dumps(record, indent=1) + "\n").encode()))

    def with_seed(self, seed: int) -> Self:
        """Return the same settings with another seed."""
        return replace(self, seed=seed)


def _check(field: str, name: str, value: object, algo: str) -> None:
    """Check a hyperparameter whose wrong value would fail only after the training has started."""
    if name in WHOLE_HYPERPARAMETERS:
        whole_number(field, value, 1 - (name in MAY_BE_ZERO), MAX_STEPS)
    elif name in FRACTION_HYPERPARAMETERS and not positive(field, value) <= 1.0:
        raise value_error(field, value, "a number > 0, at most 1")
    elif name == "learning_rate":
        positive(field, value)
    elif name == "activation":
        one_of(field, value, ACTIVATIONS)
    elif name in ("ortho_init", "critic_norm"):
        flag(field, value)
    elif name == "teacher":
        parse_kind("base", value, BASES)
    elif name == "net_arch":
        keys = NET_ARCH_KEYS.get(algo, ())
        if isinstance(value, dict) and value.keys() != {*keys}:
            allowed = f"a list of widths, or a mapping with {' and '.join(keys)}" if keys else "a list of widths"
            raise value_error(field, value, allowed)
        for part, widths in value.items() if isinstance(value, dict) else (("", value),):
            own = f"{field}.{part}" if part else field
            for i, width in enumerate(sequence(own, widths, "widths of layers")):
                whole_number(f"{own}[{i}]", width, 1, MAX_WIDTH)


RECIPE_FOLDER = Path(__file__).parent / "recipes"
RECIPES = sorted(path.stem for path in RECIPE_FOLDER.glob("*.yaml"))


def find_recipe(name: str) -> Settings:
    """Return the settings of a recipe, given its name or the path of a file."""
    if name in RECIPES:
        return Settings.recipe(RECIPE_FOLDER / f"{name}.yaml")
    if not os.path.isfile(name):  # False for any text
        raise unknown_name("recipe", name, RECIPES, "the path of a file")
    return Settings.recipe(name)
