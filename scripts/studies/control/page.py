"""Page of the controller study: table and conclusions."""

from collections.abc import Sequence

from flexman_gym.common.markdown import markdown_table
from studies.control.cases import ControlRow

PAGE = """# Controllers of arms with uncertain parameters

This study compares controllers of arms whose payload and stiffness are uncertain and whose measurements are noisy. The
adaptive LQR, which estimates the arm from the instruments of a laboratory, settles every slew, hardly later than an LQR
with the true state and parameters. A Kalman filter of the nominal arm settles about half of the slews, and a PD none.
The adaptive LQR fails under unmodelled faults: friction, sensor biases, lost or late samples. Its weakest task is
holding a position under disturbances.

`python scripts/control.py --folder docs/evidence` rewrites this page and its rows ([control.csv](control.csv)).

The condition `unknown-lab` has the instruments of a laboratory. Payload and stiffness differ from episode to episode,
torques are delayed by one control period, every measurement is noisy, and the tip is not measured.

- `privileged-lqr` uses the true state and the true parameters. It is the oracle to which the others are compared.
- `adaptive-lqr` uses the measurements of the laboratory and simulates the arm in parallel.
- `lab-flexrrr` is a policy that adjusts the reference of `adaptive-lqr` during the slew.
- `lqg` filters the same measurements with a nominal model.
- `pd` uses the motor angles and rates only.

Each row is the result of {episodes}. The columns are:

- *settled*: share of the episodes whose tip enters the band around its target and stays there.
- *settling*: median settling time, in s.
- *p-p*: median peak-to-peak motion of the tip in the last 3 s, in mm.
- *error*: median distance from the target at the end, in mm.
- *failed*: share of the episodes that violated a limit.
- *RMS*: RMS tip error over all episodes after the first 2 s, in mm, for tracking and holding tasks.
- *cost*: CPU time per control period and arm, in ms, including the environment and all controller designs.

{table}

## Results

{conclusion}

## Validity

No setting was tuned on the seeds of these episodes. The observer is given the structure of the arm, the ranges of the
uncertain parameters and the noise level. The finer arm has three elements per link, all coordinates and foreshortening,
unlike the model of the observer. A load that changes does so by 10 kg after 4 s. The last rows are faults that the
observer does not model. When the observer cannot explain its measurements any more, a PD takes over, which settles no
slew but violates no limit either.
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
            f"{ours.settling_time:.2f} s. The LQR with the true state and parameters takes {known.settling_time:.2f} s."
        )
    changed = by_case.get("adaptive-lqr, a load that changes")
    if changed and changed.again is not None:
        sentences.append(
            f"Three seconds after a change of the load, {100 * changed.again:.0f} % of the arms have settled again."
        )
    for task in ("Track", "Hold"):
        oracle, own = (by_case.get(f"{who}, FlexRRR-{task}-v0") for who in ("privileged-lqr", "adaptive-lqr"))
        if oracle and own:
            ratio = own.followed / oracle.followed
            sentences.append(f"In the task {task} its error is {ratio:.2g} times that of the oracle LQR.")
    broken = [row.case.partition(", ")[2] for row in rows if row.case.startswith("adaptive") and row.settled < 0.5]
    if broken:
        sentences.append(f"It does not settle under these faults: {', '.join(broken)}.")
    return "\n".join(sentences)
