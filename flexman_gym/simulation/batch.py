"""Batch: arms of one model that move side by side."""

from collections.abc import Callable, Collection
from typing import NoReturn

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray
from flexman_gym.common.checks import check_magnitudes, positive, value_error, whole_number, whole_ratio
from flexman_gym.kernels import layout, outputs
from flexman_gym.kernels.control_period import close_period
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

MAX_ARMS, MAX_THREADS = 65536, 256
RESTING = -1  # status of arms that are not to move; only batch integrators see it


class Batch:
    """Arms of one model that are moved by one control period at a time, each from its own state, by its own drive.

    There are b arms. They share all constants of the model except those that `vary` sets. An arm moves as it would
    alone, bit for bit.

    Attributes:
        model: the model.
        method: the Method.
        control_period: s.
        substeps: steps in a control period, at most 100000.
        rows: (b, 2 d + 2) state and ledger of each arm, see `kernels.layout`.
        state: (b, 2 d) a view of `rows`.
        outputs: (b, OUTPUTS) tip, deflection and energies at that state; columns in `kernels.layout`.
        status: (b,) int64 of the last step: OK, DIVERGED or NOT_CONVERGED of `kernels.layout`. An arm that failed keeps
            state and outputs of the end of its last good control period and rests until it is reset.
        start_energy: (b,) kinetic + elastic + gravitational energy at the last reset, J.
        energy_turnover: (b,) the largest since the reset of kinetic + elastic energy, of work and of dissipation, J.
        nominal: the model's value of each physical parameter that `vary` can change, by name.

    Raises:
        ValueError: one line with field, value and what is allowed.
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
        self._drive = np.zeros((count, n + 6))  # of the last good control period, zeros after a reset
        self._felt, self._known = np.zeros((count, layout.TIP_ACCELERATIONS)), False
        self.nominal = nominal_parameters(model)
        self.reset(np.arange(count), np.zeros((count, 2 * model.n_dof)))

    def reset(self, arms: np.ndarray, states: Array) -> None:
        """Starts the arms with the indices (r,) anew, at time 0 and at states (r, 2 d).

        Raises:
            ValueError: for a state beyond the bounds of `kernels.layout.LARGEST_STATE`; nothing has changed then.
        """
        if not np.abs(states).max(initial=0.0) <= layout.LARGEST_STATE:
            check_magnitudes("states", states.ravel().tolist(), layout.LARGEST_STATE)
        self.place(arms, states)
        self._periods[arms] = self._drive[arms] = 0.0
        self._mover.observe(arms, self.rows, self.outputs)
        energy = np.empty(len(self.rows))
        outputs.total_energies(self.outputs, energy)
        self.start_energy[arms], self.energy_turnover[arms] = energy[arms], 0.0
        outputs.update_energy_scale(self.rows, self.outputs, self.energy_turnover)

    def place(self, arms: np.ndarray, states: Array) -> None:
        """Puts the arms with the indices (r,) at states (r, 2 d), to be moved from there on.

        It takes less time than `reset`, as nothing is read and checked: energies and outputs are of no use until the
        next step, the ledger not even then.
        """
        self.rows[arms, :-2], self.rows[arms, -2:] = states, 0.0
        self.status[arms] = layout.OK
        self._known = False
        self._mover.forget(arms)

    def step(self, drive: Array, moving: BoolArray | None = None) -> None:
        """Moves all arms that have not failed by one control period, during which their drive is constant.

        Args:
            drive: (b, n + 6) torques (accelerations where the motion is prescribed), tip force and base acceleration as
                in `kernels.layout`; it is not checked.
            moving: (b,) arms that are moved, the others rest; None moves all.
        """
        if moving is None:
            status = self.status
            self._mover.move(drive, self._periods, self.rows, self.outputs, status)
        else:
            status = np.where(moving, self.status, RESTING)
            self._mover.move(drive, self._periods, self.rows, self.outputs, status)
            self.status[moving] = status[moving]
        self._known = False
        close_period(self.rows, self.outputs, status, drive, self._periods, self._drive, self.energy_turnover)

    def roll(self, drives: Array) -> tuple[Array, Array]:
        """Moves all arms that have not failed through T control periods, with Python's lock released.

        It is T times `step`, to the bit, but for `tip_accelerations`, which are those at the end.

        Args:
            drives: (b, T, n + 6) of each control period, as in `step`; they are not checked.

        Returns:
            States (b, T, 2 d) and outputs (b, T, OUTPUTS) after each control period; NaN from the one on in which an
            arm failed.
        """
        count, periods = drives.shape[:2]
        rows, read = (np.full((count, periods, each.shape[1]), np.nan) for each in (self.rows, self.outputs))
        self._mover.roll(drives, self._periods, self.rows, self.outputs, self.status, (rows, read))
        good = np.isfinite(rows[:, :, 0]).sum(axis=1)
        self._periods += good
        moved = np.flatnonzero(good)
        self._drive[moved] = drives[moved, good[moved] - 1]
        self._known = False
        for period in range(periods):
            well = period < good
            turned = self.energy_turnover[well]
            outputs.update_energy_scale(rows[well, period], read[well, period], turned)
            self.energy_turnover[well] = turned
        return rows[:, :, :-2], read

    def tip_accelerations(self) -> Array:
        """Gives how each tip is accelerated now, (b, TIP_ACCELERATIONS), m/s^2; columns in `kernels.layout`.

        TIP_ACCELERATION is the second derivative of the tip's position in the base frame, relative to the base, which
        may be accelerated itself. SPECIFIC_FORCE is what an accelerometer on the tip shows: the acceleration in
        inertial space less gravity, along the axes of the tip, which turn with the end of the last link as it bends.

        Both are those at the end of the last control period, under its drive, and after a reset without any; of an arm
        that failed, at the end of its last good one. They are calculated when they are asked for, once in a period. The
        array is overwritten later on.
        """
        if not self._known:
            self._mover.sense(self._drive, self.rows, self._felt)
            self._known = True
        return self._felt

    def run(self, arm: int) -> Integrator:
        """Gives a run of one arm, with the parameters that it has, beside the batch."""
        run, own = Integrator(self.model, self.method, *self._bound), self._mover.constants(arm)
        run.constants = run.constants._replace(**own)
        return run

    def rigid_tips(self, states: Array) -> Array:
        """Gives the tips (r, 3) in the base frame, m, of the rigid arm at the motor angles of states (r, 2 d)."""
        tips = np.empty((len(states), 3))
        rigid_tips(self.model.constants, states, tips)
        return tips

    def __reduce__(self) -> NoReturn:
        raise TypeError(
            "a Batch cannot be copied or pickled, nor what holds one; an environment can be copied, and gives its state"
        )

    def vary(self, arms: np.ndarray, **parameters: Array) -> None:
        """Gives the arms with the indices (r,) physical parameters of their own in place of the model's.

        They act from the next step on. The energies follow from the next reset on, which should come at once. Elements
        and modes stay those of the model, modal damping keeps its ratio, and the inertia of a payload grows with its
        mass.

        Args:
            arms: indices (r,).
            parameters: values (r, ...) by their name in `simulation.parameters.PARAMETERS`, in its units.

        Raises:
            ValueError: for another name or shape, for numbers that are not finite or below zero, for zero where the arm
                needs more, and for stiffness or damping of a rigid joint other than the model's.
        """
        self._known = False
        self._mover.vary(arms, varied_constants(self.model, len(arms), parameters))

    def replace_integrator(self, make: Callable[[BatchIntegrator], BatchIntegrator]) -> None:
        """Replace the integrator of all arms by one made from the present one; it acts from the next reset on."""
        self._mover = make(self._mover)

    @property
    def time(self) -> Array:
        """Seconds since the reset (b,)."""
        return self._periods * self.control_period

    @property
    def energy_residual(self) -> Array:
        """Work - dissipation - change of energy since the reset (b,), J; see `Trajectory`."""
        result = np.empty(len(self.rows))
        outputs.energy_residuals(self.rows, self.outputs, self.start_energy, result)
        return result


def _find_substeps(step: float | str | None, control_period: float) -> int:
    """Gives the steps in a control period (s): one for None, where the method chooses, and some for "auto".

    Raises:
        ValueError: for anything else that does not divide the control period.
    """
    if step is None:
        return 1
    if isinstance(step, str):
        step = default_step(control_period) if step == "auto" else step
    return whole_ratio("step", step, control_period, "a number of seconds that divides the control period", MAX_STEPS)  # type: ignore[arg-type]


def _joints(prescribed: object, count: int) -> list[int]:
    """Gives the numbers of the joints whose motion is prescribed, of `count` joints."""
    try:
        few = not isinstance(prescribed, str | bytes) and len(prescribed) <= count  # type: ignore[arg-type]
    except Exception:  # nothing that has a length
        few = False
    if not few or not isinstance(prescribed, Collection):
        raise value_error("prescribed", prescribed, f"a list of at most {count} joints, by their numbers from 0")
    return [whole_number("prescribed", joint, 0, count - 1) for joint in prescribed]
