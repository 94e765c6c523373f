"""Precision: what a run costs and how far its tip is from the truth, as rows of a study of work and precision."""

import math
import time as clock
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.model.model import Model
from flexman_gym.scene.scene import Scene
from flexman_gym.simulation.scenes import simulate
from flexman_gym.simulation.trajectory import Trajectory

OK = "ok"
TIGHT, LOOSE = 1e-9, 1e-7  # relative tolerances of the truth and of the run that estimates its error
LEAST_SECONDS, MOST_REPEATS = 0.25, 5  # a short run is repeated until it has taken so long


@dataclass(frozen=True)
class Row:
    """One run.

    Attributes:
        scene, model, method: their names.
        step: s of a fixed step; None where the method chose its steps.
        rtol: relative tolerance of such a method, None for a fixed step; its atol is a thousandth of it.
        cpu, wall: seconds of the processor and of a clock, per simulated second; the best of a few repeats.
        evaluations: of the accelerations, per simulated second.
        time_error: m, largest distance of the tip over the run from the converged solution of the same model; None
            where that was not computed, infinite for a run that failed.
        total_error: m, the same from the truth of the scene, which knows no model.
        status: "ok", "diverged" or "not converged".
    """

    scene: str
    model: str
    method: str
    step: float | None
    rtol: float | None
    cpu: float
    wall: float
    evaluations: float
    time_error: float | None
    total_error: float | None
    status: str

    @property
    def setting(self) -> str:
        """Step or tolerance as a text."""
        return f"{1e3 * self.step:.3g} ms" if self.step is not None else f"rtol {self.rtol:.0e}"


@dataclass(frozen=True)
class Floor:
    """The error of a truth, below which no run can be judged.

    Attributes:
        scene, title: name of the scene and what it is.
        model: whose converged solution it is; empty for the truth of the scene.
        floor: m.
        source: of the truth.
    """

    scene: str
    title: str
    model: str
    floor: float
    source: str


@dataclass(frozen=True, eq=False)
class Truth:
    """What the tip of a scene does.

    Attributes:
        tip: (T, 3) m at equal intervals from the start to the end of the scene.
        floor: m, an estimate of its own error.
        source: who says so.
    """

    tip: Array
    floor: float
    source: str

    def distance(self, result: Trajectory) -> float:
        """Largest distance of the tip, m, at the output times of both; infinite for a run that failed."""
        if result.status != OK:
            return math.inf
        stride, rest = divmod(len(self.tip) - 1, len(result.tip) - 1)
        if rest:
            raise ValueError(
                f"truth: {len(self.tip)} times are not allowed; give 1 + a multiple of {len(result.tip) - 1}"
            )
        return float(np.linalg.norm(result.tip - self.tip[::stride], axis=1).max())


def converged(scene: Scene, model: Model) -> Truth:
    """The solution of a model by the reference method; its error is that of a run at a looser tolerance.

    Raises:
        RuntimeError: when one of the runs fails.
    """
    tight, loose = (simulate(scene, model, "dop853", rtol=rtol, atol=1e-3 * rtol) for rtol in (TIGHT, LOOSE))
    if {tight.status, loose.status} != {OK}:
        raise RuntimeError(f"the reference method fails: {tight.status}, {loose.status}")
    floor = float(np.linalg.norm(tight.tip - loose.tip, axis=1).max())
    return Truth(tight.tip, max(floor, float(np.finfo(float).eps)), f"dop853, rtol {TIGHT:.0e}")


@dataclass(frozen=True, eq=False)
class Study:
    """A scene and what is known about it.

    Attributes:
        name: of the scene.
        scene: itself.
        models: by name.
        truth: what the tip truly does.
        solutions: converged ones of some of the models, by their names.
        title: what the scene is.
    """

    name: str
    scene: Scene
    models: dict[str, Model]
    truth: Truth
    solutions: dict[str, Truth]
    title: str = ""

    def floors(self) -> list[Floor]:
        """Errors of the truths, that of the scene first."""
        return [Floor(self.name, self.title, model, truth.floor, truth.source) for model, truth in self._truths()]

    def _truths(self) -> list[tuple[str, Truth]]:
        return [("", self.truth), *self.solutions.items()]

    def row(self, model: str, method: str, step: float | None = None, rtol: float | None = None) -> Row:
        """One run, timed."""
        tight = rtol or LOOSE
        arguments = (self.models[model], method, step, tight, 1e-3 * tight)
        short = replace(self.scene, duration=max(self.scene.output_step, step or 0.0))
        simulate(short, *arguments)  # loads or compiles the kernels
        cpu, wall, spent, result = math.inf, math.inf, 0.0, None
        for _ in range(MOST_REPEATS):
            started = clock.process_time()
            result = simulate(self.scene, *arguments)
            seconds = clock.process_time() - started
            cpu, wall, spent = min(cpu, seconds), min(wall, result.wall_seconds), spent + seconds
            if spent > LEAST_SECONDS:
                break
        assert result is not None
        reached = float(result.time[-1]) if result.status == OK else max(float(result.time[-1]), self.scene.output_step)
        solution = self.solutions.get(model)
        errors = None if solution is None else solution.distance(result), self.truth.distance(result)
        costs = cpu / reached, wall / reached, result.evaluations / reached
        return Row(self.name, model, method, step, rtol, *costs, *errors, result.status)

    def ladder(
        self, model: str, method: str, settings: Sequence[float], patience: float, adaptive: bool = False
    ) -> Iterator[Row]:
        """Rows of falling steps (s), or tolerances; ends after a run that takes longer than `patience` seconds."""
        for setting in sorted(settings, reverse=True):
            row = self.row(model, method, **{"rtol" if adaptive else "step": setting})
            yield row
            if row.status == OK and row.cpu * self.scene.duration > patience:
                return


def pareto_front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the (cost, error) that no other point beats in one without losing in the other, by rising cost.

    Points that are not finite take no part; of equal points the first stays.
    """
    order = sorted((i for i, point in enumerate(points) if all(map(math.isfinite, point))), key=lambda i: points[i])
    front: list[int] = []
    for i in order:
        if not front or points[i][1] < points[front[-1]][1]:
            front.append(i)
    return front


def cheapest(rows: Sequence[Row], model: str, method: str, error: float) -> Row | None:
    """The cheapest run of a method on a model that comes within a time error (m); None when none does."""
    result = [row for row in rows if (row.model, row.method) == (model, method) and row.time_error is not None]
    return min((row for row in result if row.time_error <= error), key=lambda row: row.cpu, default=None)  # type: ignore[operator]


def cost_at(rows: Sequence[Row], error: float) -> float | None:
    """CPU seconds per simulated second of one method on one model at a time error (m); None outside its errors.

    Between two runs both are taken to follow a power law: a line in a chart with logarithmic axes.
    """
    points = sorted((row.time_error, row.cpu) for row in rows if row.status == OK and row.time_error)
    if not points or not points[0][0] <= error <= points[-1][0]:
        return None
    errors, costs = np.log(points).T
    return float(np.exp(np.interp(np.log(error), errors, costs)))


def settled(rows: Sequence[Row], error: float, column: str = "total_error") -> list[Row]:
    """The runs that come within an error (m) together with every finer step of their model and method.

    They owe nothing to errors of model and method that happen to cancel at one step.

    Args:
        rows: runs.
        error: m.
        column: "total_error" or "time_error".
    """
    return [
        row
        for row in rows
        if all(
            (getattr(other, column) or 0.0) <= error
            for other in rows
            if (other.model, other.method) == (row.model, row.method) and (other.step or 0.0) <= (row.step or 0.0)
        )
    ]


def setbacks(rows: Sequence[Row], factor: float = 10.0) -> list[tuple[Row, Row]]:
    """Pairs of a run and a finer one of the same scene, model and method that is less accurate by a factor, or fails.

    A shorter step that does harm means that the method is unstable there.
    """
    pairs: dict[tuple[str, str, str], tuple[Row, Row]] = {}
    best: dict[tuple[str, str, str], Row] = {}
    steps = [row for row in rows if row.step is not None and row.time_error is not None]
    for row in sorted(steps, key=lambda row: -(row.step or 0.0)):
        key = row.scene, row.model, row.method
        error, earlier = row.time_error, best.get(key)
        assert error is not None
        if earlier is None or error < (earlier.time_error or 0.0):
            best[key] = row
        elif math.isfinite(earlier.time_error or 0.0) and error > factor * (earlier.time_error or 0.0):
            worst = pairs.get(key)
            if worst is None or error > (worst[1].time_error or 0.0):
                pairs[key] = earlier, row
    return list(pairs.values())
