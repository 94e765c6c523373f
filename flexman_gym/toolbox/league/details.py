"""Details of a league for the terminal: all metrics of a scenario, values of a sweep, agents, and overall scores."""

from collections.abc import Sequence

import numpy as np

from flexman_gym.common.errors import value_error
from flexman_gym.common.formatting import number_text, percent, text_table
from flexman_gym.envs.config.named_environments import DEFAULT_ID
from flexman_gym.evaluation.agent_info import describe_agent, training_seconds
from flexman_gym.evaluation.metrics import LIMIT_METRICS, MEDIAN, SHARE, Metric, task_metrics
from flexman_gym.evaluation.shares import share_text
from flexman_gym.metrics import median_interval
from flexman_gym.simulation.physical_parameters import PARAMETERS
from flexman_gym.toolbox.league.rows import DAMPING, TIME_RATIO, optimised_settling_times
from flexman_gym.toolbox.league.scenarios import GIVEN, SWEEPS, find_scenario
from flexman_gym.toolbox.league.standings import Interval, Standings

OVERALL = "overall"  # name of the table of overall scores
BREAKDOWN_LEVEL = 0.5  # share of settled episodes (moving goals: score) below which an agent fails in a scenario


def league_details(standings: Standings, name: str) -> list[str]:
    """Return the details of an agent, a scenario, a sweep such as "FlexRRR-v0/payload=", or OVERALL, as lines of text.

    Raises:
        ValueError: for a name that is not in the league.
    """
    sweeps = {f"{each}=": values for each, values in standings.sweeps.items()}
    scenarios = dict.fromkeys(scenario for scenario, _, _ in standings.results.cells)
    if name not in (OVERALL, *standings.agents, *scenarios, *sweeps):
        raise value_error("details", name, f"{OVERALL}, or an agent, a scenario or a sweep of this league")
    if name == OVERALL:
        return _overall_table(standings)
    if name in standings.agents:
        return _agent_lines(standings, name)
    return _sweep_table(standings, name, sweeps[name]) if name in sweeps else _scenario_table(standings, name)


def short_name(scenario: str) -> str:
    """Return the name of a scenario without the default environment."""
    return scenario.removeprefix(f"{DEFAULT_ID}/")


def sweep_text(name: str) -> str:
    """Return quantity and unit of a sweep."""
    return SWEEPS[name.removesuffix(GIVEN).rpartition("/")[2]].text


def _agent_lines(standings: Standings, agent: str) -> list[str]:
    """Return what an agent is and needs, its CPU time, and the scenarios where it fails or was not run."""
    info, names = describe_agent(agent), dict.fromkeys(scenario for scenario, _, _ in standings.results.cells)
    action, start = standings.cost(agent, standings.scenarios)
    failing = [short_name(each) for each in names if _is_failing(standings, agent, each)]
    missing = [short_name(each) for each in names if standings.why(agent, each)]
    return [
        f"{agent}: {info.description}",
        f"information: {info.needs}",
        f"tuning or training: {info.tuning}",
        f"CPU time: {number_text(action)} us an action, {number_text(1e-3 * start)} ms at the start of an episode",
        f"fails in: {', '.join(failing) or 'no scenario'}",
        f"not run in: {', '.join(missing) or 'no scenario'}",
    ]


def _is_failing(standings: Standings, agent: str, scenario: str) -> bool:
    if standings.why(agent, scenario):
        return False
    if find_scenario(scenario).has_settling:
        return standings.settled(agent, scenario)[0] < BREAKDOWN_LEVEL
    score = standings.score(agent, scenario)
    return score is not None and score[0] < BREAKDOWN_LEVEL


def _overall_table(standings: Standings) -> list[str]:
    """Return a table of the agents with overall score, probability of improvement on the next agent, and CPU times."""
    count, rows = len(standings.counted), []
    for agent, after in zip(standings.agents, [*standings.agents[1:], ""], strict=True):
        won = standings.improvement_probability(agent, after, standings.counted) if after else None
        action, start = standings.cost(agent, standings.scenarios)
        trained = training_seconds(agent)
        rows.append([
            agent, describe_agent(agent).needs, _interval_text(standings.overall[agent]),
            f"{count - len(standings.missed(agent))} of {count}", _probability_text(won) if won else "-",
            number_text(action), number_text(1e-3 * start), "-" if trained is None else number_text(trained / 60.0),
        ])  # fmt: skip
    heads = ["agent", "given", "score", "scenarios", "better", "action, CPU us", "start, CPU ms", "training, CPU min"]
    return [*text_table(heads, rows), f"scenarios: {', '.join(map(short_name, standings.counted))}"]


def _sweep_table(standings: Standings, name: str, values: dict[str, float]) -> list[str]:
    heads = [sweep_text(name.removesuffix("=")), *(f"{value:g}" for value in values.values())]
    agents = [each for each in standings.agents if any(not standings.why(each, scenario) for scenario in values)]
    return standings.settling_table(agents, values, heads)


def _scenario_table(standings: Standings, scenario: str) -> list[str]:
    """Return a table of the agents with all metrics of a scenario, and notes on missing entries."""
    environment = find_scenario(scenario).environment
    metrics = [each for each in task_metrics(environment.task) if each.name != "reward"]  # the score is in its place
    metrics += LIMIT_METRICS if environment.limits.recorded else ()
    times, slews = optimised_settling_times(environment), find_scenario(scenario).has_settling
    agents = [each for each in standings.agents if not standings.why(each, scenario)]
    scores = {each: standings.score(each, scenario) or (np.nan,) * 3 for each in agents}
    rows = []
    for agent in sorted(agents, key=lambda each: -np.nan_to_num(scores[each][0], nan=0.0)):
        cells = [_cell(metric, standings.values(agent, scenario, metric.name)) for metric in metrics]
        for name in [DAMPING] * slews + [TIME_RATIO] * bool(times):
            cells.append(_interval_text(median_interval(np.array([*standings.values(agent, scenario, name).values()]))))
        rows.append([agent, _interval_text(scores[agent]), *cells])
    count = len({seed for place, _, seed in standings.results.rows if place == scenario})
    heads = ["agent", "score", *(metric.header for metric in metrics), *["damping"] * slews,
             *["times optimised"] * bool(times)]  # fmt: skip
    return [f"{scenario}: {count} episodes", *text_table(heads, rows), *_notes(standings, scenario, agents)]


def _notes(standings: Standings, scenario: str, agents: Sequence[str]) -> list[str]:
    """Return notes on agents without rows, on a missing scale, and on agents designed for the nominal arm."""
    notes = [f"no row of {each}: {standings.why(each, scenario)}" for each in standings.agents if each not in agents]
    if not standings.scale(scenario):
        notes.append("no score: the mean rewards of the scores 0 and 1 are missing or too close")
    drawn = find_scenario(scenario).environment.disturbances
    if drawn is not None and set(drawn.effects) & set(PARAMETERS):
        needed = {each: {"model", "true parameters"} & set(describe_agent(each).information) for each in agents}
        wrong = [each for each in agents if needed[each] == {"model"}]
        notes += [f"designed for the nominal arm: {', '.join(wrong)}"] if wrong else []
    return notes


def _cell(metric: Metric, values: dict[int, float]) -> str:
    numbers = metric.scale * np.array([*values.values()])
    if metric.statistic == MEDIAN:
        return _interval_text(median_interval(numbers))
    if metric.statistic != SHARE:
        return number_text(metric.aggregate(numbers))
    return share_text(float(numbers.mean()), len(numbers))


def _interval_text(numbers: Interval) -> str:
    middle, low, high = map(number_text, numbers)
    return middle if middle == low == high else f"{middle} ({low}-{high})"


def _probability_text(numbers: Interval) -> str:
    """Return a probability with its bootstrap interval, which says nothing where all episodes agree."""
    middle, low, high = numbers
    return percent(middle, low, high) if low < high else percent(middle)
