"""Train a policy with PPO, SAC, TQC, CrossQ or DAgger."""

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexman_gym.commands import CommandLine, add_options
from flexman_gym.common.checks import whole_number
from flexman_gym.common.errors import value_error

if TYPE_CHECKING:
    from flexman_agents.settings import Settings
    from flexman_gym.common.parallel import Workers
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.evaluation.rollouts import EpisodeRecord

AGENT_SETTINGS = ("base", "action_repeat", "sensors")  # settings of the agent that a recipe depends on
MAX_RUNS = 1000  # largest number of runs of one command
EXIT_INTERRUPTED = 130  # exit status of a process ended by Ctrl-C, as in a shell


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    from flexman_agents.settings import ALGORITHMS
    from flexman_gym.common.parallel import Workers

    parser.add_argument("recipe", nargs="?", help="recipe (flexman list recipes) or file of settings")
    algorithms = f"{', '.join(ALGORITHMS)} (the recipe's, or ppo)"
    parser.add_argument("--algo", choices=ALGORITHMS, metavar="NAME", help=algorithms)
    add_options(parser, "--env", "--set", env={"help": "environment (flexman list environments) or file"})
    parser.add_argument("--arm", metavar="FILE", help="arm or environment (file) to which the recipe scales")
    parser.add_argument("--keep-worse", action="store_true", help="keep a policy that settles less than its base")
    parser.add_argument("--steps", type=int, metavar="N", help="environment steps, summed over all arms")
    parser.add_argument("--seed", type=int, metavar="N", help="seed of the first run")
    parser.add_argument(
        "--seeds",
        type=int,
        metavar="N",
        default=1,
        help="runs, one per seed, in FOLDER/seed-N, and a table",
    )
    parser.add_argument("--envs", type=int, metavar="N", help="number of parallel arms")
    parser.add_argument(
        "--folder", type=Path, default=Path("runs/latest"), help="folder of the run (default: %(default)s)"
    )
    parser.add_argument("--resume", action="store_true", help="resume the run in the folder")
    parser.add_argument(
        "--checkpoint-every",
        type=int,
        metavar="N",
        default=100_000,
        help="steps between checkpoints; 0: one at the end",
    )
    parser.add_argument("--eval-every", type=int, metavar="N", help="environment steps between evaluations; 0: none")
    parser.add_argument("--device", default="cpu", help="device of the networks (default: %(default)s)")
    Workers.arguments(parser)
    parser.add_argument("--quiet", action="store_true", help="show no progress bar")


def _run(options: argparse.Namespace) -> int:
    """Train or resume; return the exit status."""
    from flexman_agents.callbacks import Interrupted
    from flexman_agents.guard import guard
    from flexman_agents.training import resume
    from flexman_gym.common.run_folder import has_base_as_result, read_settings

    try:
        if options.resume:
            _refuse_settings(options)
        if options.resume and options.keep_worse and options.steps is None and has_base_as_result(options.folder):
            folders = [options.folder]  # a finished run, of which only the result changes
        elif options.resume:
            resume(options.folder, options.steps, eval_every=options.eval_every, **_training_options(options))
            folders = [options.folder]
        else:
            folders = _train_runs(options)
    except Interrupted as stop:
        command = "the same command" if options.seeds > 1 else f"flexman train --resume --folder {options.folder}"
        print(f"{stop}; to resume: {command}", file=sys.stderr)
        return EXIT_INTERRUPTED
    except KeyboardInterrupt:
        print("Interrupted; the last checkpoint remains.", file=sys.stderr)
        return EXIT_INTERRUPTED
    for each in folders:
        if report := guard(each, options.keep_worse):
            print(report if len(folders) == 1 else f"{each}: {report}")
    if len(folders) == 1:
        base = read_settings(folders[0])["environment"].get("base")
        other = base if isinstance(base, str) else "pd"
        print(f"The run is in {folders[0]}; to evaluate it: flexman evaluate {folders[0]} {other}")
    return 0


def _refuse_settings(options: argparse.Namespace) -> None:
    """Raise ValueError for settings together with --resume: a resumed run keeps its settings."""
    for name in ("recipe", "algo", "env", "arm", "set", "seed", "envs"):
        if getattr(options, name, None) not in (None, []):
            raise value_error(name, getattr(options, name), "no value with --resume: a run keeps its settings")
    if options.seeds != 1:
        raise value_error("seeds", options.seeds, "1 with --resume; without it, killed runs of seeds are resumed")


def _warn_of_missing_settings(recipe: Mapping[str, Any], own: Mapping[str, Any], env: str) -> None:
    """Warn of settings of the agent in a recipe that the given environment lacks."""
    missing = [f"{name}: {recipe[name]}" for name in AGENT_SETTINGS if name in recipe and name not in own]
    if missing:
        print(f"{env} lacks settings of the recipe: {', '.join(missing)}", file=sys.stderr)


def _warn_of_replaced_settings(arm: str, chosen: Mapping[str, Any]) -> None:
    """Warn of settings of the agent in the file of an environment in whose place are those of the recipe."""
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.evaluation.agent_spec import INTERFACE

    found = Configuration.of_file(arm)
    replaced = [name for name in INTERFACE if found and found.given.get(name, chosen.get(name)) != chosen.get(name)]
    if replaced:
        print(f"{arm}: the recipe replaces {', '.join(replaced)}; --set NAME=VALUE keeps a value", file=sys.stderr)


def _training_options(options: argparse.Namespace) -> dict[str, Any]:
    """Return the options common to new and resumed runs."""
    return {"checkpoint_every": options.checkpoint_every, "progress": not options.quiet, "device": options.device}


def _make_settings(options: argparse.Namespace) -> "Settings":
    """Return the settings of the recipe, changed by the command line."""
    from flexman_agents.own_arm import fit_to_arm
    from flexman_agents.settings import Settings, find_recipe
    from flexman_gym.envs.config.configuration import Configuration

    settings = find_recipe(options.recipe) if options.recipe else Settings()
    named = {name: getattr(options, name) for name in ("algo", "steps", "seed", "envs", "eval_every")}
    named = {name: value for name, value in named.items() if value is not None}
    if options.algo and options.algo != settings.algo:
        settings = Settings(algo=options.algo, environment=settings.environment, seed=settings.seed)
    if teacher := getattr(options, "teacher", None):
        named["hyperparameters"] = {**settings.hyperparameters, "teacher": teacher}
    of_recipe, arm = settings.environment, getattr(options, "arm", None)
    if options.env:
        settings = replace(settings, environment=Configuration.find(options.env, () if arm else options.set))
    elif not arm:
        settings = replace(settings, environment=settings.environment.changed(options.set))
    if arm:
        settings = fit_to_arm(settings, arm, options.set)
        _warn_of_replaced_settings(arm, settings.environment.given)
    if options.env and options.recipe:
        _warn_of_missing_settings(of_recipe.given, settings.environment.given, options.env)
    return replace(settings, **named)


def _train_runs(options: argparse.Namespace) -> list[Path]:
    """Train one run for each seed and, for several seeds, print a table of the runs; return their folders."""
    from flexman_agents.training import train, train_or_resume
    from flexman_gym.common.parallel import Workers, parallel_map
    from flexman_gym.envs.vector_env import compile_kernels

    settings, keywords = _make_settings(options), _training_options(options)
    if whole_number("seeds", options.seeds, 1, MAX_RUNS) == 1:
        train(settings, options.folder, **keywords)
        return [options.folder]
    workers, seeds = Workers.of(options), range(settings.seed, settings.seed + options.seeds)
    if workers != Workers():
        keywords |= {"progress": False}  # progress bars of parallel runs would overwrite each other
    cells = [(settings.with_seed(seed), str(options.folder / f"seed-{seed}"), keywords) for seed in seeds]
    for each, folder, _ in cells:
        each.check_run(Path(folder))  # before hours of training, rather than at the turn of its seed
    folders = parallel_map(train_or_resume, cells, workers, prepare=compile_kernels)
    _print_table(folders, workers)
    return [Path(folder) for folder in folders]


def _print_table(folders: Sequence[str], workers: "Workers") -> None:
    """Print the metrics of the runs in the test episodes, and the metrics over all runs."""
    from flexman_gym.common.parallel import parallel_map
    from flexman_gym.evaluation.agents import common_environment, find_agent
    from flexman_gym.evaluation.tables import metrics_table

    environment = common_environment([find_agent(folder) for folder in folders])
    results = parallel_map(_test_records, [(folder, environment) for folder in folders], workers)
    print(metrics_table(dict(zip(folders, results, strict=True)), environment, all_seeds=True))


def _test_records(cell: "tuple[str, Configuration]") -> "Sequence[EpisodeRecord]":
    """Return the records of the test episodes of a run; a task for `parallel_map`.

    Args:
        cell: folder of the run, and environment of the episodes.
    """
    from flexman_gym.evaluation.rollouts import TEST_SEEDS, rollout

    return rollout(*cell, TEST_SEEDS).records


EXAMPLES = (
    "flexman train ppo_on_pd_minute --folder runs/first  # 1.5 minutes",
    "flexman train --resume --folder runs/first --steps 300000",
    "flexman train planar_ppo_on_pd --seeds 2 --folder runs/two",
)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)
