"""Standings: scores, settled shares, comparisons and costs of the agents of a league."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.evaluation.agent_info import is_realisable
from flexman_gym.league.rows import REFERENCE_AGENTS, VALUES, EpisodeRow, LeagueRows
from flexman_gym.league.scenarios import GIVEN, PLANTS, SWEEPS, USUAL_SCENARIOS, find_scenario
from flexman_gym.metrics import (
    improvements,
    interquartile_mean,
    mean,
    normalised_scores,
    paired_score,
    stratified_interval,
)

Interval = tuple[float, float, float]  # a number and the ends of its interval


@dataclass(frozen=True)
class Standings:
    """Comparison of the agents of a league.

    Attributes:
        results: rows and cells of the league.
    """

    results: LeagueRows

    @cached_property
    def scenarios(self) -> list[str]:
        """Names of the scenarios but those of sweeps and other plants, the usual ones first."""
        known = dict.fromkeys(scenario for scenario, _, _ in self.results.cells if not {"=", "@"} & set(scenario))
        return [
            *(each for each in USUAL_SCENARIOS if each in known),
            *(each for each in known if each not in USUAL_SCENARIOS),
        ]

    @cached_property
    def sweeps(self) -> dict[str, list[str]]:
        """Sweep, such as "FlexRRR-v0/payload" -> names of its scenarios, the smallest value first."""
        result: dict[str, list[str]] = {}
        for scenario in dict.fromkeys(scenario for scenario, _, _ in self.results.cells):
            name, equals, value = scenario.removesuffix(GIVEN).partition("=")
            if equals and name.rpartition("/")[2] in SWEEPS and not {":", "@"} & set(value):
                result.setdefault(name + GIVEN * scenario.endswith(GIVEN), []).append(scenario)
        return {name: sorted(each, key=sweep_value) for name, each in sorted(result.items())}

    @cached_property
    def physical(self) -> dict[str, list[str]]:
        """Scenario -> its names on the usual plant and on others, in the order of PLANTS, where others were played."""
        known = {scenario for scenario, _, _ in self.results.cells}
        checked = dict.fromkeys(scenario.partition("@")[0] for scenario in sorted(known) if "@" in scenario)
        others = [each for each in PLANTS if each != "usual"]
        return {each: [each, *(f"{each}@{name}" for name in others if f"{each}@{name}" in known)] for each in checked}

    @cached_property
    def counted(self) -> list[str]:
        """The scenarios of the whole: those with a scale; of two with the same episodes the first."""
        result: dict[str, str] = {}
        for scenario in self.scenarios:
            if self.scale(scenario):
                result.setdefault(str(find_scenario(scenario).environment.to_plain()), scenario)
        return list(result.values())

    @cached_property
    def agents(self) -> list[str]:
        """All of them: those of all scenarios before those that miss one, and the larger score on the whole first."""
        return sorted(self.whole, key=lambda each: (len(self.missed(each)) > 0, -self.whole[each][0], each))

    def values(self, agent: str, scenario: str, name: str) -> dict[int, float]:
        """A value of each episode, by its seed; {} for an agent that has none there."""
        at = VALUES.index(name)
        return {row.seed: row.values[at] for row in self._rows.get((scenario, agent), ())}

    @cached_property
    def _rows(self) -> dict[tuple[str, str], list[EpisodeRow]]:
        result: dict[tuple[str, str], list[EpisodeRow]] = {}
        for row in self.results.rows.values():
            result.setdefault((row.scenario, row.agent), []).append(row)
        return result

    def why(self, agent: str, scenario: str) -> str:
        """Why an agent has no row there, "" where it has."""
        if self.values(agent, scenario, "reward"):
            return ""
        said = [cell.why for place, cell in self.results.cells.items() if place[:2] == (scenario, agent)]
        return said[0] if said else "it was not played there"

    def scale(self, scenario: str) -> tuple[float, float] | None:
        """The mean rewards that mean 0 and 1; None where they are too close, or not there."""
        ends = [np.array([*self.values(each, scenario, "reward").values()]) for each in REFERENCE_AGENTS]
        if not all(map(len, ends)):
            return None
        zero, one = (float(each.mean()) for each in ends)
        return None if normalised_scores(ends[0], zero, one, _largest_reward(scenario)) is None else (zero, one)

    def scores(self, agents: Sequence[str], scenarios: Sequence[str]) -> Array:
        """Scores (E, N, M) of E agents in the N episodes that all of them have in each of M scenarios with a scale."""
        rewards = [[self.values(who, scenario, "reward") for scenario in scenarios] for who in agents]
        seeds = sorted(set.intersection(*(set(each) for row in rewards for each in row))) if scenarios else []
        shape = len(agents), len(seeds), len(scenarios)
        values = np.reshape([[[each[seed] for each in row] for seed in seeds] for row in rewards], shape)
        zero, one = np.reshape([self.scale(scenario) for scenario in scenarios], (-1, 2)).astype(float).T
        return (values - zero) / (one - zero)

    def missed(self, agent: str) -> list[str]:
        """The scenarios of the whole in which an agent has no row."""
        return [scenario for scenario in self.counted if not self.values(agent, scenario, "reward")]

    def score(self, agent: str, scenario: str) -> Interval | None:
        """The score of an agent's mean reward, and its interval; None without a row or a scale."""
        if not self.scale(scenario) or self.why(agent, scenario):
            return None
        three = [self.values(each, scenario, "reward") for each in (agent, *REFERENCE_AGENTS)]
        seeds = sorted(set.intersection(*map(set, three)))
        ours, zeros, ones = (np.array([each[seed] for seed in seeds]) for each in three)
        return paired_score(ours, zeros, ones) if seeds else None

    @cached_property
    def whole(self) -> dict[str, Interval]:
        """Agent -> interquartile mean of its scores in all scenarios of the whole that it has, and its interval."""
        result: dict[str, Interval] = {}
        for agent in dict.fromkeys(agent for _, agent, _ in self.results.cells):
            scenarios = [scenario for scenario in self.counted if scenario not in self.missed(agent)]
            scores = self.scores([agent], scenarios)[0]
            known = scores if scores.size else np.full((1, 1), -np.inf)
            result[agent] = float(interquartile_mean(known.ravel())), *stratified_interval(known)
        return result

    def better(self, agent: str, other: str, scenarios: Sequence[str]) -> Interval | None:
        """Probability of a larger reward than another's in the same episode, and its interval; None without any."""
        both = [each for each in scenarios if self.scale(each) and not self.why(agent, each) + self.why(other, each)]
        ours, theirs = self.scores([agent, other], both)
        if not ours.size:
            return None
        won = improvements(ours, theirs)
        return float(won.mean()), *stratified_interval(won, mean)

    def settled(self, agent: str, scenario: str, seeds: Collection[int] | None = None) -> tuple[float, float]:
        """Part of the episodes, or of those of some seeds, that settle, and the negative of the median time.

        So the larger pair is the better one.
        """
        values = self.values(agent, scenario, "settling_time")
        times = np.sort([time for seed, time in values.items() if seeds is None or seed in seeds])
        return float(np.mean(np.isfinite(times))), -float(times[len(times) // 2])

    def buildable(self, scenario: str) -> list[str]:
        """Agents with rows there that nobody tells the truth and that act, the one to take first."""
        known = [each for each in self.agents if each not in ("zero", "random") and not self.why(each, scenario)]
        return sorted(filter(is_realisable, known), key=lambda each: self.settled(each, scenario), reverse=True)

    def cost(self, agent: str, scenarios: Sequence[str]) -> tuple[float, float]:
        """CPU time (microseconds) of an action and of the start of an episode: medians of the cells in scenarios."""
        cells = [(cell.action, cell.design) for place, cell in self.results.cells.items()
                 if place[1] == agent and place[0] in scenarios and not cell.why]  # fmt: skip
        return tuple(np.median(cells, axis=0)) if cells else (np.nan, np.nan)


@cache
def _largest_reward(scenario: str) -> float:
    """The largest reward of an episode: that of a control period is at most 1."""
    return float(find_scenario(scenario).environment.max_periods)


def sweep_value(scenario: str) -> float:
    """Return the value of a sweep in the name of a scenario."""
    return float(scenario.removesuffix(GIVEN).partition("=")[2])
