"""Stored rows of the documentation, by name."""

from functools import cached_property
from pathlib import Path
from typing import TypeVar

from flexman_gym.toolbox.league.standings import Standings
from flexman_gym.toolbox.precision.runs import PrecisionRow
from flexman_gym.toolbox.verification.table import VerificationRow
from studies.benchmark.measure import BenchmarkRow
from studies.control.cases import ControlRow
from studies.environments.measure import Baseline
from studies.files import read_comment, read_rows, split_waiting
from studies.learning.measure import LearningRow
from studies.machine.measure import FitRow
from studies.results import Results
from studies.safety.measure import SafetyRow
from studies.safety.worst_case import WorstRow
from studies.starts.measure import StartRow

Kind = TypeVar("Kind")


class Sources:
    """Stored rows of the documentation.

    Args:
        docs: folder of the documentation; the rows may be in any folder below it.

    Attributes:
        docs: folder of the documentation.
    """

    def __init__(self, docs: Path) -> None:
        self.docs = docs

    def path(self, name: str) -> Path:
        """Return the path of the file with a name.

        Raises:
            FileNotFoundError: without such a file.
        """
        found = sorted(self.docs.rglob(name))
        if not found:
            raise FileNotFoundError(f"{name}: no such file below {self.docs}")
        return found[0]

    def rows(self, name: str, kind: type[Kind]) -> list[Kind]:
        """Return the rows of a CSV file as instances of a dataclass."""
        return read_rows(self.path(name), kind)

    def mark(self, name: str) -> str:
        """Return the end of a clause with a number of a CSV file whose rows wait for new ones; "" for other files."""
        return "; waiting for new rows" * bool(split_waiting(read_comment(self.path(name)))[1])

    @cached_property
    def results(self) -> Results:
        """Results of agents without training, as on all pages."""
        return Results(self.docs)

    @cached_property
    def standings(self) -> Standings:
        """Comparison of the agents of the league."""
        return self.results.standings

    @cached_property
    def baselines(self) -> list[Baseline]:
        """Results of baselines in environments that the league does not have."""
        return self.rows("baselines.csv", Baseline)

    @cached_property
    def safety(self) -> list[SafetyRow]:
        """Moves with the safety filter."""
        return self.rows("safety.csv", SafetyRow)

    @cached_property
    def worst_moves(self) -> list[WorstRow]:
        """Largest excess of the searches for moves that exceed the limits."""
        return self.rows("safety_worst.csv", WorstRow)

    @cached_property
    def learning(self) -> list[LearningRow]:
        """Results of training and of the baselines."""
        return self.rows("learning.csv", LearningRow)

    @cached_property
    def starts(self) -> list[StartRow]:
        """Times of a first use."""
        return self.rows("starts.csv", StartRow)

    @cached_property
    def benchmark(self) -> list[BenchmarkRow]:
        """Computing times."""
        return self.rows("benchmark.csv", BenchmarkRow)

    @cached_property
    def control(self) -> list[ControlRow]:
        """Results of controllers of uncertain arms."""
        return self.rows("control.csv", ControlRow)

    @cached_property
    def peers(self) -> list[PrecisionRow]:
        """Errors and costs of our methods and of other simulators."""
        return self.rows("peers.csv", PrecisionRow)

    @cached_property
    def machine(self) -> list[FitRow]:
        """Comparison with measurements of a real arm."""
        return self.rows("machine.csv", FitRow)

    @cached_property
    def verification(self) -> list[VerificationRow]:
        """Comparisons of the verification."""
        return self.rows("verification.csv", VerificationRow)
