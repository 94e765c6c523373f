"""Page of the study of real-time loops."""

from collections.abc import Mapping, Sequence

import numpy as np

from flexman_gym.common.formatting import millimetres
from flexman_gym.common.markdown import markdown_table
from studies.drive.measure import KINDS, LOOPS, OF_AGENT, FaultRow, LoopRow, RoundTripRow, UndisturbedRow
from studies.screen import screen

QUICK = 5  # control periods in which a fault is noticed quickly
QUESTION = "Does an agent move a machine in real time as in a simulation, and what happens if a part of the loop fails?"
ANSWER = """**With real-time priority `{0}` settles in {1} and `{2}` in {3} (medians of {4}). {6} of {5} faults of
the machine are noticed, {7} within five control periods; {9} of {8} undisturbed runs are stopped.**"""
BODY = """{table}

*Noticed*: most periods from the first wrong reading, over {agents}; *rest*: longest time to rest.
Undisturbed: {environment}, one packet in ten lost, readings half a period late. Load average
{least:.1f} to {most:.1f}.

{loops}
- **Without priority** ({free_count}): {free}.
- **1 % lost** ({lost_count}): {lost}.
- **Torques from arrival** ({arrival_count}): {arrival}.
- **Round trip**: `fm.fit` finds a stiffness changed by 20 % within {fit:.1%}."""
LOOP = """- **`{agent}`, {rate:.0f} Hz**: late by {late:.1g} us, {missed} missed; vibration {vibration}
  (simulation {simulated})."""


def page(
    loops: Sequence[LoopRow],
    faults: Sequence[FaultRow],
    undisturbed: Sequence[UndisturbedRow],
    fits: Sequence[RoundTripRow],
    files: Mapping[str, str],
) -> str:
    """Return the page as Markdown; `files` are the files of the rows with their comments."""
    by_name = {(row.agent, row.condition): row for row in loops}
    first, second = ({name: row for (each, name), row in by_name.items() if each == agent} for agent in LOOPS)
    main = [each["real-time priority"] for each in (first, second)]
    words = [word for row in main for word in (row.agent, f"{row.settled:.2f} s ({_simulated(row)})")]
    text = {}
    for name, condition in (
        ("free", "no priority"), ("lost", "1 % of the packets lost"), ("arrival", "torques from their arrival"),
    ):  # fmt: skip
        own = [each[condition] for each in (first, second)]
        text[name] = "; ".join(f"`{row.agent}` {_outcome(row)}" for row in own)
        text[f"{name}_count"] = _episodes(min(row.episodes for row in own))
    environments = list(dict.fromkeys(row.environment for row in faults))
    head = ("fault", "noticed, periods", *(f"rest, {each}, s" for each in environments))
    runs, stopped = (sum(values) for values in zip(*((row.runs, row.stopped) for row in undisturbed), strict=True))
    body = BODY.format(
        table="\n".join(markdown_table(head, [_kind(kind, faults, environments) for kind in KINDS])),
        agents=", ".join(f"`{each}`" for each in dict.fromkeys(row.agent for row in faults)),
        environment=undisturbed[0].environment, loops="\n".join(map(_loop, main)),
        least=min(row.load for row in loops), most=max(row.load for row in loops),
        fit=max(abs(row.found / row.true - 1.0) for row in fits), **text,
    )  # fmt: skip
    lies = [row for row in faults if row.fault not in OF_AGENT and np.isfinite(row.noticed)]
    found = [row.noticed for row in lies if row.reported]
    most = len(found), sum(periods <= QUICK for periods in found)
    counts = f"{runs:.0f}", f"{stopped:.0f}" if stopped else "none"
    answer = ANSWER.format(*words, _episodes(min(row.episodes for row in main)), len(lies), *most, *counts)
    return screen("Real-time loops", QUESTION, answer, body, files, "drive")


def _simulated(row: LoopRow) -> str:
    return f"simulation: {row.settled_low:.2f} to {row.settled_high:.2f} s"


def _loop(row: LoopRow) -> str:
    return LOOP.format(
        agent=row.agent, rate=row.rate, late=1e6 * row.late_median,
        missed=_missed(row), vibration=millimetres(row.vibration),
        simulated=millimetres(row.vibration_simulated).removesuffix(" mm"),
    )  # fmt: skip


def _outcome(row: LoopRow) -> str:
    stopped = f", stopped in {row.stopped:.0f} of {row.episodes:.0f}" if row.stopped else ""
    settled = f"{row.settled:.2f} s" if np.isfinite(row.settled) else "not settled"
    return f"{settled}{stopped} ({_missed(row)} missed)"


def _missed(row: LoopRow) -> str:
    """Return the share of the periods with a missed deadline, of which there are few: one digit."""
    return f"{100.0 * row.missed:.1g}%"


def _episodes(count: float) -> str:
    return f"{count:.0f} episode{'s' * (count != 1)}"


def _kind(kind: str, faults: Sequence[FaultRow], environments: Sequence[str]) -> tuple[str, ...]:
    """Return a row of the table of faults."""
    own = [row for row in faults if row.fault in KINDS[kind]]
    noticed = [row.noticed for row in own if row.reported and np.isfinite(row.noticed)]
    missed = [f"; not noticed: {row.fault} (`{row.agent}`)" for row in own if not row.reported]
    rests = ([row.rest for row in own if row.environment == each and np.isfinite(row.rest)] for each in environments)
    return kind, "".join([f"{max(noticed):.0f}", *missed]), *(f"{max(rest):.2f}" if rest else "-" for rest in rests)
