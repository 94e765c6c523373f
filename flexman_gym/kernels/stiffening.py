"""Stiffening: what foreshortening adds to the kinematics of a bent link.

A beam that bends keeps the length of its centreline, so a point at x moves back by 1/2 q^T G(x) q (the integral of half
the squared slopes). Every term here is an exact derivative of the positions of mass points, the stations, that stand
for the centreline (see `beam`): an expansion to second order loses the positive mass matrix at deflections of a few
percent of the length.

The stations of a link, its tip first, fill whole groups of LANES; those that fill up the last group have no mass.
"""

from flexman_gym.kernels.compile import inner
from flexman_gym.kernels.lanes import (
    add_products,
    add_rows,
    fma,
    gather_lanes,
    group_size,
    load_lanes,
    scatter_lanes,
    store_lanes,
)
from flexman_gym.kernels.linalg import dot, load


@inner
def foreshorten_tip(constants, work, i, x, elastic):
    """Puts the stations of link i in their places and adds foreshortening to the tip and its shape."""
    start, stop, first = constants.elastic_start[i], constants.elastic_start[i + 1], constants.station_start[i]
    count = constants.station_start[i + 1] - first
    width, row = constants.station_width[i], constants.station_row[i]
    for s in range(0, count, group_size(work.back)):
        place = _station_motion(constants, i, s, x, elastic)
        store_lanes(work.place, 3 * first + s, place[0])
        for c in range(1, 3):
            offset = load_lanes(constants.station_offset, 2 * first + (c - 1) * count + s)
            store_lanes(work.place, 3 * first + c * count + s, place[c] + offset)
        back = 0.0
        for a in range(start, stop):
            bend = _station_bend(constants, i, s, a, x, elastic)
            back = fma(-0.5 * x[elastic + a], bend, back)
            store_lanes(work.bend_stations, row + (a - start) * count + s, bend)
            scatter_lanes(work.bend, row + s * width + a - start, width, bend)
        store_lanes(work.back, first + s, back)
    for a in range(start, stop):
        work.tip_shape[a, 0] = constants.tip_translation[a, 0] - work.bend[row + a - start]
    if count > 0:
        work.tip[i, 0] += work.back[first]


@inner
def _station_motion(constants, i, s, rates, elastic):
    """Motion x, y, z of a group of stations of link i, from s on, by `rates` (d,), foreshortening left out."""
    count = constants.station_start[i + 1] - constants.station_start[i]
    x = y = z = 0.0
    start, value = constants.place_start, constants.place_row[i] + s
    for e in range(start[3 * i], start[3 * i + 1]):
        x = fma(rates[elastic + constants.place_source[e]], load_lanes(constants.place_value, value + e * count), x)
    for e in range(start[3 * i + 1], start[3 * i + 2]):
        y = fma(rates[elastic + constants.place_source[e]], load_lanes(constants.place_value, value + e * count), y)
    for e in range(start[3 * i + 2], start[3 * i + 3]):
        z = fma(rates[elastic + constants.place_source[e]], load_lanes(constants.place_value, value + e * count), z)
    return x, y, z


@inner
def _station_bend(constants, i, s, a, rates, elastic):
    """Row a of G times the elastic part of `rates` (d,) at a group of stations of link i, from s on."""
    count = constants.station_start[i + 1] - constants.station_start[i]
    bend, value = 0.0, constants.bend_row[i] + s
    for e in range(constants.bend_start[a], constants.bend_start[a + 1]):
        bend = fma(rates[elastic + constants.bend_source[e]], load_lanes(constants.bend_value, value + e * count), bend)
    return bend


@inner
def foreshorten_mass(constants, work, i):
    """Adds foreshortening to the moment shape and the coupling of link i; needs `foreshorten_tip`.

    Returns the change of the first moment along x, and of the entries xx, xy, xz of P.
    """
    first, row, width = constants.station_start[i], constants.station_row[i], constants.station_width[i]
    count, weight, total = constants.station_start[i + 1] - first, work.weight, work.total
    lost = xx = xy = xz = 0.0
    for s in range(0, count, group_size(work.back)):
        mass, back, j = load_lanes(constants.station_mass, first + s), load_lanes(work.back, first + s), 3 * first + s
        along = load_lanes(constants.station_position, first + s) + load_lanes(work.place, j)
        y, z, shift = load_lanes(work.place, j + count), load_lanes(work.place, j + 2 * count), mass * back
        j = 4 * first + s
        store_lanes(weight, j, shift)
        store_lanes(weight, j + count, mass * y)
        store_lanes(weight, j + 2 * count, mass * z)
        lost = add_products(lost, shift, 1.0)
        xx = add_products(xx, shift, 2.0 * along + back)
        xy, xz = add_products(xy, shift, y), add_products(xz, shift, z)
    for group in range(0, width, group_size(work.back)):
        moment = across_y = across_z = 0.0
        for s in range(0, count, group_size(work.back)):
            weights, j = 4 * first + s, row + s * width + group
            shift = load_lanes(weight, weights)
            moment = add_rows(moment, (load_lanes(constants.station_mass, first + s),), (work.bend,), j, width)
            factors, rows = (load_lanes(weight, weights + count), shift), (work.bend, constants.station_shape[1])
            across_y = add_rows(across_y, factors, rows, j, width)
            factors, rows = (load_lanes(weight, weights + 2 * count), shift), (work.bend, constants.station_shape[2])
            across_z = add_rows(across_z, factors, rows, j, width)
        store_lanes(total, group, moment)
        store_lanes(total, width + group, across_z)
        store_lanes(total, 2 * width + group, across_y)
    for j in range(row, row + count * width, group_size(work.back)):
        store_lanes(work.stretch, j, load_lanes(constants.station_shape[0], j) - load_lanes(work.bend, j))
    start = constants.elastic_start[i]
    for a in range(constants.elastic_start[i + 1] - start):
        work.moment_shape[start + a, 0] -= total[a]
        work.coupling[start + a, 1] -= total[width + a]
        work.coupling[start + a, 2] += total[2 * width + a]
    return lost, xx, xy, xz


@inner
def stretch_mass(constants, work, i, a, group, total):
    """total + what the axial motion of stations adds to a group of row a of the elastic mass matrix of link i."""
    first, width, stretch = constants.station_start[i], constants.station_width[i], work.stretch
    for s in range(0, constants.station_start[i + 1] - first, group_size(work.back)):
        j = constants.station_row[i] + s * width
        factors = load_lanes(constants.station_mass, first + s) * gather_lanes(stretch, j + a, width)
        total = add_rows(total, (factors,), (stretch,), j + group, width)
    return total


@inner
def foreshorten_forces(constants, work, i, v, elastic):
    """Adds the quadratic velocity forces of foreshortening to link i; needs `foreshorten_mass` at the same x."""
    first, row, width = constants.station_start[i], constants.station_row[i], constants.station_width[i]
    count, weight, w = constants.station_start[i + 1] - first, work.weight, load(work.spin, i)
    square = dot(w, w)
    force = moment_x = moment_y = moment_z = 0.0
    for s in range(0, count, group_size(work.back)):
        mass, back, j = load_lanes(constants.station_mass, first + s), load_lanes(work.back, first + s), 3 * first + s
        x = load_lanes(constants.station_position, first + s) + load_lanes(work.place, j) + back
        y, z = load_lanes(work.place, j + count), load_lanes(work.place, j + 2 * count)
        rate = _station_motion(constants, i, s, v, elastic)
        drawn, pulled = _station_rates(constants, work, i, s, v, elastic)
        store_lanes(work.rate, first + s, rate[0] + drawn)
        store_lanes(work.pulled, first + s, pulled)
        # 2 w x velocity: what foreshortening turns, and without it
        turn_y, turn_z = 2.0 * w[2] * drawn, -2.0 * w[1] * drawn
        plain_y, plain_z = 2.0 * (w[2] * rate[0] - w[0] * rate[2]), 2.0 * (w[0] * rate[1] - w[1] * rate[0])
        whole = w[0] * dot(w, (x, y, z)) - square * x + 2.0 * (w[1] * rate[2] - w[2] * rate[1]) + pulled
        j = 4 * first + s
        store_lanes(weight, j, mass * ((w[0] * w[0] - square) * back + pulled))
        store_lanes(weight, j + count, mass * (w[0] * w[1] * back + turn_y))
        store_lanes(weight, j + 2 * count, mass * (w[0] * w[2] * back + turn_z))
        store_lanes(weight, j + 3 * count, (-1.0 * mass) * whole)
        force = add_products(force, mass, pulled)
        moment_x = add_products(moment_x, mass * (y * turn_z - z * turn_y), 1.0)
        moment_y = add_products(moment_y, mass * (z * pulled - x * turn_z - back * plain_z), 1.0)
        moment_z = add_products(moment_z, mass * (x * turn_y - y * pulled + back * plain_y), 1.0)
    work.bias[i, 0] += force
    work.bias[i, 3] += moment_x
    work.bias[i, 4] += moment_y
    work.bias[i, 5] += moment_z
    for group in range(0, width, group_size(work.back)):
        total = 0.0
        for s in range(0, count, group_size(work.back)):
            weights, j = 4 * first + s, row + s * width + group
            factors = (
                load_lanes(weight, weights), load_lanes(weight, weights + count),
                load_lanes(weight, weights + 2 * count), load_lanes(weight, weights + 3 * count),
            )  # fmt: skip
            shapes = constants.station_shape
            total = add_rows(total, factors, (shapes[0], shapes[1], shapes[2], work.bend), j, width)
        store_lanes(work.total, group, total)
    start = constants.elastic_start[i]
    for a in range(constants.elastic_start[i + 1] - start):
        work.elastic_bias[start + a] += work.total[a]


@inner
def _station_rates(constants, work, i, s, v, elastic):
    """Rate of foreshortening, - q'^T G q, and - q'^T G q' at a group of stations of link i, from s on."""
    start, row = constants.elastic_start[i], constants.station_row[i] + s
    count = constants.station_start[i + 1] - constants.station_start[i]
    drawn = pulled = 0.0
    for a in range(start, constants.elastic_start[i + 1]):
        drawn = fma(-v[elastic + a], load_lanes(work.bend_stations, row + (a - start) * count), drawn)
        pulled = fma(-v[elastic + a], _station_bend(constants, i, s, a, v, elastic), pulled)
    return drawn, pulled


@inner
def stretch_energy(constants, work, i):
    """Kinetic energy that the elastic mass matrix of link i leaves out; needs `velocities`."""
    value = 0.0
    for s in range(constants.station_start[i], constants.station_start[i + 1]):
        value += 0.5 * constants.station_mass[s] * work.rate[s] * work.rate[s]
    return value


@inner
def stretch_forces(constants, work, i, rates, elastic, out):
    """Adds to out (d,) the forces for accelerations `rates` (d,) that the elastic mass matrix of link i leaves out."""
    start, first = elastic + constants.elastic_start[i], constants.station_start[i]
    k = constants.elastic_start[i + 1] - constants.elastic_start[i]
    for s in range(constants.station_start[i + 1] - first):
        row, force = constants.station_row[i] + s * constants.station_width[i], 0.0
        for a in range(k):
            force += constants.station_mass[first + s] * work.stretch[row + a] * rates[start + a]
        for a in range(k):
            out[start + a] += force * work.stretch[row + a]
