"""Page of the benchmark: tables and conclusions."""

from collections.abc import Callable, Sequence
from pathlib import Path

from flexman_gym.common.markdown import markdown_table
from studies.benchmark.measure import (
    COLD,
    ENVIRONMENTS,
    EVALUATIONS,
    EVALUATIONS_NOTE,
    FIRST,
    IMPORT,
    MORE,
    OURS,
    PARTS,
    PHYSICS,
    PPO,
    REACHER,
    STARTS,
    VECTOR,
    WARM,
    BenchmarkRow,
)
from studies.benchmark.measure import PARTS_NOTE as PARTS_NOTE
from studies.markdown import bullets

PAGE = "benchmark.md"
ENDURANCE = "## Endurance"  # heading of the last section, which `benchmark.endurance` writes
STEPS_NOTE = f"""Steps of 20 ms under random actions drawn in advance, including resets. All rows are measured in
interleaved rounds. CPU time is the total of all threads, the median of the rounds. Wall-clock time is that of the
fastest round, since other processes disturb it. Ratios are those of CPU time, or of wall-clock time with two threads.
"Physics only" is without observations, rewards and episodes. MuJoCo's arm is that of {OURS} as a chain of rigid pieces
without modal damping; all its arms are simulated in one call per control period, at the longest stable step.
[peers.md](peers.md) compares the accuracy. Training is that of `flexman train` with a new policy, in batches of 1024
and with one thread for the networks. The share of the arms is that of the environment's `step`."""
STARTS_NOTE = (
    "Measured in a new process, one phase after the other: once without compiled kernels, and the median of several "
    "starts with them."
)
HEAD = """# Benchmark

This page has the speed of simulation, environment steps, training and start-up on one computer. A single arm steps
somewhat slower than the rigid arm of Reacher-v5, and many arms in one environment several times as fast. Training
spends most of its time in the networks, not in the simulation. The first start compiles kernels, which takes about a
minute. Later starts take about a second.

`make benchmark` rewrites this page; the rows are in `benchmark.csv`.

Computed with {computer}.
"""

# Conclusions; speeds are in steps per second.
CORE = "One core computes {single} steps per second of one arm, and {best} of {arms} arms in one environment."
CORE_BESIDE_PEER = CORE + " This is {single_times} and {best_times} times the speed of {peer}."
THREADS = (
    "In wall-clock time two threads are at best {times} times as fast as one, with {arms} arms. "
    "At most {cores:.1f} cores were available to them."
)
PHYSICS_ALONE = "The physics alone is {times} times as fast as {peer}."
TRAINING = (
    "PPO with {arms} arms processes {speed} steps per CPU second, a million in {minutes} min. "
    "The simulation takes {share:.0%} of the time."
)
START = (
    "A new process imports the package in {after} s of CPU time and has reset its first environment {first} s later."
)
START_COLD = START + " On a new computer the kernels are compiled first, which takes {cold} s."


def number(value: float | None, digits: int = 3) -> str:
    """Return a number with three digits and thousands separators; "" for None."""
    if value is None:
        return ""
    return f"{value:,.0f}" if abs(value) >= 1e3 else f"{value:.{digits}g}"


def _speed(seconds: float) -> str:
    return number(float(f"{1 / seconds:.3g}"))


def _evaluation(row: BenchmarkRow) -> list[str]:
    return [row.name, number(row.cpu * 1e6), row.peer, number(row.times_peer)]


def _environment(row: BenchmarkRow) -> list[str]:
    share = "" if row.share is None else f"{row.share:.0%}"
    speeds = [_speed(row.cpu), _speed(row.wall), number(row.times_peer), share]
    return [row.name, number(row.arms), number(row.threads), *speeds]


def _part(row: BenchmarkRow) -> list[str]:
    return [row.name, number(row.arms), number(row.cpu * 1e6), number(row.wall * 1e6)]


def _start(row: BenchmarkRow) -> list[str]:
    return [row.name, number(row.cpu), number(row.wall)]


TABLES: dict[str, tuple[str, str, tuple[str, ...], Callable[[BenchmarkRow], list[str]]]] = {
    ENVIRONMENTS: (
        "Steps of environments",
        STEPS_NOTE,
        (
            "row",
            "arms",
            "threads",
            "steps per CPU second",
            "per wall-clock second",
            f"times {REACHER}",
            "share of the arms",
        ),
        _environment,
    ),
    PARTS: (
        "Parts of a step",
        PARTS_NOTE,
        ("part", "arms", "CPU, microseconds", "wall clock, microseconds"),
        _part,
    ),
    STARTS: ("Start-up", STARTS_NOTE, ("row", "CPU, s", "wall clock, s"), _start),
    EVALUATIONS: (
        "Evaluations of the equations of motion",
        EVALUATIONS_NOTE,
        ("row", "CPU, microseconds", "compared with", "ratio"),
        _evaluation,
    ),
}


def _table(name: str, rows: Sequence[BenchmarkRow]) -> list[str]:
    title, note, heads, cells = TABLES[name]
    own = [row for row in rows if row.table == name]
    return [f"## {title}", "", note, "", *markdown_table(heads, map(cells, own)), ""]


def conclusions(rows: Sequence[BenchmarkRow]) -> list[str]:
    """Return the conclusions, one sentence each."""
    return [*_of_arms(rows), *_of_physics(rows), *_of_training(rows), *_of_starts(rows)]


def _named(rows: Sequence[BenchmarkRow], name: str) -> list[BenchmarkRow]:
    return [row for row in rows if row.name == name]


def _of_arms(rows: Sequence[BenchmarkRow]) -> list[str]:
    vectors = _named(rows, VECTOR)
    alone = [row for row in vectors if row.threads == 1]
    best, (single,) = min(alone, key=lambda row: row.cpu), _named(rows, OURS)
    numbers = {"single": _speed(single.cpu), "best": _speed(best.cpu), "arms": number(best.arms)}
    numbers |= {"single_times": number(single.times_peer), "best_times": number(best.times_peer), "peer": REACHER}
    core = CORE_BESIDE_PEER if single.times_peer and best.times_peer else CORE
    pairs = [(one, two) for two in vectors if two.threads != 1 for one in alone if one.arms == two.arms]
    if not pairs:
        return [core.format(**numbers)]
    one, two = max(pairs, key=lambda pair: pair[0].wall / pair[1].wall)
    gain = {"times": number(one.wall / two.wall), "arms": number(two.arms)}
    return [core.format(**numbers), THREADS.format(**gain, cores=max(row.cpu / row.wall for row in vectors))]


def _of_physics(rows: Sequence[BenchmarkRow]) -> list[str]:
    physics = [row for row in rows if row.name.endswith(PHYSICS)]
    if len(physics) < 2:
        return []
    ours, theirs = physics
    peer = theirs.name.removesuffix(f", {PHYSICS}")
    return [PHYSICS_ALONE.format(peer=peer, times=number(theirs.cpu / ours.cpu))]


def _of_training(rows: Sequence[BenchmarkRow]) -> list[str]:
    return [
        TRAINING.format(
            arms=number(row.arms),
            speed=_speed(row.cpu),
            minutes=number(row.cpu * 1e6 / 60, 2),
            share=row.share or 0.0,
        )
        for row in _named(rows, PPO)
    ]


def _of_starts(rows: Sequence[BenchmarkRow]) -> list[str]:
    cpu = {row.name: row.cpu for row in rows if row.table == STARTS}
    if not cpu:
        return []
    cold = sum(cpu.get(f"{name}, {COLD}", 0.0) for name in (FIRST, MORE))
    numbers = {"first": number(cpu[f"{FIRST}, {WARM}"], 2), "after": number(cpu[f"{IMPORT}, {WARM}"], 2)}
    return [(START_COLD if cold else START).format(**numbers, cold=number(cold, 2))]


def publish(rows: Sequence[BenchmarkRow], known: str, folder: Path) -> str:
    """Write the page from the rows and return it; `known` describes the computer."""
    lines = [HEAD.format(computer=known), *bullets(conclusions(rows)), ""]
    for name in TABLES:
        lines += _table(name, rows)
    lines += without_endurance(folder / PAGE)[1]
    page = "\n".join(lines).rstrip() + "\n"
    (folder / PAGE).write_text(page, encoding="utf-8")
    return page


def without_endurance(page: Path) -> tuple[list[str], list[str]]:
    """Return the lines of a page before the section on endurance, and the lines of that section."""
    lines = page.read_text(encoding="utf-8").splitlines() if page.exists() else []
    first = lines.index(ENDURANCE) if ENDURANCE in lines else len(lines)
    return lines[:first], lines[first:]
