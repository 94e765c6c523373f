"""Linear model of an arm about a state, in continuous time or for one control period of the simulation."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flexman_gym.common.arrays import Vector
from flexman_gym.common.checks import positive
from flexman_gym.common.errors import value_error
from flexman_gym.model.dynamics import split_state
from flexman_gym.model.friction import coulomb_torques
from flexman_gym.model.linearization import SLIDING, continuous_model, input_columns
from flexman_gym.model.model import Model, check_model
from flexman_gym.model.state_space import LinearModel
from flexman_gym.simulation.integrator import MAX_STEPS, default_step
from flexman_gym.simulation.methods import DEFAULT_METHOD, METHODS
from flexman_gym.simulation.period_map import period_jacobian


def linearize(
    model: Model,
    joint_angles: Vector | None = None,
    state: Vector | None = None,
    torque: Vector | None = None,
    outputs: Sequence[str] = ("tip",),
    inputs: Sequence[str] = ("motor_torques",),
    friction: str = SLIDING,
    *,
    period: float | None = None,
) -> LinearModel:
    """Return the linear model of an arm about the undeformed arm at rest, or about any state.

    The states x (2 d,) are deviations of coordinates and speeds in the order of `kernels.layout`. If the accelerations
    at the state are not zero (because of gravity or speeds), x is the deviation from the motion that starts at the
    state, and A is the Jacobian at its start. By default, Coulomb friction is a constant torque (sliding motors).

    With a period, the model is discrete: A and B are the exact derivatives of the state at the end of the period with
    respect to the state at its start and to constant inputs. The default method integrates the motion, in steps of at
    most 5 ms; `period_map.period_jacobian` accepts other methods and steps. In static equilibrium A and B equal those
    of `discrete` up to the error of the method. About a moving state they follow the motion over the period, whereas
    `discrete` keeps the matrices of its start.

    Args:
        model: model of the arm.
        joint_angles: (n,) rad, zero by default; the arm is undeformed and at rest.
        state: (2 d,) coordinates and speeds, as an alternative to joint angles.
        torque: (n,) motor torques, N m, zero by default.
        outputs: names of y: "tip", "tip_velocity" and "tip_acceleration" (3 entries each, in the base frame and
            relative to the base), "joint_angles", "joint_rates", "motor_angles", "motor_rates", "joint_twists" (elastic
            deflections of the joints: motor angles minus link-side angles, rad), "joint_twist_rates" (n each),
            "link_deflections", "link_deflection_rates" (2 n), "root_strains" (3 n). "tip_acceleration" requires a state
            with zero speeds.
        inputs: names of u: "motor_torques" (n, without passive joints), "tip_force" (3), "base_acceleration" (3).
        friction: treatment of Coulomb friction. "sliding": a constant torque, that of the motor rates of the state,
            which does not contribute to A. "at rest": a damper with the slope of the smoothed friction law, for motors
            that hardly move; in continuous time at the motor rates of the state, with a period along the motion.
        period: control period of constant inputs, at most 500 s; None for a model in continuous time.

    Raises:
        ValueError: for arguments that are not allowed, and for a motion that diverges within the period.

    Examples:
        >>> system = fm.linearize(fm.build_model(fm.catalog.one_joint()), outputs=("tip",))
        >>> system.A.shape, system.B.shape, system.outputs
        ((28, 28), (28, 1), ('tip_x (m)', 'tip_y (m)', 'tip_z (m)'))
        >>> system.discrete(period=0.01).period
        0.01
    """
    check_model(model)
    if state is None:
        state = model.initial_state(np.zeros(model.n_joints) if joint_angles is None else joint_angles)
    elif joint_angles is not None:
        raise value_error("state", "given with joint_angles", "one of the two")
    applied = np.zeros(model.n_joints) if torque is None else torque
    continuous = continuous_model(model, state, applied, outputs, inputs, friction)
    if period is None:
        return continuous
    period, (x, v), torques = positive("period", period, "s"), split_state(model, state), np.array(applied, dtype=float)
    if friction == SLIDING:
        torques = torques - coulomb_torques(model, v[model.motor_columns])
        without = model.constants._replace(coulomb_friction=np.zeros(model.n_joints))
        model = replace(model, constants=without)
    if (steps := round(period / default_step(period))) > MAX_STEPS:  # as in a control period of `Simulator`
        raise value_error("period", period, f"at most {MAX_STEPS * default_step(period):g} s, {MAX_STEPS} steps")
    drive = np.concatenate([torques, np.zeros(6)])
    jacobian = period_jacobian(model, METHODS[DEFAULT_METHOD], (period, steps), np.concatenate([x, v]), drive)
    transition, by_input = np.split(jacobian, [2 * model.n_dof], axis=1)
    driven = np.append(model.constants.passive == 0, np.ones(6, dtype=bool))
    columns = np.concatenate([input_columns(model, name) for name in inputs])
    return replace(continuous, A=transition, B=by_input[:, columns[driven[columns]]], period=period, balance=None)
