"""Work-precision study: scenes, models, methods, reference solutions, and runs with error and cost."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.model.model import Model, build_model
from flexman_gym.scene import catalog
from flexman_gym.scene.scene import Initial, Scene
from flexman_gym.scene.signals import ConstantTorque
from flexman_gym.simulation.methods import EXPLICIT, IMPLICIT, LINEARLY_IMPLICIT, METHODS
from flexman_gym.simulation.scene_simulation import simulate
from flexman_gym.toolbox.precision.runs import OK, PrecisionRow, PrecisionScene, ReferenceSolution, converged
from flexman_gym.toolbox.precision.scene_runs import PATIENCE, PLAIN, RIGID, RIGID_LINKS, SHORTENED
from studies.methods import fixed_step_methods


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


def reference_floors(scene: PrecisionScene) -> list[Floor]:
    """Return the errors of the reference solutions, that of the scene first."""
    references = [("", scene.reference), *scene.solutions.items()]
    return [Floor(scene.name, scene.title, model, each.floor, each.source) for model, each in references]


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


MODAL = "4 modes a link"
FINEST, NEXT_FINEST = "4 elements a link, foreshortening", "3 elements a link, foreshortening"
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


def study(case: _PrecisionCase, reference: Path) -> PrecisionScene:
    """Return a scene with all models and reference solutions, which takes about a minute."""
    built = models(case.scene)
    solutions = {name: converged(case.scene, built[name]) for name in case.timed}
    return PrecisionScene(case.name, case.scene, built, _total_reference(case, built, reference), solutions, case.title)


def _steps_of(name: str) -> tuple[float, ...]:
    """Return the steps (s) of a fixed-step method: those of its kind, and finer ones for some methods."""
    return STEPS[METHODS[name].kind] + FINER_STEPS.get(name, ())


def _tolerances_of(name: str) -> tuple[float, ...]:
    """Return the relative tolerances of a method; empty if it has no error estimate."""
    method = METHODS[name]
    return TOLERANCES[method.kind] if method.estimates else ()


def grid(result: PrecisionScene, timed: tuple[str, ...], models: Sequence[str] | None = None) -> Iterator[PrecisionRow]:
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


def quick_study() -> PrecisionScene:
    """Return a small study for tests: 0.2 s of the arm with rigid links and of a model with one mode per link."""
    scene = replace(catalog.paper_scene("ff"), duration=0.2)
    built = {name: build_model(scene.arm, **choices(scene)[name]) for name in (RIGID_LINKS, "1 mode a link")}
    solutions = {name: converged(scene, model) for name, model in built.items()}
    fine = build_model(scene.arm, modes=4)
    return PrecisionScene("paper_ff, 0.2 s", scene, built, converged(scene, fine), solutions, "the first moments")


def quick_grid(result: PrecisionScene) -> Iterator[PrecisionRow]:
    """Yield rows of a few methods and steps of each kind."""
    for model in result.models:
        for method, step in (("semi_implicit_euler", 1), ("rk4", 2), ("ros2", 5), ("extrapolated_euler_4", 10)):
            yield from result.ladder(model, method, [step * _MS / part for part in (1, 2, 4)], PATIENCE)
        yield from result.ladder(model, "implicit_midpoint", [20 * _MS, 5 * _MS], PATIENCE)
        yield from result.ladder(model, "extrapolated_euler_4", [1e-2, 1e-4], PATIENCE, adaptive=True)
