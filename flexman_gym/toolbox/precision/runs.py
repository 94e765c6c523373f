"""Runs of a scene with their error and cost: all models and methods against a reference motion of the tip."""

import math
import time as clock
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.model.model import Model
from flexman_gym.scene.scene import Scene
from flexman_gym.simulation.scene_simulation import simulate
from flexman_gym.simulation.trajectory import Trajectory

OK = "ok"
TIGHT, LOOSE = 1e-9, 1e-7  # relative tolerances of the reference solution and of the run that estimates its error
LEAST_SECONDS, MOST_REPEATS = 0.25, 5  # s; a run is repeated until this time is used


@dataclass(frozen=True)
class PrecisionRow:
    """One run.

    Attributes:
        scene, model, method: names.
        step: fixed step, s; None for adaptive steps.
        rtol: relative tolerance of adaptive steps, None for a fixed step; atol is a thousandth of it.
        cpu, wall: CPU and wall-clock time per simulated second; the best of a few repetitions.
        evaluations: evaluations of the accelerations per simulated second.
        time_error: largest distance of the tip from the converged solution of the same model, m; None if not computed,
            infinite for a failed run.
        total_error: largest distance of the tip from the reference solution of the scene, m.
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
    def error(self) -> float:
        """Total error, m; infinite for a failed run."""
        return math.inf if self.status != OK or self.total_error is None else self.total_error

    @property
    def setting(self) -> str:
        """Step or tolerance as text."""
        return f"{1e3 * self.step:.3g} ms" if self.step is not None else f"rtol {self.rtol:.0e}"


Timer = Callable[[], PrecisionRow]  # runs and times once


@dataclass(frozen=True, eq=False)
class ReferenceSolution:
    """Reference motion of the tip in a scene.

    Attributes:
        tip: tip positions (T, 3) at equal intervals from start to end of the scene, m.
        floor: estimated error, m.
        source: origin.
    """

    tip: Array
    floor: float
    source: str

    def distance(self, result: Trajectory) -> float:
        """Return the largest distance of the tip at the output times, m; infinite for a failed run."""
        if result.status != OK:
            return math.inf
        stride, rest = divmod(len(self.tip) - 1, len(result.tip) - 1)
        if rest:
            raise ValueError(
                f"reference: {len(self.tip)} times are not allowed; give 1 + a multiple of {len(result.tip) - 1}"
            )
        return float(np.linalg.norm(result.tip - self.tip[::stride], axis=1).max())


def converged(scene: Scene, model: Model) -> ReferenceSolution:
    """Return the converged solution of a model by the reference method, with an error estimate from a looser tolerance.

    Raises:
        RuntimeError: if one of the runs fails.
    """
    tight, loose = (simulate(scene, model, "dop853", rtol=rtol, atol=1e-3 * rtol) for rtol in (TIGHT, LOOSE))
    if {tight.status, loose.status} != {OK}:
        raise RuntimeError(f"the reference method fails: {tight.status}, {loose.status}")
    floor = float(np.linalg.norm(tight.tip - loose.tip, axis=1).max())
    return ReferenceSolution(tight.tip, max(floor, float(np.finfo(float).eps)), f"dop853, rtol {TIGHT:.0e}")


@dataclass(frozen=True, eq=False)
class PrecisionScene:
    """Scene with its models and reference solutions.

    Attributes:
        name: name of the scene.
        scene: arm and motion.
        models: models by name.
        reference: reference motion of the tip.
        solutions: converged solutions by model name.
        title: description of the scene.
    """

    name: str
    scene: Scene
    models: dict[str, Model]
    reference: ReferenceSolution
    solutions: dict[str, ReferenceSolution]
    title: str = ""

    def row(self, model: str, method: str, step: float | None = None, rtol: float | None = None) -> PrecisionRow:
        """Run and time a model and method; return the row."""
        tight = rtol or LOOSE
        arguments = (self.models[model], method, step, tight, 1e-3 * tight)
        short = replace(self.scene, duration=max(self.scene.output_step, step or 0.0))
        simulate(short, *arguments)  # load or compile the kernels
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
        errors = None if solution is None else solution.distance(result), self.reference.distance(result)
        costs = cpu / reached, wall / reached, result.evaluations / reached
        return PrecisionRow(self.name, model, method, step, rtol, *costs, *errors, result.status)

    def ladder(
        self, model: str, method: str, settings: Sequence[float], patience: float, adaptive: bool = False
    ) -> Iterator[PrecisionRow]:
        """Yield rows with decreasing steps (s) or tolerances until a run takes longer than `patience` seconds."""
        for setting in sorted(settings, reverse=True):
            row = self.row(model, method, **{"rtol" if adaptive else "step": setting})
            yield row
            if row.status == OK and row.cpu * self.scene.duration > patience:
                return


def pareto_front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Return the indices of the (cost, error) points on the Pareto front, by increasing cost.

    Points that are not finite are ignored; the first of equal points is kept.
    """
    order = sorted((i for i, point in enumerate(points) if all(map(math.isfinite, point))), key=lambda i: points[i])
    front: list[int] = []
    for i in order:
        if not front or points[i][1] < points[front[-1]][1]:
            front.append(i)
    return front
