"""Page of the study of the safety filter, and the part of docs/safety.md that comes from its rows."""

from collections.abc import Mapping, Sequence

import numpy as np

from flexman_gym.common.markdown import markdown_table
from studies.safety.learning import KINDS, STRAIN, LearningRow
from studies.safety.measure import ACCEPTED, STUDY, Cell, SafetyRow, violation_bound
from studies.screen import screen

QUESTION = "Do limits of strain, torque, rate and workspace hold with the safety filter, and what does it cost?"
ANSWER = """**With the filter {counts} moves violate a limit; without it {free:.0%} of all moves do.** The rate of
violations in `nominal` is below {bound:.1%} (95 % confidence)."""
BODY = """{table}

Agents and limits of each condition are in [the page on safety](../safety.md). A violation is an excess above
{accepted:.0%} of the limit, of rate and half space any excess; a negative excess is a distance. Time: ratio of the
median settling times with and without the filter, of agents with a goal, without rate and half space, least to largest.
CPU: of the filter, for an action in a batch of arms and for a single arm, least to largest.

PPO of a PD controller of `FlexOne-v0` with a strain limit of {strain:g}, {seeds} seeds, {steps:,} actions each:

{learning}

Free: a violation has no consequence; ended: it ends the episode. Violating: share of the episodes of the training with
a violation. Violations: share of {tested} moves after the training, without the filter and with it."""


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
    learning_heads = (
        "training",
        "CPU, min",
        "violating",
        "settled",
        "settling, s",
        "violations",
        "settling filtered, s",
    )
    body = BODY.format(
        table="\n".join(markdown_table(heads, lines)), accepted=ACCEPTED, strain=STRAIN,
        seeds=len({row.seed for row in learned}), steps=int(learned[0].steps), tested=100,
        learning="\n".join(markdown_table(learning_heads, (_training(kind, learned) for kind in KINDS))),
    )  # fmt: skip
    return screen("Safety filter", QUESTION, answer, body, files, "safety")


def cells(rows: Sequence[SafetyRow]) -> list[str]:
    """Return the lines of the table of all cells, for docs/safety.md."""
    heads = ("condition", "agent", "moves", "violations, free", "violations", "largest excess", "settling, s")
    return ["", *markdown_table(heads, map(_cell, rows)), ""]


def _cell(row: SafetyRow) -> tuple[object, ...]:
    agent = row.agent if row.limits == STUDY else f"{row.agent}, {row.limits}"
    return (row.condition, agent, int(row.moves), f"{row.free_violations:.0%}", int(row.violations),
            _percent(row.largest), _settling(row))  # fmt: skip


def _settling(row: SafetyRow) -> str:
    """Return the median settling times without and with the filter, or the share of settled moves if not all are."""
    if not _has_goal(row):
        return ""
    parts = [f"{time:.2f}" if np.isfinite(time) else "none" for time in (row.free_settling, row.settling)]
    shares = [f" ({share:.0%})" if share < 1.0 else "" for share in (row.free_settled, row.settled)]
    return " to ".join(part + share for part, share in zip(parts, shares, strict=True))


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


def _training(kind: str, rows: Sequence[LearningRow]) -> tuple[object, ...]:
    """Return the line of a kind of training, means over the seeds."""
    plain, safe = ([row for row in rows if row.training == kind and row.filtered == text] for text in ("False", "True"))
    mean = {name: float(np.mean([getattr(row, name) for row in plain])) for name in ("cpu", "settled", "settling")}
    violating = sum(row.violating for row in plain) / sum(row.episodes for row in plain)
    shares = (float(np.mean([row.violations for row in each])) for each in (plain, safe))
    return (kind, f"{mean['cpu']:.1f}", f"{violating:.1%}", f"{mean['settled']:.0%}", f"{mean['settling']:.2f}",
            ", ".join(f"{each:.0%}" for each in shares), f"{np.mean([row.settling for row in safe]):.2f}")  # fmt: skip


def _largest(rows: Sequence[SafetyRow]) -> float:
    return max(row.largest for row in rows)


def _percent(value: float) -> str:
    return f"{value:.1%}"
