"""View: the motion and the goals of the arms of a batch as named arrays."""

from typing import Any

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.kernels import layout
from flexman_gym.kernels.outputs import combine
from flexman_gym.model.statics import rest_state, rest_tips
from flexman_gym.simulation.batch import Batch

Number = Any  # (b,), or a number of a single arm; only arithmetic and NumPy's functions are used on it


class View:
    """Motion and goals of b arms of n links. Arrays have the axis of the arms in front, (b, ...).

    `alone()` has the same names without that axis, and numbers in place of (b,). Code with `...` and `axis=-1` serves
    both. `read` brings everything up to date. Code that sets a goal writes into `posture`, `target` and `plan`; code
    that acts writes into `effort` and `failed`.

    Attributes:
        n_joints: n.
        reach: the sum of the lengths of the links, m.
        lengths: (n,) of the links, m.
        control_period: s.
        state: (b, 2 d) coordinates and speeds of the model, in the order of `kernels.layout`.
        motor_angles, motor_rates: (b, n) rad and rad/s; of the joint where it is rigid.
        joint_twists, joint_twist_rates: (b, n) motor angle - joint angle, rad, and its rate, rad/s.
        link_deflections, link_deflection_rates: (b, 2 n) of the tip of each link along y and z of its beam frame, m and
            m/s.
        tip, tip_velocity: (b, 3) in the base frame, m and m/s.
        deflection, deflection_rate: (b, 3) of the tip relative to that of the rigid arm at the motor angles, m and m/s.
        motion: (b, 8 n + 3) all quantities that may have a limit, side by side: the above from motor_angles to
            link_deflection_rates, then tip_velocity.
        places, units: name -> slice of `motion`, and unit.
        posture: (b, n) the goal of the motors, rad.
        target: (b, 3) the goal of the tip in the base frame, m.
        target_error: (b, 3) target - tip, m.
        plan: name -> (b, ...) further arrays that describe the episode; each task has its own.
        tip_error: (b,) distance of tip and target, m.
        tip_vibration: (b,) speed of the tip relative to that of the rigid arm at the motor angles and rates, m/s.
        elastic_energy: (b,) of links and joints, J.
        energy_residual, energy_turnover: (b,) J, see `Batch`.
        action: (b, n) what the motors were asked for in the last period, parts of the torque limits.
        effort: (b,) mean of the squared actions (parts of the torque limits) of the last period.
        failed: (b,) whether the last step ended the episode by a limit or a divergence.
    """

    kept = ("posture", "target", "plan", "effort", "action", "failed")

    def __init__(self, batch: Batch) -> None:
        model, constants, arms = batch.model, batch.model.constants, len(batch.rows)
        n, d = model.n_joints, model.n_dof
        self._batch = batch
        self._one: View | None = None
        self.n_joints, self.control_period = n, batch.control_period
        self.lengths, self.reach = constants.length, float(constants.length.sum())
        bending = np.zeros((2 * d, 2 * n))
        for i in range(n):
            start, stop = constants.elastic_start[i : i + 2]
            bending[model.elastic_columns(i), 2 * i : 2 * i + 2] = constants.tip_translation[start:stop, 1:]
        angles = np.eye(2 * d)[:, model.motor_columns]
        twist = angles - np.eye(2 * d)[:, :n]
        parts = {
            "motor_angles": (angles, "rad"),
            "motor_rates": (np.roll(angles, d, axis=0), "rad/s"),
            "joint_twists": (twist, "rad"),
            "joint_twist_rates": (np.roll(twist, d, axis=0), "rad/s"),
            "link_deflections": (bending, "m"),
            "link_deflection_rates": (np.roll(bending, d, axis=0), "m/s"),
        }
        self.units = {name: unit for name, (_, unit) in parts.items()} | {"tip_velocity": "m/s"}
        ends = np.cumsum([part.shape[1] for part, _ in parts.values()] + [3]).tolist()
        self.places = {name: slice(first, end) for name, first, end in zip(self.units, [0, *ends], ends, strict=False)}
        matrix = np.hstack([part for part, _ in parts.values()]).T  # most of it is zero
        self._start = np.append(0, np.cumsum(np.count_nonzero(matrix, axis=1)))
        self._source, self._value = np.nonzero(matrix)[1], matrix[matrix != 0.0]
        self._allocate(arms)

    def _allocate(self, arms: int) -> None:
        """Makes the arrays that `read` fills, and names their parts; outputs of the batch are views of its memory."""
        n, outputs = self.n_joints, self._batch.outputs
        self.motion = np.zeros((arms, self.places["tip_velocity"].stop))
        parts = {name: self.motion[:, place] for name, place in self.places.items()}
        self.motor_angles, self.motor_rates = parts["motor_angles"], parts["motor_rates"]
        self.joint_twists, self.joint_twist_rates = parts["joint_twists"], parts["joint_twist_rates"]
        self.link_deflections, self.link_deflection_rates = parts["link_deflections"], parts["link_deflection_rates"]
        self._velocity = parts["tip_velocity"]
        self.state = self._batch.state
        self.tip, self.tip_velocity = outputs[:, layout.TIP], outputs[:, layout.TIP_VELOCITY]
        self.deflection, self.deflection_rate = outputs[:, layout.DEFLECTION], outputs[:, layout.DEFLECTION_RATE]
        self.posture, self.target, self.plan = np.zeros((arms, n)), np.zeros((arms, 3)), dict[str, Array]()
        self._vectors = np.zeros((arms, 2, 3))  # their lengths are tip_error and tip_vibration
        self.target_error, self._shaking = self._vectors[:, 0], self._vectors[:, 1]
        self.tip_error: Number = np.zeros(arms)
        self.tip_vibration: Number = np.zeros(arms)
        self.elastic_energy: Number = np.zeros(arms)
        self.energy_residual: Number = np.zeros(arms)
        self.energy_turnover: Number = np.zeros(arms)
        self.effort: Number = np.zeros(arms)
        self.action = np.zeros((arms, n))
        self.failed: Number = np.zeros(arms, dtype=bool)

    def read(self) -> None:
        """Reads the present states of the arms, for their present goals."""
        batch = self._batch
        combine(batch.rows, self._start, self._source, self._value, self.motion)
        self._velocity[:] = self.tip_velocity
        np.subtract(self.target, self.tip, out=self.target_error)
        self._shaking[:] = self.deflection_rate
        lengths = np.sqrt(np.vecdot(self._vectors, self._vectors))
        self.tip_error, self.tip_vibration = lengths[:, 0], lengths[:, 1]
        self.elastic_energy = batch.outputs[:, layout.LINK_ENERGY] + batch.outputs[:, layout.JOINT_ENERGY]
        self.energy_residual, self.energy_turnover = batch.energy_residual, batch.energy_turnover

    @property
    def time(self) -> Number:
        """Time since the reset (b,), s."""
        time = self._batch.time
        return time if self.motion.ndim > 1 else time.item()

    def rest_states(self, postures: Array) -> Array:
        """Gives the states (r, 2 d) of the arm at rest, motors at angles (r, n) rad, bent by its weight alone."""
        model = self._batch.model
        if not model.constants.gravity.any():
            return model.at_rest(postures)
        return np.array([rest_state(model, angles) for angles in postures]).reshape(len(postures), -1)

    def rest_tips(self, postures: Array) -> Array:
        """Gives the tips (r, 3) of that arm in the base frame, m; without gravity those of the rigid arm."""
        model = self._batch.model
        if not model.constants.gravity.any():
            return self._batch.rigid_tips(model.at_rest(postures))
        return rest_tips(model, postures)

    def alone(self) -> "View":
        """Gives the present view of the only arm, without the axis of the arms; it is the same object every time.

        Raises:
            ValueError: for more than one arm.
        """
        one = self._one or self._make_alone()
        if len(one.plan) != len(self.plan):
            one.plan = {name: values[0, ...] for name, values in self.plan.items()}
        one.tip_error, one.tip_vibration = self.tip_error.item(), self.tip_vibration.item()
        one.elastic_energy, one.energy_residual = self.elastic_energy.item(), self.energy_residual.item()
        one.energy_turnover, one.effort, one.failed = (
            self.energy_turnover.item(), self.effort.item(), self.failed.item(),
        )  # fmt: skip
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
