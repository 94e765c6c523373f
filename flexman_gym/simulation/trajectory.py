"""Trajectory: solution of a scene at its output times, with its energy residual and energy alarm."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import positive, vector, whole_number
from flexman_gym.common.errors import value_error
from flexman_gym.common.files import write_csv
from flexman_gym.common.registry import load_entry
from flexman_gym.kernels import layout
from flexman_gym.model.linearization import MEASUREMENT_UNITS, LinearMeasurements, column_names
from flexman_gym.model.loads import FrameMotion
from flexman_gym.model.model import Model
from flexman_gym.simulation.diagnostics import explain_bending

ENERGY_ALARM = 0.01  # dimensionless; fraction of `energy_turnover` above which the energy residual is too large


def _no_explanation(result: "Trajectory") -> str:
    return ""


def _no_kinetics(result: "Trajectory") -> FrameMotion:
    raise value_error("trajectory", "one without a scene", "a result of simulate or simulate_all")


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory:
    """Solution of a scene at T output times; after a failure only at those before the failure.

    All quantities are in SI units and radians. Positions and velocities are relative to the base, along the axes of the
    base frame, which may rotate. Energies are those in a frame with the origin of the base and the axes of the world.

    Attributes:
        time: (T,) s.
        tip: (T, 3) tip position in the base frame, m.
        tip_velocity: (T, 3) tip velocity in the base frame, m/s.
        joint_angles: (T, n) angles of the link sides of the joints, rad.
        motor_angles: (T, n) angles of the rotors after the gears, rad; in a rigid joint equal to the joint angle.
        energy: (T,) kinetic + elastic (links and joints) + gravitational energy, J; gravitational energy is zero at the
            base origin.
        moving_energy: (T,) kinetic + elastic energy, J.
        work: (T,) work of motors, tip force, and acceleration and rotation of the base since the start, J.
        dissipation: (T,) energy dissipated by dampers and friction since the start, J.
        states: (T, 2 d) coordinates and speeds, in the order of `kernels.layout`.
        deflection: (T, 3) tip position relative to the tip of the rigid arm at the motor angles, m.
        status: "ok", "diverged" or "not converged".
        evaluations: number of evaluations of the accelerations.
        wall_seconds: wall-clock time of the integration without compilation, s.
        model: the simulated model.
        explain: function: trajectory -> its `explanation`.
        kinetics: function: trajectory -> motion of its frames, for loads and energies.

    Examples:
        >>> trajectory = fm.simulate(fm.catalog.paper_scene("rr"), step=0.01)
        >>> trajectory.status, float(trajectory.time[-1]), trajectory.tip.shape
        ('ok', 2.0, (201, 3))
        >>> bool(abs(trajectory.energy_residual).max() < 0.01 * trajectory.energy_turnover[-1])
        True
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
    explain: Callable[["Trajectory"], str] = field(default=_no_explanation, repr=False)
    kinetics: Callable[["Trajectory"], FrameMotion] = field(default=_no_kinetics, repr=False)

    def __repr__(self) -> str:
        n = self.joint_angles.shape[1]
        joints = "joint" if n == 1 else "joints"
        end = f"{self.time[-1]:g} s, {len(self.time)} outputs" if len(self.time) else "no output"
        alarm = self.energy_alarm() if len(self.time) else None
        return (
            f"<Trajectory: {self.status}, {end}, {n} {joints}, {self.model.n_dof} coordinates\n"
            f"  {self.evaluations} evaluations in {self.wall_seconds:.3g} s\n"
            f"  tip at the end {np.round(self.tip[-1:], 4).tolist()} m, largest deflection "
            f"{np.linalg.norm(self.deflection, axis=1).max(initial=0.0):.4g} m\n"
            f"  energy residual {np.abs(self.energy_residual).max(initial=0.0):.3g} J"
            + (f", too large from {alarm:g} s on, see explanation()" if alarm is not None else "")
            + ("\n  large bending of a link, see explanation()" if explain_bending(self.model, self.states) else "")
            + ">"
        )

    @property
    def readings(self) -> dict[str, Array]:
        """Sensor readings without noise (T, ...), by the names of `envs.view.View`.

        Units: MEASUREMENT_UNITS of `model.linearization`.
        """
        return LinearMeasurements(self.model).measure(self.states)

    @cached_property
    def _motion(self) -> FrameMotion:
        """Motion of all frames."""
        return self.kinetics(self)

    @property
    def accelerations(self) -> Array:
        """Accelerations (T, d) of all coordinates under the inputs of the scene, rad/s^2 or m/s^2 by coordinate.

        Raises:
            ValueError: for a trajectory of a `Simulator`, whose inputs are not recorded. `joint_reactions`,
                `section_forces` and `energies` raise the same error.
        """
        return self._motion.accelerations

    @property
    def joint_reactions(self) -> Array:
        """Force (N) and moment (N m) of each joint on its outboard link, (T, n, 6), in the beam frame of this link.

        The component of the moment about the joint axis is the driving torque of the link.
        """
        return self._motion.reaction[:, :-1]

    def section_forces(self, link: int, positions: Sequence[float]) -> Array:
        """Return the internal forces of sections of a link, (T, P, 6), in the link frame at its origin.

        The six columns are the normal force, the shear forces along y and z (N), the torsional moment and the bending
        moments about y and z (N m) exerted by the outboard part, with its inertia and weight (d'Alembert), on the
        inboard part. Tension is positive, and the moment about z equals E I_z v''. At a lumped mass the section lies
        just inboard of the mass. In a model with foreshortening, the mass between the joints is lumped at the stations,
        which limits the accuracy of the result.

        Args:
            link: index of the link, from 0.
            positions: (P,) distances of the sections from the joint of the link, 0 to the length of the link, m.
        """
        i, motion = whole_number("link", link, 0, self.model.n_joints - 1), self._motion
        length, checked = self.model.arm.links[i].length, vector("positions", positions, unit="m")
        for k, position in enumerate(checked):
            if not 0.0 <= position <= length:
                allowed = f"a number from 0 to {length} (m), the length of link {i}"
                raise value_error(f"positions[{k}]", position, allowed)
        return motion.section_forces(i, checked)

    def energies(self) -> dict[str, Array]:
        """Return the energy of each part, J: (T, n) for links, rotors and joints, (T, 1) for the payload.

        The keys are link_kinetic, link_elastic, link_gravitational, rotor_kinetic, joint_elastic, payload_kinetic and
        payload_gravitational. Their sum is `energy`.
        """
        return self._motion.part_energies()

    def explanation(self) -> str:
        """Return lines on the cause of a failure or an energy alarm, and on large bending, with remedies; otherwise "".

        The call integrates again from the last valid state, step by step, to find the cause of a failure.
        """
        return self.explain(self)

    @property
    def energy_residual(self) -> Array:
        """Work - dissipation - change of energy since the start (T,), J; zero for the exact solution."""
        return self.work - self.dissipation - (self.energy - self.energy[0])

    @property
    def energy_turnover(self) -> Array:
        """Largest of kinetic + elastic energy, |work|, |dissipation| so far (T,), J: scale of the energy residual."""
        parts = np.maximum(np.maximum(self.moving_energy, np.abs(self.work)), np.abs(self.dissipation))
        return np.maximum.accumulate(parts)

    def columns(self) -> dict[str, Array]:
        """Return all quantities but the states as columns (T,) by name and unit, such as "tip_x (m)".

        Joints are numbered from 1.
        """
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
            if name != "motor_angles":  # already above
                names = column_names(name, MEASUREMENT_UNITS[name], values.shape[1], len(joints))
                result |= dict(zip(names, values.T, strict=True))
        for name in ("energy", "moving_energy", "work", "dissipation", "energy_residual"):
            result[f"{name} (J)"] = getattr(self, name)
        return result

    def to_csv(self, path: str | Path) -> None:
        """Write `columns` to a CSV file: a row of names and units, then a row for each output time.

        Numbers have all digits, so that reading restores the same values.

        Args:
            path: the file.

        Raises:
            OSError: where the file cannot be written.
        """
        write_csv(path, self.columns())

    def energy_alarm(self, level: float = ENERGY_ALARM) -> float | None:
        """Return the first time (s) at which the energy residual is too large, or None.

        Args:
            level: largest allowed residual as a fraction of `energy_turnover` at the end.
        """
        largest = positive("level", level) * self.energy_turnover[-1]
        above = np.flatnonzero(abs(self.energy_residual) > largest)
        return float(self.time[above[0]]) if above.size else None

    @classmethod
    def from_rows(
        cls,
        model: Model,
        interval: float,
        states: Array,
        outputs: Array,
        outcome: tuple[str, int, float],
        explain: Callable[["Trajectory"], str] = _no_explanation,
        kinetics: Callable[["Trajectory"], FrameMotion] = _no_kinetics,
    ) -> Self:
        """Return the trajectory given by states and outputs at equal intervals.

        Args:
            model: the model.
            interval: time between rows, s.
            states: (T, 2 d + 2) states (2 d), each followed by work and dissipation, J.
            outputs: (T, OUTPUTS) columns of `kernels.layout`.
            outcome: status, number of evaluations, and wall-clock time of the integration, s.
            explain: function: trajectory -> its explanation.
            kinetics: function: trajectory -> motion of its frames.
        """
        size = 2 * model.n_dof
        return cls(
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
            explain=explain,
            kinetics=kinetics,
        )

    def _repr_png_(self) -> bytes | None:
        """Return a picture for a notebook."""
        picture: bytes | None = load_entry("flexman_gym.toolbox.view.notebook:trajectory_picture")(self)
        return picture
