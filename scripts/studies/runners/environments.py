"""Pages of the named environments, with pictures and the metrics of baselines that the league does not have."""

from argparse import Namespace
from collections.abc import Mapping, Sequence
from functools import partial

from flexman_gym.envs.config.named_environments import DEFAULT_ID, NAMED_ENVIRONMENTS
from flexman_gym.toolbox.league.scenarios import USUAL_SCENARIOS
from studies.environments.family import FAMILIES, Family, family_page
from studies.environments.gallery import gallery_page, tasks_page
from studies.environments.measure import (
    LONG,
    LONG_NAME,
    SEEDS,
    Baseline,
    ModelError,
    baseline_rows,
    baselines_of,
    condition_rows,
    draw,
    model_error,
    run,
)
from studies.environments.rewards import draw_rewards
from studies.results import Results
from studies.study import Study, Table


def measure(options: Namespace) -> tuple[list[Baseline], list[ModelError]]:
    """Draw the pictures of all environments, and return the metrics of baselines and the errors of default models."""
    baselines, errors = [], []
    for name in NAMED_ENVIRONMENTS:
        known = name in USUAL_SCENARIOS  # of the league; one episode is enough for the pictures
        runs = {
            each: run(name, agent, seeds=SEEDS[:1] if known else SEEDS) for each, agent in baselines_of(name).items()
        }
        draw(runs, options.folder / name)
        baselines += [] if known else baseline_rows(name, runs)
        baselines += baseline_rows(name, {LONG_NAME: run(name, "pd", LONG)}) if name == DEFAULT_ID else []
        baselines += condition_rows(name)
        errors.append(model_error(name))
    return baselines, errors


def _gallery(rows: Sequence[Baseline], _: Sequence[ModelError], __: Mapping[str, str]) -> str:
    return gallery_page(Results(baselines=rows).baselines())


def _family(family: Family, rows: Sequence[Baseline], errors: Sequence[ModelError], _: Mapping[str, str]) -> str:
    return family_page(family, Results(baselines=rows).baselines(), errors)


RUNNER = Study(
    tables=(Table("baselines", Baseline), Table("model_errors", ModelError)),
    measure=measure,
    pages={"index.md": _gallery, "tasks.md": lambda *_: tasks_page()}
    | {f"{family.file}.md": partial(_family, family) for family in FAMILIES},
    charts=lambda folder, *_: draw_rewards(folder),
)
