"""Play the league: all entrants in the same episodes."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from flexman_gym.commands import CommandLine

if TYPE_CHECKING:
    from flexman_gym.league.rows import LeagueRows

FOLDER = Path("out/league")
PHYSICAL = 10  # episodes


def _arguments(result: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    from flexman_gym.common.grid import Workers
    from flexman_gym.evaluation.agent import AGENTS
    from flexman_gym.evaluation.rollout import TEST_SEEDS
    from flexman_gym.league.scenarios import SWEEPS

    result.add_argument("--entrants", nargs="+", help=f"folders of runs, or {', '.join(AGENTS)}; without it these")
    result.add_argument(
        "--environments", nargs="+", help="ids, ids and conditions, or files; without it the usual ones"
    )
    result.add_argument("--sweep", nargs="+", default=[], metavar="NAME", help=f"of {', '.join(SWEEPS)}, instead")
    result.add_argument(
        "--physical", action="store_true", help="other plants instead, see the page; 10 episodes where none are named"
    )
    result.add_argument("--episodes", type=int, help=f"without it {len(TEST_SEEDS)}, or as many as there are")
    result.add_argument("--seed", type=int, default=TEST_SEEDS.start, help="of the first episode; the next follow")
    Workers.arguments(result)
    result.add_argument("--folder", type=Path, default=FOLDER, help="of rows, page and charts; what it has is kept")
    result.add_argument(
        "--add", nargs="+", metavar="RUN", help="play these alone, where the folder's others have played"
    )


def _run(options: argparse.Namespace) -> int:
    """Plays what the folder does not have yet; returns the exit code."""
    from flexman_gym.common.grid import Workers
    from flexman_gym.evaluation.agent import AGENTS
    from flexman_gym.league.page import PAGE, write_page
    from flexman_gym.league.rows import LeagueRows, run_league

    workers = Workers.of(options)
    for name, least in (("episodes", 1), ("seed", 0)):
        given = getattr(options, name)
        if given is not None and given < least:
            options.parser.error(f"--{name}: {given} is not allowed; give a whole number >= {least}")
    entrants = options.add or options.entrants or AGENTS
    for episodes, venues in _scenarios(options, LeagueRows.load(options.folder)).items():
        seeds = range(options.seed, options.seed + episodes)
        book = run_league(entrants, venues, seeds, options.folder, workers, lambda said: print(said, flush=True))
    write_page(book, options.folder)
    print(f"{options.folder / PAGE} has the tables.")
    return 0


def _scenarios(options: argparse.Namespace, book: "LeagueRows") -> dict[int, list[str]]:
    """Numbers of episodes, and the venues in which so many are played."""
    from flexman_gym.envs.config.named_environments import DEFAULT
    from flexman_gym.evaluation.rollout import TEST_SEEDS
    from flexman_gym.league.scenarios import USUAL_SCENARIOS, plant_scenarios, sweep_scenarios

    venues = options.environments or USUAL_SCENARIOS
    episodes = options.episodes or (PHYSICAL if options.physical else len(TEST_SEEDS))
    if options.physical:
        venues = plant_scenarios()
    elif options.sweep:
        venues = [each for id in options.environments or [DEFAULT] for sweep in options.sweep
                  for each in sweep_scenarios(id, sweep)]  # fmt: skip
    elif options.add and not options.environments and book.cells:
        last = {
            venue: max(cell.end for cell in book.cells.values() if cell.venue == venue) for venue, _, _ in book.cells
        }
        groups: dict[int, list[str]] = {}
        for venue, end in last.items():
            groups.setdefault(options.episodes or max(1, end - options.seed), []).append(venue)
        return groups
    return {episodes: [venue.removesuffix("/nominal") for venue in venues]}


COMMAND = CommandLine(_arguments, _run)
