"""Train PPO or SAC on a flexible arm; the run is kept in a folder."""

import argparse
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexman_gym.commands import CommandLine, add_options
from flexman_gym.common.checks import value_error

if TYPE_CHECKING:
    from flexman_agents.settings import Settings

AGENT_SETTINGS = ("base", "action_repeat", "sensors")  # settings of an environment without which a recipe learns little
EXIT_INTERRUPTED = 130  # what a shell says of a process that Ctrl-C has ended


def _arguments(result: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    from flexman_agents.settings import ALGORITHMS
    from flexman_gym.common.parallel import Workers

    result.add_argument("recipe", nargs="?", help="a file of settings, or a name: flexman list recipes")
    words = f"{', '.join(ALGORITHMS)}; without it the recipe's, or ppo"
    result.add_argument("--algo", choices=ALGORITHMS, metavar="NAME", help=words)
    add_options(result, "--env", "--set", env={"help": "a file, or a name: flexman list environments"})
    result.add_argument("--steps", type=int, help="actions of all arms together; with --resume more")
    result.add_argument("--seed", type=int, help="of the first run")
    result.add_argument("--seeds", type=int, default=1, help="so many runs; killed ones go on")
    result.add_argument("--envs", type=int, help="arms side by side")
    result.add_argument("--folder", type=Path, default=Path("runs/latest"))
    result.add_argument("--resume", action="store_true", help="go on with the run in the folder")
    result.add_argument("--checkpoint-every", type=int, metavar="N", default=100_000, help="steps; 0: only at the end")
    result.add_argument("--judge-every", type=int, metavar="N", help="steps between evaluations; 0: none")
    result.add_argument("--device", default="cpu", help="of the networks, as PyTorch names it")
    result.add_argument("--engine", choices=("sb3", "rllib"), default="sb3", help="Stable-Baselines3, or RLlib for PPO")
    result.add_argument("--runners", type=int, default=0, help="processes of RLlib that roll out")
    Workers.arguments(result)
    result.add_argument("--quiet", action="store_true", help="no progress bar")


def _run(options: argparse.Namespace) -> int:
    """Train or resume; return the exit status."""
    from flexman_agents.callbacks import Interrupted
    from flexman_agents.training import resume

    try:
        if options.resume:
            _refuse_settings(options)
        if options.engine == "rllib":
            folders = [_train_with_rllib(options)]
        elif options.resume:
            resume(options.folder, options.steps, judge_every=options.judge_every, **_training_options(options))
            folders = [options.folder]
        else:
            folders = _train_runs(options)
    except Interrupted as stop:
        print(f"{stop}; go on with: flexman train --resume --folder {options.folder}", file=sys.stderr)
        return EXIT_INTERRUPTED
    except KeyboardInterrupt:
        print("Interrupted; what was saved before stays.", file=sys.stderr)
        return EXIT_INTERRUPTED
    for folder in folders:
        print(f"The run is in {folder}; see it with: flexman evaluate {folder} pd")
    return 0


def _refuse_settings(options: argparse.Namespace) -> None:
    """Raise ValueError for settings given with --resume, which the run has already."""
    for name in ("recipe", "algo", "env", "set", "seed", "envs"):
        if getattr(options, name) not in (None, []):
            raise value_error(name, getattr(options, name), "nothing with --resume: the run keeps its settings")


def _warn_of_missing_settings(recipe: Mapping[str, Any], own: Mapping[str, Any], env: str) -> None:
    """Print the settings of a recipe for the agent that an environment in its place does not have."""
    lost = [f"{name}: {recipe[name]}" for name in AGENT_SETTINGS if name in recipe and name not in own]
    if lost:
        print(f"{env} does not have what the recipe learned with: {', '.join(lost)}", file=sys.stderr)


def _train_with_rllib(options: argparse.Namespace) -> Path:
    """Train or resume one run with RLlib; return its folder."""
    try:
        from flexman_agents.rllib import train_rllib
    except ImportError as error:
        said = "training with RLlib needs packages of its own: pip install -r requirements-rllib.txt"
        raise ImportError(f"{said} ({error})") from None
    from flexman_agents.training import load_settings

    if options.seeds != 1:
        raise value_error("seeds", options.seeds, "1 with RLlib")
    settings = load_settings(options.folder) if options.resume else _make_settings(options)
    train_rllib(settings, options.folder, options.runners, options.checkpoint_every, options.resume)
    return Path(options.folder)


def _training_options(options: argparse.Namespace) -> dict[str, Any]:
    """Return the options that a new and a resumed run have in common."""
    return {"checkpoint_every": options.checkpoint_every, "progress": not options.quiet, "device": options.device}


def _make_settings(options: argparse.Namespace) -> "Settings":
    """Return the settings of the recipe, changed by the command line."""
    from flexman_agents.settings import Settings, find_recipe
    from flexman_gym.envs.config.configuration import Configuration

    settings = find_recipe(options.recipe) if options.recipe else Settings()
    named = {name: getattr(options, name) for name in ("algo", "steps", "seed", "envs", "judge_every")}
    named = {name: value for name, value in named.items() if value is not None}
    if options.algo and options.algo != settings.algo:
        settings = Settings(algo=options.algo, environment=settings.environment, seed=settings.seed)
    if teacher := getattr(options, "teacher", None):
        named["hyperparameters"] = {**settings.hyperparameters, "teacher": teacher}
    if options.env:
        environment = Configuration.find(options.env, options.set)
        if options.recipe:
            _warn_of_missing_settings(settings.environment.settings, environment.settings, options.env)
    else:
        environment = settings.environment.changed(options.set)
    return replace(settings, environment=environment, **named)


def _train_runs(options: argparse.Namespace) -> list[Path]:
    """Train one run for each seed; return their folders."""
    from flexman_agents.training import train, train_or_resume
    from flexman_gym.common.parallel import Workers, parallel_map
    from flexman_gym.envs.vector_env import compile_kernels

    settings, how = _make_settings(options), _training_options(options)
    if options.seeds == 1:
        train(settings, options.folder, **how)
        return [options.folder]
    workers, seeds = Workers.of(options), range(settings.seed, settings.seed + options.seeds)
    if workers != Workers():
        how |= {"progress": False}  # bars of several runs would be one tangle
    cells = [(settings.with_seed(seed), str(options.folder / f"seed-{seed}"), how) for seed in seeds]
    return [Path(folder) for folder in parallel_map(train_or_resume, cells, workers, prepare=compile_kernels)]


COMMAND = CommandLine(_arguments, _run)
