"""League page: recommendation, tables and charts of the rows."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.computer import computer_text
from flexman_gym.draw.style import LIGHT, LINK_COLOURS, MIDDLE, new_figure
from flexman_gym.envs.config.named_environments import DEFAULT_ID
from flexman_gym.evaluation.agent import BASELINES, LAWLESS_AGENTS
from flexman_gym.evaluation.agent_info import describe_agent, required_information, training_seconds
from flexman_gym.evaluation.metrics import MEAN, MEDIAN, Metric, task_metrics
from flexman_gym.league.rows import DAMPING, REFERENCE_AGENTS, TIME_RATIO, LeagueRows, optimised_settling_times
from flexman_gym.league.scenarios import GIVEN, LAB_SCENARIO, PLANTS, SWEEPS, find_scenario
from flexman_gym.league.standings import Interval, Standings, sweep_value
from flexman_gym.metrics import mean, median_interval, performance_profile, stratified_interval
from flexman_gym.simulation.parameters import PARAMETERS

PAGE, CHART = "league.md", "league.png"
PAYLOAD_SCENARIO = f"{DEFAULT_ID}/payload"
BREAKDOWN_LEVEL = 0.5  # of the episodes that settle, or of the score where goals move: less is broken
THRESHOLDS = np.linspace(-0.2, 1.4, 81)
TEMPLATE = Path(__file__).parent / "league.md"  # template of Jinja2
Section = dict[str, Any]  # values of a part of the template
MARKS = "osD^vP"  # markers of agents in a chart
MARKER_SPACING = 0.05  # distance of two agents in a chart, as a part of that of two scenarios


class _ScoreCurve(NamedTuple):
    """Scores of an agent at k places and their intervals, (k,) each; nan for no score."""

    places: Array
    middle: Array
    low: Array
    high: Array


def write_page(results: LeagueRows, folder: Path) -> None:
    """Write the page and its charts into a folder, without Matplotlib the page alone, without Jinja2 the charts."""
    standing = Standings(results)
    try:
        draw_charts(standing, folder)
    except ImportError as error:
        print(f"no charts: {error}")
    try:
        (folder / PAGE).write_text(page_text(standing), encoding="utf-8")
    except ImportError as error:
        print(f"no page: {error}")


def page_text(standing: Standings) -> str:
    """Return the page in Markdown, with the values of `standing` in the template TEXT.

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
        conclusion=recommendation(standing),
        block=max((cell.end - cell.first for cell in standing.results.cells.values()), default=0),
        glance=summary_rows(standing, standing.scenarios),
        absent=[f"`{each}`" for each in BASELINES if each not in standing.whole],
        cards=[_card(standing, agent) for agent in standing.agents],
        counted=[f"`{scenario}`" for scenario in standing.counted],
        whole=_overall_rows(standing),
        chart=CHART,
        scenarios=[_scenario_section(standing, scenario) for scenario in standing.scenarios],
        sweeps=[_sweep_section(standing, name) for name in standing.sweeps],
        plants=PLANTS,
        physical=[_plant_section(standing, *each) for each in standing.physical.items()],
        computer=computer_text(),
    )


def recommendation(standing: Standings) -> str:
    """Return the recommended agent for an arm with unknown parameters, its cost, and where it breaks."""
    if not (known := standing.buildable(LAB_SCENARIO)):
        return f"Nobody who could act on a real arm has played `{LAB_SCENARIO}`."
    best, *others = known
    said = [
        f"Take `{best}` for an arm whose payload, stiffness and delay nobody knows (`{LAB_SCENARIO}`).",
        _settling_sentence(standing, best, LAB_SCENARIO),
        f"It needs to know: {_needs(best)}.",
        _cost_sentence(standing, best, [LAB_SCENARIO]),
        *_breakdown_sentences(standing, best),
    ]
    if others:
        won = standing.better(best, others[0], [LAB_SCENARIO])
        said += [f"The next is `{others[0]}`. {_settling_sentence(standing, others[0], LAB_SCENARIO)}"]
        said += [f"The first has the larger reward in {_share(won)} of the same episodes."] if won else []
    if one := standing.values(REFERENCE_AGENTS[1], LAB_SCENARIO, "settling_time"):
        said.append(f"An LQR that is told everything needs {median_interval(np.array([*one.values()]))[0]:.2f} s.")
    if not standing.why(best, PAYLOAD_SCENARIO):
        too = f"Where the payload alone is unknown (`{PAYLOAD_SCENARIO}`), take `{best}`, too."
        said += [too, _settling_sentence(standing, best, PAYLOAD_SCENARIO)]
    return "\n".join(said)


def _settling_sentence(standing: Standings, agent: str, scenario: str) -> str:
    """How many episodes of a scenario settle, and when."""
    settled, time = standing.settled(agent, scenario)
    when = f", half of them within {-time:.2f} s" if np.isfinite(time) else ""
    return f"It settles {100.0 * settled:.0f} % of the episodes{when}."


def _cost_sentence(standing: Standings, agent: str, scenarios: list[str]) -> str:
    action, start = standing.cost(agent, scenarios)
    return f"An action takes {_number(action)} microseconds, and the start of an episode {_number(1e-3 * start)} ms."


def _breakdown_sentences(standing: Standings, agent: str) -> list[str]:
    """Where an agent breaks, and where it did not play."""
    broken = [
        f"`{_short_name(scenario)}`" for scenario in _all_scenarios(standing) if _is_broken(standing, agent, scenario)
    ]
    unplayed = [f"`{_short_name(scenario)}`" for scenario in _all_scenarios(standing) if standing.why(agent, scenario)]
    said = f"It breaks in {', '.join(broken)}." if broken else "It breaks in none of the scenarios that it played."
    return [said, *([f"It did not play: {', '.join(unplayed)}."] if unplayed else [])]


def _card(standing: Standings, agent: str) -> Section:
    """Return the values of the card of an agent."""
    description, tuning = describe_agent(agent)
    costs = [] if agent in LAWLESS_AGENTS else [_cost_sentence(standing, agent, standing.scenarios)]
    notes = [*costs, *_breakdown_sentences(standing, agent)]
    return {"agent": agent, "description": description, "needs": _needs(agent), "tuning": tuning, "notes": notes}


def summary_rows(standing: Standings, scenarios: list[str]) -> list[list[str]]:
    """Return a row for each agent: its name, and its result in each scenario."""
    return [[f"`{each}`", *(_result(standing, each, name) for name in scenarios)] for each in standing.agents]


def _result(standing: Standings, agent: str, scenario: str, seeds: frozenset[int] | None = None) -> str:
    """The part of the episodes that settles and the median time; the score where goals move; of some seeds alone."""
    if standing.why(agent, scenario):
        return "no row"
    if "settling_time" in {each.name for each in _scenario_metrics(scenario)}:
        settled, time = standing.settled(agent, scenario, seeds)
        return f"{100.0 * settled:.0f} %" + (f", {-time:.2f} s" if np.isfinite(time) else "")
    score = standing.score(agent, scenario)
    return "no scale" if score is None else f"score {_number(score[0])}"


def _plant_section(standing: Standings, scenario: str, names: list[str]) -> Section:
    """Return the section of a scenario on other plants, beside the same episodes on the usual one."""
    heads = ["agent", *(name.partition("@")[2] or "usual" for name in names)]
    compared = _comparison(standing, names, names[1:], dict.fromkeys(names, "on another plant"))
    return {"name": scenario, "heads": heads, **compared}


def _sweep_section(standing: Standings, name: str) -> Section:
    """Return the section of a sweep."""
    values = {scenario: f"{sweep_value(scenario):g}" for scenario in standing.sweeps[name]}
    compared = _comparison(standing, [*values], [*values], {each: f"at {value}" for each, value in values.items()})
    return {"name": name, "heads": [_sweep_label(name), *values.values()], "chart": _chart_name(name), **compared}


def _sweep_label(name: str) -> str:
    """Return quantity and unit of a sweep."""
    return SWEEPS[name.removesuffix(GIVEN).rpartition("/")[2]].text


def _comparison(standing: Standings, scenarios: list[str], own: list[str], places: dict[str, str]) -> Section:
    """Return results in scenarios, of the agents and episodes that some of `own` have; `places` name them in notes."""
    seeds = frozenset(seed for name, _, seed in standing.results.rows if name in own)
    there = [each for each in standing.agents if any(not standing.why(each, name) for name in own)]
    why = {(each, standing.why(each, name)): places[name] for each in there for name in scenarios}
    never = ", ".join(f"`{each}`" for each in standing.agents if each not in there)
    return {
        "episodes": len(seeds),
        "rows": [[f"`{each}`", *(_result(standing, each, name, seeds) for name in scenarios)] for each in there],
        "notes": [f"`{each}` has no row {place}: {words}." for (each, words), place in why.items() if words]
        + [f"Nothing was played by {never}."] * bool(never),
    }


def _all_scenarios(standing: Standings) -> list[str]:
    return [*standing.scenarios, *(scenario for each in standing.sweeps.values() for scenario in each)]


def _is_broken(standing: Standings, agent: str, scenario: str) -> bool:
    if standing.why(agent, scenario):
        return False
    if "settling_time" in {each.name for each in _scenario_metrics(scenario)}:
        return standing.settled(agent, scenario)[0] < BREAKDOWN_LEVEL
    score = standing.score(agent, scenario)
    return score is not None and score[0] < BREAKDOWN_LEVEL


def _overall_rows(standing: Standings) -> list[list[str]]:
    """Return a row for each agent over all scenarios that count."""
    count, rows = len(standing.counted), []
    for agent, after in zip(standing.agents, [*standing.agents[1:], ""], strict=True):
        won = standing.better(agent, after, standing.counted) if after else None
        action, start = standing.cost(agent, standing.scenarios)
        trained = training_seconds(agent)
        rows.append([
            f"`{agent}`", _needs(agent), _interval(standing.whole[agent]),
            f"{count - len(standing.missed(agent))} of {count}", _share(won) if won else "-",
            _number(action), _number(1e-3 * start), "-" if trained is None else _number(trained / 60.0),
        ])  # fmt: skip
    return rows


def _scenario_section(standing: Standings, scenario: str) -> Section:
    """Return the section of a scenario."""
    figures, times = _scenario_metrics(scenario), optimised_settling_times(find_scenario(scenario).environment)
    there = [each for each in standing.agents if not standing.why(each, scenario)]
    scores = {each: standing.score(each, scenario) or (np.nan,) * 3 for each in there}
    there.sort(key=lambda each: -np.nan_to_num(scores[each][0], nan=0.0))
    slews = "settling_time" in {figure.name for figure in figures}
    rows = []
    for agent in there:
        cells = [_cell(figure, standing.values(agent, scenario, figure.name)) for figure in figures]
        for name in [DAMPING] * slews + [TIME_RATIO] * bool(times):
            cells.append(_interval(median_interval(np.array([*standing.values(agent, scenario, name).values()]))))
        rows.append([f"`{agent}`", _interval(scores[agent]), *cells, _number(standing.cost(agent, [scenario])[0])])
    return {
        "name": scenario,
        "short": _short_name(scenario),
        "episodes": len({seed for place, _, seed in standing.results.rows if place == scenario}),
        "heads": ["agent", "score", *(figure.head for figure in figures), *["damping"] * slews,
                  *["times optimised"] * bool(times), "action, us"],
        "rows": rows,
        "notes": _notes(standing, scenario, bool(times)),
    }  # fmt: skip


def _notes(standing: Standings, scenario: str, times: bool) -> list[str]:
    """Why cells of a scenario are empty, and who knows a wrong arm."""
    said = [f"`{each}` has no row: {standing.why(each, scenario)}."
            for each in standing.agents if standing.why(each, scenario)]  # fmt: skip
    if not standing.scale(scenario):
        said.append("There is no score: the ends of the scale are too close, or were not played.")
    if not times:
        said.append("There is no multiple of the optimised slew: no table holds slews of this scenario.")
    drawn = find_scenario(scenario).environment.disturbances
    if drawn is not None and set(drawn.effects) & set(PARAMETERS):
        there = [each for each in standing.agents if not standing.why(each, scenario)]
        wrong = [
            f"`{each}`" for each in there if {"model"} == {"model", "true parameters"} & set(required_information(each))
        ]
        said += [f"The nominal arm is known to {', '.join(wrong)}: a wrong one here."] if wrong else []
    return [*said, "A dash is no number: more than half of the episodes did not settle, or failed.",
            "As a damping it says that the tip does not swing in half of them."]  # fmt: skip


def draw_charts(standing: Standings, folder: Path, sweeps_only: bool = False) -> list[Path]:
    """Draw the chart of the scenarios, and one for each sweep; return their paths.

    Raises:
        ImportError: without Matplotlib.
    """
    counted, paths = [] if sweeps_only else standing.counted, []
    curves = {each: _curve(standing, each, counted, np.arange(float(len(counted)))) for each in standing.agents}
    if counted:
        scores = {each: standing.scores([each], counted)[0] for each in standing.agents if not standing.missed(each)}
        profiles = {
            each: (THRESHOLDS, performance_profile(own, THRESHOLDS)) for each, own in scores.items() if own.size
        }
        _score_chart(curves, "", folder / CHART, counted, profiles)
        paths.append(folder / CHART)
    for name, scenarios in standing.sweeps.items():
        places = np.array([sweep_value(scenario) for scenario in scenarios])
        there = [each for each in standing.agents if any(standing.score(each, scenario) for scenario in scenarios)]
        curves = {each: _curve(standing, each, scenarios, places) for each in there}
        paths.append(folder / _chart_name(name))
        _score_chart(curves, _sweep_label(name), paths[-1])
    return paths


def _curve(standing: Standings, agent: str, scenarios: list[str], places: np.ndarray) -> _ScoreCurve:
    found = np.array([standing.score(agent, scenario) or (np.nan,) * 3 for scenario in scenarios]).reshape(-1, 3)
    return _ScoreCurve(places, *found.T)


def _scenario_metrics(scenario: str) -> tuple[Metric, ...]:
    figures = task_metrics(find_scenario(scenario).environment.task)
    return tuple(each for each in figures if each.name != "reward")  # which the score shows


def _cell(figure: Metric, values: dict[int, float]) -> str:
    numbers = figure.scale * np.array([*values.values()])
    if figure.many == MEDIAN:
        return _interval(median_interval(numbers))
    if figure.many == MEAN:
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
    return ", ".join(required_information(agent)) or ("nothing" if agent in LAWLESS_AGENTS else "its motors")


def _short_name(scenario: str) -> str:
    """A scenario without the usual environment."""
    return scenario.removeprefix(f"{DEFAULT_ID}/")


def _chart_name(name: str) -> str:
    return f"league-{name.replace('/', '-')}.png"


def _score_chart(
    curves: Mapping[str, _ScoreCurve], what: str, path: str | Path, names: Sequence[str] = (),
    profiles: Mapping[str, tuple[Array, Array]] | None = None,
) -> None:  # fmt: skip
    """Draw the scores of agents, with their performance profiles if there are any.

    Args:
        curves: agent -> its scores.
        what: the places are, the label of their axis.
        path: of the picture.
        names: of the places 0, 1 and so on; without them the places are numbers, and lines join them.
        profiles: agent -> thresholds and parts of the episodes above them.

    Raises:
        ImportError: without Matplotlib.
    """
    figure = new_figure((11.0 if profiles else 7.5, 5.0), 120.0, layout="constrained")
    panels = figure.subplots(1, 2, width_ratios=(2.0, 1.0)) if profiles else [figure.add_subplot()]
    for number, (agent, curve) in enumerate(curves.items()):
        look, shift = _line_style(number), MARKER_SPACING * (number - 0.5 * (len(curves) - 1)) if names else 0.0
        spread = [curve.middle - curve.low, curve.high - curve.middle]
        line = {"linestyle": "none"} if names else {}
        panels[0].errorbar(curve.places + shift, curve.middle, spread, label=agent, capsize=2, **(look | line))
        if profiles and agent in profiles:
            panels[1].plot(*profiles[agent], **(look | {"marker": ""}))
    panels[0].set(ylabel="score: 0 no torque, 1 told all", xlabel=what)
    if names:
        panels[0].set_xticks(range(len(names)), names, rotation=30, ha="right", rotation_mode="anchor")
    if profiles:
        panels[1].set(xlabel="score", ylabel="part of the episodes above it", ylim=(0.0, 1.02))
    for axes in panels:
        axes.grid(color=LIGHT, linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    for level in (0.0, 1.0):
        panels[0].axhline(level, color=MIDDLE, linewidth=0.8)
    panels[0].set_ylim(bottom=max(-1.0, panels[0].get_ylim()[0]))  # who drops the arm drops out of the picture
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False)
    figure.savefig(path)


def _line_style(number: int) -> dict[str, Any]:
    again, colour = divmod(number, len(LINK_COLOURS))
    look = {"color": LINK_COLOURS[colour], "marker": MARKS[(colour + again) % len(MARKS)]}
    return look | {"linestyle": ("-", "--", ":")[again % 3], "linewidth": 1.4, "markersize": 5}
