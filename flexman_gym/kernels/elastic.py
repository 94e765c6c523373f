"""The mass matrix of one link's elastic coordinates with what its tip carries, for `dynamics` to eliminate."""

from flexman_gym.kernels.lanes import group_size, load_lanes, store_lanes
from flexman_gym.kernels.linalg import (
    ZERO,
    add,
    apply,
    apply_back,
    apply_inertia,
    cross,
    inner,
    load,
    load_pair,
)
from flexman_gym.kernels.stiffening import stretch_mass


@inner
def elastic_block(constants, work, i, shift, tip):
    """factor = shifted M of link i with what its tip carries (upper half), then coupling to the frame."""
    start, stop = constants.elastic_start[i], constants.elastic_start[i + 1]
    square, width, first = constants.square_start[i], constants.factor_width[i], constants.factor_start[i]
    carried, factor, d = work.carried, work.factor, load(work.tip, i)
    k, length, size = stop - start, constants.station_width[i], group_size(factor)
    carry(constants, work, i, tip)
    for a in range(k):
        row, terms = first + a * width, 0
        if start + a >= constants.carrying[i]:
            terms = 6 if start + a >= constants.turning[i] else 1
        for group in range(a - a % size, k, size):
            j = square + a * k + group
            total = shift[0] * load_lanes(constants.damping, j) + shift[1] * load_lanes(constants.stiffness, j)
            total = load_lanes(constants.elastic_mass, j) + total
            for c in range(terms):
                total += work.tip_shape[start + a, c] * load_lanes(carried, c * length + group)
            if len(constants.station_mass) > 0:
                total = stretch_mass(constants, work, i, a, group, total)
            store_lanes(factor, row + group, total)
        # last, as these columns also take what the padding of the rows above holds
        force, moment = ZERO, ZERO
        if start + a >= constants.carrying[i]:
            force = carried[a], carried[length + a], carried[2 * length + a]
            moment = carried[3 * length + a], carried[4 * length + a], carried[5 * length + a]
        force, moment = add(force, load(work.moment_shape, start + a)), add(moment, cross(d, force))
        moment = add(moment, load(work.coupling, start + a))
        for j in range(3):
            factor[row + k + j] = force[j]
            factor[row + k + 3 + j] = moment[j]


@inner
def carry(constants, work, i, tip):
    """work.carried = what the tip of link i carries, an inertia, times the motion of the tip by each coordinate."""
    start, length = constants.elastic_start[i], constants.station_width[i]
    carried = work.carried
    for a in range(constants.carrying[i], constants.elastic_start[i + 1]):
        if a < constants.turning[i]:
            along = (work.tip_shape[a, 0], 0.0, 0.0)
            force, moment = apply(tip[0], along), apply_back(tip[1], along)
        else:
            force, moment = apply_inertia(tip, load_pair(work.tip_shape, a))
        for j in range(3):
            carried[j * length + a - start] = force[j]
            carried[(3 + j) * length + a - start] = moment[j]
