"""Batch: arms of one model, simulated together."""

from collections.abc import Callable, Collection
from typing import Any, NoReturn

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray
from flexman_gym.common.checks import check_magnitudes, positive, whole_number, whole_ratio
from flexman_gym.common.errors import value_error
from flexman_gym.kernels import layout, outputs
from flexman_gym.kernels.batch import advance_single
from flexman_gym.kernels.control_period import NOT_DONE, close_period
from flexman_gym.kernels.rigid_arm import rigid_tips
from flexman_gym.model.model import Model, check_model
from flexman_gym.simulation.batch_integrators import BatchIntegrator, Feedback, LaneIntegrator, SequentialIntegrator
from flexman_gym.simulation.integrator import (
    MAX_STEPS,
    Integrator,
    default_step,
    find_method,
    find_tolerance,
    with_prescribed,
)
from flexman_gym.simulation.methods import DEFAULT_METHOD, Method, ScipyMethod
from flexman_gym.simulation.physical_parameters import nominal_parameters, varied_constants

MAX_ARMS, MAX_THREADS = 65536, 256  # largest numbers of arms and of threads of a batch
EXCLUDED = -1  # status of arms excluded from a step; used between batch and integrator only


class Batch:
    """Arms of one model, each simulated from its own state under its own inputs, one control period at a time.

    The b arms share all constants of the model except the parameters set by `vary`. The result of an arm does not
    depend on the other arms, bit for bit. d is the number of coordinates and n of joints; see `kernels.layout`.

    Attributes:
        model: the model.
        method: the Method.
        control_period: s.
        substeps: number of integration steps in a control period, at most 100000.
        rows: (b, 2 d + 2) state (2 d) of each arm, then work and dissipation since the reset, J (the energy ledger).
        state: (b, 2 d) view of the states in `rows`: coordinates, then speeds.
        outputs: (b, OUTPUTS) tip, deflection and energies at these states; columns in `kernels.layout`.
        status: (b,) int64 status of the last step: OK, DIVERGED or NOT_CONVERGED of `kernels.layout`. After a failure,
            state and outputs keep their values at the end of the last successful control period, until the arm is
            reset.
        start_energy: (b,) kinetic + elastic + gravitational energy at the last reset, J.
        energy_turnover: (b,) largest magnitude since the reset of kinetic + elastic energy, work or dissipation, J; the
            scale for `energy_residual`.
        nominal: name of each physical parameter of `vary` -> its value in the model.
        foundation: (b, FOUNDATION) foundation rows of the next control period, with times from its start, see
            `kernels.layout`; they also hold at a reset. (b, 0) for bases that do not rotate.

    Args:
        model: the model of all arms.
        method: a Method or a name from `METHODS`.
        step: integration step, s; it divides the control period. "auto" selects the longest divisor up to 5 ms, None
            lets the method choose its steps by rtol and atol.
        control_period: s.
        rtol: relative tolerance of the local error of adaptive steps.
        atol: absolute tolerance of the local error of adaptive steps, in the unit of each coordinate or speed.
        prescribed: indices, from 0, of the joints whose motors follow prescribed accelerations instead of torques.
        arms: number of arms b, 1 to 65536.
        threads: largest number of threads, 1 to 256.
        rotates: True for bases with prescribed rotation.
    """

    state_fields: tuple[str, ...] = (
        "rows", "outputs", "status", "_periods", "energy_turnover", "start_energy", "_mover", "_drive", "_felt",
        "_known",
    )  # fmt: skip

    def __init__(
        self,
        model: Model,
        method: str | Method = DEFAULT_METHOD,
        step: float | str | None = "auto",
        control_period: float = 0.02,
        rtol: float = 1e-6,
        atol: float = 1e-9,
        prescribed: Collection[int] = (),
        *,
        arms: int = 1,
        threads: int = 1,
        rotates: bool = False,
    ) -> None:
        self.model = check_model(model)
        self.method = find_method(method)
        self.control_period = positive("control_period", control_period, "s")
        self.substeps = _find_substeps(step, self.control_period)
        n, count = model.n_joints, whole_number("arms", arms, 1, MAX_ARMS)
        whole_number("threads", threads, 1, MAX_THREADS)
        joints = _joints(prescribed, n)
        fixed = None if step is None else self.control_period / self.substeps
        tolerance = find_tolerance(self.method, fixed, rtol, atol)
        self._bound, self._rotates = (tolerance, joints, rotates), rotates
        self.foundation = np.zeros((count, layout.FOUNDATION if rotates else 0))
        self._past_foundation = self.foundation.copy()  # rows of the last control period
        if rotates:
            self.state_fields = (*self.state_fields, "foundation", "_past_foundation")
        period = self.control_period, self.substeps
        self._mover: BatchIntegrator
        self._bound_mover: BatchIntegrator | None = None  # integrator for which `bind_period` was called
        if not isinstance(self.method, ScipyMethod) and self.method.in_lanes and tolerance is None:
            constants = with_prescribed(model.constants, joints, rotates)
            self._mover = LaneIntegrator(constants, self.method, period, count, threads)
        else:
            self._mover = SequentialIntegrator(
                [Integrator(model, self.method, tolerance, joints, rotates) for _ in range(count)], period
            )
        self.rows = np.zeros((count, 2 * model.n_dof + 2))
        self.state = self.rows[:, :-2]
        self.outputs = np.zeros((count, layout.OUTPUTS))
        self.status = np.zeros(count, dtype=np.int64)
        self._periods = np.zeros(count)  # number of control periods since the reset
        self.energy_turnover, self.start_energy = np.zeros(count), np.zeros(count)
        self._drive = np.zeros((count, n + 6))  # drive of the last successful control period, zero after a reset
        # tip accelerations; True if they are those of the present rows
        self._felt, self._known = np.zeros((count, layout.TIP_ACCELERATIONS)), False
        self.nominal = nominal_parameters(model)
        self.reset(np.arange(count), np.zeros((count, 2 * model.n_dof)))

    def reset(self, arms: np.ndarray, states: Array) -> None:
        """Restart some arms at time 0 from given states.

        Args:
            arms: indices (r,) of the arms.
            states: (r, 2 d) coordinates and speeds.

        Raises:
            ValueError: for a coordinate or speed beyond `kernels.layout.LARGEST_STATE`; the batch is then unchanged.
        """
        if not np.abs(states).max(initial=0.0) <= layout.LARGEST_STATE:
            check_magnitudes("states", states.ravel().tolist(), layout.LARGEST_STATE)
        self.place(arms, states)
        self._periods[arms] = self._drive[arms] = 0.0
        self._past_foundation[arms] = self.foundation[arms]
        self._past_foundation[arms, 1:2] = 0.0  # tip accelerations are those at the start
        self._mover.compute_outputs(arms, self.rows, self.outputs, self.foundation)
        energy = np.empty(len(self.rows))
        outputs.total_energies(self.outputs, energy)
        self.start_energy[arms], self.energy_turnover[arms] = energy[arms], 0.0
        outputs.update_energy_turnover(self.rows, self.outputs, self.energy_turnover)

    def place(self, arms: np.ndarray, states: Array) -> None:
        """Set the states (r, 2 d) of the arms with the indices (r,); the next step starts from them.

        Faster than `reset`, as nothing is checked or computed: outputs are invalid until the next step, and the energy
        ledger, `energy_residual` and `energy_turnover` until the next reset.
        """
        self.rows[arms, :-2], self.rows[arms, -2:] = states, 0.0
        self.status[arms] = layout.OK
        self._known = False
        self._mover.forget(arms)

    def step(self, drive: Array, moving: BoolArray | None = None) -> None:
        """Integrate all arms whose status is OK over one control period under constant inputs.

        Args:
            drive: (b, n + 6) inputs in the order of `kernels.layout`: n motor torques, N m (accelerations of prescribed
                motors, rad/s^2), tip force, N, and base acceleration, m/s^2; not checked.
            moving: (b,) flags of the arms to integrate; None for all.
        """
        inputs = self._with_foundation(drive, self.foundation)
        if self._rotates:
            self._past_foundation[:] = self.foundation
        if moving is None:
            status = self.status
            self._mover.integrate(inputs, self._periods, self.rows, self.outputs, status)
        else:
            status = np.where(moving, self.status, EXCLUDED)
            self._mover.integrate(inputs, self._periods, self.rows, self.outputs, status)
            self.status[moving] = status[moving]
        self._known = False
        close_period(self.rows, self.outputs, status, drive, self._periods, self._drive, self.energy_turnover)

    def _with_foundation(self, drive: Array, foundation: Array) -> Array:
        """Return inputs (b, n + 6) with the foundation rows of rotating bases."""
        return np.hstack([drive, foundation]) if self._rotates else drive

    def period_arrays(self) -> dict[str, Any]:
        """Return the arrays that `step` changes by their names in `kernels.layout.Period`."""
        return {
            "periods": self._periods, "last_drive": self._drive, "turnover": self.energy_turnover,
            "start_energy": self.start_energy,
        }  # fmt: skip

    def bind_period(self, drive: Array, period: layout.Period) -> tuple[Any, ...] | None:
        """Return the arguments of `step_period` for the only arm of an environment, or None if `step` must be used.

        Args:
            drive: (1, n + 6) as in `step`.
            period: arrays of the environment, among them the drive and `period_arrays`; they must stay alive.
        """
        if not isinstance(self._mover, LaneIntegrator) or self._rotates:
            return None
        self._bound_mover = self._mover
        return self._mover.single_arguments(drive, self.rows, self.outputs, self.status, period)

    def step_period(self, arguments: tuple[Any, ...]) -> int:
        """Apply the action of the only arm of an environment for a control period.

        Args:
            arguments: result of `bind_period`.

        Returns:
            NOT_DONE for an action that is not allowed and after `replace_integrator`, without an effect; otherwise the
            result of `kernels.control_period.finish_period`.
        """
        if self._mover is not self._bound_mover:
            return NOT_DONE
        self._known = False
        result: int = advance_single(*arguments)
        return result

    def roll(self, drives: Array, feedback: Feedback | None = None) -> tuple[Array, Array]:
        """Integrate all arms whose status is OK over T control periods, with Python's global interpreter lock released.

        The results equal the results of T calls of `step` to the bit; `tip_accelerations` are then at the end of the
        last period.

        Args:
            drives: (b, T, n + 6) inputs in each control period, as in `step`; not checked.
            feedback: PD control of the motors in addition to the drives, see `kernels.batch._add_feedback`, for several
                arms and methods that integrate in lanes; None for none.

        Returns:
            States (b, T, 2 d) and outputs (b, T, OUTPUTS) after each control period; NaN from the period in which an
            arm failed.
        """
        if self._rotates:
            raise value_error("rotates", True, "False: several control periods at once need bases that do not rotate")
        count, periods = drives.shape[:2]
        rows, read = (np.full((count, periods, each.shape[1]), np.nan) for each in (self.rows, self.outputs))
        results = self.rows, self.outputs, self.status, (rows, read)
        if feedback is None:
            self._mover.integrate_periods(drives, self._periods, *results)
        else:
            self._mover.integrate_feedback(drives, *results, feedback)  # type: ignore[attr-defined]
        good = np.isfinite(rows[:, :, 0]).sum(axis=1)
        self._periods += good
        moved = np.flatnonzero(good)
        self._drive[moved] = drives[moved, good[moved] - 1]
        self._known = False
        valid, turnover = np.isfinite(rows[:, :, 0]), np.zeros(count * periods)
        outputs.update_energy_turnover(rows.reshape(count * periods, -1), read.reshape(count * periods, -1), turnover)
        largest = np.where(valid, turnover.reshape(count, periods), 0.0).max(axis=1, initial=0.0)
        np.maximum(self.energy_turnover, largest, out=self.energy_turnover)
        return rows[:, :, :-2], read

    def tip_accelerations(self) -> Array:
        """Return the tip accelerations of all arms (b, TIP_ACCELERATIONS), m/s^2; columns in `kernels.layout`.

        TIP_ACCELERATION is the second time derivative of the tip position in the base frame, relative to the base,
        which may itself accelerate. SPECIFIC_FORCE is the reading of an accelerometer at the tip: the acceleration in
        inertial space minus gravity, along the axes of the tip section of the deformed last link.

        Both quantities hold at the end of the last successful control period under its inputs; after a reset, under
        zero inputs. They are computed on demand, once in a period. Later calls overwrite the array.
        """
        if not self._known:
            inputs = self._with_foundation(self._drive, self._past_foundation)
            self._mover.compute_tip_accelerations(inputs, self.rows, self._felt)
            self._known = True
        return self._felt

    def integrator(self, arm: int) -> Integrator:
        """Return a new integrator with the present parameters of an arm, independent of the batch."""
        result, own = Integrator(self.model, self.method, *self._bound), self._mover.constants(arm)
        result.constants = result.constants._replace(**own)
        return result

    def rigid_tips(self, states: Array) -> Array:
        """Return the tips (r, 3) in the base frame, m, of the rigid arm at the motor angles of states (r, 2 d)."""
        tips = np.empty((len(states), 3))
        rigid_tips(self.model.constants, states, tips)
        return tips

    def __reduce__(self) -> NoReturn:
        raise TypeError(
            "a Batch, or an object that holds one, cannot be copied or pickled; copy the environment or its state"
        )

    def vary(self, arms: np.ndarray, **parameters: Array) -> None:
        """Set physical parameters of the arms with the indices (r,), in place of the parameters of the model.

        The parameters act from the next step on, but start energies keep their values from before the change until the
        next reset; reset these arms at once. Elements, modes and modal damping ratios of the model do not change, and
        the inertia of a payload scales with its mass.

        Args:
            arms: indices (r,) of the arms.
            **parameters: values (r,) or (r, n) by their name in `physical_parameters.PARAMETERS`, in the units there.

        Raises:
            ValueError: for an unknown name or a wrong shape, for negative or non-finite numbers, for zero where the arm
                needs a positive value, and for stiffness or damping of a rigid joint that differ from the model's.
        """
        self.set_constants(arms, varied_constants(self.model, len(arms), parameters))

    def set_constants(self, arms: np.ndarray, constants: dict[str, Array]) -> None:
        """Set constants (r, ...) of the arms (r,), results of `physical_parameters.varied_constants`; see `vary`."""
        self._known = False
        self._mover.set_constants(arms, constants)

    def spring_constants(self) -> tuple[Array, Array, Array]:
        """Return joint_stiffness (b, n), knee_twist (b, e) and knee_share (b, e) of the arms."""
        own = [self._mover.constants(arm) for arm in range(len(self.rows))]
        stiffness, twists, shares = (
            np.array([each[name] for each in own]) for name in ("joint_stiffness", "knee_twist", "knee_share")
        )
        return stiffness, twists, shares

    def replace_integrator(self, make: Callable[[BatchIntegrator], BatchIntegrator]) -> None:
        """Replace the batch integrator by `make(present batch integrator)`; reset all arms before the next step.

        Raises:
            ValueError: for bases that rotate.
        """
        if self._rotates:
            raise value_error("rotates", True, "False: another simulation of the arms needs bases that do not rotate")
        self._mover = make(self._mover)

    @property
    def time(self) -> Array:
        """Time since the reset (b,), s."""
        return self._periods * self.control_period

    @property
    def energy_residual(self) -> Array:
        """Work - dissipation - change of energy since the reset (b,), J; zero for the exact solution."""
        result = np.empty(len(self.rows))
        outputs.energy_residuals(self.rows, self.outputs, self.start_energy, result)
        return result


def _find_substeps(step: float | str | None, control_period: float) -> int:
    """Return the number of steps in a control period.

    Args:
        step: s; None for one step, "auto" for the step of `default_step`.
        control_period: s.

    Raises:
        ValueError: for a step that does not divide the control period.
    """
    if step is None:
        return 1
    if isinstance(step, str):
        step = default_step(control_period) if step == "auto" else step
    return whole_ratio("step", step, control_period, "a number of seconds that divides the control period", MAX_STEPS)  # type: ignore[arg-type]


def _joints(prescribed: object, count: int) -> list[int]:
    """Check the indices, from 0, of joints with prescribed motion among `count` joints, and return them as a list."""
    try:
        is_list = not isinstance(prescribed, str | bytes) and len(prescribed) <= count  # type: ignore[arg-type]
    except Exception:  # an object without a length
        is_list = False
    if not is_list or not isinstance(prescribed, Collection):
        raise value_error("prescribed", prescribed, f"a list of at most {count} joints, numbered from 0")
    return [whole_number("prescribed", joint, 0, count - 1) for joint in prescribed]
