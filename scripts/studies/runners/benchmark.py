"""Speed of environments, training and other simulators, and steps of many arms without growing memory."""

from argparse import Namespace
from collections.abc import Iterator, Sequence

from flexman_gym.common.computer import computer_text
from studies.benchmark import measure as benchmark
from studies.benchmark.endurance import ALLOWED, MEMORY, SETTLED, WARM_MEMORY, EnduranceRow, endurance_rows, endure
from studies.benchmark.page import page
from studies.study import QUICK, Study, Table

EVALUATION_ROUNDS, PART_ROUNDS = 40, 15
FEW_STEPS, FEW_ARMS = 3000, 8  # of the endurance test with --quick
PEERS = ("gymnasium", "stable-baselines3", "torch", "mujoco", "pin")


def speeds(small: bool) -> Iterator[benchmark.BenchmarkRow]:
    """Yield the rows of all benchmarks, each in interleaved rounds."""
    yield from benchmark.environment_rows(benchmark.QUICK if small else benchmark.Grid())
    yield from benchmark.part_rows(1 if small else PART_ROUNDS)
    yield from benchmark.evaluation_rows(2 if small else EVALUATION_ROUNDS)


def endurance(options: Namespace) -> Iterator[EnduranceRow]:
    """Yield the rows of the endurance test."""
    steps, arms = (FEW_STEPS, FEW_ARMS) if options.quick else (options.steps, options.arms)
    yield from endurance_rows(endure(steps, arms, min(SETTLED, steps)))


def report(_: Sequence[benchmark.BenchmarkRow], endured: Sequence[EnduranceRow]) -> int:
    """Return 1 if the memory has grown."""
    known = {row.quantity: row.value for row in endured}
    growth = known[MEMORY] / known[WARM_MEMORY] - 1.0
    print(f"memory grew by {growth:.1%}")
    return int(growth > ALLOWED)


RUNNER = Study(
    tables=(Table("benchmark", benchmark.BenchmarkRow), Table("endurance", EnduranceRow, 9)),
    measure=lambda options: (speeds(options.quick), endurance(options)),
    pages={"benchmark.md": page},
    report=report,
    options=QUICK
    | {
        "--steps": {"type": int, "default": 10_000_000, "help": "steps of the endurance test (default: %(default)s)"},
        "--arms": {"type": int, "default": 256, "help": "arms of the endurance test (default: %(default)s)"},
    },
    comment=lambda _: computer_text(PEERS),
)
