"""Page of the controller study: table and conclusions."""

from collections.abc import Sequence

from flexman_gym.common.markdown import markdown_table
from studies.control.cases import ControlRow

PAGE = """# Controllers on the arm that nobody knows

How controllers do when payload, stiffness and delay are not known and every reading is noisy. One that estimates the
arm from a laboratory's instruments settles every slew, hardly later than one that is told everything. A Kalman filter
of the nominal arm settles about half of them, and a PD none. Faults that nobody told the estimator break it: friction,
biases, lost or late readings. Holding still under disturbances is where it is weakest.

`python scripts/control.py --folder docs` writes this page and its rows ([control.csv](control.csv)) anew.

The condition `unknown-lab` is an arm as a laboratory has it.
Payload and stiffness differ from episode to episode, torques come a period late, and every reading is noisy.
Nobody sees the tip.

- `privileged-lqr` is told the true state and the true parameters. It is the yardstick.
- `adaptive-lqr` reads the instruments of the laboratory. It simulates the arm beside the real one.
- `lab-flexrrr` is a policy that shapes the slew of `adaptive-lqr`.
- `lqg` filters the same readings with a nominal model.
- `pd` reads its motors alone.

Each row is {episodes}. The columns are:

- *settled*: part of the episodes whose tip stays within the band around its target from some time on.
- *settling*: median time from which it stays, in s.
- *p-p*: median of the tip's motion from peak to peak in the last 3 s, in mm.
- *error*: median distance at the end, in mm.
- *failed*: part of the episodes that broke a limit.
- *RMS*: of the error in all episodes after the first 2 s, in mm, where a tip follows or holds.
- *cost*: CPU time of a control period of an arm, in ms, the environment and all designs included.

{table}

## What it shows

{conclusion}

## How far to trust it

No setting was tuned on the seeds of these episodes.
The observer knows the structure of the arm, the ranges of what is unknown and the noise.
The finer arm has three elements a link, all coordinates and foreshortening, which the observer does not have.
A load that changes does so by 10 kg after 4 s.
The last rows are faults that nobody told the observer.
Where it can explain its readings no longer, a PD takes over: it settles nothing, and breaks nothing.
"""


def page(rows: Sequence[ControlRow]) -> str:
    """Return the page as Markdown."""
    heads = ["case", "settled", "settling", "p-p", "error", "failed", "RMS", "cost"]
    table = [
        [row.case, f"{100 * row.settled:.0f} %", _finite(row.settling_time, ".2f"), _finite(1e3 * row.vibration, ".3g"),
         _finite(1e3 * row.error, ".3g"), f"{100 * row.failed:.0f} %", _followed(row), f"{1e3 * row.cost:.2f}"]
        for row in rows
    ]  # fmt: skip
    return PAGE.format(
        episodes="100 episodes", table="\n".join(markdown_table(heads, table)), conclusion=_conclusion(rows)
    )


def _finite(value: float, how: str) -> str:
    return format(value, how) if value < float("inf") else "-"


def _followed(row: ControlRow) -> str:
    """Return the RMS tip error of a tracking or holding case, mm, or "-"."""
    return f"{1e3 * row.followed:.3g}" if "Track" in row.case or "Hold" in row.case else "-"


def _conclusion(rows: Sequence[ControlRow]) -> str:
    by_case = {row.case: row for row in rows}
    sentences = []
    known, ours = by_case.get("privileged-lqr, unknown"), by_case.get("adaptive-lqr, unknown-lab")
    if known and ours:
        sentences.append(
            f"The observer's LQR settles {100 * ours.settled:.0f} % of the unknown arms, in "
            f"{ours.settling_time:.2f} s. Told everything, an LQR takes {known.settling_time:.2f} s."
        )
    changed = by_case.get("adaptive-lqr, a load that changes")
    if changed and changed.again is not None:
        sentences.append(
            f"Three seconds after a load has changed, {100 * changed.again:.0f} % of the arms are settled again."
        )
    for task in ("Track", "Hold"):
        oracle, own = (by_case.get(f"{who}, FlexRRR-{task}-v0") for who in ("privileged-lqr", "adaptive-lqr"))
        if oracle and own:
            ratio = own.followed / oracle.followed
            sentences.append(f"In {task} its error is {ratio:.2g} times that of an LQR which is told everything.")
    broken = [row.case.partition(", ")[2] for row in rows if row.case.startswith("adaptive") and row.settled < 0.5]
    if broken:
        sentences.append(f"It does not settle: {', '.join(broken)}.")
    return "\n".join(sentences)
