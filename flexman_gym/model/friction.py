"""Friction of motors in NumPy: torque, slope, and mean over a motion whose rate changes uniformly.

The law is that of the kernels, see `kernels.forces`. At the motor rate v the torque against the motion is

    b v + c tanh(v / r) (1 + s / (1 + (v / p)^2)),

with the damping of the rotor b, Coulomb friction c, width r (`coulomb_rate`), excess of static friction s, and Stribeck
rate p. Means, and torques for given coefficients, are those without the excess: b v + c tanh(v / r).
"""

from dataclasses import replace

import numpy as np

from flexman_gym.common.arrays import Array
from flexman_gym.model.model import Model

SMALL_CHANGE = 1e-2  # fraction of the width; change of rates below which derivatives are integrated numerically
NODES, WEIGHTS = np.array([0.5 - 0.15**0.5, 0.5, 0.5 + 0.15**0.5])[:, None], np.array([5.0, 8.0, 5.0]) / 18.0  # Gauss
EQUAL_RATES = 1e-6  # rad/s; difference of motor rates below which the friction torque is that of the first rate


def frictionless(model: Model) -> Model:
    """Return the model without friction of the motors; a model without friction is returned unchanged.

    Passive joints keep their friction.

    Args:
        model: model of the arm.
    """
    constants, names = model.constants, ("rotor_damping", "coulomb_friction", "has_coulomb_friction")
    if not friction_coefficients(model).any():
        return model
    slippery = {name: getattr(constants, name) * constants.passive for name in names}
    return replace(model, constants=constants._replace(**slippery))


def coulomb_torques(model: Model, rates: Array) -> Array:
    """Return the friction torques (n,), N m, without their viscous part, at motor rates (n,), rad/s."""
    constants = model.constants
    coulomb = constants.coulomb_friction * np.tanh(rates / constants.coulomb_rate)
    return coulomb * (1.0 + constants.static_excess / (1.0 + (rates / constants.stribeck_rate) ** 2))


def coulomb_slopes(model: Model, rates: Array) -> Array:
    """Return the derivatives (n,) of `coulomb_torques` by the motor rates, N m s/rad, at motor rates (n,), rad/s."""
    constants = model.constants
    slopes, scaled_rates = constants.coulomb_friction / constants.coulomb_rate, np.abs(rates / constants.coulomb_rate)
    # beyond 300 the slope is 0, and cosh would overflow
    slopes = slopes / np.cosh(np.minimum(scaled_rates, 300.0)) ** 2
    slip = rates / constants.stribeck_rate
    coulomb = constants.coulomb_friction * np.tanh(rates / constants.coulomb_rate)
    falling = 2.0 * coulomb * slip / (constants.stribeck_rate * (1.0 + slip**2))
    result: Array = slopes + constants.static_excess * (slopes - falling) / (1.0 + slip**2)
    return result


def friction_coefficients(model: Model) -> Array:
    """Return the damping of the rotors (N m s/rad) and the Coulomb friction (N m) of a model, (2, n).

    Both are 0 for passive joints, whose friction no motor compensates.
    """
    motors = 1 - model.constants.passive
    return np.array([model.constants.rotor_damping * motors, model.constants.coulomb_friction * motors])


def friction_torques(model: Model, rates: Array, coefficients: Array | None = None) -> Array:
    """Return the friction torques (..., n), N m, without the excess of static friction.

    Args:
        model: model of the arm.
        rates: (..., n) motor rates, rad/s.
        coefficients: (..., 2, n) viscous (N m s/rad) and Coulomb friction (N m); None for those of the model.
    """
    if coefficients is None:
        coefficients = friction_coefficients(model)
    sliding = np.tanh(rates / model.constants.coulomb_rate)
    return coefficients[..., 0, :] * rates + coefficients[..., 1, :] * sliding


def mean_friction_torques(coefficients: Array, before: Array, after: Array, width: Array | float) -> Array:
    """Return the mean friction torques (..., n), N m, while the motor rates change uniformly.

    The mean of c tanh(v / r) is c r (ln cosh(v1 / r) - ln cosh(v0 / r)) / (v1 - v0). Unlike the friction torque at the
    first rate, it does not drive a motor whose rate changes sign.

    Args:
        coefficients: (..., 2, n) viscous (N m s/rad) and Coulomb friction (N m).
        before: (..., n) motor rates v0 at the start, rad/s.
        after: (..., n) motor rates v1 at the end, rad/s.
        width: motor rate r of the smoothed Coulomb friction, for all joints or for each joint (n,), rad/s.
    """
    change = after - before
    equal = np.abs(change) < EQUAL_RATES
    integral = width * (_log_cosh(after / width) - _log_cosh(before / width))
    sliding = np.where(equal, np.tanh(before / width), integral / np.where(equal, 1.0, change))
    result: Array = coefficients[..., 0, :] * 0.5 * (before + after) + coefficients[..., 1, :] * sliding
    return result


def mean_friction_derivatives(
    coefficients: Array, before: tuple[Array, Array], after: tuple[Array, Array], width: Array
) -> Array:
    """Return the derivatives (p, n) of `mean_friction_torques` with respect to p parameters.

    Args:
        coefficients: (2, n) as in `mean_friction_torques`.
        before: motor rates at the start (1, n), rad/s, and their derivatives (p, n).
        after: motor rates at the end and their derivatives.
        width: (n,) as in `mean_friction_torques`.
    """
    (first, first_change), (last, last_change) = before, after
    change = last - first
    near = np.abs(change) < SMALL_CHANGE * width
    divisor = np.where(near, 1.0, change)
    mean = width * (_log_cosh(last / width) - _log_cosh(first / width)) / divisor
    slopes = (1.0 - np.tanh((first + NODES * change) / width) ** 2) / width  # at three nodes of a quadrature, (3, n)
    by_first = np.where(near, (1.0 - NODES.T) * WEIGHTS @ slopes, (mean - np.tanh(first / width)) / divisor)
    by_last = np.where(near, NODES.T * WEIGHTS @ slopes, (np.tanh(last / width) - mean) / divisor)
    sliding = by_first * first_change + by_last * last_change
    result: Array = coefficients[0] * 0.5 * (first_change + last_change) + coefficients[1] * sliding
    return result


def _log_cosh(x: Array) -> Array:
    """Return ln cosh x without overflow."""
    size = np.abs(x)
    result: Array = size + np.log1p(np.exp(-2.0 * size)) - np.log(2.0)
    return result
