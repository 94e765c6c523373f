"""Runs of a scene by another simulator."""

import math
from dataclasses import dataclass, replace

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.errors import value_error
from flexman_gym.scene.scene import Scene
from flexman_gym.toolbox.precision.runs import OK, PrecisionRow, PrecisionScene, ReferenceSolution

LARGEST_POSITION = 1e3  # m; a run with a larger coordinate of the tip has diverged
UNMODELLED = ("prescribed", "tip_force", "base_acceleration", "base_angular_acceleration", "base_attitude",
              "base_angular_velocity")  # fmt: skip


@dataclass(frozen=True, eq=False)
class PeerRun:
    """Result and cost of a run of another simulator.

    Attributes:
        model, method: names of the model and of the integration method.
        step: step, s.
        tip: tip positions (T, 3) at the output times of the scene, m; NaN after a failure.
        cpu, wall: CPU and wall-clock time per simulated second.
        evaluations: evaluations of the equations of motion per simulated second.
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
        """True if all tip positions are finite and below 1000 m."""
        return bool(np.isfinite(self.tip).all() and np.abs(self.tip).max() < LARGEST_POSITION)

    def distance(self, tip: Array) -> float:
        """Return the largest distance (m) from another tip motion (T, 3); infinite for a failed run."""
        return float(np.linalg.norm(self.tip - tip, axis=1).max()) if self.finite else math.inf


def peer_row(
    scene: PrecisionScene, done: PeerRun, solution: ReferenceSolution | None = None, sane: float = math.inf
) -> PrecisionRow:
    """Return the row of a run.

    Args:
        scene: scene with its reference.
        done: the run.
        solution: converged run of its model, for the time error; None for none.
        sane: error of the tip, m, above which a run counts as diverged.
    """
    names, costs = (scene.name, done.model, done.method, done.step, None), (done.cpu, done.wall, done.evaluations)
    error = done.distance(scene.reference.tip)
    time_error = None if solution is None else done.distance(solution.tip)
    return PrecisionRow(*names, *costs, time_error, error, OK if done.finite and error < sane else "diverged")


def check_modelled(scene: Scene) -> None:
    """Raise a ValueError for a scene with inputs that the models of other simulators do not have."""
    for name in UNMODELLED:
        if getattr(scene, name) is not None:
            raise value_error(
                f"Scene.{name}", getattr(scene, name), "None: models of other simulators have torques only"
            )
    if scene.initial.state is not None:
        raise value_error("Scene.initial.state", scene.initial.state, "None: joint angles and rates")


def output_count(scene: Scene, step: float) -> tuple[int, int]:
    """Return the number of outputs after the start of a scene, and the number of steps (s) per output.

    Raises:
        ValueError: if the step does not divide the output step.
    """
    substeps = round(scene.output_step / step)
    if abs(substeps * step - scene.output_step) > 1e-9 * scene.output_step:
        raise value_error("step", step, f"a number that divides {scene.output_step} s")
    return round(scene.duration / scene.output_step), substeps


def with_rigid_joints(scene: Scene) -> Scene:
    """Return the scene with motors that drive the links directly; passive joints keep their springs."""
    joints = [joint if joint.passive else replace(joint, stiffness=None, damping=0.0) for joint in scene.arm.joints]
    model = replace(scene.model, flexible_joints=False)
    return replace(scene, arm=replace(scene.arm, joints=joints), model=model)
