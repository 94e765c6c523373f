"""Times and rates of an arm, from which weights and references of its controllers follow."""

from typing import NamedTuple, Self

import numpy as np

from flexman_gym.agent.controller import Plant
from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import one_of
from flexman_gym.envs.config.arm_settings import PEAK_ACCELERATION, PEAK_RATE, motor_speeds, slew_inertia
from flexman_gym.model.model import Model
from flexman_gym.model.statics import holding_torques
from flexman_gym.toolbox.controllers.excited_modes import excited_modes

DESIGNS = ("arm", "named")  # origins of weights, payload nodes, and bounds and times of references
POSTURE = 0.4  # rad; angle of each motor at which the scales are computed
CHANGE = 0.46  # rad; root mean square of the changes of motor angles from -0.8 to 0.8 rad, all equally likely
TORQUE_FRACTION, LEAST_FRACTION = 0.95, 0.05  # fractions of the torque limits: of a slew with its weight, beside weight
SPEED_FRACTION, RATE_FRACTION = 0.85, 0.6  # largest planned rate / largest speed of a motor, / limit of motor rates
RINGING_AMPLITUDE = 0.1  # fraction of the largest tip amplitude of a mode; smaller ones do not ring
PENDULUM_RATIO = 0.9  # fraction of the lowest frequency with held motors; slower modes of free motors: pendulum motion
# Shortest slew / period of the first mode that rings: SHORTEST_FACTOR / torque ratio, within SHORTEST_RANGE. At 1.6
# periods a minimum-jerk motion leaves no vibration of held motors. Weak motors do not excite that much, and the
# regulator damps the rest: with 1.6 periods for every arm, FlexRRR-v0 settles in 4.5 s instead of 3.0 s.
SHORTEST_FACTOR, SHORTEST_RANGE = 0.55, (0.7, 1.6)
NAMED_SLEW = 3.0  # s; duration of a slew of the arm of FlexRRR-v0, by which the design "named" chooses durations
UNITS_PER_SLEW = 150  # time units of adaptation in a slew; one is a whole number of control periods, at least one


class SlewBounds(NamedTuple):
    """Bounds of planned slews.

    Attributes:
        limits: (n,) torque limits, N m.
        fraction: fraction of the limits available to a slew; the remainder is reserved for feedback.
        rates: (n,) largest rates of the joints, rad/s.
        vibrations: shortest duration, in periods of the first mode that rings at the goal.
        free: period of the first mode with free motors, s, for time-optimal slews, see `free_period`.
    """

    limits: Vector
    fraction: float
    rates: Array | float = np.inf
    vibrations: float = 0.0
    free: float = 0.0

    def time_optimal(self, model: Model) -> Self:
        """Return the bounds of time-optimal slews of a model."""
        return self._replace(free=free_period(model, np.full(model.n_joints, POSTURE)))

    def shortest(self, model: Model, goal: Array) -> float:
        """Return the shortest duration of a slew to motor angles (n,) rad, s."""
        return self.vibrations * ringing_period(model, goal) if self.vibrations else 0.0


class ArmScales(NamedTuple):
    """Times and rates of an arm.

    Attributes:
        rates: (n,) largest planned rates of the joints, rad/s.
        vibration: period of the first mode with held motors that rings at the tip, s; 0 for an arm without such a mode.
        torque_slew: duration of a slew at the torque limits, s.
        named: True for the design "named": fixed weights, slews bounded by torques only, and gains at three payloads.
            It is tuned for the arms of the named environments, and policies that were trained on it need it.
        named_unit: time unit of adaptation in the design "named", s; 0 for a control period.
    """

    rates: tuple[float, ...]
    vibration: float = 0.0
    torque_slew: float = 0.0
    named: bool = False
    named_unit: float = 0.0

    @classmethod
    def of(cls, model: Model, limits: Vector, rate_limit: float = np.inf) -> Self:
        """Return the scales of an arm.

        Args:
            model: model of the arm.
            limits: (n,) torque limits, N m.
            rate_limit: largest motor rate in the environment, rad/s.
        """
        speeds = [np.inf if speed is None else speed for speed in motor_speeds(model.arm)]
        rates = np.minimum(SPEED_FRACTION * np.array(speeds, dtype=float), RATE_FRACTION * rate_limit)
        posture, torques = np.full(model.n_joints, POSTURE), np.asarray(limits, dtype=float)
        duration = _torque_slew(model, torques, posture)
        return cls(tuple(rates.tolist()), ringing_period(model, posture), duration)

    @classmethod
    def of_plant(cls, plant: Plant, design: object = None) -> Self:
        """Return the scales of a plant for a design of DESIGNS; None for the usual one.

        The usual design is "named" for the arm of a named environment without passive joints, and "arm" for others.

        Raises:
            ValueError: for an unknown design.
        """
        usual = "arm" if plant.named_period is None or plant.model.constants.passive.any() else "named"
        if one_of("base.design", usual if design is None else design, DESIGNS) == "named":
            return cls.of_design_named(plant.model, plant.named_period or 0.0)
        return cls.of(plant.model, plant.torque_scales, plant.rate_limit)

    @classmethod
    def of_design_named(cls, model: Model, unit: float = 0.0) -> Self:
        """Return the scales of the design "named" with a time unit of adaptation, s; 0 for a control period."""
        return cls((np.inf,) * model.n_joints, torque_slew=NAMED_SLEW, named=True, named_unit=unit)

    @property
    def torque_ratio(self) -> float:
        """Square of the duration of a slew at the torque limits / period of the vibration; infinite without one.

        Equal to the torques that change the motion within a period of the vibration over the torque limits.
        """
        return (self.torque_slew / self.vibration) ** 2 if self.vibration else np.inf

    @property
    def vibrations(self) -> float:
        """Shortest duration of a slew, in periods of the first mode that rings."""
        return 0.0 if self.named else float(np.clip(SHORTEST_FACTOR / self.torque_ratio, *SHORTEST_RANGE))

    @property
    def slew(self) -> float:
        """Duration of a slew at the limits of torques and rates, and of the first mode that rings, s."""
        return max(self.torque_slew, PEAK_RATE * CHANGE / min(self.rates), self.vibrations * self.vibration)

    @property
    def slew_rate(self) -> float:
        """Largest rate of a slew, rad/s."""
        return PEAK_RATE * CHANGE / self.slew

    def bounds(self, limits: Array, fraction: float) -> SlewBounds:
        """Return the bounds of slews with a fraction of the torque limits (n,) N m."""
        return SlewBounds(limits, fraction, np.array(self.rates), self.vibrations)

    def unit(self, period: float) -> int:
        """Return the number of control periods (s) in a time unit of adaptation."""
        unit = self.named_unit if self.named else self.slew / UNITS_PER_SLEW
        return max(1, round(unit / period))


def ringing_period(model: Model, posture: Array) -> float:
    """Return the period of the first mode that motors excite at the tip, at motor angles (n,) rad; 0 without one."""
    return _first_period(excited_modes(model, posture))


def free_period(model: Model, posture: Array) -> float:
    """Return the period of the first mode that torques of free motors excite at the tip, s; 0 without one.

    Free motors move the whole arm, and under gravity as a pendulum. All other modes are at least as fast as the first
    one with held motors.

    Args:
        model: model of the arm.
        posture: (n,) motor angles, rad.
    """
    held, free = excited_modes(model, posture), excited_modes(model, posture, held=False)
    return _first_period(free[free[:, 0] >= PENDULUM_RATIO * held[:, 0].min(initial=np.inf)])


def _first_period(modes: Array) -> float:
    """Return the period of the first of the modes (k, 3) of `excited_modes` that rings, s; 0 without one."""
    ringing = modes[modes[:, 2] >= RINGING_AMPLITUDE * modes[:, 2].max(initial=0.0), 0]
    return 1.0 / float(ringing[0]) if len(ringing) else 0.0


def _torque_slew(model: Model, limits: Array, posture: Array) -> float:
    """Return the duration of a minimum-jerk slew at the torque limits (n,) N m, s, about motor angles (n,) rad.

    The torque of a joint is its root mean square over independent changes of the motor angles, each of CHANGE.
    """
    weight, inertia = np.abs(holding_torques(model, posture)), slew_inertia(model, posture)
    free = np.maximum(TORQUE_FRACTION * limits - weight, LEAST_FRACTION * limits)
    return float(np.sqrt((PEAK_ACCELERATION * CHANGE * np.linalg.norm(inertia, axis=1) / free).max()))
