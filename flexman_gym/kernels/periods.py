"""Periods: what a control period of many arms is beside their motion.

Each takes one call in place of several of NumPy's, which cost a microsecond each: of one arm as much as its motion.
"""

from flexman_gym.kernels.compile import kernel
from flexman_gym.kernels.layout import OK
from flexman_gym.kernels.linalg import copy
from flexman_gym.kernels.outputs import turn_over


@kernel
def within(values, bound):
    """Whether all magnitudes of the values (m,) are at most the bound; that of no number is not."""
    for value in values:
        if not abs(value) <= bound:
            return False
    return True


@kernel
def ask(actions, arriving, limits, playing, drive, asked, efforts):
    """The torques in drive (b, n + 6) = arriving actions (b, n) times limits; of arms that are playing (b,), asked =
    actions and efforts (b,) = the means of their squares."""
    n = actions.shape[1]
    for b in range(len(actions)):
        for j in range(n):
            drive[b, j] = arriving[b, j] * limits[b, j]
        if playing[b]:
            total = 0.0
            for j in range(n):
                asked[b, j] = actions[b, j]
                total += actions[b, j] * actions[b, j]
            efforts[b] = total / n


@kernel
def close(rows, outputs, status, drive, periods, driven, turned):
    """Counts a control period in periods (b,) and keeps its drive (b, n + 6) for the arms whose status is OK; what all
    have turned over (b,) grows, see `turn_over`."""
    for b in range(len(status)):
        if status[b] == OK:
            periods[b] += 1.0
            copy(drive[b], driven[b])
    turn_over(rows, outputs, turned)


@kernel
def outlast(ages, playing, longest, over):
    """Ages (b,) of arms that are playing grow by a control period; over (b,) = whether they have reached the longest.

    Returns how many have.
    """
    many = 0
    for b in range(len(ages)):
        ages[b] += playing[b]
        over[b] = ages[b] >= longest
        many += over[b]
    return many
