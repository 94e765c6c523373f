"""Standings: scores, settled shares, comparisons and costs of the agents of a league."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.evaluation.agent_info import is_realisable
from flexman_gym.league.rows import SCALE, VALUES, EpisodeRow, LeagueRows
from flexman_gym.league.scenarios import PLANTS, USUAL_SCENARIOS, find_scenario
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
    """What a book says.

    Attributes:
        book: of rows and cells.
    """

    book: LeagueRows

    @cached_property
    def venues(self) -> list[str]:
        """Names of the venues but those of sweeps and other plants, the usual ones first."""
        known = dict.fromkeys(venue for venue, _, _ in self.book.cells if not {"=", "@"} & set(venue))
        return [
            *(each for each in USUAL_SCENARIOS if each in known),
            *(each for each in known if each not in USUAL_SCENARIOS),
        ]

    @cached_property
    def sweeps(self) -> dict[str, list[str]]:
        """What is swept, such as "FlexRRR-v0/payload" -> names of the venues, the smallest value first."""
        result: dict[str, list[str]] = {}
        for venue in dict.fromkeys(venue for venue, _, _ in self.book.cells if "=" in venue):
            result.setdefault(venue.partition("=")[0], []).append(venue)
        return {name: sorted(each, key=sweep_value) for name, each in sorted(result.items())}

    @cached_property
    def physical(self) -> dict[str, list[str]]:
        """Venue -> its names on the usual plant and on others, in the order of PLANTS, where others were played."""
        known = {venue for venue, _, _ in self.book.cells}
        checked = dict.fromkeys(venue.partition("@")[0] for venue in sorted(known) if "@" in venue)
        others = [each for each in PLANTS if each != "usual"]
        return {each: [each, *(f"{each}@{name}" for name in others if f"{each}@{name}" in known)] for each in checked}

    @cached_property
    def counted(self) -> list[str]:
        """The venues of the whole: those with a scale; of two with the same episodes the first."""
        result: dict[str, str] = {}
        for venue in self.venues:
            if self.scale(venue):
                result.setdefault(str(find_scenario(venue).environment.to_plain()), venue)
        return list(result.values())

    @cached_property
    def entrants(self) -> list[str]:
        """All of them: those of all venues before those that miss one, and the larger score on the whole first."""
        return sorted(self.whole, key=lambda each: (len(self.missed(each)) > 0, -self.whole[each][0], each))

    def values(self, entrant: str, venue: str, name: str) -> dict[int, float]:
        """A value of each episode, by its seed; {} for an entrant that has none there."""
        at = VALUES.index(name)
        return {row.seed: row.values[at] for row in self._rows.get((venue, entrant), ())}

    @cached_property
    def _rows(self) -> dict[tuple[str, str], list[EpisodeRow]]:
        result: dict[tuple[str, str], list[EpisodeRow]] = {}
        for row in self.book.rows.values():
            result.setdefault((row.venue, row.entrant), []).append(row)
        return result

    def why(self, entrant: str, venue: str) -> str:
        """Why an entrant has no row there, "" where it has."""
        if self.values(entrant, venue, "reward"):
            return ""
        said = [cell.why for place, cell in self.book.cells.items() if place[:2] == (venue, entrant)]
        return said[0] if said else "it was not played there"

    def scale(self, venue: str) -> tuple[float, float] | None:
        """The mean rewards that mean 0 and 1; None where they are too close, or not there."""
        ends = [np.array([*self.values(each, venue, "reward").values()]) for each in SCALE]
        if not all(map(len, ends)):
            return None
        zero, one = (float(each.mean()) for each in ends)
        return None if normalised_scores(ends[0], zero, one, _longest(venue)) is None else (zero, one)

    def scores(self, entrants: Sequence[str], venues: Sequence[str]) -> Array:
        """Scores (E, N, M) of E entrants in the N episodes that all of them have in each of M venues with a scale."""
        rewards = [[self.values(who, venue, "reward") for venue in venues] for who in entrants]
        seeds = sorted(set.intersection(*(set(each) for row in rewards for each in row))) if venues else []
        shape = len(entrants), len(seeds), len(venues)
        values = np.reshape([[[each[seed] for each in row] for seed in seeds] for row in rewards], shape)
        zero, one = np.reshape([self.scale(venue) for venue in venues], (-1, 2)).astype(float).T
        return (values - zero) / (one - zero)

    def missed(self, entrant: str) -> list[str]:
        """The venues of the whole in which an entrant has no row."""
        return [venue for venue in self.counted if not self.values(entrant, venue, "reward")]

    def score(self, entrant: str, venue: str) -> Interval | None:
        """The score of an entrant's mean reward, and its interval; None without a row or a scale."""
        if not self.scale(venue) or self.why(entrant, venue):
            return None
        three = [self.values(each, venue, "reward") for each in (entrant, *SCALE)]
        seeds = sorted(set.intersection(*map(set, three)))
        ours, zeros, ones = (np.array([each[seed] for seed in seeds]) for each in three)
        return paired_score(ours, zeros, ones) if seeds else None

    @cached_property
    def whole(self) -> dict[str, Interval]:
        """Entrant -> the interquartile mean of its scores in all venues of the whole that it has, and its interval."""
        result: dict[str, Interval] = {}
        for entrant in dict.fromkeys(entrant for _, entrant, _ in self.book.cells):
            venues = [venue for venue in self.counted if venue not in self.missed(entrant)]
            scores = self.scores([entrant], venues)[0]
            known = scores if scores.size else np.full((1, 1), -np.inf)
            result[entrant] = float(interquartile_mean(known.ravel())), *stratified_interval(known)
        return result

    def better(self, entrant: str, other: str, venues: Sequence[str]) -> Interval | None:
        """Probability of a larger reward than another's in the same episode, and its interval; None without any."""
        both = [each for each in venues if self.scale(each) and not self.why(entrant, each) + self.why(other, each)]
        ours, theirs = self.scores([entrant, other], both)
        if not ours.size:
            return None
        won = improvements(ours, theirs)
        return float(won.mean()), *stratified_interval(won, mean)

    def settled(self, entrant: str, venue: str, seeds: Collection[int] | None = None) -> tuple[float, float]:
        """Part of the episodes, or of those of some seeds, that settle, and the negative of the median time.

        So the larger pair is the better one.
        """
        values = self.values(entrant, venue, "settling_time")
        times = np.sort([time for seed, time in values.items() if seeds is None or seed in seeds])
        return float(np.mean(np.isfinite(times))), -float(times[len(times) // 2])

    def buildable(self, venue: str) -> list[str]:
        """Entrants with rows there that nobody tells the truth and that act, the one to take first."""
        known = [each for each in self.entrants if each not in ("zero", "random") and not self.why(each, venue)]
        return sorted(filter(is_realisable, known), key=lambda each: self.settled(each, venue), reverse=True)

    def cost(self, entrant: str, venues: Sequence[str]) -> tuple[float, float]:
        """CPU time (microseconds) of an action and of the start of an episode: medians of the cells in venues."""
        cells = [(cell.action, cell.design) for place, cell in self.book.cells.items()
                 if place[1] == entrant and place[0] in venues and not cell.why]  # fmt: skip
        return tuple(np.median(cells, axis=0)) if cells else (np.nan, np.nan)


@cache
def _longest(venue: str) -> float:
    """The largest reward of an episode: that of a control period is at most 1."""
    return float(find_scenario(venue).environment.longest)


def sweep_value(venue: str) -> float:
    """The value of a sweep in the name of a venue."""
    return float(venue.partition("=")[2])
