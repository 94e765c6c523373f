"""Comparison with other simulators: their runs and ours, batches of arms, numerical damping."""

import importlib
import math
import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

import flexman_gym as fm
from flexman_gym.common.arrays import Array
from flexman_gym.kernels import layout
from flexman_gym.simulation.batch import Batch
from studies.methods import vibration_factor
from studies.precision.measure import (
    FINEST,
    LARGE_ROTATION,
    OK,
    PLAIN,
    RIGID,
    RIGID_LINKS,
    PrecisionRow,
    ReferenceSolution,
    Study,
    models,
)
from studies.ringdown.measure import default_model

Timer = Callable[[], PrecisionRow]


@dataclass(frozen=True, eq=False)
class PeerRun:
    """Result and cost of a peer.

    Attributes:
        model, method: its names.
        step: s.
        tip: (T, 3) m at the output times of the scene; NaN from where it failed.
        cpu, wall: seconds of the processor and of a clock, per simulated second.
        evaluations: of its equations of motion, per simulated second.
    """

    model: str
    method: str
    step: float
    tip: Array
    cpu: float
    wall: float
    evaluations: float

    @property
    def finite(self) -> bool:
        """Return whether all values of the run are finite and small enough."""
        return bool(np.isfinite(self.tip).all() and np.abs(self.tip).max() < 1e3)

    def distance(self, tip: Array) -> float:
        """Largest distance (m) of the tip from another tip (T, 3); infinite for a run that failed."""
        return float(np.linalg.norm(self.tip - tip, axis=1).max()) if self.finite else math.inf


def row(study: Study, done: PeerRun, solution: ReferenceSolution | None = None, sane: float = math.inf) -> PrecisionRow:
    """The row of a run; `solution` is the converged one of its model, and an error above `sane` (m) a divergence."""
    names, costs = (study.name, done.model, done.method, done.step, None), (done.cpu, done.wall, done.evaluations)
    error = done.distance(study.reference.tip)
    time_error = None if solution is None else done.distance(solution.tip)
    return PrecisionRow(*names, *costs, time_error, error, OK if done.finite and error < sane else "diverged")


def output_count(scene: fm.Scene, step: float) -> tuple[int, int]:
    """Return the number of outputs of a scene after its start, and the number of steps (s) between two of them.

    Raises:
        ValueError: for a step that does not divide the output step.
    """
    substeps = round(scene.output_step / step)
    if abs(substeps * step - scene.output_step) > 1e-9 * scene.output_step:
        raise ValueError(f"step: {step} is not allowed; give a number that divides {scene.output_step} s")
    return round(scene.duration / scene.output_step), substeps


def with_rigid_joints(scene: fm.Scene) -> fm.Scene:
    """The same scene with motors that turn the links directly."""
    joints = [replace(joint, stiffness=None, damping=0.0) for joint in scene.arm.joints]
    model = replace(scene.model, flexible_joints=False)
    return replace(scene, arm=replace(scene.arm, joints=joints), model=model)


ROUNDS = 3
FINE = [f"{mesh}, foreshortening" for mesh in ("1, 2 and 2 elements", "2 elements a link", "3 elements a link")]
# Of the loaded modes of a mesh those that are left when one after the other goes, each time the one without which the
# tip moves least in this scene; all that went moves it by 1.0 mm. Link 1 keeps all modes but the axial one, link 2 four
# of bending along each axis and two of torsion, link 3 two of bending along each axis and the first axial one.
CUT, CUT_MESH = "20 modes of 1, 3 and 3 elements, foreshortening", (1, 3, 3)
CUT_MODES = ((0, 1, 2, 3, 4), (0, 1, 2, 3, 4, 5, 6, 7, 8, 14), (0, 1, 2, 3, 9))
CHOSEN, TOLERANCE = "chosen for 4.5 mm with its mesh", 4.5e-3  # m, by `choose_model`, from the converged arm
GRID = {"extrapolated_euler_3": (1, 2, 3, 4, 5, 6), "extrapolated_euler_5": (1, 2, 3)}
GRID |= {"midpoint_2": (1, 2, 3, 4, 5, 6), "midpoint_3": (1, 2, 3, 4, 5, 6)}
GRID |= {"gauss_2": (1, 2, 3, 4), "gauss_3": (1, 2, 3, 4)}
GRID["implicit_midpoint"] = (2, 3, 4, 5, 6, 100)  # the last for the error of the model alone
MORE = {"extrapolated_euler_4": (1, 2, 3), "ros2": (5, 10), "generalised_alpha": range(4, 7)}  # where time errors count
PEERS = {"MuJoCo": "mujoco", "Exudyn": "exudyn", "Pinocchio": "pin", "SoRoMoX": "soromox"}  # name: package
MODULES = {"MuJoCo": ("mujoco", "rods"), "Exudyn": ("exudyn",), "Pinocchio": ("pinocchio",), "SoRoMoX": ("soromox",)}


def large_rotation_solution(reference: Path) -> ReferenceSolution:
    """The tip of an independent code in a folder of reference solutions; its floor is the distance to our finest."""
    tip, scene = np.loadtxt(reference / LARGE_ROTATION, delimiter=",", skiprows=1)[:, 1:4], fm.catalog.paper_scene("ff")
    finest = fm.simulate(scene, models(scene)[FINEST], "implicit_midpoint", step=1e-4)
    return ReferenceSolution(tip, ReferenceSolution(tip, 0.0, "").distance(finest), LARGE_ROTATION)


def study(known: ReferenceSolution) -> Study:
    """The scene with its truth, our models, and the converged solution of the one whose time error counts."""
    scene = fm.catalog.paper_scene("ff")
    built = models(scene) | {CUT: fm.build_model(scene.arm, CUT_MESH, CUT_MODES, stiffening=True)}
    built[CHOSEN] = _chosen().model
    plain = ReferenceSolution(fm.simulate(scene, built[PLAIN], "rk4", step=1e-4).tip, 2e-8, "rk4, 0.1 ms")
    return Study("paper_ff", scene, built, known, {PLAIN: plain})


def _chosen() -> fm.Choice:
    """The choice for the scene with an open mesh; found once."""
    scene = fm.catalog.paper_scene("ff")
    return fm.choose_model(replace(scene, model=replace(scene.model, elements=None)), TOLERANCE)


def ours(result: Study) -> list[Timer]:
    """Our runs: fine models against the truth, the paper's own model, whose time error counts, and rigid ones."""
    timers: list[Timer] = []
    for model in [CUT, *FINE, PLAIN]:
        for method, parts in (GRID | (MORE if model == PLAIN else {})).items():
            timers += [lambda a=(model, method, 0.01 / part): result.row(*a) for part in parts]  # type: ignore[misc]
    choice = _chosen()
    timers.append(lambda: result.row(CHOSEN, choice.method, choice.step))
    rigid = (RIGID, 1e-3), (RIGID_LINKS, 5e-3)
    return timers + [lambda a=(model, "rk4", step): result.row(*a) for model, step in rigid]


def theirs(result: Study) -> list[Timer]:
    """Those of the peers that are installed."""
    timers: list[Timer] = []
    for name, modules in MODULES.items():
        try:
            timers += [
                each for module in modules for each in importlib.import_module(f"studies.peers.{module}").runs(result)
            ]
        except ModuleNotFoundError:
            print(f"{name} is missing, so it is left out: pip install 'flexman_gym[peers]'")
    return timers


def in_turns(timers: Sequence[Timer]) -> list[PrecisionRow]:
    """A row of each, with the lowest cost of all rounds."""
    rounds = [[timer() for timer in timers] for _ in range(ROUNDS)]
    best = [min(rows, key=lambda row: row.cpu) for rows in zip(*rounds, strict=True)]
    return sorted(best, key=lambda row: (row.model, row.method, -(row.step or 0.0)))


def of_peers(rows: Sequence[PrecisionRow]) -> list[PrecisionRow]:
    """The rows of other codes, one code after the other."""
    return [row for name in PEERS for row in rows if row.model.startswith(name)]


CORES = len(os.sched_getaffinity(0))
ARMS, STEP = 64 * CORES, 5e-3  # s, of ours
SCENE = f"{ARMS} arms on {CORES} cores"
PIECES = (2, 4)  # of a link in MuJoCo, whose errors are those of ours
DEFAULT, MESH = ("the model of FlexRRR-v0", "midpoint_3"), ("2 elements, foreshortening", "midpoint_2")
Tips = Callable[[], Iterator[Array]]  # gives the tip (3,) m of an arm after each output step


def our_arms(scene: fm.Scene, model: fm.Model, method: str) -> Iterator[Array]:
    """Move arms from rest, under the constant torques of a scene."""
    batch = Batch(model, method, STEP, scene.output_step, arms=ARMS, threads=CORES)
    drive = np.zeros((ARMS, model.n_joints + 6))
    drive[:, : model.n_joints] = scene.torque.value  # type: ignore[union-attr]
    while True:
        batch.step(drive)
        yield batch.outputs[0, layout.TIP].copy()


def batch_rows(study: Study, peers: Sequence[PrecisionRow]) -> list[PrecisionRow]:
    """Rows with seconds for a simulated second of one arm, those of the round that was quickest by the clock."""
    scene = study.scene
    model, mesh = (
        fm.build_model(scene.arm, **vars(default_model().choice)),
        fm.build_model(scene.arm, 2, stiffening=True),
    )
    calls: dict[tuple[str, str, float], Tips] = {(*DEFAULT, STEP): partial(our_arms, scene, model, DEFAULT[1])}
    calls[*MESH, STEP] = partial(our_arms, scene, mesh, MESH[1])
    for pieces in PIECES if any(peer.model.startswith("MuJoCo") for peer in peers) else ():
        from studies.peers.mujoco import batched_arms, longest_step

        step = longest_step(study, pieces, "Euler")
        calls[f"MuJoCo, {pieces} pieces", "Euler, mujoco.batch", step] = partial(
            batched_arms, scene, pieces, step, ARMS, CORES
        )
    rounds = [[_timed(study, name, call) for name, call in calls.items()] for _ in range(ROUNDS)]
    return [min(turns, key=lambda each: each.wall) for turns in zip(*rounds, strict=True)]


def _timed(study: Study, name: tuple[str, str, float], call: Tips) -> PrecisionRow:
    """A row of one run; its first output step, which loads or compiles kernels, is not timed."""
    arms, count = call(), round(study.scene.duration / study.scene.output_step)
    tips = [study.reference.tip[0], next(arms)]
    started = time.process_time(), time.perf_counter()
    tips += [next(arms) for _ in range(count - 1)]
    simulated = ARMS * (count - 1) * study.scene.output_step
    costs = (time.process_time() - started[0]) / simulated, (time.perf_counter() - started[1]) / simulated
    return row(replace(study, name=SCENE), PeerRun(*name, np.array(tips), *costs, 1.0 / name[-1]))


OURS, MODEL, DECAY_PIECES = (
    {"midpoint_2": 2.5e-3, "gauss_3": 1e-2},
    "MuJoCo, 4 pieces",
    4,
)  # methods, steps (s)


def decay(factor: complex, step: float) -> float:
    """The part of the amplitude of a vibration that is lost in a second, from its factor of a step (s)."""
    return 1.0 - float(abs(factor)) ** (1.0 / step)


def decays(arm: fm.Arm, rows: Sequence[PrecisionRow]) -> Iterator[tuple[str, float, float]]:
    """Names of methods, their steps (s) and decays: of ours, and of MuJoCo's at the steps of its runs."""
    omega = 2.0 * np.pi * float(fm.frequencies(fm.build_model(arm, elements=3))[len(arm.joints)])
    for name, step in OURS.items():
        yield f"ours, {name}", step, decay(vibration_factor(fm.METHODS[name], omega * step), step)
    for name, step in ((row.method, row.step or 0.0) for row in rows if row.model == MODEL):
        from studies.peers.mujoco import step_factors

        factors = step_factors(arm, DECAY_PIECES, name, step)
        factor = factors[np.abs(factors - np.exp(1j * omega * step)).argmin()]  # the mode's own
        yield f"{MODEL}, {name}", step, decay(factor, step)
