"""Fidelity study: scenes, and rows of chosen and exhaustively searched models."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import flexman_gym as fm
from flexman_gym.common.arrays import Array


def _random_scene(seed: int) -> fm.Scene:
    """A chain of 1 to 3 hollow metal links on springs, driven by sine torques."""
    rng, links, joints = np.random.default_rng(seed), [], []
    for _ in range(1 + seed % 3):
        radius, length = rng.uniform(0.008, 0.02), rng.uniform(0.5, 1.5)
        area, bending = 0.36 * np.pi * radius**2, 0.5904 * np.pi / 4 * radius**4  # a wall of 0.2 radii
        turn, across = (Rotation.random(random_state=rng).as_matrix().tolist() for _ in range(2))
        links.append(fm.Link(length, area, bending, bending, 2 * bending, 70e9, 26e9, 2700.0, turn))
        joints.append(fm.Joint(across[0], rng.uniform(0.02, 0.2), 10 ** rng.uniform(2.0, 3.5), rng.uniform(0.0, 0.5)))

    def draw(low: float, high: float) -> list[float]:
        return [float(number) for number in rng.uniform(low, high, len(links))]

    torque = fm.SineTorque(draw(1.0, 6.0), draw(0.4, 2.0), draw(0.0, 3.0))
    start, arm = fm.Initial(draw(-1.0, 1.0), draw(-1.0, 1.0)), fm.Arm(links, joints, fm.Payload(rng.uniform(0.0, 0.5)))
    return fm.Scene(arm, fm.ModelChoice(True, 2), torque, start, 1.0, 0.01)


def scenes() -> dict[str, fm.Scene]:
    """The scenes of the study."""
    result = {f"paper {case}": replace(fm.catalog.paper_scene(case), duration=1.0) for case in ("rr", "fr", "ff")}
    heavy = fm.catalog.paper_rrr(rotor_inertia=10.0, payload=fm.Payload(5.0), gravity=(0.0, 0.0, -9.81))
    strips, hub = fm.catalog.planar_2r(joint_stiffness=50.0), fm.catalog.one_link(rotor_inertia=0.1)
    result["paper ff with gravity"] = replace(result["paper ff"], arm=heavy)
    for name, arm, torque in (("two strips", strips, [0.2, 0.05]), ("one link", hub, [0.5])):
        rest = [0.0] * arm.n_joints
        start, choice = fm.Initial(rest, rest), fm.ModelChoice(True, 4 - arm.n_joints)
        result[name] = fm.Scene(arm, choice, fm.ConstantTorque(torque), start, 1.0, 0.01)
    return result | {f"random {seed}": _random_scene(seed) for seed in range(6)}


def open_scenes() -> dict[str, fm.Scene]:
    """The same, with the finite elements left to the choice."""
    return {name: replace(scene, model=replace(scene.model, elements=None)) for name, scene in scenes().items()}


SCENES = {"fidelity.csv": scenes, "fidelity_open.csv": open_scenes}  # by the file of their rows
TOLERANCES = (1e-1, 1e-2, 1e-3)  # m
GRID_MODES = (2, 4, 6, 9, None)  # of each link; None keeps all
GRID_METHODS = ("ros2", "extrapolated_euler_4", "rk4", "generalised_alpha")
GRID_ELEMENTS, CONVERGED, FINE_PARTS = (1, 2, 3), 5, (20, 40)  # where the mesh is open; steps in an output step
OPEN_METHODS = ("ros2", "extrapolated_euler_4", "rk4", "midpoint_2")
GRID_PARTS = (0.1, 0.25, 0.5, 1, 2, 4, 8, 16, 32, 64)  # steps in an output step
FINE_ENOUGH = 0.2  # of the smallest tolerance: a plain run of that error gets no finer step
PATIENCE = 0.5  # s of computing, after which it gets none either
SHORT, REPEATS = 0.02, 5  # s; shorter plain runs, and all choices, are timed so many times


@dataclass(frozen=True)
class FidelityRow:
    """One choice. Costs are seconds of the processor for the whole motion.

    Attributes:
        scene: the arm and its motion.
        tolerance: m, what was asked for.
        error: m, largest distance of the tip from that of the finest model.
        estimate: m, what the choice says its error is.
        ratio: of the estimate to the error.
        coordinates: number of coordinates of the chosen model.
        method: chosen.
        step: s, chosen.
        cost: of the chosen run, the best of five.
        grid: cost of the cheapest plain run that meets the tolerance; infinite when none does.
        dearer: ratio of the two costs.
    """

    scene: str
    tolerance: float
    error: float
    estimate: float
    ratio: float
    coordinates: float
    method: str
    step: float
    cost: float
    grid: float
    dearer: float


def rows(name: str, scene: fm.Scene) -> Iterator[FidelityRow]:
    """The choices for a scene, one for each tolerance."""
    tips = _truth(scene)
    plain = _plain_runs(scene, tips)
    for tolerance in TOLERANCES:
        choice = fm.choose_model(scene, tolerance)
        chosen = choice.model, choice.method, choice.step
        error = _run(scene, *chosen, tips)[0]
        cost = min(_run(scene, *chosen, tips)[1] for _ in range(REPEATS))
        grid = min((cost for error, cost in plain if error <= tolerance), default=np.inf)
        errors = error, choice.estimated_error, choice.estimated_error / max(error, 1e-14)
        yield FidelityRow(name, tolerance, *errors, choice.model.n_dof, *chosen[1:], cost, grid, cost / grid)


def rows_of(cell: tuple[str, str]) -> list[dict[str, Any]]:
    """The choices for a scene, by the file of its rows and its name, as plain data."""
    file, name = cell
    return [asdict(row) for row in rows(name, SCENES[file]()[name])]


def _truth(scene: fm.Scene) -> Array:
    """The tip (T, 3) of the finest model of a scene; where its mesh is open, of five elements a link.

    Explicit steps of so fine a mesh would be short: it is integrated by the midpoint rule, extrapolated to steps of no
    length.
    """
    if scene.model.elements is not None:
        return fm.simulate(scene, _model(scene, None, True), "dop853", rtol=1e-8, atol=1e-11).tip
    model = _model(scene, None, True, CONVERGED)
    longer, shorter = (
        fm.simulate(scene, model, "implicit_midpoint", scene.output_step / parts) for parts in FINE_PARTS
    )
    if {longer.status, shorter.status} != {"ok"}:
        raise RuntimeError(f"the reference fails: {longer.status}, {shorter.status}")
    return (4.0 * shorter.tip - longer.tip) / 3.0


def _plain_runs(scene: fm.Scene, tips: Array) -> Sequence[tuple[float, float]]:
    """Errors and costs of plain choices: the lowest modes of each link, with or without foreshortening.

    Where the mesh is open they are of one, two and three elements a link.
    """
    result = []
    meshes = GRID_ELEMENTS if scene.model.elements is None else (None,)
    methods = GRID_METHODS if scene.model.elements is not None else OPEN_METHODS
    for mesh, modes, stiffening, method in product(meshes, GRID_MODES, (False, True), methods):
        if mesh is not None and modes is not None and modes > 6 * mesh:
            continue
        model = _model(scene, modes, stiffening, mesh)
        for parts in GRID_PARTS:
            chosen = scene, model, method, scene.output_step / parts, tips
            error, cost = _run(*chosen)
            if cost < SHORT:
                cost = min(cost, *(_run(*chosen)[1] for _ in range(REPEATS - 1)))
            result.append((error, cost))
            if error < FINE_ENOUGH * min(TOLERANCES) or cost > PATIENCE:
                break
    return result


def _run(scene: fm.Scene, model: fm.Model, method: str, step: float, tips: Array) -> tuple[float, float]:
    """Error at the tip (m), infinite for a run that failed, and cost (s of computing)."""
    started = time.process_time()
    result = fm.simulate(scene, model, method, step)
    cost = time.process_time() - started
    if result.status != "ok":
        return np.inf, cost
    stride = (len(tips) - 1) // max(1, len(result.tip) - 1)
    return float(np.linalg.norm(result.tip - tips[::stride], axis=1).max()), cost


def _model(scene: fm.Scene, modes: int | None, stiffening: bool, elements: int | None = None) -> fm.Model:
    choice = vars(scene.model) | {"modes": modes, "stiffening": stiffening}
    return fm.build_model(scene.arm, **(choice | ({} if elements is None else {"elements": elements})))
