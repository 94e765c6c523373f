"""Page of the time of a first use."""

from collections.abc import Mapping, Sequence

import numpy as np

from flexman_gym.common.markdown import markdown_table
from studies.screen import screen
from studies.starts.measure import COLD, PHASES, WARM, WAYS, WHEEL, StartRow

QUESTION = "How long does a new user wait before the first arm has moved, and what follows at once?"
ANSWER = "**{ways}.**"
BODY = """{table}

Wall-clock time and, in brackets, CPU time of a new process, s; medians of {runs} runs. The phases follow one another:
imports; one arm of `FlexRRR-v0` (`gym.make`, reset, step); 64 arms in one environment; the paper's arm simulated for
2 s; ten episodes of `lqr-tracking`.

Without machine code, all kernels are compiled in one wait, in the first phase that needs one, in a process for each
idle core, at most three."""
WORDS = {
    WHEEL: "with a wheel that brings machine code the first use takes {} s",
    COLD: "where kernels are compiled {} s, once",
    WARM: "from then on {} s",
}


def page(rows: Sequence[StartRow], files: Mapping[str, str]) -> str:
    """Return the page as Markdown; `files` is the file of the rows with its comment."""
    ways = [way for way in WAYS if any(row.way == way for row in rows)]
    cells = [(phase, *(_cell([row for row in rows if (row.way, row.phase) == (way, phase)]) for way in ways))
             for phase in PHASES]  # fmt: skip
    cells.append(("all", *(f"{total(rows, way):.1f} ({total(rows, way, 'cpu'):.1f})" for way in ways)))
    text = "; ".join(WORDS[way].format(f"{total(rows, way):.0f}") for way in ways)
    runs = len({row.run for row in rows})
    body = BODY.format(table="\n".join(markdown_table(("", *ways), cells)), runs=runs)
    return screen("First use", QUESTION, ANSWER.format(ways=text[0].upper() + text[1:]), body, files, "starts")


def total(rows: Sequence[StartRow], way: str, clock: str = "wall") -> float:
    """Return the median over the runs of the time of all phases, s."""
    runs = {row.run for row in rows if row.way == way}
    return float(
        np.median([sum(getattr(row, clock) for row in rows if (row.way, row.run) == (way, run)) for run in runs])
    )


def _cell(rows: Sequence[StartRow]) -> str:
    wall, cpu = (np.median([getattr(row, clock) for row in rows]) for clock in ("wall", "cpu"))
    return f"{wall:.2f} ({cpu:.2f})"
