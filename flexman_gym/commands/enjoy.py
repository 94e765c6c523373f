"""Run one episode of an agent, print its metrics and plot it."""

import argparse
from importlib.util import find_spec
from pathlib import Path

from flexman_gym.commands import CommandLine, add_options, load_agent


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    add_options(
        parser, "agent", "--env", "--seed", "--trust", seed={"help": "seed of the episode (default: %(default)s)"}
    )
    parser.add_argument(
        "--picture",
        type=Path,
        metavar="FILE",
        default=Path("out/episode.png"),
        help="plot of tip error and torques (default: %(default)s)",
    )


def _run(options: argparse.Namespace) -> int:
    """Run one episode, print its metrics and draw it; return 0."""
    from flexman_gym.draw.trajectories import draw_episodes
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.evaluation import rollout
    from flexman_gym.evaluation.agent import common_environment
    from flexman_gym.evaluation.metrics import task_metrics

    named = Configuration.find(options.env) if options.env else None
    agent = load_agent(options.agent, options.trust, named)
    environment = common_environment([agent], named)
    (record,) = rollout(agent, environment, [options.seed]).records
    seconds = record.period * len(record.actions)
    print(
        f"{options.agent} on {environment.id}, seed {options.seed}: "
        f"{record.failure or f'{seconds:g} s without failure'}"
    )
    for metric in task_metrics(environment.task):
        print(f"  {metric.header:<14}{metric.scale * metric.function(record):.3g}")
    if find_spec("matplotlib"):
        draw_episodes({options.agent: record}, options.picture)
        print(f"{options.picture} shows the tip error and the torques.")
    return 0


COMMAND = CommandLine(_arguments, _run)
