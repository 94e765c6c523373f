"""Results of agents on the test episodes, each from one stored row, so that all pages print the same number."""

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from flexman_gym.envs.config.named_environments import DEFAULT_ID, NAMED_ENVIRONMENTS
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.toolbox.league.rows import LeagueRows
from flexman_gym.toolbox.league.standings import Standings
from studies.environments.measure import BASELINES, LONG_NAME, SHAPED, Baseline, baselines_of
from studies.files import read_rows

DOCS = Path(__file__).parents[2] / "docs"
LEAGUE, BASELINE_FILE = "league", "environments/baselines.csv"  # below the folder of the documentation
SHOWN = ("settled", "settling_time", "vibration", "rms_error", "failed")  # metrics of a `Baseline`


class Results:
    """Rows of the league and, for environments that it does not have, of the baselines of the environments.

    Args:
        docs: folder of the documentation.
        baselines: rows of the baselines; None for those of the documentation.
    """

    def __init__(self, docs: Path = DOCS, baselines: Sequence[Baseline] | None = None) -> None:
        self._docs, self._given = docs, baselines

    @cached_property
    def standings(self) -> Standings:
        """Comparison of the agents of the league."""
        return Standings(LeagueRows.load(self._docs / LEAGUE))

    @cached_property
    def _measured(self) -> dict[tuple[str, str], Baseline]:
        rows = read_rows(self._docs / BASELINE_FILE, Baseline) if self._given is None else self._given
        return {(row.environment, row.baseline): row for row in rows}

    @property
    def long(self) -> Baseline:
        """Row of the PD of FlexRRR-v0 in longer episodes."""
        return self._measured[DEFAULT_ID, LONG_NAME]

    def find(self, agent: str, scenario: str) -> Baseline | None:
        """Return the metrics of an agent in a scenario, as those of a baseline; None without rows."""
        values = {name: [*self.standings.values(agent, scenario, name).values()] for name in SHOWN}
        if episodes := len(values[SHOWN[0]]):
            metrics = {name: METRICS[name].aggregate(np.array(each)) for name, each in values.items()}
            return Baseline(scenario, agent, **metrics, episodes=episodes)
        names = [name for name, each in (BASELINES | {SHAPED: "pd-shaped"}).items() if each == agent]
        return self._measured.get((scenario, names[0])) if names else None

    def baselines(self) -> list[Baseline]:
        """Return the rows of the baselines of all named environments that have rows."""
        rows = []
        for name in NAMED_ENVIRONMENTS:
            found = {baseline: self.find(agent, name) for baseline, agent in baselines_of(name).items()}
            rows += [Baseline(**vars(row) | {"baseline": baseline}) for baseline, row in found.items() if row]
            rows += [row for (where, _), row in self._measured.items() if where.startswith(f"{name}/")]
            rows += [self.long] if name == DEFAULT_ID else []
        return rows
