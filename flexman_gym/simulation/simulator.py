"""Simulator of one arm, one control period after another."""

from collections.abc import Collection
from typing import Self

import numpy as np

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import check_magnitudes, number_array, vector
from flexman_gym.common.errors import value_error
from flexman_gym.kernels import layout
from flexman_gym.kernels.layout import STATUS
from flexman_gym.model.model import Model
from flexman_gym.scene.signals import signal_table
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.diagnostics import explain_energy, explain_failure
from flexman_gym.simulation.methods import DEFAULT_METHOD, Method
from flexman_gym.simulation.trajectory import ENERGY_ALARM, Trajectory


class Simulator:
    """Simulation of one arm, one control period at a time, under inputs that are constant in each period.

    Args:
        model: the model.
        method: a Method or a name from `METHODS`.
        step: integration step, s; it divides the control period. "auto" selects the longest divisor up to 5 ms, None
            lets the method choose its steps by rtol and atol.
        control_period: s.
        rtol: relative tolerance of the local error of adaptive steps.
        atol: absolute tolerance of the local error of adaptive steps, in the unit of each coordinate or speed.
        prescribed: indices, from 0, of the joints whose motors follow prescribed accelerations instead of torques.

    Attributes:
        batch: the Batch of this single arm.
        model, method, control_period, substeps: as in the batch.
        state: (2 d,) coordinates and speeds, a view that `step` updates; order in `kernels.layout`.
        outputs: (OUTPUTS,) tip, deflection and energies at this state; columns in `kernels.layout`.
        prescribed: (n,) flags of the motors with prescribed motion.
        time: time since the reset, s.
        energy_turnover: largest of kinetic + elastic energy, |work| and |dissipation| since the reset, J: the scale of
            the energy residual.
        status: status of the last step: "ok", "diverged" or "not converged". After a failure, state and outputs keep
            their values at the end of the last successful control period, until a reset.

    Examples:
        >>> simulator = fm.Simulator(fm.build_model(fm.catalog.one_joint()), control_period=0.01)
        >>> simulator.reset(joint_angles=[0.3])
        >>> simulator.step([0.1])
        'ok'
        >>> simulator.time, simulator.state.shape
        (0.01, (28,))
    """

    def __init__(
        self,
        model: Model,
        method: str | Method = DEFAULT_METHOD,
        step: float | str | None = "auto",
        control_period: float = 0.02,
        rtol: float = 1e-6,
        atol: float = 1e-9,
        prescribed: Collection[int] = (),
    ) -> None:
        self._simulate(Batch(model, method, step, control_period, rtol, atol, prescribed), prescribed)

    @classmethod
    def of_batch(cls, batch: Batch) -> Self:
        """Return the simulator of the only arm of a batch without prescribed motions; its base may rotate."""
        result = cls.__new__(cls)
        result._simulate(batch, ())
        return result

    def _simulate(self, batch: Batch, prescribed: Collection[int]) -> None:
        self.batch, self.model, self.method = batch, batch.model, batch.method
        self.control_period, self.substeps = batch.control_period, batch.substeps
        self.state, self.outputs = batch.state[0], batch.outputs[0]
        self.prescribed = np.isin(np.arange(self.model.n_joints), list(prescribed))
        self._drive = np.zeros((1, self.model.n_joints + 6))
        self._record: list[tuple[Array, Array]] | None = None

    def reset(
        self, joint_angles: Vector | None = None, joint_rates: Vector | None = None, state: Vector | None = None
    ) -> None:
        """Restart at time 0, undeformed at joint angles and rates, or from a complete state.

        Args:
            joint_angles: (n,) rad, zero by default.
            joint_rates: (n,) rad/s, zero by default.
            state: (2 d,) coordinates and speeds, in place of angles and rates.

        Raises:
            ValueError: for a wrong shape, for a value that is not finite or exceeds 1e6 (rad, m, rad/s, m/s), from
                which a simulation counts as diverged, and for angles or rates together with a state.
        """
        if state is not None:
            if joint_angles is not None or joint_rates is not None:
                raise value_error("state", "given with joint_angles or joint_rates", "a state, or angles and rates")
            start = np.array(vector("state", state, 2 * self.model.n_dof))
            check_magnitudes("state", start.tolist(), layout.LARGEST_STATE)
        else:
            angles = np.zeros(self.model.n_joints) if joint_angles is None else joint_angles
            start = self.model.initial_state(angles, joint_rates)
        self.batch.reset(np.zeros(1, dtype=np.int64), start[None])
        if self._record is not None:
            self.record()

    def record(self) -> None:
        """Record the state now and after each further `step`, for `trajectory`; a reset restarts the record.

        An earlier record is discarded. Environments integrate without `step`, so they record nothing.
        """
        self._record = []
        self._append_record()

    def _append_record(self) -> None:
        if self._record is not None:
            self._record.append((self.batch.rows[0].copy(), self.outputs.copy()))

    def trajectory(self) -> Trajectory:
        """Return the record as a trajectory, with a row for its start, at time 0, and for each successful period.

        Work and dissipation are counted from the start of the record. `evaluations` and `wall_seconds` are 0.

        Raises:
            RuntimeError: where `record` was not called before.
        """
        if self._record is None:
            raise RuntimeError("nothing was recorded: call record() before the motion")
        states, outputs = (np.array(each) for each in zip(*self._record, strict=True))
        states[:, -2:] -= states[0, -2:]
        outcome = self.status, 0, 0.0
        return Trajectory.from_rows(
            self.model, self.control_period, states, outputs, outcome, lambda _: self.explanation()
        )

    def step(
        self,
        torque: Vector,
        acceleration: Vector | None = None,
        tip_force: Vector | None = None,
        base_acceleration: Vector | None = None,
    ) -> str:
        """Integrate over one control period under constant inputs; return the status.

        Args:
            torque: (n,) motor torques, N m; 0 for motors with prescribed motion.
            acceleration: (n,) accelerations of motors with prescribed motion, rad/s^2, and 0 for all other motors; None
                for zeros.
            tip_force: (3,) force on the tip of the last link, base frame, N; None for zeros.
            base_acceleration: (3,) acceleration of the base, base frame, m/s^2; None for zeros.

        Raises:
            ValueError: for a wrong shape, a value that is not finite, or a torque on a joint with prescribed motion.
            RuntimeError: after a failed step, until the next reset.
        """
        if self.status != STATUS[layout.OK]:
            raise RuntimeError(f"the simulation has failed ({self.status}); reset it first")
        n, drive = self.model.n_joints, self._drive[0]
        drive[:n] = _numbers("torque", torque, n, "N m")
        if self.prescribed.any() or acceleration is not None:
            self._prescribe(drive[:n], acceleration)
        drive[n : n + 3] = 0.0 if tip_force is None else _numbers("tip_force", tip_force, 3, "N")
        drive[n + 3 :] = 0.0
        if base_acceleration is not None:
            drive[n + 3 :] = _numbers("base_acceleration", base_acceleration, 3, "m/s^2")
        self.batch.step(self._drive)
        if self.status == STATUS[layout.OK]:
            self._append_record()
        return self.status

    def _prescribe(self, drive: Array, acceleration: Vector | None) -> None:
        """Replace the torques of prescribed motors, which must be zero, by their accelerations."""
        given = np.zeros(len(drive)) if acceleration is None else acceleration
        given = _numbers("acceleration", given, len(drive), "rad/s^2")
        for i in np.flatnonzero(self.prescribed & (drive != 0.0)):
            raise value_error(f"torque[{i}]", float(drive[i]), "0 (N m): the motion of this joint is prescribed")
        for i in np.flatnonzero(~self.prescribed & (given != 0.0)):
            allowed = "0 (rad/s^2): the motion of this joint is not prescribed"
            raise value_error(f"acceleration[{i}]", float(given[i]), allowed)
        drive[self.prescribed] = given[self.prescribed]

    @property
    def status(self) -> str:
        """Status of the last step: "ok", "diverged" or "not converged"."""
        return STATUS[self.batch.status[0]]

    @property
    def drive(self) -> Array:
        """Inputs (n + 6,) in the last control period, in the order and units of `kernels.layout`."""
        return self._drive[0]

    def explanation(self) -> str:
        """Return the cause of a failure or of an energy alarm, with remedies, see `Trajectory`; otherwise ""."""
        ok, model = self.status == STATUS[layout.OK], self.model
        if ok and not abs(self.energy_residual) > ENERGY_ALARM * self.energy_turnover:
            return ""
        integrator, step = self.batch.integrator(0), self.control_period / self.substeps
        if ok:
            return explain_energy(model, integrator, step, self.time, self.state[None])
        table = signal_table([None] * (model.n_joints + 6))
        table[layout.OFFSET] = self.drive
        grid = (self.time, step, self.substeps)
        return explain_failure(integrator, model, table, grid, self.batch.rows[0], self.status)

    @property
    def time(self) -> float:
        """Time since the reset, s."""
        return float(self.batch.time[0])

    @property
    def energy_turnover(self) -> float:
        """Largest kinetic + elastic energy, |work| or |dissipation| since the reset, J: scale of energy_residual."""
        return float(self.batch.energy_turnover[0])

    @property
    def tip(self) -> Array:
        """Tip position in the base frame (3,), m."""
        return self.outputs[layout.TIP]

    @property
    def tip_velocity(self) -> Array:
        """Tip velocity in the base frame (3,), m/s."""
        return self.outputs[layout.TIP_VELOCITY]

    @property
    def deflection(self) -> Array:
        """Position (3,), m, base frame, of the tip relative to the tip of the rigid arm at the motor angles."""
        return self.outputs[layout.DEFLECTION]

    @property
    def deflection_rate(self) -> Array:
        """Velocity (3,), m/s, base frame, of the tip relative to the rigid arm's tip at the motor angles and rates."""
        return self.outputs[layout.DEFLECTION_RATE]

    @property
    def elastic_energy(self) -> float:
        """Elastic energy of links and joints, J."""
        return float(self.outputs[layout.LINK_ENERGY] + self.outputs[layout.JOINT_ENERGY])

    @property
    def energy(self) -> float:
        """Kinetic + elastic + gravitational energy, J; gravitational energy is zero at the base origin."""
        return float(self.outputs[layout.KINETIC :].sum())

    @property
    def energy_residual(self) -> float:
        """Work - dissipation - change of energy since the reset, J; zero for the exact solution."""
        return float(self.batch.energy_residual[0])


def _numbers(name: str, value: Vector, count: int, unit: str) -> Array:
    """Check a vector of `count` finite numbers in a unit, and return it as an array (count,)."""
    return number_array(name, value, (count,), f"{count} finite numbers ({unit})")
