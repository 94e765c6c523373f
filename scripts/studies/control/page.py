"""Page of the controller study: one table, and the cases of the adaptive controller in sentences."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from textwrap import fill

import numpy as np

from flexman_gym.common.formatting import millimetres, percent
from flexman_gym.common.markdown import markdown_table
from flexman_gym.evaluation.shares import intervals_text, share_text
from flexman_gym.metrics import mean, stratified_interval
from studies.control.cases import EXTREMES, PARTS, RANDOM_ARMS, RRR, ControlRow
from studies.markdown import bullets
from studies.results import Results

PAGE = """# Controllers of arms with uncertain parameters

{opening}

| arms | `privileged-lqr` | `adaptive-lqr` | `lab-flexrrr` |
{table}

{caption}

- `privileged-lqr` is given the true state and parameters, which hardware cannot measure.
- `adaptive-lqr` is given the model, the ranges of the uncertain parameters and the noise. It estimates the parameters
  from the measurements `lab`, without the tip.
- `lab-flexrrr` is a policy that changes the reference of `adaptive-lqr`, with the same information.

## Other cases

Settled shares of `adaptive-lqr` with their 95 % intervals. *Given*: changes within the ranges that the controller is
given. *Extreme*: a parameter of `uncertain` at the end of its range, those that settle less than {well:.0f} %.

| case | episodes | settled |
{cases}

{remarks}

Effects of `unmodelled`, one at a time, with {few} episodes for each value:

| effect | values | settled, % |
{effects}

{intervals}

No setting was tuned on the episodes of this page. CPU times of an action are in the [league](../league/league.md).
Rows: [control.csv](control.csv), by `python -m studies control --folder docs/evidence`; with `--redraw` only the page.
"""
CAPTION = (
    "Slews: share of the {episodes} test episodes that settle, and median settling time; those of `FlexRRR-v0` are "
    "rows of the [league](../league/league.md). {intervals} *Track* and *Hold*: RMS tip error after 2 s. A dash: not "
    "run in this study."
)
AGENTS = ("privileged-lqr", "adaptive-lqr", "lab-flexrrr")
LAB, OURS = "unknown-lab", "adaptive-lqr, "  # condition, and start of the names of cases
ARMS = {  # row of the table -> end of the names of its cases
    "`FlexRRR-v0/unknown-lab`: payload and stiffness unknown, one period of delay": LAB,
    "`.../uncertain`: also friction, biases, lost samples": "uncertain",
    "`.../unmodelled`: backlash, ripple and other effects in no model": "unmodelled",
    "`FlexPlanar-v0/unknown-lab`": "FlexPlanar-v0",
    "`FlexRRR-Gravity-v0/unknown-lab`": "FlexRRR-Gravity-v0",
    "`FlexRRR-Track-v0/unknown-lab`": "FlexRRR-Track-v0",
    "`FlexRRR-Hold-v0/unknown-lab`": "FlexRRR-Hold-v0",
}
GIVEN = ("delay of 0 to 2 periods", "friction within a half", "biased readings", "three times the noise")
NOT_GIVEN = ("finer arm", "changed payload", "unmodelled friction", "unmodelled biases", "20 % of samples lost",
             "measurements a period late")  # fmt: skip
FEWER = "uncertain: ", "unmodelled: ", "random arm "  # parts of the names of cases with fewer episodes
WIDTH = 118  # characters of a line
WELL = 0.95  # share of settled episodes from which a case counts as settled


def page(rows: Sequence[ControlRow], results: Results) -> str:
    """Return the page as Markdown; rows of slews that the league has too are those of the league."""
    by_case = {row.case: _known(row, results) for row in rows}
    episodes = _counts(row for case, row in by_case.items() if not any(word in case for word in FEWER))
    few = [row for case, row in by_case.items() if any(word in case for word in FEWER[:2])]
    table = [[arms, *(_cell(_find(by_case, agent, end)) for agent in AGENTS)] for arms, end in ARMS.items()]
    ours = {case.removeprefix(OURS): row for case, row in by_case.items() if case.startswith(OURS)}
    return PAGE.format(
        opening=fill(_opening(by_case), WIDTH),
        caption=fill(CAPTION.format(episodes=episodes, intervals=_intervals(by_case.values())), WIDTH),
        well=100.0 * WELL,
        few=_counts(few),
        table=_body(4, table),
        cases=_body(3, _cases(ours)),
        remarks="\n".join(bullets(fill(each, WIDTH - 2, subsequent_indent="  ") for each in _remarks(by_case, ours))),
        effects=_body(3, (effect for each in PARTS if (effect := _effect(ours, *each)))),
        intervals=fill(_intervals(few), WIDTH),
    )


def _body(columns: int, rows: Iterable[Sequence[object]]) -> str:
    """Return the lines of a table below its header, which is in the template."""
    return "\n".join(markdown_table(["---"] * columns, rows)[1:])


def _intervals(rows: Iterable[ControlRow]) -> str:
    """Return the sentence on the intervals of shares of the largest number of episodes of rows; "" without rows."""
    return intervals_text(most) if (most := max((round(row.episodes) for row in rows), default=0)) else ""


def _counts(rows: Iterable[ControlRow]) -> str:
    """Return the numbers of episodes of rows as text."""
    return " or ".join(f"{count:.0f}" for count in sorted({row.episodes for row in rows}))


def _known(row: ControlRow, results: Results) -> ControlRow:
    """Return a row with the settling that all pages have, if the league has its scenario."""
    agent, _, end = row.case.partition(", ")
    known = results.find(agent, f"{RRR}/{end}" if end != "nominal" else RRR)
    if known is None:
        return row
    return replace(row, episodes=known.episodes, settled=known.settled, settling_time=known.settling_time)


def _find(by_case: Mapping[str, ControlRow], agent: str, end: str) -> ControlRow | None:
    """Return the row of an agent; an agent with the true state has the arms of unknown-lab without its sensors."""
    return by_case.get(f"{agent}, {'unknown' if (agent, end) == (AGENTS[0], LAB) else end}")


def _cell(row: ControlRow | None) -> str:
    """Return the result of a case: the RMS tip error of a tracking or holding task, otherwise settling."""
    if row is None:
        return "-"
    return millimetres(row.followed) if "Track" in row.case or "Hold" in row.case else _settling(row)


def _settling(row: ControlRow) -> str:
    """Return the share of settled episodes and the median settling time."""
    return percent(row.settled) + (f", {row.settling_time:.2f} s" if row.settling_time < float("inf") else "")


def _opening(by_case: Mapping[str, ControlRow]) -> str:
    """Return the first sentences; "" without their rows."""
    oracle, ours, nominal, pd = (
        _find(by_case, agent, LAB) for agent in ("privileged-lqr", "adaptive-lqr", "lqg", "pd")
    )
    if not (oracle and ours and nominal and pd):
        return ""
    text = (
        f"With unknown payload and stiffness, an adaptive LQR settles {percent(ours.settled)} of {ours.episodes:.0f} "
        f"slews ({ours.settling_time:.2f} s, median); an LQR with the true state and parameters takes "
        f"{oracle.settling_time:.2f} s. A Kalman filter of the nominal arm settles "
        f"{share_text(nominal.settled, nominal.episodes)}, a PD {percent(pd.settled)} within the 10 s of an episode."
    )
    friction, found = by_case.get(OURS + "unmodelled friction"), _random_arms(by_case, AGENTS[1])
    if friction and found:
        text += (f" With friction that is in no model the adaptive LQR settles "
                 f"{share_text(friction.settled, friction.episodes)}, with {len(found)} random arms "
                 f"{share_over_arms(found)}.")  # fmt: skip
    return text


def _cases(ours: Mapping[str, ControlRow]) -> list[tuple[str, ...]]:
    """Return the rows of the table of single cases of the adaptive LQR."""
    given, others = ({f"{word}: {name}": ours.get(name) for name in names}
                     for word, names in (("given", GIVEN), ("not given", NOT_GIVEN)))  # fmt: skip
    low = {f"extreme: {name}": row for name, row in _extremes(ours).items() if row.settled < WELL}
    return [(name, _counts([row]), share_text(row.settled, row.episodes))
            for name, row in (given | others | low).items() if row]  # fmt: skip


def _extremes(ours: Mapping[str, ControlRow]) -> dict[str, ControlRow]:
    """Return the rows of the extremes of `uncertain` by their names."""
    return {name: row for name, _, _ in EXTREMES if (row := ours.get(f"uncertain: {name}"))}


def _remarks(by_case: Mapping[str, ControlRow], ours: Mapping[str, ControlRow]) -> list[str]:
    """Return sentences on the extremes, on failures, and on random arms, of those that have rows."""
    lines = []
    if extremes := _extremes(ours):
        well = sum(row.settled >= WELL for row in extremes.values())
        lines.append(f"{well} of {len(extremes)} extremes settle at least {100 * WELL:.0f} %.")
    if faults := [ours[name] for name in NOT_GIVEN if name in ours]:
        failed = 100 * max(row.failed for row in faults)
        lines.append("A PD takes over where the estimator cannot explain the measurements; at most "
                     f"{failed:.0f} % of the episodes of changes that are not given end at a limit.")  # fmt: skip
    if (changed := ours.get("changed payload")) and changed.again is not None:
        lines.append("3 s after a change of the payload by 10 kg, "
                     f"{share_text(changed.again, changed.episodes)} of the arms are settled.")  # fmt: skip
    if random := {agent: found for agent in AGENTS[:2] if (found := _random_arms(by_case, agent))}:
        shares = (f"`{agent}` settles {share_over_arms(found)}, and at least 90 % with "
                  f"{sum(share >= 0.9 for share in found)} of the arms" for agent, found in random.items())  # fmt: skip
        count = min(map(len, random.values()))
        episodes = _counts(row for case, row in by_case.items() if FEWER[2] in case)
        missing = f" ({RANDOM_ARMS - count} more: no gains of a regulator within rounding)" * (count < RANDOM_ARMS)
        lines.append(
            f"{count} random arms of two to four links, with and without gravity, each with the uncertainty of "
            f"`uncertain`{missing}, {episodes} episodes each: {'; '.join(shares)} (intervals: bootstrap over the arms)."
        )
    return lines


def _random_arms(by_case: Mapping[str, ControlRow], agent: str) -> list[float]:
    """Return the settled shares of an agent for the random arms that were run."""
    return [row.settled for case, row in by_case.items() if case.startswith(f"{agent}, random arm ")]


def share_over_arms(shares: Sequence[float]) -> str:
    """Return the mean of the settled shares of arms in percent, with its bootstrap interval over the arms."""
    values = np.array(shares)
    return percent(float(mean(values)), *stratified_interval(values[:, None], mean))


def _effect(
    ours: Mapping[str, ControlRow], text: str, _: object, __: str, values: Sequence[float]
) -> tuple[str, str, str] | None:
    """Return the row of an effect: its name, its values, and the settled shares; None without rows."""
    found = {f"{value:g}": row for value in values if (row := ours.get(f"unmodelled: {text} {value:g}"))}
    shares = ", ".join(f"{100 * row.settled:.0f}" for row in found.values())
    return (text, ", ".join(found), shares) if found else None
