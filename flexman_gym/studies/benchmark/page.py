"""Page of the benchmark: its rows as tables, and sentences about them."""

from collections.abc import Callable, Sequence
from pathlib import Path

from flexman_gym.studies.benchmark.environments import OURS, PHYSICS, PPO, REACHER, VECTOR
from flexman_gym.studies.benchmark.evaluations import NOTE
from flexman_gym.studies.benchmark.rows import ENVIRONMENTS, EVALUATIONS, STARTS, Row
from flexman_gym.studies.benchmark.starts import COLD, FIRST, IMPORT, MORE, WARM
from flexman_gym.studies.verification.rows import table_line

PAGE = "benchmark.md"
ENDURANCE = "## Endurance"  # the last section, which scripts/endurance.py writes
STEPS_NOTE = f"""Steps of 20 ms under random actions drawn beforehand, with the resets of the episodes that end. All
rows take turns in rounds; CPU time, of all threads together, is the median of them, time by the clock that of the
quickest, as others on the machine disturb it. Ratios are those of CPU time, where there are two threads of the clock.
"Physics only" is without observations, rewards and episodes. MuJoCo's arm is that of {OURS} as a chain of rigid
pieces without modal damping, all arms in one call a control period, at the longest step that is stable;
[peers.md](peers.md) says how accurate either is. Steps of training are those of `scripts/train.py` from a new policy
on, in batches of 1024, with one thread for the networks; the share of the arms is that of the environment's `step`."""
STARTS_NOTE = (
    """In a new process, one part after the other; without kernels on disk once, with them the median of several."""
)


def number(value: float | None, digits: int = 3) -> str:
    """A number with a few digits, and thousands in groups; nothing for None."""
    if value is None:
        return ""
    return f"{value:,.0f}" if abs(value) >= 1e3 else f"{value:.{digits}g}"


def _speed(seconds: float) -> str:
    return number(float(f"{1 / seconds:.3g}"))


def _evaluation(row: Row) -> list[str]:
    return [row.name, number(row.cpu * 1e6), row.peer, number(row.times_peer), number(row.at_most)]


def _environment(row: Row) -> list[str]:
    share = "" if row.share is None else f"{row.share:.0%}"
    speeds = [_speed(row.cpu), _speed(row.wall), number(row.times_peer), share]
    return [row.name, number(row.arms), number(row.threads), *speeds]


def _start(row: Row) -> list[str]:
    return [row.name, number(row.cpu), number(row.wall)]


TABLES: dict[str, tuple[str, str, tuple[str, ...], Callable[[Row], list[str]]]] = {
    ENVIRONMENTS: (
        "Steps of environments",
        STEPS_NOTE,
        ("row", "arms", "threads", "steps a second of CPU", "by the clock", f"times {REACHER}", "share of the arms"),
        _environment,
    ),
    STARTS: ("Starts", STARTS_NOTE, ("row", "CPU, s", "clock, s"), _start),
    EVALUATIONS: (
        "Evaluations of the equations of motion",
        NOTE,
        ("row", "microseconds of CPU", "compared with", "times", "at most"),
        _evaluation,
    ),
}


def _table(name: str, rows: Sequence[Row]) -> list[str]:
    title, note, heads, cells = TABLES[name]
    own = [row for row in rows if row.table == name]
    lines = [table_line(heads), table_line("---" for _ in heads), *(table_line(cells(row)) for row in own)]
    return [f"## {title}", "", note, "", *lines, ""]


def conclusions(rows: Sequence[Row]) -> list[str]:
    """Sentences about what the rows hold."""
    texts = [*_of_arms(rows), *_of_physics(rows), *_of_training(rows), *_of_starts(rows)]
    for row in rows:
        if row.times_peer and row.at_most:
            verdict = "within" if row.times_peer <= row.at_most else "more than"
            texts.append(f"{row.name}: {number(row.times_peer)} times {row.peer}, {verdict} {number(row.at_most)}.")
    return texts


def _named(rows: Sequence[Row], name: str) -> list[Row]:
    return [row for row in rows if row.name == name]


def _of_arms(rows: Sequence[Row]) -> list[str]:
    vectors = _named(rows, VECTOR)
    alone = [row for row in vectors if row.threads == 1]
    best, (single,) = min(alone, key=lambda row: row.cpu), _named(rows, OURS)
    text = f"One core makes {_speed(single.cpu)} steps a second of one arm"
    text += f", and {_speed(best.cpu)} of {number(best.arms)} arms in one environment"
    if best.times_peer and single.times_peer:
        text += f": {number(single.times_peer)} and {number(best.times_peer)} times as many as of {REACHER}"
    found = [text + "."]
    gains, cores = [], 0.0
    for row in vectors:
        same = [each for each in alone if each.arms == row.arms and row.threads != 1]
        gains += [f"{number(each.wall / row.wall)} with {number(row.arms)} arms" for each in same]
        cores = max(cores, row.cpu / row.wall)
    text = f"By the clock two threads are as many times faster as one: {', '.join(gains)}"
    return [*found, f"{text}; the machine gave them {cores:.1f} cores at most."]


def _of_physics(rows: Sequence[Row]) -> list[str]:
    physics = [row for row in rows if row.name.endswith(PHYSICS)]
    if len(physics) < 2:
        return []
    ours, theirs = physics
    ratio, name = number(theirs.cpu / ours.cpu), theirs.name.removesuffix(f", {PHYSICS}")
    speeds = f"{_speed(ours.cpu)} against {_speed(theirs.cpu)}"
    return [
        f"Physics alone, {number(ours.arms)} arms: {speeds} control periods a second of {name}, {ratio} times as many."
    ]


def _of_training(rows: Sequence[Row]) -> list[str]:
    return [
        f"PPO with {number(row.arms)} arms learns from {_speed(row.cpu)} steps a second of CPU, a million in "
        f"{number(row.cpu * 1e6 / 60, 2)} minutes; the arms take {row.share or 0.0:.0%} of that."
        for row in _named(rows, PPO)
    ]


def _of_starts(rows: Sequence[Row]) -> list[str]:
    cpu = {row.name: row.cpu for row in rows if row.table == STARTS}
    if not cpu:
        return []
    first, after = f"{FIRST}, {WARM}", f"{IMPORT}, {WARM}"
    text = f"A new process imports the package in {number(cpu[after], 2)} s of CPU and has reset its first environment"
    text += f" {number(cpu[first], 2)} s later"
    cold = [cpu[f"{name}, {COLD}"] for name in (FIRST, MORE) if f"{name}, {COLD}" in cpu]
    return [f"{text}; on a new machine kernels compile first, {number(sum(cold), 2)} s." if cold else f"{text}."]


def publish(rows: Sequence[Row], known: str, folder: Path) -> str:
    """Writes the page about the rows, computed with `known`, and returns it."""
    lines = ["# Benchmark", "", "`make benchmark` writes this page anew; the rows are in `benchmark.csv`.", ""]
    lines += [f"Computed with {known}.", "", *(f"- {text}" for text in conclusions(rows)), ""]
    for name in TABLES:
        lines += _table(name, rows)
    lines += without_endurance(folder / PAGE)[1]
    page = "\n".join(lines).rstrip() + "\n"
    (folder / PAGE).write_text(page, encoding="utf-8")
    return page


def without_endurance(page: Path) -> tuple[list[str], list[str]]:
    """The lines of a page, if there is one, before the section on endurance, and those of the section."""
    lines = page.read_text(encoding="utf-8").splitlines() if page.exists() else []
    first = lines.index(ENDURANCE) if ENDURANCE in lines else len(lines)
    return lines[:first], lines[first:]
