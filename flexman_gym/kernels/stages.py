"""Stages: the slope of state and ledger, and weighted sums of slopes, for all families of methods."""

from flexman_gym.kernels.compile import inner, kernel
from flexman_gym.kernels.dynamics import accelerate
from flexman_gym.kernels.forces import drive_at
from flexman_gym.kernels.lanes import fused


@inner
def slope(constants, work, table, time, state, out):
    """out (2 d + 2,) = time derivative of state and ledger."""
    d = len(state) // 2 - 1
    x, v = state[:d], state[d : 2 * d]
    drive_at(table, time, work.drive)
    out[2 * d], out[2 * d + 1] = accelerate(constants, work, x, v, out[d : 2 * d])
    for j in range(d):
        out[j] = v[j]


@kernel
def derivative(constants, work, table, time, state, out):
    """out (2 d + 2,) = time derivative of state and ledger, for integrators outside the kernels."""
    slope(constants, work, table, time, state, out)


@inner
def add_stages(state, step, weights, stages, count, out):
    """out = state + step * sum of weights[j] * stages[j] over the first `count` stages."""
    for k in range(len(state)):
        out[k] = state[k]
    for j in range(count):
        weight = step * weights[j]
        if weight != 0.0:
            for k in range(len(state)):
                out[k] = fused(weight, stages[j, k], out[k])
