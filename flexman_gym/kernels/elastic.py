"""The elastic coordinates of one link: their mass matrix with what the tip carries, and its elimination."""

import math

from flexman_gym.kernels.compile import inner
from flexman_gym.kernels.groups import group_size, load_lanes, store_lanes
from flexman_gym.kernels.lanes import choose_below, fused
from flexman_gym.kernels.linalg import (
    ZERO,
    add,
    add_scaled,
    apply,
    apply_back,
    apply_inertia,
    cross,
    load,
    load_pair,
    subtract_outer,
)
from flexman_gym.kernels.stiffening import stretch_mass


@inner
def eliminate_elastic(constants, work, i, shift, tip, inertia):
    """What is left of an inertia when the elastic coordinates of link i, with what its tip carries, are free.

    Fills work.factor row by row: R of the shifted M = R^T D^-1 R, its diagonal D inverted, then coupling to the frame.
    """
    start, width, first = constants.elastic_start[i], constants.factor_width[i], constants.factor_start[i]
    k, factor = constants.elastic_start[i + 1] - start, work.factor
    force, mixed, moment = inertia
    carry(constants, work, i, tip)
    for a in range(k):
        row = first + a * width
        elastic_row(constants, work, i, a, shift)
        linear, angular = coupling(constants, work, i, a)
        for c in range(a):
            j, share = first + c * width + k, work.total[c]
            linear = add_scaled(linear, share, (factor[j], factor[j + 1], factor[j + 2]))
            angular = add_scaled(angular, share, (factor[j + 3], factor[j + 4], factor[j + 5]))
        # an M that is not positive definite, of a state out of all bounds, ends as a divergence
        pivot = choose_below(factor[row + a], 0.0, math.nan, 1.0 / factor[row + a])
        factor[row + a] = pivot
        # last, as these columns also take what the padding of the row holds
        for j in range(3):
            factor[row + k + j], factor[row + k + 3 + j] = linear[j], angular[j]
        scaled, turned = add_scaled(ZERO, pivot, linear), add_scaled(ZERO, pivot, angular)
        force = subtract_outer(force, scaled, linear)
        mixed = subtract_outer(mixed, scaled, angular)
        moment = subtract_outer(moment, turned, angular)
    return force, mixed, moment


@inner
def elastic_row(constants, work, i, a, shift):
    """Row a of the shifted M of link i, from the diagonal on, into factor, less what the rows above take from it.

    work.total[c] = the share of row c that is taken.
    """
    start, square, width = constants.elastic_start[i], constants.square_start[i], constants.factor_width[i]
    first, length, factor, carried = constants.factor_start[i], constants.station_width[i], work.factor, work.carried
    k, size = constants.elastic_start[i + 1] - start, group_size(factor)
    linear, angular = load_pair(work.tip_shape, start + a)
    for c in range(a):
        work.total[c] = -factor[first + c * width + a] * factor[first + c * width + c]
    for group in range(a - a % size, k, size):
        j = square + a * k + group
        total = fused(shift[0], load_lanes(constants.damping, j), load_lanes(constants.elastic_mass, j))
        total = fused(shift[1], load_lanes(constants.stiffness, j), total)
        if start + a >= constants.turning[i]:
            total = fused(linear[0], load_lanes(carried, group), total)
            total = fused(linear[1], load_lanes(carried, length + group), total)
            total = fused(linear[2], load_lanes(carried, 2 * length + group), total)
            total = fused(angular[0], load_lanes(carried, 3 * length + group), total)
            total = fused(angular[1], load_lanes(carried, 4 * length + group), total)
            total = fused(angular[2], load_lanes(carried, 5 * length + group), total)
        elif start + a >= constants.carrying[i]:
            total = fused(linear[0], load_lanes(carried, group), total)
        if len(constants.station_mass) > 0:
            total = stretch_mass(constants, work, i, a, group, total)
        for c in range(a):
            total = fused(work.total[c], load_lanes(factor, first + c * width + group), total)
        store_lanes(factor, first + a * width + group, total)


@inner
def coupling(constants, work, i, a):
    """Force and moment that elastic coordinate a of link i, accelerated, exerts on the frame."""
    start, length, carried = constants.elastic_start[i], constants.station_width[i], work.carried
    force = moment = ZERO
    if start + a >= constants.carrying[i]:
        force = carried[a], carried[length + a], carried[2 * length + a]
        moment = carried[3 * length + a], carried[4 * length + a], carried[5 * length + a]
    moment = add(add(moment, cross(load(work.tip, i), force)), load(work.coupling, start + a))
    return add(force, load(work.moment_shape, start + a)), moment


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
