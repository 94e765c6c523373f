"""Write the pages of the named environments.

The metrics of the baselines in environments that the league does not have are written to baselines.csv, and the errors
of the default models to model_errors.csv; --redraw writes the pages from these rows and those of the league without a
simulation.
"""

import argparse
from pathlib import Path

from flexman_gym.envs.config.named_environments import DEFAULT_ID, NAMED_ENVIRONMENTS
from flexman_gym.toolbox.league.scenarios import USUAL_SCENARIOS
from studies.environments.family import FAMILIES, family_page
from studies.environments.gallery import gallery_page, tasks_page
from studies.environments.measure import (
    BASELINES,
    LONG,
    LONG_NAME,
    SEEDS,
    ModelError,
    baseline_rows,
    draw,
    model_error,
    run,
)
from studies.files import folder, read_rows, write_rows
from studies.results import Results

BASELINE_FILE, ERROR_FILE = "baselines.csv", "model_errors.csv"


def main() -> None:
    """Run the baselines and write rows, pictures and pages."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=folder, default="out/environments", help="output folder")
    parser.add_argument("--redraw", action="store_true", help="write only the pages, from the rows in the folder")
    options = parser.parse_args()
    if not options.redraw:
        measure(options.folder)
    baselines = Results(baselines=options.folder / BASELINE_FILE).baselines()
    errors = read_rows(options.folder / ERROR_FILE, ModelError)
    (options.folder / "index.md").write_text(gallery_page(baselines), encoding="utf-8")
    (options.folder / "tasks.md").write_text(tasks_page(), encoding="utf-8")
    for family in FAMILIES:
        text = family_page(family, baselines, errors)
        (options.folder / f"{family.file}.md").write_text(text, encoding="utf-8")


def measure(target: Path) -> None:
    """Write the rows and the pictures of all environments to a folder."""
    baselines, errors = [], []
    for name in NAMED_ENVIRONMENTS:
        known = name in USUAL_SCENARIOS  # of the league; one episode is enough for the pictures
        runs = {each: run(name, agent, seeds=SEEDS[:1] if known else SEEDS) for each, agent in BASELINES.items()}
        draw(runs, target / name)
        new = [] if known else baseline_rows(name, runs)
        new += baseline_rows(name, {LONG_NAME: run(name, "pd", LONG)}) if name == DEFAULT_ID else []
        baselines += new
        errors.append(model_error(name))
        print(name, *new, errors[-1], sep="\n", flush=True)
    write_rows(baselines, target / BASELINE_FILE)
    write_rows(errors, target / ERROR_FILE)


if __name__ == "__main__":
    main()
