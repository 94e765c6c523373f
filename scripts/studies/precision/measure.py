"""Work-precision study: runs with error and cost, reference solutions, scenes, models and methods."""

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
TIGHT, LOOSE = 1e-9, 1e-7  # relative tolerances of the truth and of the run that estimates its error
LEAST_SECONDS, MOST_REPEATS = 0.25, 5  # a short run is repeated until it has taken so long


@dataclass(frozen=True)
class PrecisionRow:
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
class ReferenceSolution:
    """Motion of the tip in a scene.

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
                f"reference: {len(self.tip)} times are not allowed; give 1 + a multiple of {len(result.tip) - 1}"
            )
        return float(np.linalg.norm(result.tip - self.tip[::stride], axis=1).max())


def _converged(scene: Scene, model: Model) -> ReferenceSolution:
    """The solution of a model by the reference method; its error is that of a run at a looser tolerance.

    Raises:
        RuntimeError: when one of the runs fails.
    """
    tight, loose = (simulate(scene, model, "dop853", rtol=rtol, atol=1e-3 * rtol) for rtol in (TIGHT, LOOSE))
    if {tight.status, loose.status} != {OK}:
        raise RuntimeError(f"the reference method fails: {tight.status}, {loose.status}")
    floor = float(np.linalg.norm(tight.tip - loose.tip, axis=1).max())
    return ReferenceSolution(tight.tip, max(floor, float(np.finfo(float).eps)), f"dop853, rtol {TIGHT:.0e}")


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
    reference: ReferenceSolution
    solutions: dict[str, ReferenceSolution]
    title: str = ""

    def floors(self) -> list[Floor]:
        """Errors of the truths, that of the scene first."""
        return [Floor(self.name, self.title, model, each.floor, each.source) for model, each in self._references()]

    def _references(self) -> list[tuple[str, ReferenceSolution]]:
        return [("", self.reference), *self.solutions.items()]

    def row(self, model: str, method: str, step: float | None = None, rtol: float | None = None) -> PrecisionRow:
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
        errors = None if solution is None else solution.distance(result), self.reference.distance(result)
        costs = cpu / reached, wall / reached, result.evaluations / reached
        return PrecisionRow(self.name, model, method, step, rtol, *costs, *errors, result.status)

    def ladder(
        self, model: str, method: str, settings: Sequence[float], patience: float, adaptive: bool = False
    ) -> Iterator[PrecisionRow]:
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


def cheapest(rows: Sequence[PrecisionRow], model: str, method: str, error: float) -> PrecisionRow | None:
    """The cheapest run of a method on a model that comes within a time error (m); None when none does."""
    result = [row for row in rows if (row.model, row.method) == (model, method) and row.time_error is not None]
    return min((row for row in result if row.time_error <= error), key=lambda row: row.cpu, default=None)  # type: ignore[operator]


def cost_at(rows: Sequence[PrecisionRow], error: float) -> float | None:
    """CPU seconds per simulated second of one method on one model at a time error (m); None outside its errors.

    Between two runs both are taken to follow a power law: a line in a chart with logarithmic axes.
    """
    points = sorted((row.time_error, row.cpu) for row in rows if row.status == OK and row.time_error)
    if not points or not points[0][0] <= error <= points[-1][0]:
        return None
    errors, costs = np.log(points).T
    return float(np.exp(np.interp(np.log(error), errors, costs)))


def settled(rows: Sequence[PrecisionRow], error: float, column: str = "total_error") -> list[PrecisionRow]:
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


def setbacks(rows: Sequence[PrecisionRow], factor: float = 10.0) -> list[tuple[PrecisionRow, PrecisionRow]]:
    """Pairs of a run and a finer one of the same scene, model and method that is less accurate by a factor, or fails.

    A shorter step that does harm means that the method is unstable there.
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
PATIENCE = 1.0  # s of computing, after which a method gets no finer setting
LARGE_ROTATION = "paper_ff_large_rotation.csv"

_MS = 1e-3
_LONG = tuple(step * _MS for step in (20, 10, 5, 2.5, 1, 0.5, 0.25))
_SHORT = tuple(step * _MS for step in (2, 1, 0.5, 0.25, 0.2, 0.1, 0.05, 0.025))
# By the kind of a method. Reference methods judge the others and have none.
STEPS = {EXPLICIT: _SHORT, LINEARLY_IMPLICIT: _LONG, IMPLICIT: (*_LONG, 0.1 * _MS)}
FINER_STEPS = {"semi_implicit_euler": (0.0125 * _MS,), "ros2": (0.1 * _MS, 0.05 * _MS)}  # of those of low order
TOLERANCES = {EXPLICIT: (1e-2, 1e-3, 1e-4, 1e-5), LINEARLY_IMPLICIT: (1e-2, 1e-3), IMPLICIT: (1e-2, 1e-3)}
FEW_STEPS = {"extrapolated_euler_5": (20 * _MS, 10 * _MS, 5 * _MS), "implicit_midpoint": (5 * _MS, 2.5 * _MS)}
RIGID_STEPS = {"rk4": (20 * _MS, 10 * _MS, 5 * _MS, 2 * _MS)}


@dataclass(frozen=True)
class _PrecisionCase:
    """A scene of the study.

    Attributes:
        name: of the scene.
        title: what it is.
        scene: itself.
        timed: names of the models whose time error is studied.
        reference: file of an independent solution; None where our finest model is the truth.
    """

    name: str
    title: str
    scene: Scene
    timed: tuple[str, ...]
    reference: str | None = None


def whirl_scene() -> Scene:
    """The paper's arm, everything flexible, without torques: joints that start at 3, 1.5 and -5 rad/s, for 1.5 s."""
    scene = catalog.paper_scene("ff")
    start = Initial((0.0, 0.0, 0.0), (3.0, 1.5, -5.0))
    return replace(scene, torque=ConstantTorque((0.0,) * 3), initial=start, duration=1.5, note="a fast whirl")


def cases(reference: Path) -> tuple[_PrecisionCase, ...]:
    """The scenes; `reference` is the folder of reference scenes and solutions."""
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
    """Keyword arguments of `build_model` by the name of the model."""
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
    """All models of a scene, by name."""
    return {name: build_model(scene.arm, **choice) for name, choice in choices(scene).items()}


def _total_reference(case: _PrecisionCase, built: dict[str, Model], reference: Path) -> ReferenceSolution:
    """Return the reference motion of the tip: a model of large rotations if there is one, else our finest model.

    Its floor is the distance to our finest model, or of that to the next finest.
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
    """A scene with all its models and truths, which takes a minute."""
    built = models(case.scene)
    solutions = {name: _converged(case.scene, built[name]) for name in case.timed}
    return Study(case.name, case.scene, built, _total_reference(case, built, reference), solutions, case.title)


def _steps_of(name: str) -> tuple[float, ...]:
    """Step (s) of a method of fixed steps: those of its kind, and finer ones for some."""
    return STEPS[METHODS[name].kind] + FINER_STEPS.get(name, ())


def _tolerances_of(name: str) -> tuple[float, ...]:
    """Relative tolerances of such a method, none when it does not know its error."""
    method = METHODS[name]
    return TOLERANCES[method.kind] if method.estimates else ()


def grid(result: Study, timed: tuple[str, ...], models: Sequence[str] | None = None) -> Iterator[PrecisionRow]:
    """All methods and steps on the models whose time error is studied, a few on the others; of some models, or all."""
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
    """A small study for tests: the rigid arm with flexible joints for 0.2 s, whose total error a finer model judges."""
    scene = replace(catalog.paper_scene("ff"), duration=0.2)
    built = {name: build_model(scene.arm, **choices(scene)[name]) for name in (RIGID_LINKS, "1 mode a link")}
    solutions = {name: _converged(scene, model) for name, model in built.items()}
    fine = build_model(scene.arm, modes=4)
    return Study("paper_ff, 0.2 s", scene, built, _converged(scene, fine), solutions, "the first moments")


def quick_grid(result: Study) -> Iterator[PrecisionRow]:
    """A few methods and steps of each kind."""
    for model in result.models:
        for method, step in (("semi_implicit_euler", 1), ("rk4", 2), ("ros2", 5), ("extrapolated_euler_4", 10)):
            yield from result.ladder(model, method, [step * _MS / part for part in (1, 2, 4)], PATIENCE)
        yield from result.ladder(model, "implicit_midpoint", [20 * _MS, 5 * _MS], PATIENCE)
        yield from result.ladder(model, "extrapolated_euler_4", [1e-2, 1e-4], PATIENCE, adaptive=True)
