"""Play the league: all entrants in the same episodes, as rows, a page of tables, and charts."""

import argparse
from pathlib import Path

FOLDER = Path("out/league")


def arguments(result: argparse.ArgumentParser) -> None:
    """Says what it takes."""
    from flexman_gym.evaluation.entrants import BASELINES
    from flexman_gym.evaluation.seeds import TEST
    from flexman_gym.evaluation.venues import SWEEPS

    result.add_argument("--entrants", nargs="+", help=f"folders of runs, or {', '.join(BASELINES)}; without it these")
    result.add_argument(
        "--environments", nargs="+", help="ids, ids and conditions, or files; without it the usual ones"
    )
    result.add_argument("--sweep", nargs="+", default=[], metavar="NAME", help=f"of {', '.join(SWEEPS)}, instead")
    result.add_argument("--episodes", type=int, default=len(TEST))
    result.add_argument("--seed", type=int, default=TEST.start, help="of the first episode; the next follow")
    result.add_argument("--jobs", type=int, default=1, help="processes")
    result.add_argument("--folder", type=Path, default=FOLDER, help="of rows, page and charts; what it has is kept")
    result.add_argument(
        "--add", nargs="+", metavar="RUN", help="play these alone, where the folder's others have played"
    )


def run(options: argparse.Namespace) -> int:
    """Plays what the folder does not have yet; returns the exit code."""
    from flexman_gym.envs.catalog import DEFAULT
    from flexman_gym.evaluation.entrants import BASELINES
    from flexman_gym.evaluation.league import Book, play_league
    from flexman_gym.evaluation.league_page import PAGE, write_page
    from flexman_gym.evaluation.venues import USUAL, sweep_names

    for name, least in (("episodes", 1), ("jobs", 1), ("seed", 0)):
        if getattr(options, name) < least:
            options.parser.error(f"--{name}: {getattr(options, name)} is not allowed; give a whole number >= {least}")
    venues = options.environments or USUAL
    if options.sweep:
        venues = [each for id in options.environments or [DEFAULT] for sweep in options.sweep
                  for each in sweep_names(id, sweep)]  # fmt: skip
    elif options.add and not options.environments:
        venues = list(dict.fromkeys(venue for venue, _, _ in Book.load(options.folder).cells)) or venues
    venues = [venue.removesuffix("/nominal") for venue in venues]
    seeds = range(options.seed, options.seed + options.episodes)
    entrants = options.add or options.entrants or BASELINES
    book = play_league(entrants, venues, seeds, options.folder, options.jobs, lambda said: print(said, flush=True))
    write_page(book, options.folder)
    print(f"{options.folder / PAGE} has the tables.")
    return 0
