"""Batch: arms of one model, simulated together."""

from collections.abc import Callable, Collection
from typing import Any, NoReturn

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray
from flexman_gym.common.checks import check_magnitudes, positive, value_error, whole_number, whole_ratio
from flexman_gym.kernels import layout, outputs
from flexman_gym.kernels.batch import advance_single
from flexman_gym.kernels.control_period import NOT_DONE, close_period
from flexman_gym.kernels.rigid_arm import rigid_tips
from flexman_gym.model.model import Model, check_model
from flexman_gym.simulation.batch_integrators import BatchIntegrator, LaneIntegrator, SequentialIntegrator
from flexman_gym.simulation.integrator import (
    MAX_STEPS,
    Integrator,
    default_step,
    find_method,
    find_tolerance,
    prescribed_flags,
)
from flexman_gym.simulation.methods import DEFAULT_METHOD, IteratedGauss, LinearlyImplicit, Method
from flexman_gym.simulation.parameters import nominal_parameters, varied_constants

MAX_ARMS, MAX_THREADS = 65536, 256  # of a batch
RESTING = -1  # status of arms excluded from a step; used between batch and integrator only


class Batch:
    """Arms of one model, each simulated from its own state under its own drive, one control period at a time.

    The b arms share all constants of the model except those set by `vary`. Each arm has the result of a batch of this
    arm alone, bit for bit.

    Attributes:
        model: the model.
        method: the Method.
        control_period: s.
        substeps: steps in a control period, at most 100000.
        rows: (b, 2 d + 2) state and ledger of each arm, see `kernels.layout`.
        state: (b, 2 d) view of the states in `rows`.
        outputs: (b, OUTPUTS) tip, deflection and energies at these states; columns in `kernels.layout`.
        status: (b,) int64 status of the last step: OK, DIVERGED or NOT_CONVERGED of `kernels.layout`. After a failure,
            state and outputs stay those at the end of the last successful control period, until the arm is reset.
        start_energy: (b,) kinetic + elastic + gravitational energy at the last reset, J.
        energy_turnover: (b,) largest values since the reset of kinetic + elastic energy, work and dissipation, J.
        nominal: value in the model of each physical parameter of `vary`, by name.

    Args:
        model: the model of all arms.
        method: a Method or a name from `METHODS`.
        step: s; it divides the control period. "auto" takes the longest divisor up to 5 ms, None lets the method
            choose.
        control_period: s.
        rtol: relative local error of adaptive steps.
        atol: absolute local error of adaptive steps.
        prescribed: joints, from 0, whose motors follow accelerations instead of torques.
        arms: number of arms b, 1 to 65536.
        threads: largest number of threads, 1 to 256.
    """

    state_fields = (
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
        self._bound = tolerance, joints
        period = self.control_period, self.substeps
        self._mover: BatchIntegrator
        self._bound_mover: BatchIntegrator | None = None  # of `bind_period`
        if isinstance(self.method, LinearlyImplicit | IteratedGauss) and tolerance is None:
            constants = model.constants._replace(prescribed=prescribed_flags(n, joints))
            self._mover = LaneIntegrator(constants, self.method, period, count, threads)
        else:
            self._mover = SequentialIntegrator(
                [Integrator(model, self.method, tolerance, joints) for _ in range(count)], period
            )
        self.rows = np.zeros((count, 2 * model.n_dof + 2))
        self.state = self.rows[:, :-2]
        self.outputs = np.zeros((count, layout.OUTPUTS))
        self.status = np.zeros(count, dtype=np.int64)
        self._periods = np.zeros(count)  # control periods since the reset
        self.energy_turnover, self.start_energy = np.zeros(count), np.zeros(count)
        self._drive = np.zeros((count, n + 6))  # drive of the last successful control period, zero after a reset
        self._felt, self._known = np.zeros((count, layout.TIP_ACCELERATIONS)), False
        self.nominal = nominal_parameters(model)
        self.reset(np.arange(count), np.zeros((count, 2 * model.n_dof)))

    def reset(self, arms: np.ndarray, states: Array) -> None:
        """Restart some arms at time 0 from given states.

        Args:
            arms: indices (r,).
            states: (r, 2 d).

        Raises:
            ValueError: for a state beyond `kernels.layout.LARGEST_STATE`; the batch is then unchanged.
        """
        if not np.abs(states).max(initial=0.0) <= layout.LARGEST_STATE:
            check_magnitudes("states", states.ravel().tolist(), layout.LARGEST_STATE)
        self.place(arms, states)
        self._periods[arms] = self._drive[arms] = 0.0
        self._mover.compute_outputs(arms, self.rows, self.outputs)
        energy = np.empty(len(self.rows))
        outputs.total_energies(self.outputs, energy)
        self.start_energy[arms], self.energy_turnover[arms] = energy[arms], 0.0
        outputs.update_energy_scale(self.rows, self.outputs, self.energy_turnover)

    def place(self, arms: np.ndarray, states: Array) -> None:
        """Set the states (r, 2 d) of the arms with the indices (r,), as start of the next step.

        Faster than `reset`, as nothing is checked or computed: outputs and energies are invalid until the next step,
        and the ledger stays invalid until the next reset.
        """
        self.rows[arms, :-2], self.rows[arms, -2:] = states, 0.0
        self.status[arms] = layout.OK
        self._known = False
        self._mover.forget(arms)

    def step(self, drive: Array, moving: BoolArray | None = None) -> None:
        """Integrate all arms without a failure over one control period under constant drives.

        Args:
            drive: (b, n + 6) torques (accelerations of prescribed motors), tip force and base acceleration as in
                `kernels.layout`; not checked.
            moving: (b,) flags of the arms to integrate; None for all.
        """
        if moving is None:
            status = self.status
            self._mover.integrate(drive, self._periods, self.rows, self.outputs, status)
        else:
            status = np.where(moving, self.status, RESTING)
            self._mover.integrate(drive, self._periods, self.rows, self.outputs, status)
            self.status[moving] = status[moving]
        self._known = False
        close_period(self.rows, self.outputs, status, drive, self._periods, self._drive, self.energy_turnover)

    def period_arrays(self) -> dict[str, Any]:
        """Return the arrays that `step` changes by their names in `kernels.layout.Period`."""
        return {
            "periods": self._periods, "last_drive": self._drive, "turnover": self.energy_turnover,
            "start_energy": self.start_energy,
        }  # fmt: skip

    def bind_period(self, drive: Array, period: layout.Period) -> tuple[Any, ...] | None:
        """Return the arguments of `step_period` for the only arm of an environment, or None where it is not possible.

        Args:
            drive: (1, n + 6) as in `step`.
            period: arrays of the environment, among them the drive and `period_arrays`; they must stay alive.
        """
        if not isinstance(self._mover, LaneIntegrator):
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

    def roll(self, drives: Array) -> tuple[Array, Array]:
        """Integrate all arms without a failure over T control periods, with Python's global lock released.

        The result equals that of T calls of `step`, to the bit, except for `tip_accelerations`, which are those at the
        end.

        Args:
            drives: (b, T, n + 6) drive of each control period, as in `step`; not checked.

        Returns:
            States (b, T, 2 d) and outputs (b, T, OUTPUTS) after each control period; NaN from the period in which an
            arm failed.
        """
        count, periods = drives.shape[:2]
        rows, read = (np.full((count, periods, each.shape[1]), np.nan) for each in (self.rows, self.outputs))
        self._mover.integrate_periods(drives, self._periods, self.rows, self.outputs, self.status, (rows, read))
        good = np.isfinite(rows[:, :, 0]).sum(axis=1)
        self._periods += good
        moved = np.flatnonzero(good)
        self._drive[moved] = drives[moved, good[moved] - 1]
        self._known = False
        for period in range(periods):
            valid = period < good
            turnover = self.energy_turnover[valid]
            outputs.update_energy_scale(rows[valid, period], read[valid, period], turnover)
            self.energy_turnover[valid] = turnover
        return rows[:, :, :-2], read

    def tip_accelerations(self) -> Array:
        """Return the tip accelerations of all arms (b, TIP_ACCELERATIONS), m/s^2; columns in `kernels.layout`.

        TIP_ACCELERATION is the second time derivative of the tip position in the base frame, relative to the base,
        which may itself accelerate. SPECIFIC_FORCE is the reading of an accelerometer at the tip: the acceleration in
        inertial space minus gravity, along the axes of the tip, which turn with the end of the last link as it bends.

        Both hold at the end of the last control period, under its drive; after a reset, under zero drive; for a failed
        arm, at the end of its last successful period. They are computed on demand, once in a period. The array is
        overwritten by later calls.
        """
        if not self._known:
            self._mover.compute_tip_accelerations(self._drive, self.rows, self._felt)
            self._known = True
        return self._felt

    def integrator(self, arm: int) -> Integrator:
        """Return an integrator of one arm with its present parameters, independent of the batch."""
        run, own = Integrator(self.model, self.method, *self._bound), self._mover.constants(arm)
        run.constants = run.constants._replace(**own)
        return run

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
        """Set physical parameters of the arms with the indices (r,), in place of those of the model.

        They act from the next step on; energies follow from the next reset on, so reset the arms at once. Elements and
        modes stay those of the model, modal damping ratios are kept, and the inertia of a payload scales with its mass.

        Args:
            arms: indices (r,).
            **parameters: values (r, ...) by their name in `simulation.parameters.PARAMETERS`, in its units.

        Raises:
            ValueError: for an unknown name or a wrong shape, for numbers not finite or negative, for zero where the arm
                needs a positive value, and for stiffness or damping of a rigid joint that differ from the model's.
        """
        self._known = False
        self._mover.vary(arms, varied_constants(self.model, len(arms), parameters))

    def replace_integrator(self, make: Callable[[BatchIntegrator], BatchIntegrator]) -> None:
        """Replace the integrator of all arms by one made from the present one; it acts from the next reset on."""
        self._mover = make(self._mover)

    @property
    def time(self) -> Array:
        """Time since the reset (b,), s."""
        return self._periods * self.control_period

    @property
    def energy_residual(self) -> Array:
        """Work - dissipation - change of energy since the reset (b,), J; see `Trajectory`."""
        result = np.empty(len(self.rows))
        outputs.energy_residuals(self.rows, self.outputs, self.start_energy, result)
        return result


def _find_substeps(step: float | str | None, control_period: float) -> int:
    """Return the number of steps in a control period (s): one for None, for "auto" as in `default_step`.

    Args:
        step: s, None or "auto".
        control_period: s.

    Returns:
        The number of steps.

    Raises:
        ValueError: for a step that does not divide the control period.
    """
    if step is None:
        return 1
    if isinstance(step, str):
        step = default_step(control_period) if step == "auto" else step
    return whole_ratio("step", step, control_period, "a number of seconds that divides the control period", MAX_STEPS)  # type: ignore[arg-type]


def _joints(prescribed: object, count: int) -> list[int]:
    """Return the numbers of the joints with prescribed motion, of `count` joints."""
    try:
        is_list = not isinstance(prescribed, str | bytes) and len(prescribed) <= count  # type: ignore[arg-type]
    except Exception:  # an object without a length
        is_list = False
    if not is_list or not isinstance(prescribed, Collection):
        raise value_error("prescribed", prescribed, f"a list of at most {count} joints, numbered from 0")
    return [whole_number("prescribed", joint, 0, count - 1) for joint in prescribed]
