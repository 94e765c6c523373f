"""Evaluate policies and controllers on the same episodes."""

import argparse
import sys

from flexman_gym.commands import CommandLine, add_options, load_agent, name_unused, output_folder


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    add_options(parser, "agent", "--episodes", "--seed", "--env", "--set", "--trust", "--json", agent={"nargs": "+"})
    parser.add_argument(
        "--save", type=output_folder, metavar="FOLDER", help="save each episode in this folder, as a file of arrays"
    )


def _run(options: argparse.Namespace) -> int:
    """Print one table or JSON document of all agents; return 0, or 2 if an agent is left out."""
    from flexman_gym.common.formatting import json_text
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.evaluation.agents import common_environment
    from flexman_gym.evaluation.metrics import all_metrics, median_intervals
    from flexman_gym.evaluation.rollouts import rollout, save_rollouts
    from flexman_gym.evaluation.tables import metrics_table

    if options.episodes < 1:
        options.parser.error(f"--episodes: {options.episodes} is not allowed; give a whole number > 0")
    named = Configuration.find(options.env) if options.env else None
    agents = {name: load_agent(name, options.trust, named) for name in options.agent}
    environment = common_environment(list(agents.values()), named, options.set)
    name_unused(options.env, named, environment, agents.values())
    seeds = range(options.seed, options.seed + options.episodes)
    results, errors = {}, list[Exception]()
    for name, each in agents.items():
        try:
            results[name] = rollout(each, environment, seeds)
        except (ImportError, ValueError) as error:
            errors.append(error)
            if len(agents) > 1:
                print(f"{name} is left out: {error}", file=sys.stderr)
    if not results:
        raise errors[0]
    records = {name: each.records for name, each in results.items()}
    if options.json:
        metrics = {name: all_metrics(each) | {"intervals": median_intervals(each)} for name, each in records.items()}
        about = {"environment": environment.to_plain(), "seed": options.seed, "episodes": options.episodes}
        print(json_text(about | {"agents": metrics}))
    else:
        print(metrics_table(records, environment, name=options.env if options.env and not options.set else ""))
    if options.save is not None:
        files = save_rollouts([*results.values()], options.save)
        print(
            f"{len(files)} episodes are in {options.save}; to watch: flexman replay {files[0]} --out page.html",
            file=sys.stderr if options.json else sys.stdout,
        )
    return 2 * bool(errors)


EXAMPLES = (
    "flexman evaluate pd lqr-tracking --env FlexOne-v0  # 100 episodes",
    "flexman evaluate lab-flexrrr --env FlexRRR-v0/delay --episodes 5",
    "flexman evaluate pd --env FlexOne-v0 --episodes 2 --save episodes",
    "flexman evaluate lqr --env FlexOne-v0 --json | python3 -m json.tool",
)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)
