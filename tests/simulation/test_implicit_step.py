"""Implicit steps: one step solves the dense linear system, with springs, dampers, friction and rotors in its matrix."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from flexman_gym.kernels import layout
from flexman_gym.simulation.families import LinearlyImplicit
from flexman_gym.simulation.one_by_one import OneByOne
from flexman_gym.simulation.run import Run

from oracles.affected import affected
from oracles.chains import QUICK

ZERO, ONE = np.zeros((1, 1)), np.ones(1)
EULER = LinearlyImplicit("linearly_implicit_euler", 1, "Hairer and Wanner, Solving ODEs II, IV.9", ZERO, ONE, 1.0, ZERO)


def structure(case, v):
    """Stiffness and damping (d, d) of springs, links and friction, this with its secant at the rates v (d,)."""
    chain, d = case.chain, len(v)
    stiffness, damping = np.zeros((d, d)), np.zeros((d, d))
    for i, joint in enumerate(case.arm.joints):
        motor = chain.motor.get(i, i)
        if i in chain.motor:
            pair = np.ix_([i, motor], [i, motor])
            stiffness[pair] += joint.stiffness * np.array([[1.0, -1.0], [-1.0, 1.0]])
            damping[pair] += joint.damping * np.array([[1.0, -1.0], [-1.0, 1.0]])
        damping[motor, motor] += joint.viscous_friction
        if joint.coulomb_friction > 0.0:
            damping[motor, motor] += joint.coulomb_friction * np.tanh(v[motor] / joint.coulomb_rate) / v[motor]
    for beam, drag, columns in zip(chain.beams, chain.damping, chain.elastic, strict=True):
        stiffness[columns, columns] += beam.K
        damping[columns, columns] += drag
    return stiffness, damping


@settings(QUICK, max_examples=50)
@given(affected(), st.sampled_from([1e-4, 1e-3, 1e-2]))
def test_a_linearly_implicit_euler_step_solves_the_dense_linear_system(case, step):
    """(M + h D + h^2 K) w = F(x, v) - h K v, then v += h w and x += h v; held motors have the w that is given."""
    (x, v), drive, d = case.sample.state(), case.drive(), case.model.n_dof
    n, motors = case.model.n_joints, case.model.motor_columns
    mass, force = case.chain.equation(
        x, v, np.where(np.isin(range(n), case.held), 0.0, drive[:n]), *drive[n:].reshape(2, 3)
    )
    stiffness, damping = structure(case, v)
    matrix, right = mass + step * damping + step**2 * stiffness, force - step * stiffness @ v
    w, held = np.zeros(d), np.zeros(d, dtype=bool)
    held[motors[list(case.held)]], w[motors[list(case.held)]] = True, drive[list(case.held)]
    scale = np.sqrt(np.diag(matrix))  # metres and radians of fine elements weigh alike
    free = np.ix_(~held, ~held)
    weighed = matrix / np.outer(scale, scale)
    w[~held] = np.linalg.solve(weighed[free], ((right - matrix @ w) / scale)[~held]) / scale[~held]

    mover = OneByOne([Run(case.model, EULER, None, case.held)], (step, 1))
    rows, status = np.r_[x, v, 0.0, 0.0][None], np.zeros(1, dtype=np.int64)
    mover.move(drive[None], np.zeros(1), rows, np.zeros((1, layout.OUTPUTS)), status)
    assert status[0] == layout.OK
    result = (rows[0, d : 2 * d] - v) / step
    condition = np.linalg.cond(weighed[free]) if free[0].size else 1.0
    rounding = np.finfo(float).eps * np.abs(scale * v).max() / step
    largest = np.abs(scale * w).max()
    assert (
        np.abs(scale * (result - w)).max() <= (1e-10 + 100 * np.finfo(float).eps * condition) * largest + 10 * rounding
    )
    moved = x + step * rows[0, d : 2 * d]
    np.testing.assert_allclose(rows[0, :d], moved, rtol=1e-12, atol=1e-12 * np.abs(moved).max(initial=1.0))
