"""League page: recommendation, tables and charts, made from the rows."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.computer import computer_text
from flexman_gym.common.markdown import bullets, introduced_table, markdown_table
from flexman_gym.draw.style import LIGHT, LINK_COLOURS, MIDDLE, new_figure
from flexman_gym.envs.config.named_environments import DEFAULT
from flexman_gym.evaluation.agent import BASELINES
from flexman_gym.evaluation.agent_info import describe_agent, required_information, training_seconds
from flexman_gym.evaluation.metrics import MEAN, MEDIAN, Metric, task_metrics
from flexman_gym.league.rows import DAMPING, MULTIPLE, SCALE, LeagueRows, optimised_times
from flexman_gym.league.scenarios import LAB_SCENARIO, PLANTS, SWEEPS, find_scenario
from flexman_gym.league.standings import Interval, Standings, sweep_value
from flexman_gym.metrics import mean, median_interval, performance_profile, stratified_interval
from flexman_gym.simulation.parameters import PARAMETERS

PAGE, CHART = "league.md", "league.png"
LOADED = f"{DEFAULT}/payload"
BROKEN = 0.5  # of the episodes that settle, or of the score where goals move: less is broken
IDLE = ("zero", "random")
THRESHOLDS = np.linspace(-0.2, 1.4, 81)
TEXT = Path(__file__).parent / "league.md"  # with names in braces
HEADS = ("entrant", "needs", "score", "venues", "better", "action, us", "start, ms", "training, min")
MARKS = "osD^vP"  # markers of entrants in a chart
SHIFT = 0.05  # distance of two entrants in a chart, as a part of that of two scenarios


class _ScoreCurve(NamedTuple):
    """Scores of an entrant at k places and their intervals, (k,) each; nan for no score."""

    places: Array
    middle: Array
    low: Array
    high: Array


def write_page(book: LeagueRows, folder: Path) -> None:
    """Writes the page and its charts into a folder; without Matplotlib the page alone."""
    standing = Standings(book)
    try:
        draw_charts(standing, folder)
    except ImportError as error:
        print(f"no charts: {error}")
    (folder / PAGE).write_text(page_text(standing), encoding="utf-8")


def page_text(standing: Standings) -> str:
    """Gives the page."""
    said = {
        "conclusion": conclusion(standing),
        "block": max((cell.end - cell.first for cell in standing.book.cells.values()), default=0),
        "glance": _glance(standing),
        "cards": "\n".join(line for entrant in standing.entrants for line in _card(standing, entrant)),
        "whole": _whole(standing),
        "chart": CHART,
        "venues": "\n".join(line for venue in standing.venues for line in _venue(standing, venue)),
        "sweeps": "\n".join(line for name in standing.sweeps for line in _sweep(standing, name)),
        "plants": "\n".join(bullets(f"*{name}*: {what}" for name, (what, _) in PLANTS.items())),
        "physical": "\n".join(_physical(standing)),
        "machine": computer_text(),
    }
    return TEXT.read_text(encoding="utf-8").format(**said)


def conclusion(standing: Standings) -> str:
    """Says which entrant to take for an arm that nobody knows, what it costs and where it breaks."""
    if not (known := standing.buildable(LAB_SCENARIO)):
        return f"Nobody who could act on a real arm has played `{LAB_SCENARIO}`."
    best, *others = known
    said = [
        f"Take `{best}` for an arm whose payload, stiffness and delay nobody knows (`{LAB_SCENARIO}`).",
        _settles(standing, best, LAB_SCENARIO),
        f"It needs to know: {_needs(best)}.",
        _costs(standing, best, [LAB_SCENARIO]),
        *_breaks(standing, best),
    ]
    if others:
        won = standing.better(best, others[0], [LAB_SCENARIO])
        said += [f"The next is `{others[0]}`. {_settles(standing, others[0], LAB_SCENARIO)}"]
        said += [f"The first has the larger reward in {_share(won)} of the same episodes."] if won else []
    if one := standing.values(SCALE[1], LAB_SCENARIO, "settling_time"):
        said.append(f"An LQR that is told everything needs {median_interval(np.array([*one.values()]))[0]:.2f} s.")
    if not standing.why(best, LOADED):
        too = f"Where the payload alone is unknown (`{LOADED}`), take `{best}`, too."
        said += [too, _settles(standing, best, LOADED)]
    return "\n".join(said)


def _settles(standing: Standings, entrant: str, venue: str) -> str:
    """How many episodes of a venue settle, and when."""
    settled, time = standing.settled(entrant, venue)
    when = f", half of them within {-time:.2f} s" if np.isfinite(time) else ""
    return f"It settles {100.0 * settled:.0f} % of the episodes{when}."


def _costs(standing: Standings, entrant: str, venues: list[str]) -> str:
    action, start = standing.cost(entrant, venues)
    return f"An action takes {_number(action)} microseconds, and the start of an episode {_number(1e-3 * start)} ms."


def _breaks(standing: Standings, entrant: str) -> list[str]:
    """Where an entrant breaks, and where it did not play."""
    broken = [f"`{_short(venue)}`" for venue in _everywhere(standing) if _is_broken(standing, entrant, venue)]
    unplayed = [f"`{_short(venue)}`" for venue in _everywhere(standing) if standing.why(entrant, venue)]
    said = f"It breaks in {', '.join(broken)}." if broken else "It breaks in none of the venues that it played."
    return [said, *([f"It did not play: {', '.join(unplayed)}."] if unplayed else [])]


def _card(standing: Standings, entrant: str) -> list[str]:
    """What there is to know of an entrant."""
    what, tuned = describe_agent(entrant)
    said = [f"It is {what}.", f"It needs to know: {_needs(entrant)}.", f"Tuning or training: {tuned}."]
    if entrant not in IDLE:
        said.append(_costs(standing, entrant, standing.venues))
    return [f"### Card: {entrant}", "", *bullets([*said, *_breaks(standing, entrant)]), ""]


def _glance(standing: Standings) -> str:
    """What every entrant does in every venue."""
    names = map(_short, standing.venues)
    rows = [[f"`{each}`", *(_result(standing, each, venue) for venue in standing.venues)] for each in standing.entrants]
    absent = [f"`{each}`" for each in BASELINES if each not in standing.whole]
    said = ["", f"Not played yet: {', '.join(absent)}."] if absent else []
    return "\n".join([*markdown_table(["entrant", *names], rows), *said])


def _result(standing: Standings, entrant: str, venue: str, seeds: frozenset[int] | None = None) -> str:
    """The part of the episodes that settles and the median time; the score where goals move; of some seeds alone."""
    if standing.why(entrant, venue):
        return "no row"
    if "settling_time" in {each.name for each in _figures(venue)}:
        settled, time = standing.settled(entrant, venue, seeds)
        return f"{100.0 * settled:.0f} %" + (f", {-time:.2f} s" if np.isfinite(time) else "")
    score = standing.score(entrant, venue)
    return "no scale" if score is None else f"score {_number(score[0])}"


def _physical(standing: Standings) -> list[str]:
    """What entrants do on other plants, beside the same episodes on the usual one."""
    result = []
    for venue, names in standing.physical.items():
        seeds = frozenset(seed for name, _, seed in standing.book.rows if name in names[1:])
        plants = [name.partition("@")[2] or "usual" for name in names]
        there = [each for each in standing.entrants if any(not standing.why(each, name) for name in names[1:])]
        rows = [[f"`{each}`", *(_result(standing, each, name, seeds) for name in names)] for each in there]
        table = introduced_table(f"{len(seeds)} episodes.", ["entrant", *plants], rows)
        result += [f"### {venue} on other plants", "", *table]
        why = {(each, standing.why(each, name)) for each in there for name in names}
        never = [f"`{each}`" for each in standing.entrants if each not in there]
        said = [f"`{each}` has no row on another plant: {words}." for each, words in sorted(why) if words]
        result += [*bullets(said + ([f"Nothing was played by {', '.join(never)}."] if never else [])), ""]
    return result or ["It was not played."]


def _everywhere(standing: Standings) -> list[str]:
    return [*standing.venues, *(venue for each in standing.sweeps.values() for venue in each)]


def _is_broken(standing: Standings, entrant: str, venue: str) -> bool:
    if standing.why(entrant, venue):
        return False
    if "settling_time" in {each.name for each in _figures(venue)}:
        return standing.settled(entrant, venue)[0] < BROKEN
    score = standing.score(entrant, venue)
    return score is not None and score[0] < BROKEN


def _whole(standing: Standings) -> str:
    count, rows = len(standing.counted), []
    for entrant, after in zip(standing.entrants, [*standing.entrants[1:], ""], strict=True):
        won = standing.better(entrant, after, standing.counted) if after else None
        action, start = standing.cost(entrant, standing.venues)
        trained = training_seconds(entrant)
        rows.append([
            f"`{entrant}`", _needs(entrant), _interval(standing.whole[entrant]),
            f"{count - len(standing.missed(entrant))} of {count}", _share(won) if won else "-",
            _number(action), _number(1e-3 * start), "-" if trained is None else _number(trained / 60.0),
        ])  # fmt: skip
    counted = ", ".join(f"`{venue}`" for venue in standing.counted)
    return "\n".join(introduced_table(f"Venues: {counted}.", HEADS, rows))


def _venue(standing: Standings, venue: str) -> list[str]:
    """The section of a venue."""
    environment = find_scenario(venue).environment
    figures, times = _figures(venue), optimised_times(environment)
    played = [each for each in standing.entrants if not standing.why(each, venue)]
    scores = {each: standing.score(each, venue) or (np.nan,) * 3 for each in played}
    played.sort(key=lambda each: -np.nan_to_num(scores[each][0], nan=0.0))
    slews = "settling_time" in {figure.name for figure in figures}
    heads = ["entrant", "score", *(figure.head for figure in figures), *(["damping"] if slews else []),
             *(["times optimised"] if times else []), "action, us"]  # fmt: skip
    rows = []
    for entrant in played:
        cells = [_cell(figure, standing.values(entrant, venue, figure.name)) for figure in figures]
        for name in [DAMPING] * slews + [MULTIPLE] * bool(times):
            cells.append(_interval(median_interval(np.array([*standing.values(entrant, venue, name).values()]))))
        rows.append([f"`{entrant}`", _interval(scores[entrant]), *cells, _number(standing.cost(entrant, [venue])[0])])
    count = len({seed for place, _, seed in standing.book.rows if place == venue})
    lines = [f"### {venue}", "", *introduced_table(f"{count} episodes.", heads, rows)]
    return [*lines, *bullets(_notes(standing, venue, bool(times))), ""]


def _notes(standing: Standings, venue: str, times: bool) -> list[str]:
    """Why cells of a venue are empty, and who knows a wrong arm."""
    said = [f"`{each}` has no row: {standing.why(each, venue)}."
            for each in standing.entrants if standing.why(each, venue)]  # fmt: skip
    if not standing.scale(venue):
        said.append("There is no score: the ends of the scale are too close, or were not played.")
    if not times:
        said.append("There is no multiple of the optimised slew: no table holds slews of this venue.")
    drawn = find_scenario(venue).environment.disturbed
    if drawn is not None and set(drawn.effects) & set(PARAMETERS):
        there = [each for each in standing.entrants if not standing.why(each, venue)]
        wrong = [
            f"`{each}`" for each in there if {"model"} == {"model", "true parameters"} & set(required_information(each))
        ]
        said += [f"The nominal arm is known to {', '.join(wrong)}: a wrong one here."] if wrong else []
    return [*said, "A dash is no number: more than half of the episodes did not settle, or failed.",
            "As a damping it says that the tip does not swing in half of them."]  # fmt: skip


def _sweep(standing: Standings, name: str) -> list[str]:
    """The section of a sweep."""
    venues = standing.sweeps[name]
    played = [each for each in standing.entrants if any(not standing.why(each, venue) for venue in venues)]
    rows = [[f"`{entrant}`", *(_result(standing, entrant, venue) for venue in venues)] for entrant in played]
    swept = SWEEPS[name.rpartition("/")[2]]
    heads = [swept.what, *(f"{sweep_value(venue):g}" for venue in venues)]
    count = len({seed for venue, _, seed in standing.book.rows if venue in venues})
    text, picture = f"{count} episodes: what settles, and when.", f"![Scores over {swept.what}]({_file(name)})"
    lines = [f"## Sweep: {name}", "", picture, "", *introduced_table(text, heads, rows)]
    why = {(each, standing.why(each, venue)): sweep_value(venue)
           for each in played for venue in venues if standing.why(each, venue)}  # fmt: skip
    said = [f"`{each}` has no row at {value:g}: {words}." for (each, words), value in why.items()]
    never = ", ".join(f"`{each}`" for each in standing.entrants if each not in played)
    return ["", *lines, *bullets([*said, *([f"Nothing was played by {never}."] if never else [])])]


def draw_charts(standing: Standings, folder: Path, sweeps_only: bool = False) -> list[Path]:
    """Draws the chart of the venues, and one for each sweep; returns their paths.

    Raises:
        ImportError: without Matplotlib.
    """
    counted, paths = [] if sweeps_only else standing.counted, []
    curves = {each: _curve(standing, each, counted, np.arange(float(len(counted)))) for each in standing.entrants}
    if counted:
        scores = {each: standing.scores([each], counted)[0] for each in standing.entrants if not standing.missed(each)}
        profiles = {
            each: (THRESHOLDS, performance_profile(own, THRESHOLDS)) for each, own in scores.items() if own.size
        }
        _score_chart(curves, "", folder / CHART, counted, profiles)
        paths.append(folder / CHART)
    for name, venues in standing.sweeps.items():
        places = np.array([sweep_value(venue) for venue in venues])
        there = [each for each in standing.entrants if any(standing.score(each, venue) for venue in venues)]
        curves = {each: _curve(standing, each, venues, places) for each in there}
        paths.append(folder / _file(name))
        _score_chart(curves, SWEEPS[name.rpartition("/")[2]].what, paths[-1])
    return paths


def _curve(standing: Standings, entrant: str, venues: list[str], places: np.ndarray) -> _ScoreCurve:
    found = np.array([standing.score(entrant, venue) or (np.nan,) * 3 for venue in venues]).reshape(-1, 3)
    return _ScoreCurve(places, *found.T)


def _figures(venue: str) -> tuple[Metric, ...]:
    figures = task_metrics(find_scenario(venue).environment.task)
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


def _needs(entrant: str) -> str:
    return ", ".join(required_information(entrant)) or ("nothing" if entrant in IDLE else "its motors")


def _short(venue: str) -> str:
    """A venue without the usual environment."""
    return venue.removeprefix(f"{DEFAULT}/")


def _file(name: str) -> str:
    return f"league-{name.replace('/', '-')}.png"


def _score_chart(
    curves: Mapping[str, _ScoreCurve], what: str, path: str | Path, names: Sequence[str] = (),
    profiles: Mapping[str, tuple[Array, Array]] | None = None,
) -> None:  # fmt: skip
    """Draw the scores of entrants, with their performance profiles if there are any.

    Args:
        curves: entrant -> its scores.
        what: the places are, the label of their axis.
        path: of the picture.
        names: of the places 0, 1 and so on; without them the places are numbers, and lines join them.
        profiles: entrant -> thresholds and parts of the episodes above them.

    Raises:
        ImportError: without Matplotlib.
    """
    figure = new_figure((11.0 if profiles else 7.5, 5.0), 120.0, layout="constrained")
    panels = figure.subplots(1, 2, width_ratios=(2.0, 1.0)) if profiles else [figure.add_subplot()]
    for number, (entrant, curve) in enumerate(curves.items()):
        look, shift = _look(number), SHIFT * (number - 0.5 * (len(curves) - 1)) if names else 0.0
        spread = [curve.middle - curve.low, curve.high - curve.middle]
        line = {"linestyle": "none"} if names else {}
        panels[0].errorbar(curve.places + shift, curve.middle, spread, label=entrant, capsize=2, **(look | line))
        if profiles and entrant in profiles:
            panels[1].plot(*profiles[entrant], **(look | {"marker": ""}))
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


def _look(number: int) -> dict[str, Any]:
    again, colour = divmod(number, len(LINK_COLOURS))
    look = {"color": LINK_COLOURS[colour], "marker": MARKS[(colour + again) % len(MARKS)]}
    return look | {"linestyle": ("-", "--", ":")[again % 3], "linewidth": 1.4, "markersize": 5}
