"""Standings: scores, settled shares, comparisons and costs of the agents of a league."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.formatting import number_text, text_table
from flexman_gym.evaluation.agent_info import describe_agent
from flexman_gym.evaluation.agent_spec import SIMPLE_AGENTS
from flexman_gym.metrics import (
    improvements,
    interquartile_mean,
    mean,
    normalised_scores,
    paired_score,
    stratified_interval,
)
from flexman_gym.toolbox.league.rows import REFERENCE_AGENTS, VALUES, EpisodeRow, LeagueRows
from flexman_gym.toolbox.league.scenarios import GIVEN, LAB_SCENARIO, PLANTS, SWEEPS, USUAL_SCENARIOS, find_scenario

SWEPT_AGENTS = ("privileged-lqr", "lab-flexrrr", "adaptive-lqr", "lqg", "pd-torque")  # agents of the sweeps, if run
Interval = tuple[float, float, float]  # estimate, and the ends of its bootstrap interval


@dataclass(frozen=True)
class Standings:
    """Comparison of the agents of a league.

    Attributes:
        results: rows and cells of the league.
    """

    results: LeagueRows

    @cached_property
    def scenarios(self) -> list[str]:
        """Names of the scenarios that belong to no sweep and no other plant; USUAL_SCENARIOS come first."""
        names = dict.fromkeys(scenario for scenario, _, _ in self.results.cells if not {"=", "@"} & set(scenario))
        return [
            *(each for each in USUAL_SCENARIOS if each in names),
            *(each for each in names if each not in USUAL_SCENARIOS),
        ]

    @cached_property
    def sweeps(self) -> dict[str, dict[str, float]]:
        """Sweep, such as "FlexRRR-v0/payload" -> value by the name of its scenario, sorted by the value."""
        result: dict[str, dict[str, float]] = {}
        for scenario in dict.fromkeys(scenario for scenario, _, _ in self.results.cells):
            name, equals, value = scenario.removesuffix(GIVEN).partition("=")
            if equals and name.rpartition("/")[2] in SWEEPS and not {":", "@"} & set(value):
                result.setdefault(name + GIVEN * scenario.endswith(GIVEN), {})[scenario] = float(value)
        return {
            name: dict(sorted(values.items(), key=lambda entry: entry[1])) for name, values in sorted(result.items())
        }

    @cached_property
    def plants(self) -> dict[str, list[str]]:
        """Scenario that was run on other plants -> its names on all plants, in the order of PLANTS."""
        names = {scenario for scenario, _, _ in self.results.cells}
        checked = dict.fromkeys(scenario.partition("@")[0] for scenario in sorted(names) if "@" in scenario)
        others = [each for each in PLANTS if each != "usual"]
        return {each: [each, *(f"{each}@{name}" for name in others if f"{each}@{name}" in names)] for each in checked}

    @cached_property
    def counted(self) -> list[str]:
        """Scenarios of the overall score: those with a `scale`; of scenarios with equal environments only the first."""
        result: dict[str, str] = {}
        for scenario in self.scenarios:
            if self.scale(scenario):
                result.setdefault(str(find_scenario(scenario).environment.to_plain()), scenario)
        return list(result.values())

    @cached_property
    def agents(self) -> list[str]:
        """Names of the agents in descending order of overall score; agents with missing scenarios come last."""
        return sorted(self.overall, key=lambda each: (len(self.missed(each)) > 0, -self.overall[each][0], each))

    def values(self, agent: str, scenario: str, name: str) -> dict[int, float]:
        """Return seed -> value of the column `name`, for the episodes of an agent in a scenario; {} without rows."""
        at = VALUES.index(name)
        return {row.seed: row.values[at] for row in self._rows.get((scenario, agent), ())}

    @cached_property
    def _rows(self) -> dict[tuple[str, str], list[EpisodeRow]]:
        result: dict[tuple[str, str], list[EpisodeRow]] = {}
        for row in self.results.rows.values():
            result.setdefault((row.scenario, row.agent), []).append(row)
        return result

    def why(self, agent: str, scenario: str) -> str:
        """Return the reason for which an agent has no rows in a scenario; "" if there are rows."""
        if self.values(agent, scenario, "reward"):
            return ""
        reasons = [cell.why for index, cell in self.results.cells.items() if index[:2] == (scenario, agent)]
        return reasons[0] if reasons else "it was not run there"

    def scale(self, scenario: str) -> tuple[float, float] | None:
        """Return the mean returns that define the scores 0 and 1 in a scenario; None if missing or too close."""
        ends = [np.array([*self.values(each, scenario, "reward").values()]) for each in REFERENCE_AGENTS]
        if not all(map(len, ends)):
            return None
        zero, one = (float(each.mean()) for each in ends)
        return None if normalised_scores(ends[0], zero, one, _largest_reward(scenario)) is None else (zero, one)

    def scores(self, agents: Sequence[str], scenarios: Sequence[str]) -> Array:
        """Return the scores (E, N, M) of E agents in M scenarios with a scale, for the N episodes common to all."""
        rewards = [[self.values(agent, scenario, "reward") for scenario in scenarios] for agent in agents]
        seeds = sorted(set.intersection(*(set(each) for row in rewards for each in row))) if scenarios else []
        shape = len(agents), len(seeds), len(scenarios)
        values = np.reshape([[[each[seed] for each in row] for seed in seeds] for row in rewards], shape)
        zero, one = np.reshape([self.scale(scenario) for scenario in scenarios], (-1, 2)).astype(float).T
        return (values - zero) / (one - zero)

    def missed(self, agent: str) -> list[str]:
        """Return the scenarios of the overall score in which an agent has no rows."""
        return [scenario for scenario in self.counted if not self.values(agent, scenario, "reward")]

    def score(self, agent: str, scenario: str) -> Interval | None:
        """Return the score of the mean return of an agent and its interval; None without rows or a scale."""
        if not self.scale(scenario) or self.why(agent, scenario):
            return None
        rewards = [self.values(each, scenario, "reward") for each in (agent, *REFERENCE_AGENTS)]
        seeds = sorted(set.intersection(*map(set, rewards)))
        own, zeros, ones = (np.array([each[seed] for seed in seeds]) for each in rewards)
        return paired_score(own, zeros, ones) if seeds else None

    @cached_property
    def overall(self) -> dict[str, Interval]:
        """Agent -> overall score: interquartile mean over all its episodes of `counted`, and its interval."""
        result: dict[str, Interval] = {}
        for agent in dict.fromkeys(agent for _, agent, _ in self.results.cells):
            scenarios = [scenario for scenario in self.counted if scenario not in self.missed(agent)]
            scores = self.scores([agent], scenarios)[0]
            values = scores if scores.size else np.full((1, 1), -np.inf)
            result[agent] = float(interquartile_mean(values.ravel())), *stratified_interval(values)
        return result

    def improvement_probability(self, agent: str, other: str, scenarios: Sequence[str]) -> Interval | None:
        """Return the probability of improvement: of a larger return than another agent in the same episode.

        The result has a bootstrap interval; it is None without common episodes in scenarios with a scale.
        """
        both = [each for each in scenarios if self.scale(each) and not self.why(agent, each) + self.why(other, each)]
        own, others = self.scores([agent, other], both)
        if not own.size:
            return None
        won = improvements(own, others)
        return float(won.mean()), *stratified_interval(won, mean)

    def settled(self, agent: str, scenario: str, seeds: Collection[int] | None = None) -> tuple[float, float]:
        """Return share of settled episodes (0 to 1), minus median settling time (s); the better has the larger tuple.

        Args:
            agent: name of an agent with rows in the scenario.
            scenario: name of the scenario.
            seeds: seeds of the episodes; None for all.
        """
        values = self.values(agent, scenario, "settling_time")
        times = np.sort([time for seed, time in values.items() if seeds is None or seed in seeds])
        return float(np.mean(np.isfinite(times))), -float(times[len(times) // 2])

    def settling_table(self, agents: Iterable[str], scenarios: Iterable[str], heads: Sequence[str]) -> list[str]:
        """Return a table with these heads, and a row for each agent: name, and result in each scenario."""
        rows = [[each, *(self.settling_text(each, name) for name in scenarios)] for each in agents]
        return text_table(heads, rows)

    def settling_text(self, agent: str, scenario: str) -> str:
        """Return the share of settled episodes and the median settling time, or the score for a moving goal.

        In an environment with limits that are recorded, the largest excess of an episode with a settling time follows.
        """
        if self.why(agent, scenario):
            return "not run"
        if find_scenario(scenario).has_settling:
            settled, time = self.settled(agent, scenario)
            excess = max(self.values(agent, scenario, "excess").values())
            beyond = f", excess {100.0 * excess:.2g} %" if excess >= 0.0 else ""  # nan without limits
            return f"{100.0 * settled:.0f} %" + (f", {-time:.2f} s" if np.isfinite(time) else "") + beyond
        score = self.score(agent, scenario)
        return "no scale" if score is None else f"score {number_text(score[0])}"

    def realisable(self, scenario: str) -> list[str]:
        """Return the agents with rows in a scenario that use measurable signals only, the recommended agent first."""
        agents = [each for each in self.agents if each not in SIMPLE_AGENTS and not self.why(each, scenario)]
        agents = [each for each in agents if describe_agent(each).realisable]
        return sorted(agents, key=lambda each: self.settled(each, scenario), reverse=True)

    def swept_agents(self) -> list[str]:
        """Return at most five agents with rows in sweeps or on other plants: SWEPT_AGENTS and realisable ones first."""
        scenarios = [scenario for values in self.sweeps.values() for scenario in values]
        scenarios += [scenario for names in self.plants.values() for scenario in names[1:]]
        names = dict.fromkeys([*SWEPT_AGENTS, *self.realisable(LAB_SCENARIO), *self.agents])
        found = [each for each in names if any(not self.why(each, scenario) for scenario in scenarios)]
        return [each for each in found if each not in SIMPLE_AGENTS][: len(SWEPT_AGENTS)]

    def cost(self, agent: str, scenarios: Sequence[str]) -> tuple[float, float]:
        """Return the CPU times (microseconds) of an action and of the start of an episode, medians over cells."""
        cells = [(cell.action, cell.design) for index, cell in self.results.cells.items()
                 if index[1] == agent and index[0] in scenarios and not cell.why]  # fmt: skip
        return tuple(np.median(cells, axis=0)) if cells else (np.nan, np.nan)


@cache
def _largest_reward(scenario: str) -> float:
    """Return the largest possible return of an episode; the reward of a control period is at most 1."""
    return float(find_scenario(scenario).environment.max_periods)
