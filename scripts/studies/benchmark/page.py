"""Page of the benchmark: speeds of environments and training."""

from collections.abc import Mapping, Sequence

from flexman_gym.common.markdown import markdown_table
from studies.benchmark.endurance import ALARMS, DIVERGED, MEMORY, STEPS, WARM_MEMORY, EnduranceRow
from studies.benchmark.measure import (
    ENVIRONMENTS,
    OURS,
    PHYSICS,
    PPO,
    REACHER,
    VECTOR,
    BenchmarkRow,
)
from studies.screen import screen

SHOWN = (64, 256, 1024)  # numbers of arms in the table
QUESTION = "How many steps per second does one core compute?"
ANSWER = "**One core computes {single} steps per second of one arm, and {best} of {arms} arms in one environment.**"
BESIDE = """**One core computes {single} steps per second of one arm, and {best} of {arms} arms in one environment:
{single_times} and {best_times} times the speed of {peer}.**"""
BODY = """{table}

Steps of 20 ms under random actions, resets included; CPU time of all threads, median of interleaved rounds. *Physics
only* is without observations, rewards and episodes. MuJoCo's arm is a chain of rigid pieces at its longest stable
step.

{texts}"""
TRAINING = """- PPO with {arms} arms processes {speed} steps per CPU second, learning included. The simulation takes
  {share:.0%} of the time, with one control period per action; recipes that repeat an action for several periods
  spend more."""
EFFECTS = """- Foreshortening multiplies the cost of an evaluation of the equations of motion by
  {foreshortening:.2f}, rotary inertia by {rotary:.2f}."""
ENDURED = """- {steps} random steps with all randomisations: {diverged} divergences, {alarms} energy alarms,
  {growth:+.1%} memory."""
HEADS = ("", "arms", "threads", "steps per CPU second", f"times {REACHER}")


def number(value: float | None, digits: int = 3) -> str:
    """Return a number with three digits and thousands separators; "" for None."""
    if value is None:
        return ""
    return f"{value:,.0f}" if abs(value) >= 1e3 else f"{value:.{digits}g}"


def page(rows: Sequence[BenchmarkRow], endured: Sequence[EnduranceRow], files: Mapping[str, str]) -> str:
    """Return the page as Markdown.

    Args:
        rows: rows of the benchmark.
        endured: rows of the endurance test; empty without one.
        files: files of both with their comments.
    """
    vectors = [row for row in rows if row.name == VECTOR and row.threads == 1]
    shown = [row for row in rows if row.table == ENVIRONMENTS and _is_shown(row)]
    table = markdown_table(HEADS, ((row.name, number(row.arms), number(row.threads), _speed(row.cpu),
                                    _ratio(row.times_peer)) for row in shown))  # fmt: skip
    best, single = min(vectors, key=lambda row: row.cpu), next(row for row in rows if row.name == OURS)
    answer = (BESIDE if single.times_peer and best.times_peer else ANSWER).format(
        single=_speed(single.cpu), best=_speed(best.cpu), arms=number(best.arms), peer=REACHER,
        single_times=_ratio(single.times_peer), best_times=_ratio(best.times_peer),
    )  # fmt: skip
    texts = [*_training(rows), *_effects(rows), *_endured(endured)]
    body = BODY.format(table="\n".join(table), texts="\n".join(texts))
    return screen("Speed", QUESTION, answer, body, files, "benchmark")


def _is_shown(row: BenchmarkRow) -> bool:
    """Return whether the table has a row of environments."""
    many = row.name == VECTOR and row.threads == 1 and row.arms in SHOWN
    return many or row.name in (OURS, PPO, REACHER) or row.name.endswith(PHYSICS)


def _speed(seconds: float) -> str:
    return number(float(f"{1 / seconds:.2g}"))


def _ratio(times: float | None) -> str:
    """Return a ratio of speeds with the digits that repeat; "" without one."""
    return "" if times is None else f"{times:.2g}"


def _training(rows: Sequence[BenchmarkRow]) -> list[str]:
    return [
        TRAINING.format(arms=number(row.arms), speed=_speed(row.cpu), share=row.share or 0.0)
        for row in rows if row.name == PPO
    ]  # fmt: skip


def _effects(rows: Sequence[BenchmarkRow]) -> list[str]:
    ratios = {row.name: row.times_peer for row in rows}
    foreshortening, without = ratios.get("with foreshortening"), ratios.get("without rotary inertia")
    if not foreshortening or not without:
        return []
    return [EFFECTS.format(foreshortening=foreshortening, rotary=1.0 / without)]


def _endured(rows: Sequence[EnduranceRow]) -> list[str]:
    known = {row.quantity: row.value for row in rows}
    if not known:
        return []
    growth = known[MEMORY] / known[WARM_MEMORY] - 1.0
    numbers = {"steps": number(known[STEPS]), "diverged": number(known[DIVERGED]), "alarms": number(known[ALARMS])}
    return [ENDURED.format(**numbers, growth=growth)]
