"""Page of the study of the safety filter, and the part of docs/safety.md that comes from its rows."""

from collections.abc import Mapping, Sequence

import numpy as np

from flexman_gym.common.formatting import percent
from flexman_gym.common.markdown import markdown_table
from flexman_gym.evaluation.shares import share_text
from studies.safety.learning import KINDS, TEST_SEEDS, LearningRow, task
from studies.safety.measure import ACCEPTED, STUDY, Cell, SafetyRow, violation_bound
from studies.screen import screen

QUESTION = "Do limits of strain, torque, rate and workspace hold with the safety filter, and what does it cost?"
ANSWER = """**With the filter {counts} moves violate a limit; without it {free} of all moves do.** The rates of
violations are below {bounds} (95 % confidence each)."""
BODY = """{table}

[The page on safety](../safety.md) has agents and limits. A violation is an excess above {accepted:.0%} of the limit, of
rate and half space any excess. Time: ratio of the median settling times with and without the filter. CPU: for an action
in a batch, and of a single arm.

PPO of a PD controller of `FlexOne-v0`, strain limit {strain:g}, {seeds} seeds, {steps:,} actions each; free: violations
have no consequence; ended: they end the episode. Moves after the training: {tests} of each seed.

{learning}"""
LEARNED = ("training", "episodes that violate", "CPU, min", "moves that violate", "with the filter",
           "settling with it, s")  # fmt: skip


def page(rows: Sequence[SafetyRow], learned: Sequence[LearningRow], files: Mapping[str, str]) -> str:
    """Return the page as Markdown; `files` are the files of both kinds of rows with their comments."""
    totals = {name: [int(sum(getattr(row, field) for row in rows if row.condition == name))
                     for field in ("violations", "moves")]
              for name in dict.fromkeys(row.condition for row in rows)}  # fmt: skip
    counts = ", ".join(f"{violations} of {moves} (`{name}`)" for name, (violations, moves) in totals.items())
    free = sum(row.moves * row.free_violations for row in rows) / sum(row.moves for row in rows)
    bounds = ", ".join(f"{_percent(violation_bound(*count))} (`{name}`)" for name, count in totals.items())
    answer = ANSWER.format(counts=counts, free=percent(free), bounds=bounds)
    heads = "condition", "moves", "violations", "largest excess", "time", "changed periods", "CPU, ms"
    lines = [_condition(name, [row for row in rows if row.condition == name]) for name in totals]
    body = BODY.format(
        table="\n".join(markdown_table(heads, lines)), accepted=ACCEPTED, strain=task("cost").limits.strain,
        seeds=len({row.seed for row in learned}), steps=int(learned[0].steps),
        learning="\n".join(markdown_table(LEARNED, [_training(kind, learned) for kind in KINDS])),
        tests=len(TEST_SEEDS),
    )  # fmt: skip
    return screen("Safety filter", QUESTION, answer, body, files, "safety")


def cells(rows: Sequence[SafetyRow]) -> list[str]:
    """Return the lines of the table of all cells, for docs/safety.md."""
    heads = ("agent", "moves", "violations without the filter", "with it", "largest excess",
             "settling without the filter, s (settled)", "with it")  # fmt: skip
    return ["", *markdown_table(heads, map(_cell, rows)), ""]


def _cell(row: SafetyRow) -> tuple[object, ...]:
    agent = ", ".join((row.condition, row.agent, *[row.limits] * (row.limits != STUDY)))
    pairs = (row.free_settling, row.free_settled), (row.settling, row.settled)
    settling = [_settling(*pair) if _has_goal(row) else "" for pair in pairs]
    return (agent, int(row.moves), share_text(row.free_violations, row.moves), int(row.violations),
            _percent(row.largest), *settling)  # fmt: skip


def _settling(time: float, share: float) -> str:
    """Return a median settling time and the share of settled moves."""
    return f"{time:.2f} ({percent(share)})" if np.isfinite(time) else f"none ({percent(share)})"


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
    violating, episodes = (int(sum(getattr(row, name) for row in plain)) for name in ("violating", "episodes"))
    cpu, settling = np.mean([row.cpu for row in plain]), np.mean([row.settling for row in safe])
    shares = (share_text(float(np.mean([row.violations for row in each])), len(TEST_SEEDS) * len(each))
              for each in (plain, safe))  # fmt: skip
    return kind, f"{violating} of {episodes}", f"{cpu:.1g}", *shares, f"{settling:.2f}"


def _largest(rows: Sequence[SafetyRow]) -> float:
    return max(row.largest for row in rows)


def _percent(value: float) -> str:
    return f"{value:.1%}"
