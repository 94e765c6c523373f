"""View: named arrays of the state of b arms, the input of sensors, tasks and limits."""

from collections.abc import Iterable
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.envs.postures import PostureRanges
from flexman_gym.kernels import layout
from flexman_gym.kernels.control_period import fill_views, sparse_product
from flexman_gym.kernels.rigid_arm import inverse_kinematics as solve_inverse_kinematics
from flexman_gym.model.deformation import gauge_radii
from flexman_gym.model.dynamics import frequencies
from flexman_gym.model.linearization import MEASUREMENT_UNITS, LinearMeasurements
from flexman_gym.model.model import Model
from flexman_gym.model.statics import rest_state, rest_tips
from flexman_gym.simulation.batch import Batch

SLEW_TIME = 3.2  # s; slew time of the named environments, the median of the slews of FlexRRR-v0
TIP_TOLERANCE = 1e-9  # fraction of the reach; accepted tip error of the inverse kinematics
DAMPED_SINGULAR_VALUE = 1e-4  # fraction of the reach; damping factor of the damped least-squares inverse kinematics
Number = Any  # array (b,), or a number for a single arm; supports arithmetic and the functions of NumPy


class View:
    """State and goals of b arms with n links, as named arrays (b, ...).

    `single()` returns the view of a single arm: its arrays lack the axis of the arms, and arrays (b,) are numbers. Code
    with `...` and `axis=-1` works on both views. `read` computes all arrays from the current state. The environment
    writes `goal_angles`, `target` and `episode_parameters`, and after each step `action`, `effort` and `failed`.

    Attributes:
        n_joints: number of joints n.
        reach: sum of the lengths of the links, m.
        lengths: (n,) lengths of the links, m.
        postures: ranges of the joint angles and the posture in their middle, see `PostureRanges`.
        foundation: moving foundations of the arms, see `envs.foundation`; None for fixed ones.
        gear_ratios: (n,) turns of the motor shaft per turn of the joint; 1 for a joint without a `Motor`.
        has_gravity: True for an arm under gravity.
        gauge_radii: (n, 3) distances of the gauges of `root_strains` from the axis of the link, m.
        control_period: time between two commands, s.
        slew_time: time of a usual slew, s; the distance reward relates velocities to it.
        state: (b, 2 d) generalised coordinates and their rates, in the order of `kernels.layout`.
        joint_angles: (b, n) angles of the link side of the joints, rad.
        joint_rates: (b, n) rates of the joint angles, rad/s.
        motor_angles: (b, n) angles of the rotors after the gears, rad; equal to the joint angles for rigid and
            passive joints.
        motor_rates: (b, n) rates of the motor angles, rad/s.
        joint_twists: (b, n) elastic deflections of the joints: motor angles minus link-side angles, rad.
        joint_twist_rates: (b, n) rates of the joint twists, rad/s.
        link_deflections: (b, 2 n) displacement of the tip of each link along y and z of its beam frame, m.
        link_deflection_rates: (b, 2 n) rates of the link deflections, m/s.
        tip: (b, 3) position of the tip in the base frame, m.
        tip_velocity: (b, 3) velocity of the tip in the base frame, m/s.
        deflection: (b, 3) displacement of the tip from the tip of the rigid arm at the same motor angles, m.
        deflection_rate: (b, 3) rate of the deflection, m/s.
        motion: (b, 8 n + 3) all quantities with limits, concatenated: from motor_angles to link_deflection_rates in the
            order above, then tip_velocity.
        slices: name of a quantity -> its slice of `motion`.
        units: name of each quantity that an instrument can measure -> its unit.
        goal_angles: (b, n) goal of the motor angles, rad.
        goal_rates: (b, n) mean rate of the goal angles in the last control period, rad/s.
        target: (b, 3) goal of the tip in the base frame, m.
        target_velocity: (b, 3) mean velocity of the target in the last control period, m/s.
        target_error: (b, 3) target - tip, m.
        episode_parameters: name -> (b, ...) parameters of the episode, drawn by the task, such as start and goal.
        tip_error: (b,) distance of tip and target, m.
        tip_vibration: (b,) magnitude of the deflection rate, m/s: the speed of the tip relative to the tip of a rigid
            arm.
        elastic_energy: (b,) elastic energy of links and joints, J.
        energy_residual: (b,) work - dissipation - change of energy since the reset, J, see `Batch`.
        energy_turnover: (b,) largest of kinetic + elastic energy, |work| and |dissipation| since the reset, J: the
            scale for `energy_residual`.
        action: (b, n) commanded torques of the last control period, as fractions of the torque limits.
        effort: (b,) mean square of the n commanded torques / limits of the last control period, from 0 to 1.
        failed: (b,) True if the arm exceeded a limit or its simulation diverged in the last step.
    """

    state_fields = (
        "goal_angles",
        "goal_rates",
        "target",
        "target_velocity",
        "episode_parameters",
        "effort",
        "action",
        "failed",
    )

    def __init__(self, batch: Batch, slew_time: float = SLEW_TIME) -> None:
        model, constants, arms = batch.model, batch.model.constants, len(batch.rows)
        self._batch = batch
        self._one: View | None = None
        self.foundation: Any = None
        self._springs: tuple[Array, Array, Array] | None = None  # see `Batch.spring_constants`
        self.n_joints, self.control_period, self.slew_time = model.n_joints, batch.control_period, slew_time
        self.lengths, self.reach = constants.length, float(constants.length.sum())
        self.postures = PostureRanges.of(model.arm)
        self.gear_ratios = np.array([each.motor.gear_ratio if each.motor else 1.0 for each in model.arm.joints])
        self.has_gravity = bool(constants.gravity.any())
        self.gauge_radii = gauge_radii(model)
        self._measurements = LinearMeasurements(model)
        end = 8 * self.n_joints
        self.slices = self._measurements.columns | {"tip_velocity": slice(end, end + 3)}
        self.units = MEASUREMENT_UNITS | {
            "joint_angles": "rad", "joint_rates": "rad/s", "tip": "m", "tip_velocity": "m/s", "deflection": "m",
            "deflection_rate": "m/s", "tip_acceleration": "m/s^2", "specific_force": "m/s^2",
        }  # fmt: skip
        self._allocate(arms)

    def _allocate(self, arms: int) -> None:
        """Allocate the arrays filled by `read`, and set attributes to their parts or to parts of the batch's arrays."""
        n, outputs = self.n_joints, self._batch.outputs
        self.motion = np.zeros((arms, self.slices["tip_velocity"].stop))
        parts = {name: self.motion[:, columns] for name, columns in self.slices.items()}
        self.motor_angles, self.motor_rates = parts["motor_angles"], parts["motor_rates"]
        self.joint_twists, self.joint_twist_rates = parts["joint_twists"], parts["joint_twist_rates"]
        self.link_deflections, self.link_deflection_rates = parts["link_deflections"], parts["link_deflection_rates"]
        self.state, d = self._batch.state, self._batch.model.n_dof
        self.joint_angles, self.joint_rates = self.state[:, :n], self.state[:, d : d + n]
        self.tip, self.tip_velocity = outputs[:, layout.TIP], outputs[:, layout.TIP_VELOCITY]
        self.deflection, self.deflection_rate = outputs[:, layout.DEFLECTION], outputs[:, layout.DEFLECTION_RATE]
        self.goal_angles, self.target, self.episode_parameters = (
            np.zeros((arms, n)),
            np.zeros((arms, 3)),
            dict[str, Array](),
        )
        self.goal_rates, self.target_velocity = np.zeros((arms, n)), np.zeros((arms, 3))
        self._vectors = np.zeros((arms, 6))  # target error and deflection rate of each arm
        self.target_error = self._vectors[:, :3]
        self._numbers = np.zeros((5, arms))
        self._name(self._numbers)
        self.effort: Number = np.zeros(arms)
        self.action = np.zeros((arms, n))
        self.failed: Number = np.zeros(arms, dtype=bool)

    def read(self) -> None:
        """Compute all quantities from the current states and goals."""
        batch = self._batch
        if len(self.motion) > 1:  # the info of several arms holds the last ones
            self._numbers = np.empty((5, len(self.motion)))
        fill_views(
            batch.rows, batch.outputs, batch.start_energy, batch.energy_turnover, self.target,
            self._measurements.motion, self.motion, self._vectors, self._numbers,
        )  # fmt: skip
        self._name(self._numbers)

    def period_arrays(self) -> dict[str, Any]:
        """Return the arrays of a single arm by their names in `kernels.layout.Period`."""
        start, source, value = self._measurements.motion
        return {
            "requested": self.action, "efforts": self.effort, "target": self.target, "reading_start": start,
            "reading_source": source, "reading_value": value, "motion": self.motion, "vectors": self._vectors,
            "scalars": self._numbers, "motor_angles": self.motor_angles, "tip_velocity": self.tip_velocity,
            "goal_angles": self.goal_angles, "target_error": self.target_error, "tip_error": self._numbers[0],
            "tip_vibration": self._numbers[1],
        }  # fmt: skip

    def _name(self, numbers: Iterable[Number]) -> None:
        """Set tip_error, tip_vibration, elastic_energy, energy_residual and energy_turnover from rows (5, b)."""
        (self.tip_error, self.tip_vibration, self.elastic_energy, self.energy_residual, self.energy_turnover) = numbers

    @property
    def span(self) -> float:
        """Reach, and largest distance of a moving base from its middle, m."""
        return self.reach if self.foundation is None else self.reach + float(self.foundation.settings.range)

    @property
    def root_strains(self) -> Array:
        """Strains (b, 3 n), m/m, at the root of each link, computed at each access; see `deformation.root_gauges`."""
        result = np.zeros((len(self._batch.rows), 3 * self.n_joints))
        sparse_product(self._batch.rows, *self._measurements.strains, result)
        return result if self.motion.ndim > 1 else result[0]

    @property
    def spring_torques(self) -> Array:
        """Torques (b, n) of the joint springs, N m, computed at each access; 0 for rigid joints."""
        if self._springs is None:
            self._springs = self._batch.spring_constants()
        result = _spring_torques(self._batch.model, *self._springs, np.atleast_2d(self.joint_twists))
        return result if self.motion.ndim > 1 else result[0]

    @property
    def tip_acceleration(self) -> Array:
        """Acceleration (b, 3) of the tip in the base frame, m/s^2, computed at each access by `Batch`."""
        return self._accelerations(layout.TIP_ACCELERATION)

    @property
    def specific_force(self) -> Array:
        """Specific force (b, 3) in the tip frame, m/s^2: reading of an accelerometer; computed at each access."""
        return self._accelerations(layout.SPECIFIC_FORCE)

    def _accelerations(self, columns: slice) -> Array:
        result = self._batch.tip_accelerations()[:, columns]
        return result if self.motion.ndim > 1 else result[0]

    @property
    def time(self) -> Number:
        """Time since the reset (b,), s."""
        time = self._batch.time
        return time if self.motion.ndim > 1 else time.item()

    def rest_states(self, postures: Array) -> Array:
        """Return the equilibrium states (r, 2 d) of the arm at rest under gravity at motor angles (r, n), rad."""
        return rest_state(self._batch.model, postures)

    def hanging(self, postures: Array) -> Array:
        """Return angles (r, n) of motors and passive joints at rest under gravity, for motor angles (r, n), rad."""
        model = self._batch.model
        if not model.constants.passive.any():
            return postures
        result: Array = self.rest_states(postures)[:, model.motor_columns]
        return result

    def rigid_tips(self, postures: Array) -> Array:
        """Return the tip positions (r, 3), m, base frame, of the undeformed arm at joint angles (r, n), rad.

        The motor angles of the undeformed arm equal the joint angles.
        """
        return self._batch.rigid_tips(self._batch.model.at_rest(postures))

    def inverse_kinematics(self, tips: Array, near: Array) -> tuple[Array, float]:
        """Solve the inverse kinematics of the undeformed arm.

        Args:
            tips: (r, 3) positions of the tip in the base frame, m.
            near: (n,) initial motor angles of the iteration, rad.

        Returns:
            Motor angles (r, n), rad, and the largest distance of a tip from its given position, m.
        """
        constants, n = self._batch.model.constants, self.n_joints
        result, x = np.repeat(near[None], len(tips), axis=0), np.zeros(self._batch.model.n_dof)
        accuracy, damping = TIP_TOLERANCE * self.reach, DAMPED_SINGULAR_VALUE * self.reach
        jacobian = np.zeros((n, 3))
        distance = solve_inverse_kinematics(
            constants, np.ascontiguousarray(tips), x, jacobian, accuracy, damping, result
        )
        return result, distance

    def rest_tips(self, postures: Array) -> Array:
        """Return the tip positions (r, 3), m, of the arm at rest under gravity at motor angles (r, n), rad."""
        return rest_tips(self._batch.model, postures) if self.has_gravity else self.rigid_tips(postures)

    @cached_property
    def first_frequency(self) -> float:
        """Lowest natural frequency, Hz, at zero angles with locked motors; infinite for a rigid arm."""
        result = frequencies(self._batch.model, lock_joints=True)
        return float(result[0]) if len(result) else np.inf

    def single(self) -> "View":
        """Return the view of a single arm, without the axis of the arms; each call returns the same object.

        Raises:
            ValueError: if there is more than one arm.
        """
        one = self._one or self._make_single()
        if len(one.episode_parameters) != len(self.episode_parameters):
            one.episode_parameters = {name: values[0, ...] for name, values in self.episode_parameters.items()}
        one._name(self._numbers[:, 0].tolist())
        one.effort, one.failed = self.effort.item(), self.failed.item()
        return one

    def refresh(self) -> None:
        """Compute all quantities again after the state or parameters of the batch were replaced."""
        self._one = self._springs = None
        self.read()

    def _make_single(self) -> "View":
        """Return a view of the only arm, with arrays that share the memory of this view."""
        if len(self.motion) > 1:
            raise ValueError(f"view: {len(self.motion)} arms are not allowed; give the view of one")
        self._one = one = object.__new__(View)
        for name, value in vars(self).items():
            setattr(one, name, value[0] if isinstance(value, np.ndarray) and value.ndim > 1 else value)
        one.episode_parameters = {}
        return one


def _spring_torques(model: Model, stiffness: Array, knees: Array, shares: Array, twists: Array) -> Array:
    """Return the torques (b, n) of the joint springs of b arms at twists (b, n), as `kernels.forces.spring_torque`."""
    result = stiffness * twists
    for i, (start, stop) in enumerate(pairwise(model.constants.knee_start.tolist())):
        if stop > start:
            width, places, twist = model.constants.knee_width[i], knees[:, start:stop], twists[:, i : i + 1]
            above, below = (_ramp(each - places, width) for each in (twist, -twist))
            result[:, i] = stiffness[:, i] * np.sum(shares[:, start:stop] * (above - below), axis=1)
    return result


def _ramp(values: Array, width: float) -> Array:
    """Return the rounded ramp of `kernels.forces._ramp`."""
    return (np.clip(values, -width, width) + width) ** 2 / (4.0 * width) + np.maximum(values, width) - width
