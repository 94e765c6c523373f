"""Page of the study of the safety filter, and the part of docs/safety.md that comes from its rows."""

from collections.abc import Mapping, Sequence

import numpy as np

from flexman_gym.common.markdown import markdown_table
from studies.safety.learning import KINDS, LearningRow, task
from studies.safety.measure import ACCEPTED, STUDY, Cell, SafetyRow, violation_bound
from studies.screen import screen

QUESTION = "Do limits of strain, torque, rate and workspace hold with the safety filter, and what does it cost?"
ANSWER = """**With the filter {counts} moves violate a limit; without it {free:.0%} of all moves do.** The rate of
violations in `nominal` is below {bound:.1%} (95 % confidence)."""
BODY = """{table}

[The page on safety](../safety.md) has agents and limits. A violation is an excess above {accepted:.0%} of the limit, of
rate and half space any excess. Time: ratio of the median settling times with and without the filter. CPU: for an action
in a batch, and of a single arm.

PPO of a PD controller of `FlexOne-v0`, strain limit {strain:g}, {seeds} seeds, {steps:,} actions each; free: violations
have no consequence; ended: they end the episode.

{learning}"""


def page(rows: Sequence[SafetyRow], learned: Sequence[LearningRow], files: Mapping[str, str]) -> str:
    """Return the page as Markdown; `files` are the files of both kinds of rows with their comments."""
    totals = {name: [int(sum(getattr(row, field) for row in rows if row.condition == name))
                     for field in ("violations", "moves")]
              for name in dict.fromkeys(row.condition for row in rows)}  # fmt: skip
    counts = ", ".join(f"{violations} of {moves} (`{name}`)" for name, (violations, moves) in totals.items())
    free = sum(row.moves * row.free_violations for row in rows) / sum(row.moves for row in rows)
    answer = ANSWER.format(counts=counts, free=free, bound=violation_bound(*totals["nominal"]))
    heads = "condition", "moves", "violations", "largest excess", "time", "changed periods", "CPU, ms"
    lines = [_condition(name, [row for row in rows if row.condition == name]) for name in totals]
    body = BODY.format(
        table="\n".join(markdown_table(heads, lines)), accepted=ACCEPTED, strain=task("cost").limits.strain,
        seeds=len({row.seed for row in learned}), steps=int(learned[0].steps),
        learning="\n".join(_training(kind, learned) for kind in KINDS),
    )  # fmt: skip
    return screen("Safety filter", QUESTION, answer, body, files, "safety")


def cells(rows: Sequence[SafetyRow]) -> list[str]:
    """Return the lines of the table of all cells, for docs/safety.md."""
    heads = ("agent", "moves", "violations, free", "violations", "largest excess", "settling, s (settled)")
    return ["", *markdown_table(heads, map(_cell, rows)), ""]


def _cell(row: SafetyRow) -> tuple[object, ...]:
    agent = ", ".join((row.condition, row.agent, *[row.limits] * (row.limits != STUDY)))
    return (agent, int(row.moves), f"{row.free_violations:.0%}", int(row.violations),
            _percent(row.largest), _settling(row))  # fmt: skip


def _settling(row: SafetyRow) -> str:
    """Return the median settling times and the shares of settled moves without and with the filter."""
    if not _has_goal(row):
        return ""
    times, shares = (row.free_settling, row.settling), (row.free_settled, row.settled)
    return " to ".join(
        f"{time:.2f} ({share:.0%})" if np.isfinite(time) else f"none ({share:.0%})"
        for time, share in zip(times, shares, strict=True)
    )


def _has_goal(row: SafetyRow) -> bool:
    return Cell(row.condition, row.agent, row.limits, 0).has_goal


def _condition(name: str, rows: Sequence[SafetyRow]) -> tuple[object, ...]:
    """Return the line of a condition."""
    losses = [row.settling / row.free_settling for row in rows
              if _has_goal(row) and row.limits == STUDY and np.isfinite(row.free_settling)]  # fmt: skip
    times = f"{min(losses):.2f} to {max(losses):.2f}" if losses else ""
    batch, single = ([getattr(row, field) for row in rows] for field in ("cpu", "cpu_single"))
    changed = [row.changed + row.stopped for row in rows]
    return (name, f"{int(sum(row.moves for row in rows)):,}", int(sum(row.violations for row in rows)),
            _percent(_largest(rows)), times, f"{min(changed):.1%} to {max(changed):.1%}",
            f"{min(batch):.2f} to {max(batch):.2f}, {min(single):.1f} to {max(single):.1f}")  # fmt: skip


def _training(kind: str, rows: Sequence[LearningRow]) -> str:
    """Return the item of a kind of training, means over the seeds."""
    plain, safe = ([row for row in rows if row.training == kind and row.filtered == text] for text in ("False", "True"))
    violating, episodes = (int(sum(getattr(row, name) for row in plain)) for name in ("violating", "episodes"))
    cpu, settling = np.mean([row.cpu for row in plain]), np.mean([row.settling for row in safe])
    free, filtered = (np.mean([row.violations for row in each]) for each in (plain, safe))
    return (f"- {kind}: {violating} of {episodes} episodes violate; {cpu:.2f} min of CPU time; then {free:.0%} of the "
            f"moves, {filtered:.0%} with the filter; settling {settling:.2f} s.")  # fmt: skip


def _largest(rows: Sequence[SafetyRow]) -> float:
    return max(row.largest for row in rows)


def _percent(value: float) -> str:
    return f"{value:.1%}"
