"""League page: recommended agents by the information given, heat map, limits in sweeps, and rules."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from textwrap import fill

import numpy as np

from flexman_gym.common.files import write_file
from flexman_gym.common.formatting import number_text
from flexman_gym.common.markdown import markdown_table
from flexman_gym.envs.config.named_environments import DEFAULT_ID, NAMED_ENVIRONMENTS
from flexman_gym.evaluation.agent_info import INFORMATION, describe_agent
from flexman_gym.evaluation.agent_spec import SIMPLE_AGENTS
from flexman_gym.evaluation.shares import intervals_text
from flexman_gym.metrics.signals import BAND
from flexman_gym.toolbox.league.charts import (
    CHART,
    SWEEP_CHART,
    agents_by_information,
    draw_charts,
    result_cell,
)
from flexman_gym.toolbox.league.details import (
    short_name,
    sweep_text,
)
from flexman_gym.toolbox.league.rows import BLOCK, REFERENCE_AGENTS, LeagueRows
from flexman_gym.toolbox.league.scenarios import GIVEN, LAB_SCENARIO, PLANTS, find_scenario
from flexman_gym.toolbox.league.standings import Standings

PAGE, COMPUTED = "league.md", "Computed with "
KNOWN, UNKNOWN = DEFAULT_ID, f"{DEFAULT_ID}/unknown"  # scenarios by which agents are chosen
COMPARED = (KNOWN, UNKNOWN, f"{DEFAULT_ID}/uncertain", f"{DEFAULT_ID}/unmodelled")  # columns of the first table
WELL = 0.95  # share of settled episodes at which an agent copes with a value of a sweep
TEXT = """# League of controllers and policies

All agents are evaluated in the same {episodes} of each scenario{few}. In `{known}`, an arm with
flexible links, of {reach:g} m in total, moves its tip to a target and stops there. An episode lasts {horizon:g} s. It
is settled if the tip stays within {band:.0f} mm of the target for at least the last second; an agent that needs longer
settles nothing.

## Choose an agent

{recommendation}

The best agents for each kind of information that they are given, with the share of settled episodes and the median
settling time. *Action* is the CPU time for one action of one arm, of {block} simulated together, as the median over the
scenarios. Agents with *true state and parameters* are oracles: they are given the true parameters or, as `optimised`,
the nominal model and the starts and goals of the episodes in advance.
{intervals}

{choice}

## Results

<div class="wide" markdown>

![Share of settled episodes of each agent in each scenario]({chart})

</div>

Upper number: settled episodes, %. Lower number: median settling time, s. For moving goals (Track, Hold) the number is
the median RMS tip error in mm, and the shade the error of `{oracle}` relative to it. No number: not run, because the
agent needs another arm, or information that cannot be measured there. A name such as `payload` is a condition of
`{known}`.

<div class="narrow" markdown>

{results}

</div>

## Limits

{limits}

## Rules

- Test episodes have the seeds 9000 to 9099. Nothing is selected on them; `flexman league` rejects a run that used one.
  Seeds below 100 and from 5000 to 8999 are for tuning and selection, those from 1000000 on for the episodes of a
  training (run 0 begins there; the seed of a run is not that of its episodes).
- One agent for all scenarios, with the sensors of its training. `flexman league --add FOLDER` adds a training run.
- A controller may be tuned with as much CPU time as the training of the policy with which it is compared.
- Rows have a hash of scenario, agent, code and package versions, and are equal to the bit in every repetition.

All rows are in `rows.csv` (episodes) and `cells.csv` (CPU times, reasons for missing rows) beside this page.
`flexman league --redraw --folder FOLDER` writes page and charts from them; `--details` prints all metrics of a
scenario, the data of an agent, a sweep (`{known}/payload=`), or the scores (`overall`).
"""
LIMITS = """Values of a parameter at which at least {well:.0f} % of the {sweep} settle. *Given* is the range for which
the controllers are designed; outside of it their model is wrong. The last rows are the settled shares, %, of the same
{plant} in other simulations, of which the controllers are not informed.

{intervals}

{table}

{plants}
{chart}
"""
SWEEPS = """
<div class="wide" markdown>

![Settled episodes over the values of each parameter]({chart})

Settled shares over the values of each parameter, of {sweep} for each value.

</div>
"""


def write_page(results: LeagueRows, folder: Path, computer: str | None = None) -> None:
    """Write the page and its charts to a folder; without Matplotlib only the page.

    Args:
        results: rows and cells.
        folder: folder of page and charts.
        computer: computer and versions that made the rows; None for those of the present page, "" if there is none.
    """
    standings = Standings(results)
    page = folder / PAGE
    if computer is None:
        lines = page.read_text(encoding="utf-8").splitlines() if page.is_file() else []
        computer = next((line for line in lines if line.startswith(COMPUTED)), "").removeprefix(COMPUTED).rstrip(".")
    try:
        draw_charts(standings, folder)
    except ImportError as error:
        print(f"no charts: {error}")
    write_file(page, _page_text(standings) + f"\n{COMPUTED}{computer}.\n" * bool(computer))


def _page_text(standings: Standings) -> str:
    """Return the page in Markdown, without the computer that made the rows."""
    reach = sum(link.length for link in NAMED_ENVIRONMENTS[DEFAULT_ID].arm.links)
    return TEXT.format(
        episodes=_count_text(max(_counts(standings, standings.scenarios).values(), default=0)),
        few=_fewer(standings),
        intervals=_intervals(standings, standings.scenarios),
        known=KNOWN,
        oracle=REFERENCE_AGENTS[1],
        reach=reach,
        band=1e3 * BAND * reach,
        horizon=NAMED_ENVIRONMENTS[DEFAULT_ID].horizon,
        recommendation=_recommendation(standings),
        choice="\n".join(_choice_table(standings)),
        block=BLOCK,
        chart=CHART,
        results="\n".join(_results_table(standings)),
        limits=_limits(standings),
    )


def _counts(standings: Standings, scenarios: Iterable[str]) -> dict[tuple[str, str], int]:
    """Return (agent, scenario) -> number of episodes, of those that were run."""
    pairs = ((agent, scenario) for scenario in scenarios for agent in standings.agents)
    counts = {pair: len(standings.values(*pair, "reward")) for pair in pairs}
    return {pair: count for pair, count in counts.items() if count}


def _count_text(*counts: int) -> str:
    return f"{' or '.join(str(count) for count in sorted(set(counts))) or 'no'} episodes"


def _intervals(standings: Standings, scenarios: Iterable[str]) -> str:
    """Return the sentence on the intervals of shares of the most episodes of scenarios; "" without rows."""
    most = max(_counts(standings, scenarios).values(), default=0)
    return intervals_text(most) if most else ""


def _fewer(standings: Standings) -> str:
    """Return the scenarios in which agents have fewer episodes than elsewhere, as the end of a clause; "" for none."""
    counts = _counts(standings, standings.scenarios)
    fewer = {pair: count for pair, count in counts.items() if count < max(counts.values())}
    texts = (f"`{agent}` in `{short_name(scenario)}`: {count}" for (agent, scenario), count in fewer.items())
    return f" ({', '.join(texts)})" if fewer else ""


def _recommendation(standings: Standings) -> str:
    """Return the recommended agent for an arm with uncertain parameters, with its settling, information and cost."""
    if not (agents := standings.realisable(LAB_SCENARIO)):
        return f"No agent that is realisable on hardware was run in `{LAB_SCENARIO}`."
    best, *others = agents
    action, start = standings.cost(best, standings.scenarios)
    sentences = [
        f"For an arm with unknown payload and stiffness and a known delay (`{LAB_SCENARIO}`), use `{best}`.",
        _settling_sentence(standings, best),
        f"It needs: {describe_agent(best).needs}".replace("of the model", "of the model, ranges of the parameters")
        + ".",
        f"An action takes {number_text(action)} us of CPU time, and the start of an episode "
        f"{number_text(1e-3 * start)} ms.",
    ]
    if others:
        sentences.append(f"The second is `{others[0]}`. {_settling_sentence(standings, others[0])}")
        if won := standings.improvement_probability(best, others[0], [LAB_SCENARIO]):
            sentences.append(f"The first has the larger reward in {100.0 * won[0]:.0f} % of the same episodes.")
    if not standings.why(REFERENCE_AGENTS[1], LAB_SCENARIO):
        time = -standings.settled(REFERENCE_AGENTS[1], LAB_SCENARIO)[1]
        sentences.append(f"The median settling time of an LQR with the true state and parameters is {time:.2f} s.")
    return fill(" ".join(sentences), 118, break_long_words=False, break_on_hyphens=False)


def _settling_sentence(standings: Standings, agent: str) -> str:
    settled, time = standings.settled(agent, LAB_SCENARIO)
    when = f", half of them within {-time:.2f} s" if np.isfinite(time) else ""
    return f"It settles {100.0 * settled:.0f} % of the episodes{when}."


def _choice_table(standings: Standings) -> list[str]:
    """Return a table of the best agents of each kind of information, in the known and in the unknown arm."""
    columns = [each for each in COMPARED if each in standings.scenarios]
    groups: dict[str, list[str]] = {name: [] for name in reversed(INFORMATION)}
    for agent in standings.agents:
        if agent not in SIMPLE_AGENTS:
            groups[describe_agent(agent).kind].append(agent)
    rows = []
    for given, agents in groups.items():
        best = []
        for scenario in (each for each in (KNOWN, UNKNOWN) if each in columns):
            run = [each for each in agents if not standings.why(each, scenario)]
            best += [max(run, key=lambda each: standings.settled(each, scenario))] if run else []
        for agent in dict.fromkeys(best):
            results = [standings.settling_text(agent, each) for each in columns]
            rows.append([given, f"`{agent}`", *results, number_text(standings.cost(agent, standings.scenarios)[0])])
    return markdown_table(["given", "agent", *(f"`{short_name(each)}`" for each in columns), "action, CPU us"], rows)


def _results_table(standings: Standings) -> list[str]:
    """Return the numbers of the heat map as a table, for screens on which the map is too small."""
    rows = []
    for agent in agents_by_information(standings):
        cells = [result_cell(standings, agent, each) for each in standings.scenarios]
        rows.append([f"`{agent}`", *(", ".join(filter(None, [cell.number or "-", cell.time])) for cell in cells)])
    return markdown_table(["agent", *(f"`{short_name(each)}`" for each in standings.scenarios)], rows)


def _limits(standings: Standings) -> str:
    """Return the table of limits and the chart of the sweeps."""
    if not (agents := standings.swept_agents()):
        return "No sweep of a parameter and no other simulation was run."
    rows = [
        [
            _sweep_name(name),
            find_scenario(next(iter(values))).given_values(),
            *(_well_settled(standings, agent, values) for agent in agents),
        ]
        for name, values in standings.sweeps.items()
    ]
    for names in standings.plants.values():
        heads = ", ".join(f"@{name.partition('@')[2] or 'usual'}" for name in names)
        rows.append(
            [f"`{short_name(names[0])}` {heads}", "-", *(_on_plants(standings, each, names) for each in agents)]
        )
    table = markdown_table(["swept", "given", *(f"`{each}`" for each in agents)], rows)
    swept = [each for values in standings.sweeps.values() for each in values]
    others = [each for names in standings.plants.values() for each in names[1:]]
    sweep, plant = (_count_text(*_counts(standings, scenarios).values()) for scenarios in (swept, others))
    chart = SWEEPS.format(chart=SWEEP_CHART, sweep=sweep) if standings.sweeps else ""
    plants = fill("; ".join(f"*@{name}*: {text}" for name, (text, _) in PLANTS.items()) + ".", 118)
    return LIMITS.format(
        well=100.0 * WELL,
        sweep=sweep,
        plant=plant,
        intervals=_intervals(standings, [*swept, *others]),
        table="\n".join(table),
        plants=plants,
        chart=chart,
    ).rstrip()


def _on_plants(standings: Standings, agent: str, names: Sequence[str]) -> str:
    """Return the settled shares on all plants, %, in the episodes of the plants other than the usual one."""
    seeds = {seed for scenario, _, seed in standings.results.rows if scenario in names[1:]}
    shares = (
        "-" if standings.why(agent, each) else f"{100.0 * standings.settled(agent, each, seeds)[0]:.0f}"
        for each in names
    )
    return ", ".join(shares) + " %"


def _sweep_name(name: str) -> str:
    where = short_name(name.removesuffix(GIVEN)).rpartition("/")[0]
    return sweep_text(name) + (f" (`{where}`)" if where else "")


def _well_settled(standings: Standings, agent: str, values: Mapping[str, float]) -> str:
    """Return the values of a sweep at which an agent settles WELL, as ranges of neighbouring values."""
    if all(standings.why(agent, each) for each in values):
        return "not run"
    well = [(not standings.why(agent, each) and standings.settled(agent, each)[0] >= WELL, value)
            for each, value in values.items()]  # fmt: skip
    runs = [[value for _, value in run] for passed, run in groupby(well, key=lambda each: each[0]) if passed]
    return ", ".join(f"{run[0]:g}" if len(run) == 1 else f"{run[0]:g} to {run[-1]:g}" for run in runs) or "none"
