"""Page of the controller study: one table, and the cases of the adaptive controller in sentences."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from statistics import mean
from textwrap import fill

from flexman_gym.common.markdown import markdown_table
from studies.control.cases import EXTREMES, PARTS, RANDOM_ARMS, RRR, ControlRow
from studies.markdown import bullets
from studies.results import Results
from studies.screen import HIDDEN

PAGE = """# Controllers of arms with uncertain parameters

{opening}

| arms | `privileged-lqr` | `adaptive-lqr` | `lab-flexrrr` |
{table}

Slews: share of the {episodes} test episodes that settle, and median settling time; those of `FlexRRR-v0` are rows of
the [league](../league/league.md). *Track* and *Hold*: RMS tip error after 2 s. A dash: not run in this study.

- `privileged-lqr` is given the true state and parameters, which hardware cannot measure.
- `adaptive-lqr` is given the model, the ranges of the uncertain parameters and the noise. It estimates the parameters
  from the measurements `lab`, without the tip.
- `lab-flexrrr` is a policy that changes the reference of `adaptive-lqr`, with the same information.

Settled shares of `adaptive-lqr` in other cases, of {episodes} episodes where no other number is given:

{cases}

Extremes and single effects have {few} episodes, each random arm {random}. No setting was tuned on these episodes. CPU
times of an action are in the [league](../league/league.md). Rows: [control.csv](control.csv), by
`python -m studies control --folder docs/evidence`; with `--redraw` only the page.
"""
AGENTS = ("privileged-lqr", "adaptive-lqr", "lab-flexrrr")
LAB = "unknown-lab"
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
    counts = [_counts(row for case, row in by_case.items() if word in case) for word in FEWER]
    table = [[arms, *(_cell(_find(by_case, agent, end)) for agent in AGENTS)] for arms, end in ARMS.items()]
    return HIDDEN + PAGE.format(
        opening=_opening(by_case),
        episodes=_counts(row for case, row in by_case.items() if not any(word in case for word in FEWER)),
        few=" or ".join(dict.fromkeys(counts[:2])),
        random=counts[2],
        table="\n".join(markdown_table(["---"] * 4, table)[1:]),
        cases="\n".join(bullets(_cases(by_case))),
    )


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
    return f"{1e3 * row.followed:.3g} mm" if "Track" in row.case or "Hold" in row.case else _settling(row)


def _settling(row: ControlRow) -> str:
    """Return the share of settled episodes and the median settling time."""
    return f"{100 * row.settled:.0f} %" + (f", {row.settling_time:.2f} s" if row.settling_time < float("inf") else "")


def _opening(by_case: Mapping[str, ControlRow]) -> str:
    """Return the first sentences; "" without their rows."""
    oracle, ours, nominal, pd = (
        _find(by_case, agent, LAB) for agent in ("privileged-lqr", "adaptive-lqr", "lqg", "pd")
    )
    if not (oracle and ours and nominal and pd):
        return ""
    return fill(
        f"With unknown payload and stiffness, an adaptive LQR settles {_settling(ours)} (median); an LQR with "
        f"the true state and parameters takes {oracle.settling_time:.2f} s. A Kalman filter of the nominal arm settles "
        f"{100 * nominal.settled:.0f} %, a PD {100 * pd.settled:.0f} % within the 10 s of an episode.",
        WIDTH,
    )


def _cases(by_case: Mapping[str, ControlRow]) -> list[str]:
    """Return a line on each group of cases of the adaptive LQR that has rows."""
    ours = {case.removeprefix("adaptive-lqr, "): row for case, row in by_case.items() if case.startswith("adaptive")}
    given, faults = ({name: ours[name] for name in names if name in ours} for names in (GIVEN, NOT_GIVEN))
    extremes = {name: ours[f"uncertain: {name}"] for name, _, _ in EXTREMES if f"uncertain: {name}" in ours}
    low = {name: row for name, row in extremes.items() if row.settled < WELL}
    lines = [f"Changes within the given ranges: {_shares(given)}."] * bool(given)
    if faults:
        failed = 100 * max(row.failed for row in faults.values())
        lines.append(
            f"Changes that are not given: {_shares(faults)}. A PD takes over where the estimator cannot explain the "
            f"measurements; at most {failed:.0f} % of the episodes end at a limit."
        )
    if (changed := ours.get("changed payload")) and changed.again is not None:
        lines.append(
            f"3 s after a change of the payload by 10 kg, {100 * changed.again:.0f} % of the arms are settled."
        )
    if extremes:
        lines.append(
            f"Extremes of `uncertain`, one parameter at a time: {len(extremes) - len(low)} of {len(extremes)} cases "
            f"settle at least {100 * WELL:.0f} %{'; ' * bool(low)}{_shares(low)}."
        )
    if parts := [part for each in PARTS if (part := _part(ours, *each))]:
        lines.append(f"Effects of `unmodelled`, one at a time: {'; '.join(parts)}.")
    if random := {agent: found for agent in AGENTS[:2] if (found := _random_arms(by_case, agent))}:
        shares = (f"`{agent}` settles {100 * mean(found):.1f} %, and at least 90 % with "
                  f"{sum(share >= 0.9 for share in found)} of the arms" for agent, found in random.items())  # fmt: skip
        count = min(map(len, random.values()))
        missing = f" ({RANDOM_ARMS - count} more: no gains of a regulator within rounding)" * (count < RANDOM_ARMS)
        lines.append(
            f"{count} random arms of two to four links, with and without gravity, each with the uncertainty of "
            f"`uncertain`{missing}: {'; '.join(shares)}."
        )
    return [fill(line, WIDTH - 2, subsequent_indent="  ") for line in lines]


def _random_arms(by_case: Mapping[str, ControlRow], agent: str) -> list[float]:
    """Return the settled shares of an agent for the random arms that were run."""
    return [row.settled for case, row in by_case.items() if case.startswith(f"{agent}, random arm ")]


def _shares(rows: Mapping[str, ControlRow]) -> str:
    return ", ".join(f"{name} {100 * row.settled:.0f} %" for name, row in rows.items())


def _part(ours: Mapping[str, ControlRow], text: str, _: object, __: str, values: Sequence[float]) -> str:
    """Return the settled shares over the values of an effect; "" without rows."""
    found = {f"{value:g}": ours.get(f"unmodelled: {text} {value:g}") for value in values}
    shares = [f"{100 * row.settled:.0f} % at {value}" for value, row in found.items() if row]
    return f"{text} {', '.join(shares)}" if shares else ""
