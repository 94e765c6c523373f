"""Work-precision study: scenes, models, methods, reference solutions, and runs with error and cost."""

import math
import time as clock
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.model.model import Model, build_model
from flexman_gym.scene import catalog
from flexman_gym.scene.scene import Initial, Scene
from flexman_gym.scene.signals import ConstantTorque
from flexman_gym.simulation.methods import EXPLICIT, IMPLICIT, LINEARLY_IMPLICIT, METHODS
from flexman_gym.simulation.scene_simulation import simulate
from flexman_gym.simulation.trajectory import Trajectory
from studies.methods import fixed_step_methods

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
    def setting(self) -> str:
        """Step or tolerance as text."""
        return f"{1e3 * self.step:.3g} ms" if self.step is not None else f"rtol {self.rtol:.0e}"


@dataclass(frozen=True)
class Floor:
    """Error of a reference solution, below which errors of runs cannot be resolved.

    Attributes:
        scene, title: name and description of the scene.
        model: model of a converged solution; "" for the reference solution of the scene.
        floor: error, m.
        source: origin of the reference solution.
    """

    scene: str
    title: str
    model: str
    floor: float
    source: str


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


def _converged(scene: Scene, model: Model) -> ReferenceSolution:
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
class Study:
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

    def floors(self) -> list[Floor]:
        """Return the errors of the reference solutions, that of the scene first."""
        return [Floor(self.name, self.title, model, each.floor, each.source) for model, each in self._references()]

    def _references(self) -> list[tuple[str, ReferenceSolution]]:
        return [("", self.reference), *self.solutions.items()]

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


def cheapest(rows: Sequence[PrecisionRow], model: str, method: str, error: float) -> PrecisionRow | None:
    """Return the cheapest run of a method and model within a time error (m), or None."""
    result = [row for row in rows if (row.model, row.method) == (model, method) and row.time_error is not None]
    return min((row for row in result if row.time_error <= error), key=lambda row: row.cpu, default=None)  # type: ignore[operator]


def cost_at(rows: Sequence[PrecisionRow], error: float) -> float | None:
    """Return the CPU time per simulated second at a time error (m), from runs of one method and model.

    The cost is interpolated by a power law between neighbouring runs; None outside their errors.
    """
    points = sorted((row.time_error, row.cpu) for row in rows if row.status == OK and row.time_error)
    if not points or not points[0][0] <= error <= points[-1][0]:
        return None
    errors, costs = np.log(points).T
    return float(np.exp(np.interp(np.log(error), errors, costs)))


def settled(rows: Sequence[PrecisionRow], error: float, column: str = "total_error") -> list[PrecisionRow]:
    """Return the runs whose errors, and those of all finer steps of the same model and method, are within a limit.

    This excludes runs whose model and method errors cancel by chance.

    Args:
        rows: runs.
        error: largest error, m.
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


def setbacks(rows: Sequence[PrecisionRow], factor: float = 10.0) -> list[tuple[PrecisionRow, PrecisionRow]]:
    """Return pairs of a run and a run with a finer step that is less accurate by a factor, or fails.

    Such a pair shows that the method is unstable at the finer step.
    """
    pairs: dict[tuple[str, str, str], tuple[PrecisionRow, PrecisionRow]] = {}
    best: dict[tuple[str, str, str], PrecisionRow] = {}
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


MODAL, PLAIN, SHORTENED = "4 modes a link", "2 elements a link", "2 elements a link, foreshortening"
FINEST, NEXT_FINEST = "4 elements a link, foreshortening", "3 elements a link, foreshortening"
RIGID, RIGID_LINKS = "rigid", "rigid links, flexible joints"
PATIENCE = 1.0  # s; a method with a longer run gets no finer setting
LARGE_ROTATION = "paper_ff_large_rotation.csv"

_MS = 1e-3
_LONG = tuple(step * _MS for step in (20, 10, 5, 2.5, 1, 0.5, 0.25))
_SHORT = tuple(step * _MS for step in (2, 1, 0.5, 0.25, 0.2, 0.1, 0.05, 0.025))
# Steps by kind of method; reference methods have none.
STEPS = {EXPLICIT: _SHORT, LINEARLY_IMPLICIT: _LONG, IMPLICIT: (*_LONG, 0.1 * _MS)}
FINER_STEPS = {
    "semi_implicit_euler": (0.0125 * _MS,),
    "ros2": (0.1 * _MS, 0.05 * _MS),
}  # additional steps of low-order methods
TOLERANCES = {EXPLICIT: (1e-2, 1e-3, 1e-4, 1e-5), LINEARLY_IMPLICIT: (1e-2, 1e-3), IMPLICIT: (1e-2, 1e-3)}
FEW_STEPS = {"extrapolated_euler_5": (20 * _MS, 10 * _MS, 5 * _MS), "implicit_midpoint": (5 * _MS, 2.5 * _MS)}
RIGID_STEPS = {"rk4": (20 * _MS, 10 * _MS, 5 * _MS, 2 * _MS)}


@dataclass(frozen=True)
class _PrecisionCase:
    """Scene of the study.

    Attributes:
        name: name of the scene.
        title: description.
        scene: arm and motion.
        timed: names of the models whose time error is studied.
        reference: file of an independent solution; None uses our finest model.
    """

    name: str
    title: str
    scene: Scene
    timed: tuple[str, ...]
    reference: str | None = None


def whirl_scene() -> Scene:
    """Return the paper's flexible arm without torques, with initial joint rates of 3, 1.5 and -5 rad/s, for 1.5 s."""
    scene = catalog.paper_scene("ff")
    start = Initial((0.0, 0.0, 0.0), (3.0, 1.5, -5.0))
    return replace(scene, torque=ConstantTorque((0.0,) * 3), initial=start, duration=1.5, note="a fast whirl")


def cases(reference: Path) -> tuple[_PrecisionCase, ...]:
    """Return the scenes of the study; `reference` is the folder of reference scenes and solutions."""
    loaded = Scene.load(reference / "gravity_payload_ff.json")
    paper = "the paper's arm, flexible links"
    return (
        _PrecisionCase(
            "paper_ff", f"{paper} and joints", catalog.paper_scene("ff"), (MODAL, PLAIN, SHORTENED), LARGE_ROTATION
        ),
        _PrecisionCase("paper_fr", f"{paper}, rigid joints", catalog.paper_scene("fr"), (MODAL, PLAIN)),
        _PrecisionCase("gravity_payload_ff", "gravity, damping and a payload of 5 kg", loaded, (MODAL, PLAIN)),
        _PrecisionCase("whirl_ff", "the paper's arm, whirling freely", whirl_scene(), (MODAL, SHORTENED)),
    )


def choices(scene: Scene) -> dict[str, dict[str, Any]]:
    """Return keyword arguments of `build_model` by model name."""
    joints = {"flexible_joints": scene.model.flexible_joints}
    result: dict[str, dict[str, Any]] = {RIGID: {"flexible_links": False, "flexible_joints": False}}
    if scene.model.flexible_joints:
        result[RIGID_LINKS] = {"flexible_links": False}
    plural = {count: f"{count} mode{'s' * (count > 1)} a link" for count in (1, 2, 3, 4, 5, 6, 7, 9)}
    result |= {name: {"modes": count, **joints} for count, name in plural.items()}
    result["9 modes a link, foreshortening"] = {"modes": 9, "stiffening": True, **joints}
    meshes: dict[str, Any] = {f"{n} element{'s' * (n > 1)} a link": n for n in (1, 2, 3, 4)}
    meshes["1, 2 and 2 elements"] = (1, 2, 2)
    for name, elements in meshes.items():
        result[name] = {"elements": elements, **joints}
        result[f"{name}, foreshortening"] = {"elements": elements, "stiffening": True, **joints}
    return result


def models(scene: Scene) -> dict[str, Model]:
    """Return all models of a scene by name."""
    return {name: build_model(scene.arm, **choice) for name, choice in choices(scene).items()}


def _total_reference(case: _PrecisionCase, built: dict[str, Model], reference: Path) -> ReferenceSolution:
    """Return the reference motion of the tip: a large-rotation solution if there is one, else our finest model.

    The floor is the distance between both, or between our two finest models.
    """
    fine = simulate(case.scene, built[FINEST], "implicit_midpoint", step=0.1 * _MS)
    if case.reference is not None:
        tip = np.loadtxt(reference / case.reference, delimiter=",", skiprows=1)[:, 1:4]
        return ReferenceSolution(tip, ReferenceSolution(tip, 0.0, "").distance(fine), "independent large-rotation code")
    if fine.status != OK:
        raise RuntimeError(f"the finest model of {case.name}: {fine.status}")
    coarser = simulate(case.scene, built[NEXT_FINEST], "implicit_midpoint", step=0.1 * _MS)
    return ReferenceSolution(
        fine.tip, ReferenceSolution(fine.tip, 0.0, "").distance(coarser), f"{FINEST}, implicit_midpoint 0.1 ms"
    )


def study(case: _PrecisionCase, reference: Path) -> Study:
    """Return a scene with all models and reference solutions, which takes about a minute."""
    built = models(case.scene)
    solutions = {name: _converged(case.scene, built[name]) for name in case.timed}
    return Study(case.name, case.scene, built, _total_reference(case, built, reference), solutions, case.title)


def _steps_of(name: str) -> tuple[float, ...]:
    """Return the steps (s) of a fixed-step method: those of its kind, and finer ones for some methods."""
    return STEPS[METHODS[name].kind] + FINER_STEPS.get(name, ())


def _tolerances_of(name: str) -> tuple[float, ...]:
    """Return the relative tolerances of a method; empty if it has no error estimate."""
    method = METHODS[name]
    return TOLERANCES[method.kind] if method.estimates else ()


def grid(result: Study, timed: tuple[str, ...], models: Sequence[str] | None = None) -> Iterator[PrecisionRow]:
    """Yield rows: all methods and steps for the models with studied time error, a few for the other models."""
    names = fixed_step_methods()
    every = {name: _steps_of(name) for name in names}
    for model in models or result.models:
        rigid = model in (RIGID, RIGID_LINKS)
        ladders = every if model in timed else RIGID_STEPS if rigid else FEW_STEPS
        for method, steps in ladders.items():
            usable = [step for step in steps if _fits(result.scene, step)]
            yield from result.ladder(model, method, usable, PATIENCE)
        for method in names if model in timed else ():
            yield from result.ladder(model, method, _tolerances_of(method), PATIENCE, adaptive=True)


def _fits(scene: Scene, step: float) -> bool:
    """Return whether the duration is a whole number of steps and of outputs."""
    count = scene.duration / max(step, scene.output_step)
    return abs(count - round(count)) < 1e-9 * count


def quick_study() -> Study:
    """Return a small study for tests: 0.2 s of the arm with rigid links and of a model with one mode per link."""
    scene = replace(catalog.paper_scene("ff"), duration=0.2)
    built = {name: build_model(scene.arm, **choices(scene)[name]) for name in (RIGID_LINKS, "1 mode a link")}
    solutions = {name: _converged(scene, model) for name, model in built.items()}
    fine = build_model(scene.arm, modes=4)
    return Study("paper_ff, 0.2 s", scene, built, _converged(scene, fine), solutions, "the first moments")


def quick_grid(result: Study) -> Iterator[PrecisionRow]:
    """Yield rows of a few methods and steps of each kind."""
    for model in result.models:
        for method, step in (("semi_implicit_euler", 1), ("rk4", 2), ("ros2", 5), ("extrapolated_euler_4", 10)):
            yield from result.ladder(model, method, [step * _MS / part for part in (1, 2, 4)], PATIENCE)
        yield from result.ladder(model, "implicit_midpoint", [20 * _MS, 5 * _MS], PATIENCE)
        yield from result.ladder(model, "extrapolated_euler_4", [1e-2, 1e-4], PATIENCE, adaptive=True)
