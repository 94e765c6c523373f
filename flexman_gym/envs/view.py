"""View: named arrays of the state of many arms, the only input of sensors, tasks and limits."""

from collections.abc import Iterable
from functools import cached_property
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.kernels import layout
from flexman_gym.kernels.control_period import fill_views, sparse_product
from flexman_gym.kernels.rigid_arm import inverse_kinematics
from flexman_gym.model.deformation import gauge_radii
from flexman_gym.model.dynamics import frequencies
from flexman_gym.model.linearization import MEASUREMENT_UNITS, LinearMeasurements
from flexman_gym.model.statics import rest_states, rest_tips
from flexman_gym.simulation.batch import Batch

REACHED, SLOPE = 1e-9, 1e-4  # of the reach: a place that is reached; slopes of the tip that turn no joint
Number = Any  # (b,), or a number of a single arm; only arithmetic and NumPy's functions are used on it


class View:
    """Motion and goals of b arms of n links. Arrays have the axis of the arms in front, (b, ...).

    `alone()` has the same names without that axis, and numbers in place of (b,). Code with `...` and `axis=-1` serves
    both. `read` brings everything up to date. Code that sets a goal writes into `goal_angles`, `target` and `plan`,
    code that acts into `effort` and `failed`.

    Attributes:
        n_joints: n.
        reach: the sum of the lengths of the links, m.
        lengths: (n,) of the links, m.
        heavy: whether the arm has weight.
        gauge_radii: (n, 3) distances of the gauges of `root_strains` from the axis of the link, m.
        control_period: s.
        state: (b, 2 d) coordinates and speeds of the model, in the order of `kernels.layout`.
        joint_angles: (b, n) rad, of the side of the links.
        joint_rates: (b, n) rad/s, of the side of the links.
        motor_angles: (b, n) rad; of the joint where it is rigid.
        motor_rates: (b, n) rad/s; of the joint where it is rigid.
        joint_twists: (b, n) motor angle - joint angle, rad.
        joint_twist_rates: (b, n) its rate, rad/s.
        link_deflections: (b, 2 n) of the tip of each link along y and z of its beam frame, m.
        link_deflection_rates: (b, 2 n) its rate, m/s.
        tip: (b, 3) in the base frame, m.
        tip_velocity: (b, 3) in the base frame, m/s.
        deflection: (b, 3) of the tip relative to that of the rigid arm at the motor angles, m.
        deflection_rate: (b, 3) its rate, m/s.
        motion: (b, 8 n + 3) all quantities that may have a limit, side by side: the above from motor_angles to
            link_deflection_rates, then tip_velocity.
        places: name -> slice of `motion`.
        units: name -> unit, of all quantities that an instrument may measure.
        goal_angles: (b, n) the goal of the motors, rad.
        goal_rates: (b, n) how fast it moved in the last control period, rad/s.
        target: (b, 3) the goal of the tip in the base frame, m.
        target_velocity: (b, 3) of a target that moves, over the last control period, m/s.
        target_error: (b, 3) target - tip, m.
        plan: name -> (b, ...) further arrays that describe the episode; each task has its own.
        tip_error: (b,) distance of tip and target, m.
        tip_vibration: (b,) speed of the tip relative to that of the rigid arm at the motor angles and rates, m/s.
        elastic_energy: (b,) of links and joints, J.
        energy_residual: (b,) J, see `Batch`.
        energy_turnover: (b,) J, see `Batch`.
        action: (b, n) what the motors were asked for in the last period, parts of the torque limits.
        effort: (b,) mean of the squared actions (parts of the torque limits) of the last period.
        failed: (b,) whether the last step ended the episode by a limit or a divergence.
    """

    state_fields = ("goal_angles", "goal_rates", "target", "target_velocity", "plan", "effort", "action", "failed")

    def __init__(self, batch: Batch) -> None:
        model, constants, arms = batch.model, batch.model.constants, len(batch.rows)
        self._batch = batch
        self._one: View | None = None
        self.n_joints, self.control_period = model.n_joints, batch.control_period
        self.lengths, self.reach = constants.length, float(constants.length.sum())
        self.heavy = bool(constants.gravity.any())
        self.gauge_radii = gauge_radii(model)
        self._readings = LinearMeasurements(model)
        end = 8 * self.n_joints
        self.places = self._readings.places | {"tip_velocity": slice(end, end + 3)}
        self.units = MEASUREMENT_UNITS | {
            "joint_angles": "rad", "joint_rates": "rad/s", "tip": "m", "tip_velocity": "m/s", "deflection": "m",
            "deflection_rate": "m/s", "tip_acceleration": "m/s^2", "specific_force": "m/s^2",
        }  # fmt: skip
        self._allocate(arms)

    def _allocate(self, arms: int) -> None:
        """Makes the arrays that `read` fills, and names their parts; outputs of the batch are views of its memory."""
        n, outputs = self.n_joints, self._batch.outputs
        self.motion = np.zeros((arms, self.places["tip_velocity"].stop))
        parts = {name: self.motion[:, place] for name, place in self.places.items()}
        self.motor_angles, self.motor_rates = parts["motor_angles"], parts["motor_rates"]
        self.joint_twists, self.joint_twist_rates = parts["joint_twists"], parts["joint_twist_rates"]
        self.link_deflections, self.link_deflection_rates = parts["link_deflections"], parts["link_deflection_rates"]
        self.state, d = self._batch.state, self._batch.model.n_dof
        self.joint_angles, self.joint_rates = self.state[:, :n], self.state[:, d : d + n]
        self.tip, self.tip_velocity = outputs[:, layout.TIP], outputs[:, layout.TIP_VELOCITY]
        self.deflection, self.deflection_rate = outputs[:, layout.DEFLECTION], outputs[:, layout.DEFLECTION_RATE]
        self.goal_angles, self.target, self.plan = np.zeros((arms, n)), np.zeros((arms, 3)), dict[str, Array]()
        self.goal_rates, self.target_velocity = np.zeros((arms, n)), np.zeros((arms, 3))
        self._vectors = np.zeros((arms, 2, 3))  # with the deflection rate; their lengths: tip_error and tip_vibration
        self.target_error = self._vectors[:, 0]
        self._numbers = np.zeros((5, arms))
        self._name(self._numbers)
        self.effort: Number = np.zeros(arms)
        self.action = np.zeros((arms, n))
        self.failed: Number = np.zeros(arms, dtype=bool)

    def read(self) -> None:
        """Reads the present states of the arms, for their present goals."""
        batch = self._batch
        self._numbers = np.empty((5, len(self.motion)))
        fill_views(
            batch.rows, batch.outputs, batch.start_energy, batch.energy_turnover, self.target, self._readings.motion,
            self.motion, self._vectors, self._numbers,
        )  # fmt: skip
        self._name(self._numbers)

    def _name(self, numbers: Iterable[Number]) -> None:
        """Gives their names to what `fill_views` has put side by side."""
        (self.tip_error, self.tip_vibration, self.elastic_energy, self.energy_residual, self.energy_turnover) = numbers

    @property
    def root_strains(self) -> Array:
        """Strains (b, 3 n) at the root of each link, see `model.deformation.root_strain_matrix`; worked out when asked for."""
        result = np.zeros((len(self._batch.rows), 3 * self.n_joints))
        sparse_product(self._batch.rows, *self._readings.strains, result)
        return result if self.motion.ndim > 1 else result[0]

    @property
    def tip_acceleration(self) -> Array:
        """Acceleration of the tip (b, 3) in the base frame, m/s^2, see `Batch.tip_accelerations`; for who asks."""
        return self._felt(layout.TIP_ACCELERATION)

    @property
    def specific_force(self) -> Array:
        """What an accelerometer fixed to the tip shows, (b, 3) m/s^2, see `Batch.tip_accelerations`; for who asks."""
        return self._felt(layout.SPECIFIC_FORCE)

    def _felt(self, columns: slice) -> Array:
        result = self._batch.tip_accelerations()[:, columns]
        return result if self.motion.ndim > 1 else result[0]

    @property
    def time(self) -> Number:
        """Time since the reset (b,), s."""
        time = self._batch.time
        return time if self.motion.ndim > 1 else time.item()

    def rest_states(self, postures: Array) -> Array:
        """Gives the states (r, 2 d) of the arm at rest, motors at angles (r, n) rad, bent by its weight alone."""
        return rest_states(self._batch.model, postures)

    def rigid_tips(self, postures: Array) -> Array:
        """Gives the tips (r, 3) of the undeformed arm at postures (r, n) rad, base frame, m."""
        return self._batch.rigid_tips(self._batch.model.at_rest(postures))

    def reaching(self, tips: Array, near: Array) -> tuple[Array, float]:
        """Gives motor angles (r, n) rad at which the tip of the undeformed arm is at tips (r, 3) m, base frame.

        Args:
            tips: where it should be.
            near: motor angles (n,) rad from which the search starts.

        Returns:
            The angles, and the largest distance that is left (m).
        """
        constants, n = self._batch.model.constants, self.n_joints
        result, x = np.repeat(near[None], len(tips), axis=0), np.zeros(self._batch.model.n_dof)
        accuracy, damping = REACHED * self.reach, SLOPE * self.reach
        left = inverse_kinematics(constants, np.ascontiguousarray(tips), x, np.zeros((n, 3)), accuracy, damping, result)
        return result, left

    def rest_tips(self, postures: Array) -> Array:
        """Gives the tips (r, 3) of that arm in the base frame, m; without gravity those of the rigid arm."""
        model = self._batch.model
        if not self.heavy:
            return self.rigid_tips(postures)
        return rest_tips(model, postures)

    @cached_property
    def first_frequency(self) -> float:
        """Lowest natural frequency (Hz) at zero angles with the motors held; infinite where nothing bends."""
        result = frequencies(self._batch.model, lock_joints=True)
        return float(result[0]) if len(result) else np.inf

    def alone(self) -> "View":
        """Gives the present view of the only arm, without the axis of the arms; it is the same object every time.

        Raises:
            ValueError: for more than one arm.
        """
        one = self._one or self._make_alone()
        if len(one.plan) != len(self.plan):
            one.plan = {name: values[0, ...] for name, values in self.plan.items()}
        one._name(self._numbers[:, 0].tolist())
        one.effort, one.failed = self.effort.item(), self.failed.item()
        return one

    def renew(self) -> None:
        """Reads everything anew, after what the view keeps was given back."""
        self._one = None
        self.read()

    def _make_alone(self) -> "View":
        """Makes the view of the only arm; its arrays share the memory of this view."""
        if len(self.motion) > 1:
            raise ValueError(f"view: {len(self.motion)} arms are not allowed; give the view of one")
        self._one = one = object.__new__(View)
        for name, value in vars(self).items():
            setattr(one, name, value[0] if isinstance(value, np.ndarray) and value.ndim > 1 else value)
        one.plan = {}
        return one
