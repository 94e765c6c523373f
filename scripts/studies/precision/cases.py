"""Precision, cases: scenes, their models and truths, and the grid of methods and steps of the published study."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from flexman_gym.model.model import Model, build_model
from flexman_gym.scene import catalog
from flexman_gym.scene.drive import ConstantTorque
from flexman_gym.scene.scene import Initial, Scene
from flexman_gym.simulation.families import EXPLICIT, IMPLICIT, LINEARLY_IMPLICIT
from flexman_gym.simulation.methods import METHODS
from flexman_gym.simulation.scenes import simulate
from studies.methods import fixed_step_methods
from studies.precision.measure import OK, Row, Study, Truth, converged

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
class Case:
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


def cases(reference: Path) -> tuple[Case, ...]:
    """The scenes; `reference` is the folder of reference scenes and solutions."""
    loaded = Scene.load(reference / "gravity_payload_ff.json")
    paper = "the paper's arm, flexible links"
    return (
        Case("paper_ff", f"{paper} and joints", catalog.paper_scene("ff"), (MODAL, PLAIN, SHORTENED), LARGE_ROTATION),
        Case("paper_fr", f"{paper}, rigid joints", catalog.paper_scene("fr"), (MODAL, PLAIN)),
        Case("gravity_payload_ff", "gravity, damping and a payload of 5 kg", loaded, (MODAL, PLAIN)),
        Case("whirl_ff", "the paper's arm, whirling freely", whirl_scene(), (MODAL, SHORTENED)),
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


def total_truth(case: Case, built: dict[str, Model], reference: Path) -> Truth:
    """What the tip truly does: a model of large rotations where there is one, else our finest.

    Its floor is the distance to our finest model, or of that to the next finest.
    """
    fine = simulate(case.scene, built[FINEST], "implicit_midpoint", step=0.1 * _MS)
    if case.reference is not None:
        tip = np.loadtxt(reference / case.reference, delimiter=",", skiprows=1)[:, 1:4]
        return Truth(tip, Truth(tip, 0.0, "").distance(fine), "independent large-rotation code")
    if fine.status != OK:
        raise RuntimeError(f"the finest model of {case.name}: {fine.status}")
    coarser = simulate(case.scene, built[NEXT_FINEST], "implicit_midpoint", step=0.1 * _MS)
    return Truth(fine.tip, Truth(fine.tip, 0.0, "").distance(coarser), f"{FINEST}, implicit_midpoint 0.1 ms")


def study(case: Case, reference: Path) -> Study:
    """A scene with all its models and truths, which takes a minute."""
    built = models(case.scene)
    solutions = {name: converged(case.scene, built[name]) for name in case.timed}
    return Study(case.name, case.scene, built, total_truth(case, built, reference), solutions, case.title)


def steps_of(name: str) -> tuple[float, ...]:
    """Steps (s) of a method of fixed steps: those of its kind, and finer ones for some."""
    return STEPS[METHODS[name].kind] + FINER_STEPS.get(name, ())


def tolerances_of(name: str) -> tuple[float, ...]:
    """Relative tolerances of such a method, none when it does not know its error."""
    method = METHODS[name]
    return TOLERANCES[method.kind] if method.estimates else ()


def grid(result: Study, timed: tuple[str, ...], models: Sequence[str] | None = None) -> Iterator[Row]:
    """All methods and steps on the models whose time error is studied, a few on the others; of some models, or all."""
    names = fixed_step_methods()
    every = {name: steps_of(name) for name in names}
    for model in models or result.models:
        rigid = model in (RIGID, RIGID_LINKS)
        ladders = every if model in timed else RIGID_STEPS if rigid else FEW_STEPS
        for method, steps in ladders.items():
            usable = [step for step in steps if _fits(result.scene, step)]
            yield from result.ladder(model, method, usable, PATIENCE)
        for method in names if model in timed else ():
            yield from result.ladder(model, method, tolerances_of(method), PATIENCE, adaptive=True)


def _fits(scene: Scene, step: float) -> bool:
    """Whether the duration is a whole number of steps and of outputs."""
    count = scene.duration / max(step, scene.output_step)
    return abs(count - round(count)) < 1e-9 * count


def quick_study() -> Study:
    """A small study for tests: the rigid arm with flexible joints for 0.2 s, whose total error a finer model judges."""
    scene = replace(catalog.paper_scene("ff"), duration=0.2)
    built = {name: build_model(scene.arm, **choices(scene)[name]) for name in (RIGID_LINKS, "1 mode a link")}
    solutions = {name: converged(scene, model) for name, model in built.items()}
    fine = build_model(scene.arm, modes=4)
    return Study("paper_ff, 0.2 s", scene, built, converged(scene, fine), solutions, "the first moments")


def quick_grid(result: Study) -> Iterator[Row]:
    """A few methods and steps of each kind."""
    for model in result.models:
        for method, step in (("semi_implicit_euler", 1), ("rk4", 2), ("ros2", 5), ("extrapolated_euler_4", 10)):
            yield from result.ladder(model, method, [step * _MS / part for part in (1, 2, 4)], PATIENCE)
        yield from result.ladder(model, "implicit_midpoint", [20 * _MS, 5 * _MS], PATIENCE)
        yield from result.ladder(model, "extrapolated_euler_4", [1e-2, 1e-4], PATIENCE, adaptive=True)
