"""Statics: where an arm rests under its weight."""

from flexman_gym.kernels.compile import kernel
from flexman_gym.kernels.inverse import inertial_forces

ITERATIONS, ROUNDING = 100, 1e-12  # at most, and what is a change no more


@kernel
def settle(constants, work, stiffness, compliance, free, rest, x, force):
    """Turns and bends the `free` coordinates (f,) of x (d,) until springs and links hold the weight.

    The slope of that balance is taken to be the stiffness (d, d), whose inverse of the free part is the compliance
    (f, f); `rest` (d,) are zeros. Overwrites x and force (d,); returns the largest change of the last of its iterations
    as a part of the largest coordinate, at least 1.
    """
    largest = 1.0
    for _ in range(ITERATIONS):
        inertial_forces(constants, work, x, rest, rest, force)
        for i in range(len(free)):
            for j in range(len(x)):
                force[free[i]] += stiffness[free[i], j] * x[j]
        largest, size = 0.0, 1.0
        for i in range(len(free)):
            change = 0.0
            for j in range(len(free)):
                change += compliance[i, j] * force[free[j]]
            x[free[i]] -= change
            largest = max(largest, abs(change))
        for j in range(len(x)):
            size = max(size, abs(x[j]))
        largest /= size
        if not largest > ROUNDING:
            break
    return largest
