"""Peers: what a run of another code is, its row in a comparison, and the arm of a scene with rigid joints."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

import flexman_gym as fm
from flexman_gym.arrays import Array
from studies.precision.measure import OK, Row, Study, Truth

Timer = Callable[[], Row]


@dataclass(frozen=True, eq=False)
class PeerRun:
    """What a peer computed and what it cost.

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
        """Whether the run stayed in the world."""
        return bool(np.isfinite(self.tip).all() and np.abs(self.tip).max() < 1e3)

    def distance(self, tip: Array) -> float:
        """Largest distance (m) of the tip from another tip (T, 3); infinite for a run that failed."""
        return float(np.linalg.norm(self.tip - tip, axis=1).max()) if self.finite else math.inf


def row(study: Study, done: PeerRun, solution: Truth | None = None, sane: float = math.inf) -> Row:
    """The row of a run; `solution` is the converged one of its model, and an error above `sane` (m) a divergence."""
    names, costs = (study.name, done.model, done.method, done.step, None), (done.cpu, done.wall, done.evaluations)
    error = done.distance(study.truth.tip)
    time_error = None if solution is None else done.distance(solution.tip)
    return Row(*names, *costs, time_error, error, OK if done.finite and error < sane else "diverged")


def output_count(scene: fm.Scene, step: float) -> tuple[int, int]:
    """How many outputs a scene has after its start, and how many steps (s) lie between two of them.

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
