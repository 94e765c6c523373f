"""Sensors: what an agent sees of an arm, as named slices with units and bounds. Arrays have a leading batch axis b."""

from dataclasses import dataclass

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.checks import positive, store
from flexman_gym.kernels import layout
from flexman_gym.kernels.outputs import combine
from flexman_gym.model.model import Model

MOVING = slice(layout.TIP_VELOCITY.start, layout.DEFLECTION_RATE.stop)
NEAR = 0.1  # m of tip error that is half of the way to the largest nearness


@dataclass(frozen=True)
class Limits:
    """How far an arm may move; an episode ends when it goes further. Beyond them the model, too, loses its meaning.

    Attributes:
        angle: of a motor, rad.
        rate: of a motor, rad/s.
        twist: of a joint spring (motor angle - joint angle), rad; its rate may be `rate`.
        deflection: of a link's tip, as a part of the link's length.
        deflection_rate: of a link's tip, m/s.
        tip_speed: m/s.

    Raises:
        ValueError: for a limit that is not a finite number > 0.
    """

    angle: float = 4.0
    rate: float = 10.0
    twist: float = 1.0
    deflection: float = 0.25
    deflection_rate: float = 15.0
    tip_speed: float = 40.0

    def __post_init__(self) -> None:
        store(self, **{name: positive(f"Limits.{name}", value) for name, value in vars(self).items()})


class FullState:
    """The whole mechanical state in physical quantities whose number does not depend on the fidelity of the model.

    Attributes:
        slices: name -> slice of the observation.
        units: name -> unit.
        bound: (size,) largest magnitude of each entry.
        observations: (b, size) of the last reading, which the next one overwrites.
        tip_error: (b,) distance of tip and target in the last reading, m.
        tip_vibration: (b,) speed of the tip relative to that of the rigid arm at the motor angles and rates, m/s.
    """

    def __init__(self, model: Model, limits: Limits, arms: int = 1) -> None:
        n, d = model.n_joints, model.n_dof
        constants = model.constants
        reach = float(constants.length.sum())
        bending = np.zeros((2 * d, 2 * n))
        for i in range(n):
            start, stop = constants.elastic_start[i : i + 2]
            bending[model.elastic_columns(i), 2 * i : 2 * i + 2] = constants.tip_translation[start:stop, 1:]
        angles = np.eye(2 * d)[:, model.motor_columns]
        twist = angles - np.eye(2 * d)[:, :n]
        linear = {
            "motor_angles": (angles, "rad", limits.angle),
            "motor_rates": (np.roll(angles, d, axis=0), "rad/s", limits.rate),
            "joint_twists": (twist, "rad", limits.twist),
            "joint_twist_rates": (np.roll(twist, d, axis=0), "rad/s", limits.rate),
            "link_deflections": (bending, "m", limits.deflection * np.repeat(constants.length, 2)),
            "link_deflection_rates": (np.roll(bending, d, axis=0), "m/s", limits.deflection_rate),
        }
        goal = {
            "posture_errors": (n, "rad", 2 * limits.angle),
            "target_error": (3, "m", 2 * reach),
            "target_nearness": (3, "1", 1.0),
            "tip_velocity": (3, "m/s", limits.tip_speed),
        }
        sizes = {name: part[0].shape[1] for name, part in linear.items()} | {
            name: part[0] for name, part in goal.items()
        }
        ends = np.cumsum(list(sizes.values()))
        self.slices = {
            name: slice(int(end) - size, int(end)) for (name, size), end in zip(sizes.items(), ends, strict=True)
        }
        self.units = {name: part[1] for name, part in (linear | goal).items()}
        bounds = [np.ones(sizes[name]) * np.asarray(part[2]) for name, part in (linear | goal).items()]
        self.bound: Array = np.concatenate(bounds)
        from_state = np.hstack([part[0] for part in linear.values()] + [-angles]).T  # most of it is zero
        self._start = np.append(0, np.cumsum(np.count_nonzero(from_state, axis=1)))
        self._source, self._value = np.nonzero(from_state)[1], from_state[from_state != 0.0]
        self._allocate(arms)

    def _allocate(self, arms: int) -> None:
        """Space of a reading, and the views of it that `read` fills."""
        size, motion = len(self.bound), len(self._start) - 1
        # an observation ends with the tip's velocity; its deflection and the rate of that follow it as in the outputs
        row = np.zeros((arms, size + 6))
        self.observations = row[:, :size]
        self._row, self._postures = row, row[:, self.slices["posture_errors"]]
        self._error, self._near = row[:, self.slices["target_error"]], row[:, self.slices["target_nearness"]]
        self._moving = row[:, size - 3 :]
        self._lengths = row[:, motion:].reshape(arms, 5, 3)[:, ::4]  # error and rate of deflection
        self.tip_error, self.tip_vibration = np.zeros(arms), np.zeros(arms)

    def read(self, states: Array, outputs: Array, postures: Array, targets: Array) -> None:
        """Reads states (b, 2 d), or with a ledger, and outputs (b, OUTPUTS) for goals (b, n) rad and (b, 3) m."""
        combine(states, self._start, self._source, self._value, self._row)
        self._postures += postures
        np.subtract(targets, outputs[:, layout.TIP], out=self._error)
        self._moving[:] = outputs[:, MOVING]
        lengths = np.sqrt(np.vecdot(self._lengths, self._lengths))
        # the error again on a scale that still tells millimetres when normalised by the metres of a slew
        np.divide(self._error, lengths[:, :1] + NEAR, out=self._near)
        self.tip_error, self.tip_vibration = lengths[:, 0], lengths[:, 1]

    def broken(self, observation: Array) -> str:
        """The name of the first slice of one observation (size,) beyond its bound, with the value; "" if none is."""
        inside = np.abs(observation) <= self.bound
        if inside.all():
            return ""
        first = int(np.argmin(inside))
        name = next(name for name, part in self.slices.items() if first < part.stop)
        return f"{name} {observation[first]:.4g} {self.units[name]} beyond {self.bound[first]:.4g}"
