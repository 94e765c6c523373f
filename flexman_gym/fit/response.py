"""Response: what the arms of a measurement do, several side by side, as its sensors show it."""

from collections.abc import Mapping
from dataclasses import replace
from difflib import get_close_matches
from typing import Any

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import refusal, vector
from flexman_gym.fit.measurement import Measurement
from flexman_gym.kernels import layout, tip
from flexman_gym.model.model import Model
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.choice import ModelChoice
from flexman_gym.scene.drive import ConstantTorque
from flexman_gym.scene.samples import SampledAngles, SampledTorque
from flexman_gym.scene.scene import Initial, Scene
from flexman_gym.simulation.parameters import varied_constants
from flexman_gym.simulation.run import prescribed_flags
from flexman_gym.simulation.scenes import prescribed_joints
from flexman_gym.simulation.several import simulate_all
from flexman_gym.simulation.trajectory import Trajectory

METHOD = "gauss_3_sweeps"  # of order 4, in lanes: its error stays below that of the data
STACKED = (
    "time", "tip", "tip_velocity", "joint_angles", "motor_angles", "energy", "moving_energy", "work", "dissipation",
    "states", "deflection",
)  # fmt: skip
FELT = {  # column of `kernels.tip` by name
    f"{name}_{axis}": part.start + i
    for name, part in (("tip_acceleration", layout.TIP_ACCELERATION), ("specific_force", layout.SPECIFIC_FORCE))
    for i, axis in enumerate("xyz")
}


class Response:
    """How an arm answers the inputs of a measurement.

    Attributes:
        measurement: what was recorded.
        scene: the same inputs, for the simulator.
        method: its name.
        step: s.
    """

    def __init__(self, arm: Arm, measurement: Measurement, step: float | None, method: str = METHOD) -> None:
        self.measurement, self.method = measurement, method
        self.step = measurement.period if step is None else step
        times = np.asarray(measurement.times) - measurement.times[0]
        torques, motions = np.zeros((len(times), arm.n_joints)), [None] * arm.n_joints
        starts = [float(measurement.outputs.get(f"motor_angle_{i + 1}", [0.0])[0]) for i in range(arm.n_joints)]
        if measurement.start is not None:
            starts = list(vector("Measurement.start", measurement.start, arm.n_joints, "rad"))
        for name, values in measurement.inputs.items():
            head = measurement.head(name)
            if head.joint >= arm.n_joints:
                raise refusal("Measurement.inputs", name, f"joints from 1 to {arm.n_joints}")
            if head.kind == "motor_angle":
                motions[head.joint] = SampledAngles(times, values, measurement.deviations.get(name, 0.0))  # type: ignore[call-overload]
            else:
                torques[:, head.joint] += values * (1.0 if head.kind == "torque" else _per_ampere(arm, head.joint))
        still = ConstantTorque(np.zeros(arm.n_joints).tolist())
        kept = np.ones(len(times), dtype=bool)
        if measurement.hold == "zero":  # a simulation stops at every sample, and only changes matter
            kept[1:-1] = (np.diff(torques, axis=0)[:-1] != 0.0).any(axis=1)
        self.scene = Scene(
            arm,
            ModelChoice((True,) * arm.n_joints, (1,) * arm.n_joints),
            SampledTorque(times[kept], torques[kept], measurement.hold) if torques.any() else still,  # type: ignore[arg-type]
            Initial(starts, np.zeros(arm.n_joints).tolist()),
            duration=measurement.period * (len(times) - 1),
            output_step=measurement.period,
            prescribed=motions if any(motions) else None,
        )

    def signals(self, model: Model, parameters: Mapping[str, Array]) -> Array:
        """Gives the outputs (b, c, T) of b arms behind their filters, NaN of an arm that failed.

        Args:
            model: of the arm.
            parameters: values (b, ...) by their name in `simulation.parameters.PARAMETERS`, at least one.
        """
        count = len(next(iter(parameters.values())))
        given: dict[str, Any] = dict(parameters)
        runs = simulate_all([self.scene] * count, model, self.method, self.step, **given)
        size, period = len(self.measurement.times), self.measurement.period
        whole = [run for run in runs if len(run.time) == size]
        result = np.full((count, len(self.measurement.outputs), size), np.nan)
        if not whole:
            return result
        rows: dict[str, Any] = {each: np.concatenate([getattr(run, each) for run in whole]) for each in STACKED}
        stacked = replace(whole[0], **rows)
        columns = {head.partition(" (")[0]: values for head, values in stacked.columns().items()}
        felt = None
        good = [i for i, run in enumerate(runs) if len(run.time) == size]
        for c, name in enumerate(self.measurement.outputs):
            if name in FELT:
                felt = self._felt(model, runs, parameters) if felt is None else felt
                result[:, c] = felt[:, :, FELT[name]]
            else:
                if name not in columns:
                    near = ", ".join(get_close_matches(name, [*columns, *FELT], 3, 0.0))
                    raise refusal("Measurement.outputs", name, f"a name of Trajectory.columns; the nearest are {near}")
                result[good, c] = columns[name].reshape(len(whole), size)
            for each in self.measurement.filters.get(name, ()):
                result[good, c] = each.applied(result[good, c], period)
        return result

    def _felt(self, model: Model, runs: list[Trajectory], parameters: Mapping[str, Array]) -> Array:
        """Tip accelerations (b, T, TIP_ACCELERATIONS), under the drive up to each sample."""
        own, size = varied_constants(model, len(runs), parameters), len(self.measurement.times)
        flags = prescribed_flags(model.n_joints, prescribed_joints(self.scene))
        pieces, d = self.scene.pieces, model.n_dof
        moments = self.measurement.period * np.arange(size)
        middle = 0.5 * (pieces.moments[1:] + pieces.moments[:-1])
        drives = np.array([pieces.table(p) for p in range(len(middle))])
        before = np.clip(np.searchsorted(pieces.moments, moments - 1e-9 * moments[-1]) - 1, 0, len(middle) - 1)
        applied = drives[before, layout.OFFSET] + drives[before, layout.SLOPE] * moments[:, None]
        result = np.full((len(runs), size, layout.TIP_ACCELERATIONS), np.nan)
        work = layout.make_work(model.constants)
        for i, run in enumerate(runs):
            constants = model.constants._replace(prescribed=flags, **{name: each[i] for name, each in own.items()})
            for state, drive, out in zip(run.states, applied, result[i], strict=False):
                tip.tip_accelerations(constants, work, state[:d], state[d:], drive, out)
        return result


def _per_ampere(arm: Arm, joint: int) -> float:
    """Torque at a joint for each ampere, N m/A."""
    motor = arm.joints[joint].motor
    if motor is None:
        raise refusal(f"Measurement.inputs['current_{joint + 1}']", None, "torques: this joint has no Motor")
    return motor.torque_per_ampere
