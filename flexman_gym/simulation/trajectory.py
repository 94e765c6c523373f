"""Trajectory: the solution of a scene at its output times, with the audit of its energy."""

import csv
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import positive
from flexman_gym.kernels import layout
from flexman_gym.model.model import Model
from flexman_gym.simulation.energy import ENERGY_ALARM, alarm, turnover
from flexman_gym.simulation.readings import UNITS, Readings


def _nothing(result: "Trajectory") -> str:
    return ""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The solution of a scene at T output times; after a divergence only the times before it.

    All quantities are in SI units and radians.

    Attributes:
        time: (T,) s.
        tip, tip_velocity: (T, 3) in the base frame.
        joint_angles, motor_angles: (T, n) link side and motor side; equal where a joint is rigid.
        energy: (T,) kinetic + elastic (links and joints) + gravitational energy, the last zero at the base origin, J.
        moving_energy: (T,) its kinetic and elastic part, J.
        work: (T,) of motors, tip force and base acceleration since the start, J.
        dissipation: (T,) energy lost in dampers and friction since the start, J. Energies are relative to the base.
        states: (T, 2 d); the order is that of `kernels.layout`.
        deflection: (T, 3) tip relative to the tip of the rigid arm at the motor angles.
        status: "ok", "diverged" or "not converged".
        evaluations: number of evaluations of the accelerations.
        wall_seconds: time in the integrator, without compilation.
        model: that was moved.
        explained: what `explanation` asks.
    """

    time: Array
    tip: Array
    tip_velocity: Array
    joint_angles: Array
    motor_angles: Array
    energy: Array
    moving_energy: Array
    work: Array
    dissipation: Array
    states: Array
    deflection: Array
    status: str
    evaluations: int
    wall_seconds: float
    model: Model
    explained: Callable[["Trajectory"], str] = field(default=_nothing, repr=False)

    @property
    def readings(self) -> dict[str, Array]:
        """What sensors of environments measure, (T, ...) by the names of `View`; UNITS of `simulation.readings`."""
        return Readings(self.model).named(self.states)

    def explanation(self) -> str:
        """Says what went first in a failure or an energy alarm, and what to change; "" while all is well.

        The last good state is moved on once more, step by step. Nothing is computed before this is asked for.
        """
        return self.explained(self)

    @property
    def energy_residual(self) -> Array:
        """Energy that the integrator invented or lost: work - dissipation - change of energy (T,), J."""
        return self.work - self.dissipation - (self.energy - self.energy[0])

    @property
    def energy_turnover(self) -> Array:
        """The largest so far of kinetic + elastic energy, of work and of dissipation (T,), J."""
        parts = turnover(self.moving_energy, self.work, self.dissipation)
        return np.maximum.accumulate(parts)

    def columns(self) -> dict[str, Array]:
        """Gives all but the states: columns (T,) by name and unit, such as "tip_x (m)"; joints count from 1."""
        joints = range(1, self.joint_angles.shape[1] + 1)
        groups: tuple[tuple[str, str, Iterable[object], Array], ...] = (
            ("tip", "m", "xyz", self.tip),
            ("tip_velocity", "m/s", "xyz", self.tip_velocity),
            ("deflection", "m", "xyz", self.deflection),
            ("joint_angle", "rad", joints, self.joint_angles),
            ("motor_angle", "rad", joints, self.motor_angles),
        )
        result = {"time (s)": self.time}
        for name, unit, ends, values in groups:
            for end, column in zip(ends, values.T, strict=True):
                result[f"{name}_{end} ({unit})"] = column
        for name, values in self.readings.items():
            if name != "motor_angles":  # which are there
                ends = [f"{joint}" for joint in joints]
                parts = {1: ("",), 2: ("_y", "_z"), 3: ("_y", "_z", "_torsion")}[values.shape[1] // len(ends)]
                heads = [f"{name.removesuffix('s')}_{end}{part}" for end in ends for part in parts]
                result |= dict(zip((f"{head} ({UNITS[name]})" for head in heads), values.T, strict=True))
        for name in ("energy", "moving_energy", "work", "dissipation", "energy_residual"):
            result[f"{name} (J)"] = getattr(self, name)
        return result

    def to_csv(self, path: str | Path) -> None:
        """Writes `columns` to a file: a line of names and units, then a line for each output time.

        Numbers have all their digits, so that reading them gives the same numbers.

        Raises:
            OSError: where the file cannot be written.
        """
        columns = self.columns()
        with Path(path).open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(columns)
            writer.writerows(np.column_stack(list(columns.values())).tolist())

    def energy_alarm(self, level: float = ENERGY_ALARM) -> float | None:
        """Gives the first time (s) at which the energy residual is too large, or None.

        Args:
            level: the part of the energy turned over until the end that the residual may reach.

        Raises:
            ValueError: for a level that is not a number > 0.
        """
        late = np.flatnonzero(alarm(self.energy_residual, self.energy_turnover[-1], positive("level", level)))
        return float(self.time[late[0]]) if late.size else None


def trajectory(
    model: Model,
    interval: float,
    states: Array,
    outputs: Array,
    outcome: tuple[str, int, float],
    explained: Callable[[Trajectory], str] = _nothing,
) -> Trajectory:
    """Builds a trajectory from rows at equal intervals.

    Args:
        model: the model.
        interval: between rows, s.
        states: (T, 2 d + 2) with their ledger.
        outputs: (T, OUTPUTS).
        outcome: status, evaluations and seconds in the integrator.
        explained: says why a trajectory failed.
    """
    size = 2 * model.n_dof
    return Trajectory(
        time=interval * np.arange(len(states), dtype=np.float64),
        tip=outputs[:, layout.TIP],
        tip_velocity=outputs[:, layout.TIP_VELOCITY],
        joint_angles=states[:, : model.n_joints],
        motor_angles=states[:, model.motor_columns],
        energy=outputs[:, layout.KINETIC :].sum(axis=1),
        moving_energy=outputs[:, layout.KINETIC : layout.GRAVITATIONAL].sum(axis=1),
        work=states[:, size],
        dissipation=states[:, size + 1],
        states=states[:, :size],
        deflection=outputs[:, layout.DEFLECTION],
        status=outcome[0],
        evaluations=outcome[1],
        wall_seconds=outcome[2],
        model=model,
        explained=explained,
    )
