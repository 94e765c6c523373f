"""Peers, abreast: many arms side by side on all cores, ours beside MuJoCo's batch."""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

import flexman_gym as fm
from flexman_gym.arrays import Array
from flexman_gym.kernels import layout
from flexman_gym.simulation.batch import Batch
from studies.peers.compare import ROUNDS
from studies.peers.runs import PeerRun, row
from studies.precision.measure import Row, Study
from studies.ringdown.cases import default_model

CORES = len(os.sched_getaffinity(0))
ARMS, STEP = 64 * CORES, 5e-3  # s, of ours
SCENE = f"{ARMS} arms on {CORES} cores"
PIECES = (2, 4)  # of a link in MuJoCo, whose errors are those of ours
DEFAULT, MESH = ("the model of FlexRRR-v0", "midpoint_3_sweeps"), ("2 elements, foreshortening", "midpoint_2_sweeps")
Tips = Callable[[], Iterator[Array]]  # gives the tip (3,) m of an arm after each output step


def ours(scene: fm.Scene, model: fm.Model, method: str) -> Iterator[Array]:
    """Moves arms from rest, under the constant torques of a scene."""
    batch = Batch(model, method, STEP, scene.output_step, arms=ARMS, threads=CORES)
    drive = np.zeros((ARMS, model.n_joints + 6))
    drive[:, : model.n_joints] = scene.torque.value  # type: ignore[union-attr]
    while True:
        batch.step(drive)
        yield batch.outputs[0, layout.TIP].copy()


def rows(study: Study, peers: Sequence[Row]) -> list[Row]:
    """Rows with seconds for a simulated second of one arm, those of the round that was quickest by the clock."""
    scene = study.scene
    model, mesh = (
        fm.build_model(scene.arm, **vars(default_model().choice)),
        fm.build_model(scene.arm, 2, stiffening=True),
    )
    calls: dict[tuple[str, str, float], Tips] = {(*DEFAULT, STEP): partial(ours, scene, model, DEFAULT[1])}
    calls[*MESH, STEP] = partial(ours, scene, mesh, MESH[1])
    for pieces in PIECES if any(peer.model.startswith("MuJoCo") for peer in peers) else ():
        from studies.peers.mujoco import abreast, longest_step

        step = longest_step(study, pieces, "Euler")
        calls[f"MuJoCo, {pieces} pieces", "Euler, mujoco.batch", step] = partial(
            abreast, scene, pieces, step, ARMS, CORES
        )
    rounds = [[_timed(study, name, call) for name, call in calls.items()] for _ in range(ROUNDS)]
    return [min(turns, key=lambda each: each.wall) for turns in zip(*rounds, strict=True)]


def _timed(study: Study, name: tuple[str, str, float], call: Tips) -> Row:
    """A row of one run; its first output step, which loads or compiles kernels, is not timed."""
    arms, count = call(), round(study.scene.duration / study.scene.output_step)
    tips = [study.truth.tip[0], next(arms)]
    started = time.process_time(), time.perf_counter()
    tips += [next(arms) for _ in range(count - 1)]
    simulated = ARMS * (count - 1) * study.scene.output_step
    costs = (time.process_time() - started[0]) / simulated, (time.perf_counter() - started[1]) / simulated
    return row(replace(study, name=SCENE), PeerRun(*name, np.array(tips), *costs, 1.0 / name[-1]))
