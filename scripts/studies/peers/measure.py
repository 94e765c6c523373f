"""Comparison with other simulators: single runs, batches of arms, numerical damping."""

import importlib
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

import flexman_gym as fm
from flexman_gym.common.arrays import Array
from flexman_gym.kernels import layout
from flexman_gym.simulation.batch import Batch
from flexman_gym.toolbox.precision.charts import CHOSEN
from flexman_gym.toolbox.precision.peers.peer_run import PeerRun, peer_row
from flexman_gym.toolbox.precision.runs import PrecisionRow, PrecisionScene, ReferenceSolution, Timer
from flexman_gym.toolbox.precision.scene_runs import (
    PLAIN,
    SHORTENED,
    finest_solution,
    our_rows,
    peer_timers,
    precision_scene,
    scene_models,
)
from studies.methods import vibration_factor
from studies.precision.measure import LARGE_ROTATION, Floor, whirl_scene
from studies.ringdown.measure import default_model

ROUNDS = 2  # rounds in which all runs of a scene take turns; the row of lowest CPU time counts
PEERS = {"MuJoCo": "mujoco", "Exudyn": "exudyn", "Pinocchio": "pin", "SoRoMoX": "soromox"}  # simulator -> package
PAPER, ALONE = "paper_ff", ("studies.peers.rods", "studies.peers.soromox")  # models of the paper's arm at rest only


@dataclass(frozen=True)
class PeerScene:
    """Scene of the comparison.

    Attributes:
        name, title: name and description of the scene.
        scene: arm and motion.
        tolerance: tolerance of `choose_model`, m.
    """

    name: str
    title: str
    scene: fm.Scene
    tolerance: float


def scenes(reference: Path) -> list[PeerScene]:
    """Return the scenes; `reference` is the folder of reference scenes."""
    small, torque = fm.catalog.vertical_2r(), fm.SineTorque([6.0, 1.5], [1.0, 1.5], [1.0, 0.0])
    choice, hanging = fm.ModelChoice((True, True), (2, 2)), fm.Initial((-1.5, 0.0), (0.0, 0.0))
    payload = fm.Scene.load(reference / "gravity_payload_ff.json")
    return [
        PeerScene(PAPER, "The paper's arm, 400 N m at each joint", fm.catalog.paper_scene("ff"), 5e-3),
        PeerScene("gravity_payload_ff", "Gravity, damping, a payload of 5 kg", payload, 5e-3),
        PeerScene("whirl_ff", "A fast whirl without torques", whirl_scene(), 5e-3),
        PeerScene("vertical_2r", "Two links of half a metre under gravity",
                  fm.Scene(small, choice, torque, hanging, 1.5, 0.005), 1e-3),
    ]  # fmt: skip


def large_rotation_solution(reference: Path) -> ReferenceSolution:
    """Return the independent large-rotation solution; its floor is its distance from our finest model."""
    tip = np.loadtxt(reference / LARGE_ROTATION, delimiter=",", skiprows=1)[:, 1:4]
    finest = finest_solution(fm.catalog.paper_scene("ff")).tip
    return ReferenceSolution(tip, float(np.linalg.norm(finest - tip, axis=1).max()), "independent large-rotation code")


def study(case: PeerScene, reference: Path) -> PrecisionScene:
    """Return a scene with models and reference; that of the paper's scene is by an independent code."""
    if case.name != PAPER:
        return precision_scene(case.scene, case.name)
    built = scene_models(case.scene)
    plain = ReferenceSolution(fm.simulate(case.scene, built[PLAIN], "rk4", step=1e-4).tip, 2e-8, "rk4, 0.1 ms")
    return PrecisionScene(case.name, case.scene, built, large_rotation_solution(reference), {PLAIN: plain}, case.title)


def measured(case: PeerScene, result: PrecisionScene) -> tuple[list[PrecisionRow], Floor]:
    """Return the rows of a scene, ours first and the default before all, and the error of its reference."""
    floor = Floor(case.name, case.title, "", result.reference.floor, result.reference.source)
    choice = chosen(case)
    every = result.models[SHORTENED].n_dof
    name = f"{CHOSEN}{1e3 * case.tolerance:g} mm: {choice.model.n_dof} of {every} coordinates"
    built = result.models | {name: choice.model}
    timers = theirs(result, alone=case.name == PAPER)
    best: dict[tuple[str, str, float | None], PrecisionRow] = {}
    for _ in range(ROUNDS):
        rows = [*our_rows(result), replace(result, models=built).row(name, choice.method, choice.step)]
        for row in (*rows, *(timer() for timer in timers)):
            key = row.model, row.method, row.step
            best[key] = min(row, best.get(key, row), key=lambda each: each.cpu)
    return list(best.values()), floor


def chosen(case: PeerScene) -> fm.Choice:
    """Return the choice of `choose_model` for a scene with an open mesh."""
    return fm.choose_model(replace(case.scene, model=replace(case.scene.model, elements=None)), case.tolerance)


def theirs(result: PrecisionScene, alone: bool) -> list[Timer]:
    """Return timers of the runs of all installed simulators; `alone` adds the models of the paper's arm."""
    timers, lines = peer_timers(result)
    if alone:
        with suppress(ModuleNotFoundError):
            from flexman_gym.toolbox.precision.peers import mujoco

            others = [name for name in mujoco.integrators() if name not in mujoco.QUICKEST]
            timers += mujoco.stable_runs(result, others)
    for name in ALONE if alone else ():
        try:
            timers += importlib.import_module(name).runs(result)
        except ModuleNotFoundError as error:
            lines.append(f"{name} is left out: {error}")
    print("".join(f"{line}\n" for line in lines), end="", flush=True)
    return timers


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
