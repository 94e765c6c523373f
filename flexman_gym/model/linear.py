"""Linear: the linear model of an arm about a state.

The balance inertial forces + damping v + stiffness q = torques is differentiated term by term, so that stiff
springs spoil nothing. Stiffness, damping, B and C are exact up to rounding. The slope by speeds is exact too, as
the forces are quadratic in them.

The slope of the inertial forces by coordinates is taken by central differences, extrapolated to order six. No step
moves a section by more than 0.5 % of its link's length or 0.005 rad. On random chains, bent and fast, its measured
error is 1e-12 of its largest entry. With the condition of the mass matrix on top, the error of A is 1e-10 of its
largest entry (metres and radians weighed by their masses).

Coulomb friction c of a motor that slides is a constant torque and damps no small departure: it has no part in A. The
smoothed law c tanh(rate / coulomb_rate) has the slope c / coulomb_rate at rest, a damper of a hundred times c by
default. A model with that slope holds for rates far below `coulomb_rate` alone, where the motor hardly moves; no gain
or margin may be designed on it.
"""

from collections.abc import Sequence

import numpy as np

from flexman_gym.arrays import Array, Vector
from flexman_gym.checks import one_of, refusal
from flexman_gym.model.instant import (
    acceleration,
    damping_matrix,
    inertial_forces,
    mass_matrix,
    split_state,
    stiffness_matrix,
)
from flexman_gym.model.model import Model, checked_model
from flexman_gym.model.readings import input_columns, output_rows
from flexman_gym.model.rounding import solvable
from flexman_gym.model.slopes import coordinate_sizes, coordinate_slopes
from flexman_gym.model.state_space import Balance, LinearModel

SLIDING, AT_REST = "sliding", "at rest"  # Coulomb friction in a linear model


def linearize(
    model: Model,
    joint_angles: Vector | None = None,
    state: Vector | None = None,
    torque: Vector | None = None,
    outputs: Sequence[str] = ("tip",),
    inputs: Sequence[str] = ("motor_torques",),
    friction: str = SLIDING,
) -> LinearModel:
    """Gives the linear model about the undeformed arm at rest, or about a whole state.

    States x (2 d,) are coordinates and speeds in the order of `kernels.layout`. Where the accelerations at the state do
    not vanish (gravity, speeds), x departs from the motion that starts there, and A is the slope at its start. Coulomb
    friction of a sliding motor, the default, is constant and has no slope.

    Args:
        model: the model.
        joint_angles: (n,) rad, zero by default.
        state: (2 d,), in place of joint angles.
        torque: (n,) of the motors, N m, zero by default.
        outputs: what y reads: "tip", "tip_velocity" and "tip_acceleration" (3 numbers each, in the base frame and
            relative to the base), "joint_angles", "joint_rates", "motor_angles", "motor_rates", "joint_twists",
            "joint_twist_rates" (n each), "link_deflections", "link_deflection_rates" (2 n), "root_strains" (3 n).
        inputs: what u holds: "motor_torques" (n), "tip_force" (3) and "base_acceleration" (3).
        friction: "sliding", or "at rest" for the slope of the smoothed Coulomb friction at the rates of the state.

    Raises:
        ValueError: for wrong shapes, values that are not finite, a state and joint angles at once, unknown names, and
            the acceleration of the tip about a state that moves.

    Examples:
        >>> system = fm.linearize(fm.build_model(fm.catalog.one_joint()), outputs=("tip",))
        >>> system.A.shape, system.B.shape, system.outputs
        ((28, 28), (28, 1), ('tip_x (m)', 'tip_y (m)', 'tip_z (m)'))
        >>> system.discrete(period=0.01).period
        0.01
    """
    checked_model(model)
    if state is None:
        state = model.initial_state(np.zeros(model.n_joints) if joint_angles is None else joint_angles)
    elif joint_angles is not None:
        raise refusal("state", "given with joint_angles", "one of the two")
    applied = np.zeros(model.n_joints) if torque is None else torque
    caused = acceleration(model, state, applied)
    columns, driven = input_columns(model, split_state(model, state)[0], inputs)
    demands = np.hstack([_demands(model, state, caused), columns])
    if one_of("friction", friction, (SLIDING, AT_REST)) == AT_REST:
        _add_coulomb_slopes(model, state, demands)
    rows, read = output_rows(model, state, caused, outputs)
    return _solved(model, Balance(mass_matrix(model, state), demands, rows), tuple(driven), tuple(read))


def _solved(model: Model, balance: Balance, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> LinearModel:
    """Gives the linear model of a balance of forces."""
    from scipy.linalg import cho_factor, cho_solve

    (mass, demands, rows), d = balance, model.n_dof
    scale = np.sqrt(np.diag(mass))  # metres and radians of fine elements weigh alike
    with solvable("accelerations"):
        factor = cho_factor(mass / np.outer(scale, scale))
        slopes = cho_solve(factor, demands / scale[:, None]) / scale[:, None]
    felt = rows[:, 2 * d :] @ slopes
    return LinearModel(
        A=np.block([[np.zeros((d, d)), np.eye(d)], [slopes[:, : 2 * d]]]),
        B=np.vstack([np.zeros((d, len(inputs))), slopes[:, 2 * d :]]),
        C=rows[:, : 2 * d] + felt[:, : 2 * d],
        D=felt[:, 2 * d :],
        states=_state_names(model),
        inputs=inputs,
        outputs=outputs,
        balance=balance,
    )


def _state_names(model: Model) -> tuple[str, ...]:
    """Gives the names (2 d,) of coordinates and speeds; elastic coordinates have the units of their nodes or modes."""
    joints, motors = range(1, model.n_joints + 1), np.flatnonzero(model.constants.motor >= 0) + 1
    elastic = [
        f"link_{i + 1}_elastic_{a + 1}"
        for i in range(model.n_joints)
        for a in range(model.elastic_columns(i).stop - model.elastic_columns(i).start)
    ]
    return tuple(
        name
        for kind, unit in (("angle", "rad"), ("rate", "rad/s"))
        for name in [
            *(f"joint_{kind}_{i} ({unit})" for i in joints),
            *(f"motor_{kind}_{i} ({unit})" for i in motors),
            *(each if kind == "angle" else f"{each}_rate" for each in elastic),
        ]
    )


def _demands(model: Model, state: Vector, caused: Array) -> Array:
    """Gives slopes (d, 2 d), by coordinates and speeds, of the forces that accelerate the arm by `caused` (d,)."""
    (x, v), forces = split_state(model, state), inertial_forces(model)
    d, size = model.n_dof, coordinate_sizes(model)

    def by_speed(unit: Array) -> Array:
        return (forces(x, v + unit, caused) - forces(x, v - unit, caused)) / 2

    demands = np.zeros((d, 2 * d))
    demands[:, :d] = -stiffness_matrix(model) - coordinate_slopes(model, lambda place: forces(place, v, caused), x)
    demands[:, d:] = -damping_matrix(model) - np.transpose([by_speed(unit) for unit in np.diag(size)]) / size
    return demands


def _add_coulomb_slopes(model: Model, state: Vector, demands: Array) -> None:
    """Subtract the slopes of the smoothed Coulomb friction by the motor rates from demands (d, 2 d + m)."""
    motors, constants = model.motor_columns, model.constants
    steepness = constants.coulomb_friction / constants.coulomb_rate
    parts = np.abs(split_state(model, state)[1][motors] / constants.coulomb_rate)
    # beyond 300 the slope is 0 and cosh overflows
    demands[motors, model.n_dof + motors] -= steepness / np.cosh(np.minimum(parts, 300.0)) ** 2
