"""Fidelity study: scenes, chosen models, and an exhaustive search for comparison."""

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
    """Return a random chain of 1 to 3 hollow metal links on elastic joints, driven by sine torques."""
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
    """Return the scenes of the study by name."""
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
    """Return the same scenes with the number of finite elements left to `choose_model`."""
    return {name: replace(scene, model=replace(scene.model, elements=None)) for name, scene in scenes().items()}


SCENES = {"fidelity.csv": scenes, "fidelity_open.csv": open_scenes}  # file of the rows -> scenes
TOLERANCES = (1e-1, 1e-2, 1e-3)  # m
GRID_MODES = (2, 4, 6, 9, None)  # modes per link; None: all
GRID_METHODS = ("ros2", "extrapolated_euler_4", "rk4", "generalised_alpha")
GRID_ELEMENTS, CONVERGED, FINE_PARTS = (1, 2, 3), 5, (20, 40)  # of open meshes; steps per output step
OPEN_METHODS = ("ros2", "extrapolated_euler_4", "rk4", "midpoint_2")
GRID_PARTS = (0.1, 0.25, 0.5, 1, 2, 4, 8, 16, 32, 64)  # steps per output step
FINE_ENOUGH = 0.2  # share of the smallest tolerance; a grid run below it gets no finer step
PATIENCE = 0.5  # s; a grid run with a longer CPU time gets no finer step
SHORT, REPEATS = 0.02, 5  # s; shorter grid runs and all chosen runs are repeated for timing


@dataclass(frozen=True)
class FidelityRow:
    """One choice of `choose_model`; costs are CPU seconds of the whole motion.

    Attributes:
        scene: name of the arm and its motion.
        tolerance: requested tip error, m.
        error: largest distance of the tip from that of the finest model, m.
        estimate: error estimate returned with the choice, m.
        ratio: estimate divided by error.
        coordinates: number of coordinates of the chosen model.
        method: chosen method.
        step: chosen step, s.
        cost: CPU time of the chosen run, best of five, s.
        grid: CPU time of the cheapest run of the grid that meets the tolerance, s; infinite if none does.
        dearer: cost divided by grid.
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
    """Yield the choice for a scene at each tolerance."""
    tips = _reference_tip(scene)
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
    """Return the choices of a cell (file of the rows, scene name) as plain data."""
    file, name = cell
    return [asdict(row) for row in rows(name, SCENES[file]()[name])]


def _reference_tip(scene: fm.Scene) -> Array:
    """Return the tip (T, 3) of the finest model of a scene, with five elements per link if its mesh is open.

    On this fine mesh explicit steps would be short; the midpoint rule with Richardson extrapolation is used instead.
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
    """Return errors and costs of a grid of models: the lowest modes of each link, with and without foreshortening.

    An open mesh has one, two or three elements per link.
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
    """Return the tip error (m; infinite if the run fails) and the CPU time (s)."""
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
