"""Comparison with other simulators: single runs, batches of arms, numerical damping."""

import importlib
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
from flexman_gym.toolbox.precision.peers.peer_run import PeerRun, peer_row
from flexman_gym.toolbox.precision.runs import PrecisionRow, PrecisionScene, ReferenceSolution, Timer
from studies.methods import vibration_factor
from studies.precision.measure import FINEST, LARGE_ROTATION, PLAIN, RIGID, RIGID_LINKS, models
from studies.ringdown.measure import default_model

ROUNDS = 3
FINE = [f"{mesh}, foreshortening" for mesh in ("1, 2 and 2 elements", "2 elements a link", "3 elements a link")]
# Loaded modes after backward elimination, which removes the mode with the smallest effect on the tip in this scene; all
# removed modes together move the tip by 1.0 mm. Link 1 keeps all modes but the axial one, link 2 four bending modes
# along each axis and two torsional modes, link 3 two bending modes along each axis and the first axial mode.
CUT, CUT_MESH = "20 modes of 1, 3 and 3 elements, foreshortening", (1, 3, 3)
CUT_MODES = ((0, 1, 2, 3, 4), (0, 1, 2, 3, 4, 5, 6, 7, 8, 14), (0, 1, 2, 3, 9))
CHOSEN, TOLERANCE = "chosen for 4.5 mm with its mesh", 4.5e-3  # m; tolerance of `choose_model`
GRID = {"extrapolated_euler_3": (1, 2, 3, 4, 5, 6), "extrapolated_euler_5": (1, 2, 3)}
GRID |= {"midpoint_2": (1, 2, 3, 4, 5, 6), "midpoint_3": (1, 2, 3, 4, 5, 6)}
GRID |= {"gauss_2": (1, 2, 3, 4), "gauss_3": (1, 2, 3, 4)}
GRID["implicit_midpoint"] = (2, 3, 4, 5, 6, 100)  # the last isolates the model error
MORE = {
    "extrapolated_euler_4": (1, 2, 3),
    "ros2": (5, 10),
    "generalised_alpha": range(4, 7),
}  # models with studied time error
PEERS = {"MuJoCo": "mujoco", "Exudyn": "exudyn", "Pinocchio": "pin", "SoRoMoX": "soromox"}  # simulator -> package
_PACKAGE = "flexman_gym.toolbox.precision.peers"
MODULES = {
    "MuJoCo": (f"{_PACKAGE}.mujoco", "studies.peers.rods"), "Exudyn": (f"{_PACKAGE}.exudyn",),
    "Pinocchio": (f"{_PACKAGE}.pinocchio",), "SoRoMoX": ("studies.peers.soromox",),
}  # fmt: skip


def large_rotation_solution(reference: Path) -> ReferenceSolution:
    """Return the independent large-rotation solution; its floor is its distance from our finest model."""
    tip, scene = np.loadtxt(reference / LARGE_ROTATION, delimiter=",", skiprows=1)[:, 1:4], fm.catalog.paper_scene("ff")
    finest = fm.simulate(scene, models(scene)[FINEST], "implicit_midpoint", step=1e-4)
    return ReferenceSolution(tip, ReferenceSolution(tip, 0.0, "").distance(finest), LARGE_ROTATION)


def study(known: ReferenceSolution) -> PrecisionScene:
    """Return the study: scene, reference, our models, and the converged solution of the paper's model."""
    scene = fm.catalog.paper_scene("ff")
    built = models(scene) | {CUT: fm.build_model(scene.arm, CUT_MESH, CUT_MODES, stiffening=True)}
    built[CHOSEN] = _chosen().model
    plain = ReferenceSolution(fm.simulate(scene, built[PLAIN], "rk4", step=1e-4).tip, 2e-8, "rk4, 0.1 ms")
    return PrecisionScene("paper_ff", scene, built, known, {PLAIN: plain})


def _chosen() -> fm.Choice:
    """Return the choice of `choose_model` for the scene with an open mesh."""
    scene = fm.catalog.paper_scene("ff")
    return fm.choose_model(replace(scene, model=replace(scene.model, elements=None)), TOLERANCE)


def ours(result: PrecisionScene) -> list[Timer]:
    """Return timers of our runs: fine models, the paper's model (with time errors), and rigid models."""
    timers: list[Timer] = []
    for model in [CUT, *FINE, PLAIN]:
        for method, parts in (GRID | (MORE if model == PLAIN else {})).items():
            timers += [lambda a=(model, method, 0.01 / part): result.row(*a) for part in parts]  # type: ignore[misc]
    choice = _chosen()
    timers.append(lambda: result.row(CHOSEN, choice.method, choice.step))
    rigid = (RIGID, 1e-3), (RIGID_LINKS, 5e-3)
    return timers + [lambda a=(model, "rk4", step): result.row(*a) for model, step in rigid]


def theirs(result: PrecisionScene) -> list[Timer]:
    """Return timers of the runs of all installed simulators."""
    timers: list[Timer] = []
    for name, modules in MODULES.items():
        try:
            timers += [each for module in modules for each in importlib.import_module(module).runs(result)]
        except ModuleNotFoundError:
            print(f"{name} is missing, so it is left out: pip install 'flexman_gym[peers]'")
    return timers


def in_turns(timers: Sequence[Timer]) -> list[PrecisionRow]:
    """Run all timers in interleaved rounds and return the row of lowest CPU time of each."""
    rounds = [[timer() for timer in timers] for _ in range(ROUNDS)]
    best = [min(rows, key=lambda row: row.cpu) for rows in zip(*rounds, strict=True)]
    return sorted(best, key=lambda row: (row.model, row.method, -(row.step or 0.0)))


def of_peers(rows: Sequence[PrecisionRow]) -> list[PrecisionRow]:
    """Return the rows of other simulators, ordered by simulator."""
    return [row for name in PEERS for row in rows if row.model.startswith(name)]


CORES = len(os.sched_getaffinity(0))
ARMS, STEP = 64 * CORES, 5e-3  # number of arms; step of our batches, s
SCENE = f"{ARMS} arms on {CORES} cores"
PIECES = (2, 4)  # pieces per link in MuJoCo, with errors similar to ours
DEFAULT, MESH = ("the model of FlexRRR-v0", "midpoint_3"), ("2 elements, foreshortening", "midpoint_2")
Tips = Callable[[], Iterator[Array]]  # returns an iterator over the tip (3,) m of an arm at the output times


def our_arms(scene: fm.Scene, model: fm.Model, method: str) -> Iterator[Array]:
    """Simulate a batch of arms from rest under the torques of a scene; yield the tip of the first arm."""
    batch = Batch(model, method, STEP, scene.output_step, arms=ARMS, threads=CORES)
    drive = np.zeros((ARMS, model.n_joints + 6))
    drive[:, : model.n_joints] = scene.torque.value  # type: ignore[union-attr]
    while True:
        batch.step(drive)
        yield batch.outputs[0, layout.TIP].copy()


def batch_rows(study: PrecisionScene, peers: Sequence[PrecisionRow]) -> list[PrecisionRow]:
    """Measure batches of arms and return rows with CPU and wall-clock time per simulated second and arm."""
    scene = study.scene
    model, mesh = (
        fm.build_model(scene.arm, **vars(default_model().choice)),
        fm.build_model(scene.arm, 2, stiffening=True),
    )
    calls: dict[tuple[str, str, float], Tips] = {(*DEFAULT, STEP): partial(our_arms, scene, model, DEFAULT[1])}
    calls[*MESH, STEP] = partial(our_arms, scene, mesh, MESH[1])
    for pieces in PIECES if any(peer.model.startswith("MuJoCo") for peer in peers) else ():
        from flexman_gym.toolbox.precision.peers.mujoco import batched_arms, longest_step

        step = longest_step(study, pieces, "Euler")
        calls[f"MuJoCo, {pieces} pieces", "Euler, mujoco.batch", step] = partial(
            batched_arms, scene, pieces, step, ARMS, CORES
        )
    rounds = [[_timed(study, name, call) for name, call in calls.items()] for _ in range(ROUNDS)]
    return [min(turns, key=lambda each: each.wall) for turns in zip(*rounds, strict=True)]


def _timed(study: PrecisionScene, name: tuple[str, str, float], call: Tips) -> PrecisionRow:
    """Return the row of a batch run; the first output step is excluded, since it loads or compiles kernels."""
    arms, count = call(), round(study.scene.duration / study.scene.output_step)
    tips = [study.reference.tip[0], next(arms)]
    started = time.process_time(), time.perf_counter()
    tips += [next(arms) for _ in range(count - 1)]
    simulated = ARMS * (count - 1) * study.scene.output_step
    costs = (time.process_time() - started[0]) / simulated, (time.perf_counter() - started[1]) / simulated
    return peer_row(replace(study, name=SCENE), PeerRun(*name, np.array(tips), *costs, 1.0 / name[-1]))


OURS, MODEL, DECAY_PIECES = (
    {"midpoint_2": 2.5e-3, "gauss_3": 1e-2},
    "MuJoCo, 4 pieces",
    4,
)  # methods, steps (s)


def decay(factor: complex, step: float) -> float:
    """Return the share of the amplitude lost per second, from the amplification factor of a step (s)."""
    return 1.0 - float(abs(factor)) ** (1.0 / step)


@dataclass(frozen=True)
class Decay:
    """Numerical damping of an integrator.

    Attributes:
        integrator: code or model, and method.
        step: step, s.
        loss: share of the amplitude of the lowest mode lost per second, for an arm without damping.
    """

    integrator: str
    step: float
    loss: float


def decays(arm: fm.Arm, rows: Sequence[PrecisionRow]) -> Iterator[Decay]:
    """Yield the numerical damping of our methods, and of MuJoCo's integrators at the steps of their runs."""
    omega = 2.0 * np.pi * float(fm.frequencies(fm.build_model(arm, elements=3))[len(arm.joints)])
    for name, step in OURS.items():
        yield Decay(f"ours, {name}", step, decay(vibration_factor(fm.METHODS[name], omega * step), step))
    for name, step in ((row.method, row.step or 0.0) for row in rows if row.model == MODEL):
        from flexman_gym.toolbox.precision.peers.mujoco import step_factors

        factors = step_factors(arm, DECAY_PIECES, name, step)
        factor = factors[np.abs(factors - np.exp(1j * omega * step)).argmin()]  # factor of the lowest mode
        yield Decay(f"{MODEL}, {name}", step, decay(factor, step))
