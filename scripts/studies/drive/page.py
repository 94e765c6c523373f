"""Page of the study of real-time loops."""

from collections.abc import Mapping, Sequence

import numpy as np

from flexman_gym.common.markdown import markdown_table
from flexman_gym.evaluation.machine.drive import REST_RATE
from studies.drive.measure import FAULTS, LOOPS, FaultRow, LoopRow, RoundTripRow
from studies.screen import screen

QUESTION = "Does an agent move a machine in real time as in a simulation, and what happens if a part of the loop fails?"
ANSWER = """**With real-time priority `{0}` settles in {1} and `{2}` in {3} (medians of {6}), and {4} of {5} faults
end at rest within the limits.**"""
BODY = """{table}

The simulated machine runs behind UDP. *At rest*: all motors below {rest:.1%} of the limit of
their rate. Load average of the two cores: {load}. *Missed*: torques too late for their period.

{loops}
- **Without priority** ({free_count}): {free}.
- **1 % of the packets lost** ({lost_count}): {lost}.
- **Torques from their arrival** ({arrival_count}): {arrival}.
- **Round trip**: `fm.fit` finds a stiffness changed by 20 % within {fit:.2%}."""
LOOP = """- **`{agent}`, {rate:.0f} Hz**: late by {late:.4f} ms (median; at most {most:.2g} ms), torques {delay:.1f} ms
  later, {missed} missed; vibration {vibration:.2g} mm (simulation {simulated:.2g} mm)."""


def page(
    loops: Sequence[LoopRow], faults: Sequence[FaultRow], fits: Sequence[RoundTripRow], files: Mapping[str, str]
) -> str:
    """Return the page as Markdown; `files` are the files of the rows with their comments."""
    by_name = {(row.agent, row.condition): row for row in loops}
    first, second = ({name: row for (each, name), row in by_name.items() if each == agent} for agent in LOOPS)
    main = [each["real-time priority"] for each in (first, second)]
    rested = [row for row in faults if np.isfinite(row.rest)]
    words = [word for row in main for word in (row.agent, f"{row.settled:.2f} s ({_simulated(row)})")]
    text = {}
    for name, condition in (
        ("free", "no priority"), ("lost", "1 % of the packets lost"), ("arrival", "torques from their arrival"),
    ):  # fmt: skip
        own = [each[condition] for each in (first, second)]
        text[name] = "; ".join(f"`{row.agent}` {_outcome(row)}" for row in own)
        text[f"{name}_count"] = _episodes(min(row.episodes for row in own))
    loads = [row.load for row in loops]
    body = BODY.format(
        table="\n".join(markdown_table(("fault", "reported", *(f"at rest, {row.environment}" for row in main)),
                                       [_fault(fault, faults) for fault in FAULTS])),
        rest=REST_RATE, load=f"{min(loads):.2g} to {max(loads):.2g}", loops="\n".join(map(_loop, main)),
        fit=max(abs(row.found / row.true - 1.0) for row in fits), **text,
    )  # fmt: skip
    answer = ANSWER.format(*words, len(rested), len(faults), _episodes(min(row.episodes for row in main)))
    return screen("Real-time loops", QUESTION, answer, body, files, "drive")


def _simulated(row: LoopRow) -> str:
    return f"simulation: {row.settled_low:.2f} to {row.settled_high:.2f} s"


def _loop(row: LoopRow) -> str:
    return LOOP.format(
        agent=row.agent, rate=row.rate, late=1e3 * row.late_median, most=1e3 * row.late_largest,
        delay=1e3 * row.delay, missed=f"{row.missed:.2%}", vibration=1e3 * row.vibration,
        simulated=1e3 * row.vibration_simulated,
    )  # fmt: skip


def _outcome(row: LoopRow) -> str:
    stopped = f", stopped in {row.stopped:.0f} of {row.episodes:.0f}" if row.stopped else ""
    settled = f"{row.settled:.2f} s" if np.isfinite(row.settled) else "not settled"
    return f"{settled}{stopped} ({row.missed:.2%} missed)"


def _episodes(count: float) -> str:
    return f"{count:.0f} episode{'s' * (count != 1)}"


def _fault(fault: str, rows: Sequence[FaultRow]) -> tuple[str, ...]:
    own = [row for row in rows if row.fault == fault]
    rests = (f"{row.rest:.2f} s" if np.isfinite(row.rest) else "its process is gone" for row in own)
    return fault, own[0].reported, *rests
