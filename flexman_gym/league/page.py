"""League page: recommendation, tables and charts of the rows."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.computer import computer_text
from flexman_gym.common.plot_style import LIGHT, LINK_COLOURS, MIDDLE, new_figure
from flexman_gym.envs.config.named_environments import DEFAULT_ID
from flexman_gym.evaluation.agent import BASELINES, SIMPLE_AGENTS
from flexman_gym.evaluation.agent_info import describe_agent, training_seconds
from flexman_gym.evaluation.metrics import MEAN, MEDIAN, Metric, optimised_settling_times, task_metrics
from flexman_gym.league.rows import DAMPING, REFERENCE_AGENTS, TIME_RATIO, LeagueRows
from flexman_gym.league.scenarios import GIVEN, LAB_SCENARIO, PLANTS, SWEEPS, find_scenario
from flexman_gym.league.standings import Interval, Standings
from flexman_gym.metrics import mean, median_interval, performance_profile, stratified_interval
from flexman_gym.simulation.parameters import PARAMETERS

PAGE, CHART = "league.md", "league.png"
PAYLOAD_SCENARIO = f"{DEFAULT_ID}/payload"
BREAKDOWN_LEVEL = 0.5  # share of settled episodes (moving goals: score) below which an agent fails in a scenario
THRESHOLDS = np.linspace(-0.2, 1.4, 81)  # dimensionless; scores at which performance profiles are evaluated
TEMPLATE = Path(__file__).parent / "league.md"  # Jinja2
Section = dict[str, Any]  # values for a part of the template
MARKERS = "osD^vP"  # Matplotlib markers of the agents
MARKER_SPACING = 0.05  # dimensionless; horizontal distance of the markers of two agents / of two scenarios


class _ScoreCurve(NamedTuple):
    """Scores of an agent at k abscissae and the ends of their intervals, (k,) each; nan for no score."""

    abscissae: Array
    scores: Array
    low: Array
    high: Array


def write_page(results: LeagueRows, folder: Path) -> None:
    """Write the page and its charts to a folder; without Jinja2 only the charts, without Matplotlib only the page."""
    standings = Standings(results)
    try:
        draw_charts(standings, folder)
    except ImportError as error:
        print(f"no charts: {error}")
    try:
        (folder / PAGE).write_text(_page_text(standings), encoding="utf-8")
    except ImportError as error:
        print(f"no page: {error}")


def _page_text(standings: Standings) -> str:
    """Return the page in Markdown, made from TEMPLATE.

    Args:
        standings: comparison of the agents.

    Returns:
        Markdown.

    Raises:
        ImportError: without Jinja2.
    """
    try:
        from jinja2 import Environment, StrictUndefined
    except ImportError:
        raise ImportError("it needs Jinja2: pip install 'flexman_gym[render]'") from None
    environment = Environment(
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    return environment.from_string(TEMPLATE.read_text(encoding="utf-8")).render(
        recommendation=_recommendation(standings),
        block=max((cell.end - cell.first for cell in standings.results.cells.values()), default=0),
        summary=summary_rows(standings, standings.scenarios),
        absent=[f"`{each}`" for each in BASELINES if each not in standings.overall],
        agents=[_agent_section(standings, agent) for agent in standings.agents],
        counted=[f"`{scenario}`" for scenario in standings.counted],
        overall=_overall_rows(standings),
        chart=CHART,
        scenarios=[_scenario_section(standings, scenario) for scenario in standings.scenarios],
        sweeps=[_sweep_section(standings, name) for name in standings.sweeps],
        plants=PLANTS,
        plant_results=[_plant_section(standings, *each) for each in standings.plants.items()],
        computer=computer_text(),
    )


def _recommendation(standings: Standings) -> str:
    """Return the recommended agent for an arm with uncertain parameters, its cost, and the scenarios where it fails."""
    if not (agents := standings.realisable(LAB_SCENARIO)):
        return f"No agent that is realisable on hardware was run in `{LAB_SCENARIO}`."
    best, *others = agents
    lines = [
        f"For an arm with unknown payload, stiffness and delay (`{LAB_SCENARIO}`), use `{best}`.",
        _settling_sentence(standings, best, LAB_SCENARIO),
        f"It needs: {_needs(best)}.",
        _cost_sentence(standings, best, [LAB_SCENARIO]),
        *_breakdown_sentences(standings, best),
    ]
    if others:
        won = standings.improvement_probability(best, others[0], [LAB_SCENARIO])
        lines += [f"The second is `{others[0]}`. {_settling_sentence(standings, others[0], LAB_SCENARIO)}"]
        lines += [f"The first has the larger reward in {_share(won)} of the same episodes."] if won else []
    if reference := standings.values(REFERENCE_AGENTS[1], LAB_SCENARIO, "settling_time"):
        time = median_interval(np.array([*reference.values()]))[0]
        lines.append(f"The median settling time of an LQR with the true state and parameters is {time:.2f} s.")
    if not standings.why(best, PAYLOAD_SCENARIO):
        lines.append(f"If only the payload is unknown (`{PAYLOAD_SCENARIO}`), use `{best}` too.")
        lines.append(_settling_sentence(standings, best, PAYLOAD_SCENARIO))
    return "\n".join(lines)


def _settling_sentence(standings: Standings, agent: str, scenario: str) -> str:
    settled, time = standings.settled(agent, scenario)
    when = f", half of them within {-time:.2f} s" if np.isfinite(time) else ""
    return f"It settles {100.0 * settled:.0f} % of the episodes{when}."


def _cost_sentence(standings: Standings, agent: str, scenarios: list[str]) -> str:
    action, start = standings.cost(agent, scenarios)
    return f"An action takes {_number(action)} microseconds, and the start of an episode {_number(1e-3 * start)} ms."


def _breakdown_sentences(standings: Standings, agent: str) -> list[str]:
    """Return sentences on the scenarios where an agent fails, and on the scenarios where it was not run."""
    names = _all_scenarios(standings)
    failing = [f"`{_short_name(each)}`" for each in names if _is_failing(standings, agent, each)]
    missing = [f"`{_short_name(each)}`" for each in names if standings.why(agent, each)]
    first = f"It fails in {', '.join(failing)}." if failing else "It fails in none of its scenarios."
    return [first, *([f"It was not run in: {', '.join(missing)}."] if missing else [])]


def _agent_section(standings: Standings, agent: str) -> Section:
    info = describe_agent(agent)
    costs = [] if agent in SIMPLE_AGENTS else [_cost_sentence(standings, agent, standings.scenarios)]
    notes = [*costs, *_breakdown_sentences(standings, agent)]
    return {"agent": agent, "description": info.description, "needs": _needs(agent), "tuning": info.tuning,
            "notes": notes}  # fmt: skip


def summary_rows(standings: Standings, scenarios: list[str]) -> list[list[str]]:
    """Return a row of a table for each agent: name, and result in each scenario."""
    return [[f"`{each}`", *(_result(standings, each, name) for name in scenarios)] for each in standings.agents]


def _result(standings: Standings, agent: str, scenario: str, seeds: frozenset[int] | None = None) -> str:
    """Return the share of settled episodes and the median settling time, or the score for a moving goal."""
    if standings.why(agent, scenario):
        return "no row"
    if "settling_time" in {each.name for each in _scenario_metrics(scenario)}:
        settled, time = standings.settled(agent, scenario, seeds)
        return f"{100.0 * settled:.0f} %" + (f", {-time:.2f} s" if np.isfinite(time) else "")
    score = standings.score(agent, scenario)
    return "no scale" if score is None else f"score {_number(score[0])}"


def _plant_section(standings: Standings, scenario: str, names: list[str]) -> Section:
    """Return the section of a scenario on other plants, with the same episodes on the usual plant."""
    heads = ["agent", *(name.partition("@")[2] or "usual" for name in names)]
    compared = _comparison(standings, names, names[1:], dict.fromkeys(names, "on another plant"))
    return {"name": scenario, "heads": heads, **compared}


def _sweep_section(standings: Standings, name: str) -> Section:
    values = {scenario: f"{value:g}" for scenario, value in standings.sweeps[name].items()}
    compared = _comparison(standings, [*values], [*values], {each: f"at {value}" for each, value in values.items()})
    return {"name": name, "heads": [_sweep_label(name), *values.values()], "chart": _chart_name(name), **compared}


def _sweep_label(name: str) -> str:
    """Return quantity and unit of a sweep."""
    return SWEEPS[name.removesuffix(GIVEN).rpartition("/")[2]].text


def _comparison(standings: Standings, scenarios: list[str], own: list[str], places: dict[str, str]) -> Section:
    """Return the results of all agents in several scenarios.

    Args:
        standings: comparison of the agents.
        scenarios: names of the scenarios.
        own: scenarios whose agents and episodes are selected for the comparison.
        places: scenario -> its description in notes.

    Returns:
        Number of episodes, rows of the table, and notes.
    """
    seeds = frozenset(seed for name, _, seed in standings.results.rows if name in own)
    agents = [each for each in standings.agents if any(not standings.why(each, name) for name in own)]
    why = {(each, standings.why(each, name)): places[name] for each in agents for name in scenarios}
    absent = ", ".join(f"`{each}`" for each in standings.agents if each not in agents)
    return {
        "episodes": len(seeds),
        "rows": [[f"`{each}`", *(_result(standings, each, name, seeds) for name in scenarios)] for each in agents],
        "notes": [f"`{each}` has no row {place}: {words}." for (each, words), place in why.items() if words]
        + [f"Not run at all: {absent}."] * bool(absent),
    }


def _all_scenarios(standings: Standings) -> list[str]:
    return [*standings.scenarios, *(scenario for each in standings.sweeps.values() for scenario in each)]


def _is_failing(standings: Standings, agent: str, scenario: str) -> bool:
    if standings.why(agent, scenario):
        return False
    if "settling_time" in {each.name for each in _scenario_metrics(scenario)}:
        return standings.settled(agent, scenario)[0] < BREAKDOWN_LEVEL
    score = standings.score(agent, scenario)
    return score is not None and score[0] < BREAKDOWN_LEVEL


def _overall_rows(standings: Standings) -> list[list[str]]:
    """Return a row for each agent with its overall score and cost."""
    count, rows = len(standings.counted), []
    for agent, after in zip(standings.agents, [*standings.agents[1:], ""], strict=True):
        won = standings.improvement_probability(agent, after, standings.counted) if after else None
        action, start = standings.cost(agent, standings.scenarios)
        trained = training_seconds(agent)
        rows.append([
            f"`{agent}`", _needs(agent), _interval(standings.overall[agent]),
            f"{count - len(standings.missed(agent))} of {count}", _share(won) if won else "-",
            _number(action), _number(1e-3 * start), "-" if trained is None else _number(trained / 60.0),
        ])  # fmt: skip
    return rows


def _scenario_section(standings: Standings, scenario: str) -> Section:
    metrics, times = _scenario_metrics(scenario), optimised_settling_times(find_scenario(scenario).environment)
    agents = [each for each in standings.agents if not standings.why(each, scenario)]
    scores = {each: standings.score(each, scenario) or (np.nan,) * 3 for each in agents}
    agents.sort(key=lambda each: -np.nan_to_num(scores[each][0], nan=0.0))
    slews = "settling_time" in {metric.name for metric in metrics}
    rows = []
    for agent in agents:
        cells = [_cell(metric, standings.values(agent, scenario, metric.name)) for metric in metrics]
        for name in [DAMPING] * slews + [TIME_RATIO] * bool(times):
            cells.append(_interval(median_interval(np.array([*standings.values(agent, scenario, name).values()]))))
        rows.append([f"`{agent}`", _interval(scores[agent]), *cells, _number(standings.cost(agent, [scenario])[0])])
    return {
        "name": scenario,
        "short": _short_name(scenario),
        "episodes": len({seed for place, _, seed in standings.results.rows if place == scenario}),
        "heads": ["agent", "score", *(metric.header for metric in metrics), *["damping"] * slews,
                  *["times optimised"] * bool(times), "action, us"],
        "rows": rows,
        "notes": _notes(standings, scenario, bool(times)),
    }  # fmt: skip


def _notes(standings: Standings, scenario: str, times: bool) -> list[str]:
    """Return notes on missing entries of a scenario, and on agents designed for the nominal arm."""
    notes = [f"`{each}` has no row: {standings.why(each, scenario)}."
             for each in standings.agents if standings.why(each, scenario)]  # fmt: skip
    if not standings.scale(scenario):
        notes.append("There is no score: the mean rewards of the scores 0 and 1 are missing or too close.")
    if not times:
        notes.append("There is no ratio to the optimised slew: no table has slews of this scenario.")
    drawn = find_scenario(scenario).environment.disturbances
    if drawn is not None and set(drawn.effects) & set(PARAMETERS):
        agents = [each for each in standings.agents if not standings.why(each, scenario)]
        wrong = [
            f"`{each}`" for each in agents
            if {"model"} == {"model", "true parameters"} & set(describe_agent(each).information)
        ]  # fmt: skip
        notes += [f"Designed for the nominal arm, a wrong one here: {', '.join(wrong)}."] if wrong else []
    return [*notes, "A dash stands for no number: more than half of the episodes did not settle, or failed.",
            "As a damping it stands for a tip that does not oscillate in more than half of the episodes."]  # fmt: skip


def draw_charts(standings: Standings, folder: Path, sweeps_only: bool = False) -> list[Path]:
    """Draw the chart of the scenarios and a chart for each sweep; return their paths.

    Args:
        standings: comparison of the agents.
        folder: folder of the pictures.
        sweeps_only: True to leave out the chart of the scenarios.

    Returns:
        Paths of the pictures.

    Raises:
        ImportError: without Matplotlib.
    """
    counted, paths = [] if sweeps_only else standings.counted, []
    curves = {each: _score_curve(standings, each, counted, np.arange(float(len(counted)))) for each in standings.agents}
    if counted:
        scores = {each: standings.scores([each], counted)[0] for each in standings.agents if not standings.missed(each)}
        profiles = {
            each: (THRESHOLDS, performance_profile(own, THRESHOLDS)) for each, own in scores.items() if own.size
        }
        _score_chart(curves, "", folder / CHART, counted, profiles)
        paths.append(folder / CHART)
    for name, values in standings.sweeps.items():
        scenarios, abscissae = [*values], np.array([*values.values()])
        agents = [each for each in standings.agents if any(standings.score(each, scenario) for scenario in scenarios)]
        curves = {each: _score_curve(standings, each, scenarios, abscissae) for each in agents}
        paths.append(folder / _chart_name(name))
        _score_chart(curves, _sweep_label(name), paths[-1])
    return paths


def _score_curve(standings: Standings, agent: str, scenarios: list[str], abscissae: Array) -> _ScoreCurve:
    found = np.array([standings.score(agent, scenario) or (np.nan,) * 3 for scenario in scenarios]).reshape(-1, 3)
    return _ScoreCurve(abscissae, *found.T)


def _scenario_metrics(scenario: str) -> tuple[Metric, ...]:
    metrics = task_metrics(find_scenario(scenario).environment.task)
    return tuple(each for each in metrics if each.name != "reward")  # the score stands for the reward


def _cell(metric: Metric, values: dict[int, float]) -> str:
    numbers = metric.scale * np.array([*values.values()])
    if metric.statistic == MEDIAN:
        return _interval(median_interval(numbers))
    if metric.statistic == MEAN:
        return _number(float(numbers.mean()))
    return _share((float(numbers.mean()), *stratified_interval(numbers[:, None], mean)))


def _interval(numbers: Interval) -> str:
    middle, low, high = map(_number, numbers)
    return middle if middle == low == high else f"{middle} ({low} to {high})"


def _number(value: float) -> str:
    if not np.isfinite(value):
        return "-"
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{round(value, 3) + 0.0:.3g}"


def _share(numbers: Interval) -> str:
    middle, low, high = (f"{100.0 * each:.0f}" for each in numbers)
    return f"{middle} %" if low == high else f"{middle} % ({low} to {high})"


def _needs(agent: str) -> str:
    return ", ".join(describe_agent(agent).information) or ("nothing" if agent in SIMPLE_AGENTS else "its motors")


def _short_name(scenario: str) -> str:
    """Return the name of a scenario without the default environment."""
    return scenario.removeprefix(f"{DEFAULT_ID}/")


def _chart_name(name: str) -> str:
    return f"league-{name.replace('/', '-')}.png"


def _score_chart(
    curves: Mapping[str, _ScoreCurve], label: str, path: str | Path, names: Sequence[str] = (),
    profiles: Mapping[str, tuple[Array, Array]] | None = None,
) -> None:  # fmt: skip
    """Draw the scores of agents, with their performance profiles if there are any.

    Args:
        curves: agent -> scores.
        label: label of the horizontal axis.
        path: path of the picture.
        names: labels of the abscissae 0, 1, ...; without labels the abscissae are numbers, joined by lines.
        profiles: agent -> performance profile: thresholds, and share of episodes with a score above each threshold.

    Raises:
        ImportError: without Matplotlib.
    """
    figure = new_figure((11.0 if profiles else 7.5, 5.0), 120.0, layout="constrained")
    panels = figure.subplots(1, 2, width_ratios=(2.0, 1.0)) if profiles else [figure.add_subplot()]
    for number, (agent, curve) in enumerate(curves.items()):
        style, shift = _line_style(number), MARKER_SPACING * (number - 0.5 * (len(curves) - 1)) if names else 0.0
        spread = [curve.scores - curve.low, curve.high - curve.scores]
        line = {"linestyle": "none"} if names else {}
        panels[0].errorbar(curve.abscissae + shift, curve.scores, spread, label=agent, capsize=2, **(style | line))
        if profiles and agent in profiles:
            panels[1].plot(*profiles[agent], **(style | {"marker": ""}))
    panels[0].set(ylabel="score: 0 no torque, 1 true state and parameters", xlabel=label)
    if names:
        panels[0].set_xticks(range(len(names)), names, rotation=30, ha="right", rotation_mode="anchor")
    if profiles:
        panels[1].set(xlabel="score", ylabel="share of the episodes above it", ylim=(0.0, 1.02))
    for axes in panels:
        axes.grid(color=LIGHT, linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    for level in (0.0, 1.0):
        panels[0].axhline(level, color=MIDDLE, linewidth=0.8)
    panels[0].set_ylim(bottom=max(-1.0, panels[0].get_ylim()[0]))  # failed agents have scores far below
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False)
    figure.savefig(path)


def _line_style(number: int) -> dict[str, Any]:
    again, colour = divmod(number, len(LINK_COLOURS))
    style = {"color": LINK_COLOURS[colour], "marker": MARKERS[(colour + again) % len(MARKERS)]}
    return style | {"linestyle": ("-", "--", ":")[again % 3], "linewidth": 1.4, "markersize": 5}
