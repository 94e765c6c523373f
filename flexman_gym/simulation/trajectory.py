"""Trajectory: the solution of a scene at its output times, its energy residual and the alarm on it."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import positive, value_error, vector, whole_number
from flexman_gym.common.time_series import write_csv
from flexman_gym.kernels import layout
from flexman_gym.model.linearization import MEASUREMENT_UNITS, LinearMeasurements, column_names
from flexman_gym.model.loads import FrameMotion, frame_motion, part_energies, section_forces
from flexman_gym.model.model import Model

ENERGY_ALARM = 0.01  # of the energy turned over


def _energy_turnover(moving_energy: Array | float, work: Array | float, dissipation: Array | float) -> Array:
    """Gives the largest magnitude of the three energies, the scale of an error of the energy, J."""
    return np.maximum(np.maximum(moving_energy, np.abs(work)), np.abs(dissipation))


def energy_alarm(residual: Any, turned_over: Any, level: float = ENERGY_ALARM) -> Any:
    """Tells whether a residual of the energy is more than a part of the energy turned over.

    Args:
        residual: number or array, J.
        turned_over: number or array, J.
        level: the part.
    """
    return abs(residual) > level * turned_over


class Kinetics(NamedTuple):
    """A model with the constants that it was moved with, its accelerations (T, d) and the drive (T, n + 6)."""

    model: Model
    accelerations: Array
    drives: Array


def _no_explanation(result: "Trajectory") -> str:
    return ""


def _no_kinetics(result: "Trajectory") -> Kinetics:
    raise value_error("trajectory", "one without a scene", "one of simulate or simulate_all, whose torques are known")


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory:
    """The solution of a scene at T output times; after a divergence only the times before it.

    All quantities are in SI units and radians.

    Attributes:
        time: (T,) s.
        tip: (T, 3) m, in the base frame.
        tip_velocity: (T, 3) m/s, in the base frame.
        joint_angles: (T, n) rad, link side.
        motor_angles: (T, n) rad, motor side; equal where a joint is rigid.
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
        moved: gives the accelerations, for loads and energies.
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
    explained: Callable[["Trajectory"], str] = field(default=_no_explanation, repr=False)
    moved: Callable[["Trajectory"], Kinetics] = field(default=_no_kinetics, repr=False)

    def __repr__(self) -> str:
        n = self.joint_angles.shape[1]
        joints = "joint" if n == 1 else "joints"
        end = f"{self.time[-1]:g} s, {len(self.time)} outputs" if len(self.time) else "no output"
        alarm = self.energy_alarm() if len(self.time) else None
        return (
            f"<Trajectory: {self.status}, {end}, {n} {joints}, {self.model.n_dof} coordinates\n"
            f"  {self.evaluations} evaluations in {self.wall_seconds:.3g} s\n"
            f"  tip at the end {np.round(self.tip[-1:], 4).tolist()} m, most deflection "
            f"{np.linalg.norm(self.deflection, axis=1).max(initial=0.0):.4g} m\n"
            f"  energy residual {np.abs(self.energy_residual).max(initial=0.0):.3g} J"
            + (f", too large from {alarm:g} s on: see explanation()" if alarm is not None else "")
            + ">"
        )

    @property
    def readings(self) -> dict[str, Array]:
        """What sensors of environments measure, (T, ...) by the names of `View`; UNITS of `model.linearization`."""
        return LinearMeasurements(self.model).measure(self.states)

    @cached_property
    def _seen(self) -> tuple[Kinetics, FrameMotion]:
        moved = self.moved(self)
        return moved, frame_motion(moved.model, self.states, moved.accelerations, moved.drives)

    @property
    def accelerations(self) -> Array:
        """Accelerations (T, d) of all coordinates under the torques of the scene.

        Raises:
            ValueError: for a trajectory of which no torques are known; so do the next three.
        """
        return self._seen[0].accelerations

    @property
    def joint_reactions(self) -> Array:
        """Force (N) and moment (N m) of each joint on the link behind it, (T, n, 6), in the frame of that link.

        Their part about the axis of the joint is the torque on the link.
        """
        return self._seen[1].reaction[:, :-1]

    def section_forces(self, link: int, positions: Sequence[float]) -> Array:
        """Gives what sections of a link carry, (T, P, 6) in the frame of the link at its origin.

        They are the normal force, the shear forces along y and z (N), the torsion and the bending moments about y and z
        (N m) with which the outboard part acts on the inboard one, by its inertia and weight (d'Alembert). Tension is
        positive, and a moment about z bends as E I v''. At a lumped mass it is the section before it. Between the
        joints of a model with foreshortening it has the error of its stations.

        Args:
            link: counted from 0.
            positions: (P,) along the link, from 0 at its joint to its length at its tip, m.

        Raises:
            ValueError: for a link or a position that does not exist.
        """
        i, (moved, seen) = whole_number("link", link, 0, self.model.n_joints - 1), self._seen
        length, places = self.model.arm.links[i].length, vector("positions", positions, unit="m")
        for k, place in enumerate(places):
            if not 0.0 <= place <= length:
                raise value_error(f"positions[{k}]", place, f"a number from 0 to {length} (m), the length of link {i}")
        return section_forces(moved.model, seen, self.states, moved.accelerations, i, places)

    def energies(self) -> dict[str, Array]:
        """Gives the energy of each part, J, by name: (T, n) of links, rotors and joints, (T, 1) of the payload.

        The names are link_kinetic, link_elastic, link_gravitational, rotor_kinetic, joint_elastic, payload_kinetic and
        payload_gravitational. All of them together are `energy`.
        """
        return part_energies(self._seen[0].model, self._seen[1], self.states)

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
        parts = _energy_turnover(self.moving_energy, self.work, self.dissipation)
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
                heads = column_names(name, MEASUREMENT_UNITS[name], values.shape[1], len(joints))
                result |= dict(zip(heads, values.T, strict=True))
        for name in ("energy", "moving_energy", "work", "dissipation", "energy_residual"):
            result[f"{name} (J)"] = getattr(self, name)
        return result

    def to_csv(self, path: str | Path) -> None:
        """Writes `columns` to a file: a line of names and units, then a line for each output time.

        Numbers have all their digits, so that reading them gives the same numbers.

        Raises:
            OSError: where the file cannot be written.
        """
        write_csv(path, self.columns())

    def energy_alarm(self, level: float = ENERGY_ALARM) -> float | None:
        """Gives the first time (s) at which the energy residual is too large, or None.

        Args:
            level: the part of the energy turned over until the end that the residual may reach.

        Raises:
            ValueError: for a level that is not a number > 0.
        """
        late = np.flatnonzero(energy_alarm(self.energy_residual, self.energy_turnover[-1], positive("level", level)))
        return float(self.time[late[0]]) if late.size else None


def build_trajectory(
    model: Model,
    interval: float,
    states: Array,
    outputs: Array,
    outcome: tuple[str, int, float],
    explained: Callable[[Trajectory], str] = _no_explanation,
    moved: Callable[[Trajectory], Kinetics] = _no_kinetics,
) -> Trajectory:
    """Builds a trajectory from rows at equal intervals.

    Args:
        model: the model.
        interval: between rows, s.
        states: (T, 2 d + 2) with their ledger.
        outputs: (T, OUTPUTS).
        outcome: status, evaluations and seconds in the integrator.
        explained: says why a trajectory failed.
        moved: gives its accelerations.
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
        moved=moved,
    )
