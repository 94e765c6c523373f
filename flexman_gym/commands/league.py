"""Compare agents over many scenarios in a league table.

All agents run the same episodes. Rows, page and charts are written to a folder; stored rows are not run again.
With --agent, a policy is tested under other physics, parameters, delays and noise instead: its certificate is written
to its folder, and the exit status is 1 if the policy exceeds a limit.
"""

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexman_gym.commands import CommandLine, add_options, agent_name, output_folder
from flexman_gym.common.formatting import json_text

if TYPE_CHECKING:
    from flexman_gym.common.parallel import Workers
    from flexman_gym.toolbox.league.rows import LeagueRows
    from flexman_gym.toolbox.league.standings import Standings

DEFAULT_FOLDER = Path("out/league")
PHYSICAL_EPISODES = 10  # episodes per scenario with --physical


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    from flexman_gym.common.parallel import Workers
    from flexman_gym.evaluation.rollouts import TEST_SEEDS
    from flexman_gym.toolbox.league.scenarios import SWEEPS

    parser.add_argument(
        "--agents", nargs="+", metavar="AGENT",
        help="folders of runs, Python files with a controller, or names of controllers and policies (default: all of "
        "flexman list, zero and random; in sweeps and with other physics those of the page)",
    )  # fmt: skip
    parser.add_argument(
        "--scenarios", nargs="+",
        metavar="SCENARIO", help="environments with a condition or a change, such as FlexRRR-v0/delay=3+given "
        "(default: the usual ones)",
    )  # fmt: skip
    parser.add_argument("--agent", metavar="NAME", help="certify an exported policy, by its name or folder")
    parser.add_argument(
        "--sweep", nargs="+", default=[], metavar="NAME", help=f"run sweeps of {', '.join(SWEEPS)} instead"
    )
    parser.add_argument(
        "--physical", action="store_true", help="run plants with other physics instead, 10 episodes each"
    )
    parser.add_argument("--episodes", type=int, metavar="N", help=f"episodes per scenario (default: {len(TEST_SEEDS)})")
    parser.add_argument(
        "--seed",
        type=int,
        metavar="N",
        default=TEST_SEEDS.start,
        help="seed of the first episode",
    )
    add_options(parser, "--json")
    parser.add_argument("--quiet", action="store_true", help="print the results without the progress of the runs")
    Workers.arguments(parser)
    about = f"folder of rows, page and charts (default: {DEFAULT_FOLDER})"
    parser.add_argument("--folder", type=output_folder, help=about)
    parser.add_argument("--redraw", action="store_true", help="write page and charts of the folder without any run")
    parser.add_argument(
        "--details", nargs="+", metavar="NAME",
        help="stored metrics of scenarios, agents, sweeps, or overall",
    )  # fmt: skip
    parser.add_argument("--add", nargs="+", metavar="AGENT", help="run these agents in the scenarios of the folder")


def _run(options: argparse.Namespace) -> int:
    """Run the missing episodes of the league and write its page; return the exit status."""
    from flexman_gym.common.computer import computer_text
    from flexman_gym.common.parallel import Workers
    from flexman_gym.evaluation.trained_agents import AGENTS
    from flexman_gym.toolbox.league.details import league_details
    from flexman_gym.toolbox.league.page import PAGE, write_page
    from flexman_gym.toolbox.league.rows import LeagueRows, run_league
    from flexman_gym.toolbox.league.standings import SWEPT_AGENTS, Standings

    workers = Workers.of(options)
    for name, minimum in (("episodes", 1), ("seed", 0)):
        given = getattr(options, name)
        if given is not None and given < minimum:
            options.parser.error(f"--{name}: {given} is not allowed; give a whole number >= {minimum}")
    if options.agent:
        return _certify(options, workers)
    usual = SWEPT_AGENTS if options.sweep or options.physical else AGENTS
    agents = [agent_name(each) for each in options.add or options.agents or usual]
    folder = options.folder or DEFAULT_FOLDER
    results = LeagueRows.load(folder)
    if (options.redraw or options.details) and not results.cells:
        options.parser.error(f"--folder: {folder} is not allowed; give the folder of a league with rows")
    if options.details:
        if options.json:
            options.parser.error("--json: a table of --details has none; leave one of both out")
        print("\n\n".join("\n".join(league_details(Standings(results), agent_name(name))) for name in options.details))
        return 0
    groups = {} if options.redraw else _scenarios(options, results)
    for episodes, scenarios in groups.items():
        seeds = range(options.seed, options.seed + episodes)
        results = run_league(agents, scenarios, seeds, folder, workers, _progress(options))
    names = [name for scenarios in groups.values() for name in scenarios] or Standings(results).scenarios
    standings = Standings(results)
    write_page(results, folder, None if options.redraw else computer_text())
    if options.json:
        print(json_text({"page": str(folder / PAGE), "agents": _results(standings, names)}))
        return 0
    table = standings.settling_table(standings.agents, names, ["agent", *names])
    print("\n".join([*table, f"{folder / PAGE} has the results."]))
    return 0


def _progress(options: argparse.Namespace) -> Callable[[str], None]:
    """Return the function that prints a line of progress: on stderr with --json, nowhere with --quiet."""
    stream = sys.stderr if options.json else sys.stdout
    return lambda line: None if options.quiet else print(line, file=stream, flush=True)


def _results(standings: "Standings", scenarios: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return agent -> its overall score, and its share of settled episodes and median settling time by scenario."""
    results: dict[str, dict[str, Any]] = {}
    for agent in standings.agents:
        score, low, high = standings.overall[agent]
        results[agent] = {"score": score, "interval": (low, high), "scenarios": {}}
        for name in scenarios:
            if why := standings.why(agent, name):
                results[agent]["scenarios"][name] = {"no row": why}
                continue
            settled, time = standings.settled(agent, name)
            own = standings.score(agent, name)
            values = {"settled": settled, "settling_time": -time, "score": own and own[0]}
            results[agent]["scenarios"][name] = values
    return results


def _certify(options: argparse.Namespace, workers: "Workers") -> int:
    """Write the certificate of a policy and print its rows; return 0, or 1 if the policy exceeds a limit."""
    from flexman_gym.toolbox.league.certificate import certify

    path = certify(options.agent, jobs=workers, log=_progress(options))
    text = path.read_text(encoding="utf-8")
    fails = json.loads(text)["fails"]
    verdict = f"{path}: {'beyond its limits in ' + ', '.join(fails) if fails else 'within all limits'}"
    print(text.rstrip() if options.json else verdict)
    return 1 if fails else 0


def _scenarios(options: argparse.Namespace, results: "LeagueRows") -> dict[int, list[str]]:
    """Return number of episodes -> names of the scenarios that run this number of episodes."""
    from flexman_gym.common.checks import one_of
    from flexman_gym.envs.config.named_environments import DEFAULT_ID
    from flexman_gym.evaluation.rollouts import TEST_SEEDS
    from flexman_gym.toolbox.league.scenarios import PLANT_SCENARIOS, SWEEPS, USUAL_SCENARIOS

    scenarios = options.scenarios or USUAL_SCENARIOS
    episodes = options.episodes or (PHYSICAL_EPISODES if options.physical else len(TEST_SEEDS))
    if options.physical:
        scenarios = PLANT_SCENARIOS
    elif options.sweep:
        sweeps = {name: SWEEPS[one_of("sweep", name, SWEEPS)].values for name in options.sweep}
        scenarios = [f"{id}/{name}={value:g}" for id in options.scenarios or [DEFAULT_ID]
                     for name, values in sweeps.items() for value in values]  # fmt: skip
    elif options.add and not options.scenarios and results.cells:
        last: dict[str, int] = {}
        for cell in results.cells.values():
            last[cell.scenario] = max(cell.end, last.get(cell.scenario, 0))
        groups: dict[int, list[str]] = {}
        for scenario, end in last.items():
            groups.setdefault(options.episodes or max(1, end - options.seed), []).append(scenario)
        return groups
    return {episodes: [scenario.removesuffix("/nominal") for scenario in scenarios]}


EXAMPLES = (
    "flexman league --agents zero pd lqr --scenarios FlexOne-v0 --episodes 10",
    "flexman league --add lqr-tracking  # in the same scenarios",
    "flexman league --redraw --json | python3 -m json.tool",
)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)
