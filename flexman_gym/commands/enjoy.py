"""Enjoy an episode of a policy: its figures, and a picture."""

import argparse
from importlib.util import find_spec
from pathlib import Path

from flexman_gym.commands import CommandLine, add_options, load_agent


def _arguments(result: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    add_options(result, "entrant", "--env", "--seed", "--trust", seed={"help": "of the episode"})
    result.add_argument("--picture", type=Path, default=Path("out/episode.png"), help="of error and torques")


def _run(options: argparse.Namespace) -> int:
    """Run one episode, print its metrics and draw it; return 0."""
    from flexman_gym.draw.trajectories import draw_episodes
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.evaluation import rollout
    from flexman_gym.evaluation.agent import common_environment
    from flexman_gym.evaluation.metrics import task_metrics

    named = Configuration.find(options.env) if options.env else None
    player = load_agent(options.entrant, options.trust, named)
    environment = common_environment([player], named)
    (record,) = rollout(player, environment, [options.seed]).records
    seconds = record.period * len(record.actions)
    print(
        f"{options.entrant} on {environment.id}, seed {options.seed}: {record.failure or f'played for {seconds:g} s'}"
    )
    for metric in task_metrics(environment.task):
        print(f"  {metric.header:<14}{metric.scale * metric.function(record):.3g}")
    if find_spec("matplotlib"):
        draw_episodes({options.entrant: record}, options.picture)
        print(f"{options.picture} shows the distance of the tip from its target, and the torques.")
    return 0


COMMAND = CommandLine(_arguments, _run)
