"""Cost weights of linear-quadratic regulators, and the gain of the sampled regulator."""

from typing import NamedTuple, Self

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.common.checks import check_solvable, mapping, positive
from flexman_gym.common.errors import value_error
from flexman_gym.model.model import Model
from flexman_gym.model.state_space import LinearModel, discretize
from flexman_gym.model.statics import holding_torques, rest_state
from flexman_gym.simulation.linearization import linearize
from flexman_gym.toolbox.controllers.arm_scales import ArmScales
from flexman_gym.toolbox.controllers.observers.kalman_filter import late_covariances

# Tuned for an arm with a reach of 8.5 m as 0.2 m and 1 m/s; smaller values saturate the torques and fail.
TIP_SCALE, TIP_SPEED_SCALE = 0.2 / 8.5, 1.0 / 8.5  # fraction of the reach, 1/s; tip deviation and speed that cost 1
MOTOR_WEIGHT = 0.5  # rad; motor angle of unit cost
TIP_TIME = 1.0 / 16.0  # fraction of the first vibration, or of a slew of a rigid arm; tip / tip speed of unit cost
TORQUE_SCALE = 1.5  # dimensionless; torque of unit cost / torque ratio of the arm, at most the torque limits
# Motor rate of unit cost / planned rate, where slews reach at least a fifth of the planned rates, as with limits that
# follow from the arm. It increases with the square of this ratio: rates far below a generous limit need no cost.
RATE_SCALE, USUAL_RATIO = 0.3, 5.0
# Factor of torques and motor rates of unit cost for a regulator whose torques act on the whole distance to the goal, or
# on noise: of 200 slews of five arms by the LQR, 29 exceed a limit, with 1 56, with the weights of the reach 78.
EXPENSIVE_FACTOR = 0.3
REQUIRED = ("tip", "tip_speed", "motor")  # weights that a mapping must contain


class CostWeights(NamedTuple):
    """Deviations of unit cost in an LQR (Bryson's rule).

    Attributes:
        tip: deviation of the tip position, m.
        tip_speed: deviation of the tip velocity, m/s.
        motor: deviation of a motor angle, rad.
        motor_rate: deviation of the rate of each motor, one number or (n,), rad/s; infinite for no cost.
        torque: torque, as a fraction of the torque limits.
    """

    tip: float
    tip_speed: float
    motor: float
    motor_rate: float | tuple[float, ...] = np.inf
    torque: float = 1.0

    @classmethod
    def default(cls, model: Model, scales: ArmScales) -> "CostWeights":
        """Return the cost weights of an arm.

        Tip deviations are in proportion to the reach, and cost as much as the tip speed that they need in a sixteenth
        of the first vibration: 20 cm and 1 m/s for the arm of FlexRRR-v0. Motor rates are in proportion to the planned
        rates, where these are not generous, and torques to those that change the motion within a period of the
        vibration. The design "named" has 20 cm and 1 m/s for a reach of 8.5 m, torques at their limits, and no cost of
        motor rates.
        """
        if scales.named:
            return NamedWeights.of_reach(model)
        reach = float(model.constants.length.sum())
        time = TIP_TIME * (scales.vibration or scales.slew)
        rates = np.array(scales.rates)
        rates = RATE_SCALE * rates * np.maximum(1.0, rates / (USUAL_RATIO * scales.slew_rate)) ** 2
        return cls(
            TIP_SCALE * reach,
            TIP_SCALE * reach / time,
            MOTOR_WEIGHT,
            tuple(rates.tolist()),
            min(1.0, TORQUE_SCALE * scales.torque_ratio),
        )

    @classmethod
    def expensive(cls, model: Model, scales: ArmScales) -> "CostWeights":
        """Return the cost weights of expensive control, for a regulator without a planned slew or the true state.

        Tip deviation and tip speed of unit cost are those of `NamedWeights`, torques and motor rates 0.3 of the default
        ones. The design "named" has `NamedWeights`.
        """
        named, default = NamedWeights.of_reach(model), cls.default(model, scales)
        if scales.named:
            return named
        rates = tuple((EXPENSIVE_FACTOR * np.array(default.motor_rate)).tolist())
        return cls(*named[:3], rates, EXPENSIVE_FACTOR * default.torque)

    def gain(self, linear: LinearModel, motors: Array, limits: Array, period: float) -> Array:
        """Return the gain K (m, 2 d) of the sampled LQR, torques = -K x, for states x relative to the equilibrium.

        Args:
            linear: linear model about an equilibrium, with m motors.
            motors: (m,) columns of the motor angles in x.
            limits: (m,) torque limits, N m.
            period: control period, s.

        Raises:
            ValueError: for an arm whose Riccati equation has no solution within rounding.
        """
        with check_solvable("gains of a regulator"):
            transition, inputs = discretize(linear.A, linear.B, period)
            n, outputs, unit = len(limits), self.outputs(linear, motors), self.torque * limits
            scaled = inputs * unit  # torques in units of their cost, for a well-scaled equation
            solution = self._cost_to_go((transition, scaled, outputs.T @ outputs), unit)
            gain = np.linalg.solve(np.eye(n) + scaled.T @ solution @ scaled, scaled.T @ solution @ transition)
            if not np.isfinite(gain).all():  # functions of LAPACK return NaN without an error
                raise FloatingPointError
        return unit[:, None] * gain

    def _cost_to_go(self, equation: tuple[Array, Array, Array], unit: Array) -> Array:
        """Return the matrix of the cost of all later periods, dual to a covariance.

        Args:
            equation: transition matrix, input matrix of torques in units of their cost, and cost matrix of states.
            unit: (n,) torques of unit cost, N m.
        """
        transition, inputs, cost = equation
        return late_covariances(transition.T, cost, inputs.T, np.ones(len(unit)))[0]

    def terminal(self, transition: Array, inputs: Array, outputs: Array, limits: Array) -> Array:
        """Return the matrix (2 d, 2 d) of the cost of all periods after a horizon, under the LQR.

        Args:
            transition: (2 d, 2 d) matrix of the state after a period.
            inputs: (2 d, n) matrix of the torques, fractions of the limits.
            outputs: matrix of the outputs in the cost, see `outputs`.
            limits: (n,) torque limits, N m.
        """
        return self._cost_to_go((transition, inputs, outputs.T @ outputs), limits)

    def outputs(self, linear: LinearModel, motors: Array) -> Array:
        """Return the matrix (6 + m or 6 + 2 m, 2 d) of the outputs in the cost, divided by their weights.

        The outputs are tip, its rate, motor angles, and motor rates that have a cost.
        """
        d, n = len(linear.A) // 2, len(motors)
        tip, outputs = linear.C[:, :d], np.zeros((6 + 2 * n, 2 * d))
        outputs[:3, :d], outputs[3:6, d:] = tip / self.tip, tip / self.tip_speed
        outputs[6 : 6 + n, motors] = np.eye(n) / self.motor
        outputs[6 + n :, d + motors] = np.eye(n) / self.motor_rate
        return outputs if outputs[6 + n :].any() else outputs[: 6 + n]


class NamedWeights(CostWeights):
    """Cost weights in proportion to the reach, of the design "named" and of regulators without a planned slew.

    Their gains are those of the Riccati solver of SciPy, to the bit, where it finds a solution.
    """

    @classmethod
    def of_reach(cls, model: Model) -> Self:
        """Return the cost weights of an arm: 20 cm and 1 m/s for a reach of 8.5 m."""
        reach = float(model.constants.length.sum())
        return cls(TIP_SCALE * reach, TIP_SPEED_SCALE * reach, MOTOR_WEIGHT)

    def _cost_to_go(self, equation: tuple[Array, Array, Array], unit: Array) -> Array:
        from scipy.linalg import solve_discrete_are

        identity = np.diag(1.0 / unit**2) * np.outer(unit, unit)  # with rounding, which stored policies were trained on
        for balanced in (True, False):  # balancing makes some equations unsolvable, and others solvable
            try:
                result: Array = solve_discrete_are(*equation, identity, balanced=balanced)
            except (ValueError, np.linalg.LinAlgError):
                continue
            if np.isfinite(result).all():  # SciPy 1.18 returns NaN where earlier versions raise an error
                return result
        return super()._cost_to_go(equation, unit)


def posture_gain(model: Model, posture: Array, weights: CostWeights, limits: Array, period: float) -> Array:
    """Return the gain K (n, 2 d) of the sampled LQR about rest at motor angles (n,) rad; 0 for passive joints.

    Args:
        model: model of the arm, whose motors have no friction.
        posture: (n,) motor angles, rad; passive joints hang.
        weights: cost weights.
        limits: (n,) torque limits, N m.
        period: control period, s.
    """
    linear = linearize(model, state=rest_state(model, posture), torque=holding_torques(model, posture))
    motors, gain = model.constants.passive == 0, np.zeros((model.n_joints, 2 * model.n_dof))
    if isinstance(weights.motor_rate, tuple):
        weights = weights._replace(motor_rate=tuple(np.array(weights.motor_rate)[motors].tolist()))
    gain[motors] = weights.gain(linear, model.driven_columns, limits[motors], period)
    return gain


def parse_weights(value: object, scales: ArmScales) -> CostWeights | None:
    """Return the cost weights of a mapping; None for None.

    Args:
        value: mapping "tip" (m), "tip_speed" (m/s) and "motor" (rad), and optionally "motor_rate" (rad/s) and "torque"
            (fraction of the limits).
        scales: scales of the arm.
    """
    if value is None:
        return None
    given = mapping("base.weights", value, CostWeights._fields)
    if not set(REQUIRED) <= set(given):
        raise value_error("base.weights", given, "a mapping with tip (m), tip_speed (m/s) and motor (rad)")
    checked = {name: positive(f"base.weights.{name}", each) for name, each in given.items()}
    return NamedWeights(**checked) if scales.named else CostWeights(**checked)
