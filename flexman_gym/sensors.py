"""Sensors: what an agent sees of an arm, as named slices with units and bounds. Arrays have a leading batch axis b."""

from dataclasses import dataclass

import numpy as np

from flexman_gym.beam import Array
from flexman_gym.checks import positive, store
from flexman_gym.kernels import layout
from flexman_gym.model import Model

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
        motor_columns: (n,) columns of the motor angles in a state.
    """

    def __init__(self, model: Model, limits: Limits) -> None:
        n, d = model.n_joints, model.n_dof
        constants = model.constants
        reach = float(constants.length.sum())
        self.motor_columns = model.motor_columns
        bending = np.zeros((2 * d, 2 * n))
        for i in range(n):
            start, stop = constants.elastic_start[i : i + 2]
            bending[model.elastic_columns(i), 2 * i : 2 * i + 2] = constants.tip_translation[start:stop, 1:]
        angles = np.eye(2 * d)[:, self.motor_columns]
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
        self._from_state = np.hstack([part[0] for part in linear.values()])

    def read(self, states: Array, outputs: Array, postures: Array, targets: Array) -> Array:
        """Observations (b, size) of states (b, 2 d) with outputs (b, OUTPUTS) for goals (b, n) rad and (b, 3) m."""
        error = targets - outputs[:, layout.TIP]
        # the error again on a scale that still tells millimetres when normalised by the metres of a slew
        nearness = error / (NEAR + np.sqrt((error * error).sum(axis=1, keepdims=True)))
        parts = (
            states @ self._from_state,
            postures - states[:, self.motor_columns],
            error,
            nearness,
            outputs[:, layout.TIP_VELOCITY],
        )
        return np.concatenate(parts, axis=1)

    def broken(self, observation: Array) -> str:
        """The name of the first slice of one observation (size,) beyond its bound, with the value; "" if none is."""
        inside = np.abs(observation) <= self.bound
        if inside.all():
            return ""
        first = int(np.argmin(inside))
        name = next(name for name, part in self.slices.items() if first < part.stop)
        return f"{name} {observation[first]:.4g} {self.units[name]} beyond {self.bound[first]:.4g}"
