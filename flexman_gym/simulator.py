"""The simulator: a model moved through time, as a whole scene or one control period after another."""

import time as clock
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexman_gym.beam import Array
from flexman_gym.checks import one_of, positive, refusal, vector
from flexman_gym.kernels import layout, steppers
from flexman_gym.kernels.layout import STATUS, Clock, Work, make_work
from flexman_gym.methods import EXPLICIT, LINEARLY_IMPLICIT, METHODS, Method
from flexman_gym.model import Model, scene_model
from flexman_gym.scene import Scene

WHOLE = 1e-9  # how far a ratio of two times may be from a whole number, relatively


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The solution of a scene at T output times; after a divergence only the times before it. SI units, radians.

    Attributes:
        time: (T,) s.
        tip, tip_velocity: (T, 3) in the base frame.
        joint_angles, motor_angles: (T, n) link side and motor side; equal where a joint is rigid.
        energy: (T,) kinetic + elastic (links and joints) + gravitational, the last zero at the base origin; J.
        work, dissipation: (T,) work of the motors and energy lost in dampers since the start, J.
        states: (T, 2 d); the order is that of `kernels.layout`.
        deflection: (T, 3) tip relative to the tip of the rigid arm at the motor angles.
        status: "ok", "diverged" or "not converged".
        evaluations: of the accelerations.
        wall_seconds: spent in the integrator, without compilation.
    """

    time: Array
    tip: Array
    tip_velocity: Array
    joint_angles: Array
    motor_angles: Array
    energy: Array
    work: Array
    dissipation: Array
    states: Array
    deflection: Array
    status: str
    evaluations: int
    wall_seconds: float

    @property
    def energy_residual(self) -> Array:
        """(T,) work of the motors - dissipation - change of energy, J: what the integrator invented or lost."""
        return self.work - self.dissipation - (self.energy - self.energy[0])


def simulate(
    scene: Scene,
    model: Model | None = None,
    method: str = "auto",
    step: float | None = None,
    rtol: float = 1e-6,
    atol: float = 1e-9,
) -> Trajectory:
    """Simulates a scene.

    Args:
        scene: arm, torque, initial state, duration.
        model: None takes what the scene says.
        method: a name from `METHODS`; "auto" takes "ros2" where a step is given and the reference "dop853" where not.
        step: of a fixed-step method, s. It divides the output step of the scene or is a multiple of it; in the latter
            case there is an output after every step. An adaptive method takes it as its first guess.
        rtol, atol: relative and absolute local error of an adaptive method.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """
    if not isinstance(scene, Scene):
        raise refusal("scene", scene, "a Scene")
    model = scene_model(scene) if model is None else model
    if not isinstance(model, Model):
        raise refusal("model", model, "a Model, from build_model")
    if model.n_joints != scene.arm.n_joints:
        raise refusal("model", f"{model.n_joints} joints", f"a model of the scene's arm, {scene.arm.n_joints} joints")
    chosen = find_method("ros2" if method == "auto" and step is not None else "dop853" if method == "auto" else method)
    interval, substeps = _output_interval(chosen, step, scene.output_step)
    rows = _whole("step", interval, scene.duration, "a number of seconds that divides the duration")
    run = _Run(model, chosen, (positive("rtol", rtol), positive("atol", atol)))
    state = np.append(model.initial_state(scene.initial.joint_angles, scene.initial.joint_rates), [0.0, 0.0])
    states, outputs = np.zeros((rows + 1, len(state))), np.zeros((rows + 1, layout.OUTPUTS))
    table = scene.torque.table()
    run.start(state, states[0], outputs[0])
    started = clock.perf_counter()
    status, valid, evaluations = run(table, Clock(0.0, interval / substeps, substeps), state, states[1:], outputs[1:])
    elapsed = clock.perf_counter() - started
    outcome = (STATUS[status], evaluations, elapsed)
    return _trajectory(model, interval, states[: valid + 1], outputs[: valid + 1], outcome)


class Simulator:
    """A model that is moved by one control period at a time, under torques that are constant during it.

    Attributes:
        model: the model.
        state: (2 d,) coordinates and speeds, a view that `step` updates; order in `kernels.layout`.
        outputs: (OUTPUTS,) tip, deflection and energies at that state; columns in `kernels.layout`.
        time: s since the reset.
        status: of the last step, "ok", "diverged" or "not converged". After a failure state and outputs are those at
            the end of the last good control period, and only a reset leads on.

    Raises:
        ValueError: one line with field, value and what is allowed.
    """

    def __init__(
        self,
        model: Model,
        method: str = "ros2",
        step: float | None = 0.005,
        control_period: float = 0.02,
        rtol: float = 1e-6,
        atol: float = 1e-9,
    ) -> None:
        if not isinstance(model, Model):
            raise refusal("model", model, "a Model, from build_model")
        self.model = model
        self.method = find_method(method)
        self.control_period = positive("control_period", control_period, "s")
        if step is None and not self.method.adaptive:
            raise refusal("step", None, f"a number > 0 (s): {self.method.name} takes fixed steps")
        allowed = "a number of seconds that divides the control period"
        self.substeps = 1 if step is None else _whole("step", step, self.control_period, allowed)
        self._run = _Run(model, self.method, (positive("rtol", rtol), positive("atol", atol)))
        size = 2 * model.n_dof
        self._row, self._rows = np.zeros(size + 2), np.zeros((1, size + 2))
        self.outputs, self._new_outputs = np.zeros(layout.OUTPUTS), np.zeros((1, layout.OUTPUTS))
        self._torque = np.zeros((4, model.n_joints))
        self.state = self._row[:size]
        self.reset(np.zeros(model.n_joints))

    def reset(
        self,
        joint_angles: Sequence[float] | Array | None = None,
        joint_rates: Sequence[float] | Array | None = None,
        state: Sequence[float] | Array | None = None,
    ) -> None:
        """Starts anew at time 0, undeformed at joint angles (n,) rad and rates (n,) rad/s, or at a whole state (2 d,).

        Angles and rates are zero by default; a state excludes them.

        Raises:
            ValueError: wrong shape, a value that is not finite, or both ways at once.
        """
        if state is not None:
            if joint_angles is not None or joint_rates is not None:
                raise refusal("state", "given with joint_angles or joint_rates", "one of the two")
            start = np.array(vector("state", state, 2 * self.model.n_dof))
        else:
            angles = np.zeros(self.model.n_joints) if joint_angles is None else joint_angles
            start = self.model.initial_state(angles, joint_rates)
        self._row[:-2], self._row[-2:] = start, 0.0
        self._periods = 0
        self.status = STATUS[layout.OK]
        self._run.start(self._row, self._rows[0], self.outputs)
        self._start_energy = self.energy

    def step(self, torque: Sequence[float] | Array) -> str:
        """Moves on by one control period under constant motor torques (n,) in N m; returns the status.

        Raises:
            ValueError: wrong shape or a value that is not finite.
            RuntimeError: after a failed step, until the next reset.
        """
        if self.status != STATUS[layout.OK]:
            raise RuntimeError(f"the simulation is over, it {self.status}: reset it first")
        values = np.asarray(torque)
        if values.shape != self._torque[0].shape or values.dtype.kind not in "fiu" or not np.isfinite(values).all():
            raise refusal("torque", torque, f"{self.model.n_joints} finite numbers (N m)")
        self._torque[0] = values
        moment = Clock(self.time, self.control_period / self.substeps, self.substeps)
        status, _, _ = self._run(self._torque, moment, self._row, self._rows, self._new_outputs)
        if status == layout.OK:
            self._periods += 1
            self.outputs[:] = self._new_outputs[0]
        else:
            self._row[:] = self._rows[0]
        self.status = STATUS[status]
        return self.status

    @property
    def time(self) -> float:
        """Seconds since the reset."""
        return self._periods * self.control_period

    @property
    def tip(self) -> Array:
        """(3,) tip position in the base frame, m."""
        return self.outputs[layout.TIP]

    @property
    def tip_velocity(self) -> Array:
        """(3,) tip velocity in the base frame, m/s."""
        return self.outputs[layout.TIP_VELOCITY]

    @property
    def deflection(self) -> Array:
        """(3,) tip relative to the tip of the rigid arm at the motor angles, m."""
        return self.outputs[layout.DEFLECTION]

    @property
    def deflection_rate(self) -> Array:
        """(3,) tip velocity relative to that of the rigid arm at the motor angles and rates, m/s."""
        return self.outputs[layout.DEFLECTION_RATE]

    @property
    def elastic_energy(self) -> float:
        """Elastic energy of links and joints, J."""
        return float(self.outputs[layout.LINK_ENERGY] + self.outputs[layout.JOINT_ENERGY])

    @property
    def energy(self) -> float:
        """Kinetic, elastic and gravitational energy, the last zero at the base origin, J."""
        return float(self.outputs[layout.KINETIC :].sum())

    @property
    def energy_residual(self) -> float:
        """Work of the motors - dissipation - change of energy since the reset, J."""
        return float(self._row[-2] - self._row[-1]) - (self.energy - self._start_energy)


def find_method(name: object) -> Method:
    """The method of that name; raises ValueError with the names there are."""
    return METHODS[one_of("method", name, METHODS)]


class _Run:
    """A method bound to a model and its work space."""

    def __init__(self, model: Model, method: Method, tolerance: tuple[float, float]) -> None:
        self.constants = model.constants
        self.work: Work = make_work(model.constants)
        self.tableau = method.tableau
        self.tolerance = np.array(tolerance)
        self.kind = method.kind

    def __call__(self, torque: Array, moment: Clock, state: Array, rows: Array, outputs: Array) -> tuple[int, int, int]:
        arguments = (self.constants, self.work, self.tableau, torque, moment, state, rows, outputs)
        if self.kind == EXPLICIT:
            return steppers.run_explicit(*arguments)
        if self.kind == LINEARLY_IMPLICIT:
            return steppers.run_linearly_implicit(*arguments)
        return steppers.run_adaptive(*arguments, self.tolerance)

    def start(self, state: Array, row: Array, outputs: Array) -> None:
        """Records the state as it is, by a run of no steps, which also loads or compiles the kernels."""
        at_rest = np.zeros((4, len(self.constants.mass)))
        self(at_rest, Clock(0.0, 0.0, 0), state, row[None], outputs[None])


def _whole(name: str, part: float, total: float, allowed: str) -> int:
    """total / part when that is a whole number."""
    ratio = total / positive(name, part, "s")
    count = round(ratio)
    if count < 1 or abs(ratio - count) > WHOLE * ratio:
        raise refusal(name, part, f"{allowed}, {total} s")
    return count


def _output_interval(method: Method, step: float | None, output_step: float) -> tuple[float, int]:
    """Time between outputs and the number of steps in it."""
    if step is None:
        if not method.adaptive:
            raise refusal("step", None, f"a number > 0 (s): {method.name} takes fixed steps")
        return output_step, 1
    allowed = "a number of seconds that divides, or is a multiple of, the output step"
    if method.adaptive:
        return output_step, max(1, round(output_step / positive("step", step, "s")))
    if positive("step", step, "s") <= output_step:
        return output_step, _whole("step", step, output_step, allowed)
    multiple = step / output_step
    if abs(multiple - round(multiple)) > WHOLE * multiple:
        raise refusal("step", step, f"{allowed}, {output_step} s")
    return step, 1


def _trajectory(
    model: Model, interval: float, states: Array, outputs: Array, outcome: tuple[str, int, float]
) -> Trajectory:
    size = 2 * model.n_dof
    return Trajectory(
        time=interval * np.arange(len(states), dtype=np.float64),
        tip=outputs[:, layout.TIP],
        tip_velocity=outputs[:, layout.TIP_VELOCITY],
        joint_angles=states[:, : model.n_joints],
        motor_angles=states[:, model.motor_columns],
        energy=outputs[:, layout.KINETIC :].sum(axis=1),
        work=states[:, size],
        dissipation=states[:, size + 1],
        states=states[:, :size],
        deflection=outputs[:, layout.DEFLECTION],
        status=outcome[0],
        evaluations=outcome[1],
        wall_seconds=outcome[2],
    )
