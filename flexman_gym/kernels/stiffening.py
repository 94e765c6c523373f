"""Stiffening: what foreshortening adds to the kinematics of a bent link.

A beam that bends keeps the length of its centreline, so a point at x moves back by 1/2 q^T G(x) q (the integral of half
the squared slopes). Every term here is an exact derivative of the positions of mass points, the stations, on that
centreline: an expansion to second order loses the positive mass matrix at deflections of a few percent of the length.
"""

from flexman_gym.kernels.linalg import add_scaled, inner, load, load_pair, store, store_pair


@inner
def shorten_mass(constants, work, i, x, elastic):
    """Adds foreshortening to U, the moments and the elastic mass matrix of link i.

    Returns the change of the first moment along x, and of the entries xx, xy, xz of P.
    """
    start = constants.elastic_start[i]
    k = constants.elastic_start[i + 1] - start
    bend_rates(constants, work, i, x, elastic)
    lost = xx = xy = xz = 0.0
    for s in range(constants.station_start[i], constants.station_start[i + 1]):
        row = constants.station_row[i] + (s - constants.station_start[i]) * k
        mass = constants.station_mass[s]
        place = (constants.station_position[s], 0.0, 0.0)
        back = 0.0
        for a in range(k):
            q = x[elastic + start + a]
            place = add_scaled(place, q, load(constants.station_shape, row + a))
            back -= 0.5 * q * work.bend[row + a]
        lost += mass * back
        xx += mass * back * (2.0 * place[0] + back)
        xy += mass * back * place[1]
        xz += mass * back * place[2]
        along = place[0] + back
        store(work.station, s, (along, place[1], place[2]))
        store_pair(work.weight, s, (mass * back, mass * along, mass * place[1]), (mass * place[2], mass, 0.0))
    for a in range(k):
        shorten_shape(constants, work, i, a)
    stretch_mass(constants, work, i)
    return lost, xx, xy, xz


@inner
def shorten_shape(constants, work, i, a):
    """Adds to U and to the moment shape of coordinate a of link i what the weighted stations hold."""
    first, k = constants.elastic_start[i], constants.elastic_start[i + 1] - constants.elastic_start[i]
    row, j = constants.station_row[i] + a, 9 * (first + a)
    xx = xy = xz = yx = zx = moment = 0.0
    for s in range(constants.station_start[i], constants.station_start[i + 1]):
        shape, bend = load(constants.station_shape, row), work.bend[row]
        (shift, along, y), (z, mass, _) = load_pair(work.weight, s)
        work.stretch[row] = shape[0] - bend
        xx += shift * shape[0] - along * bend
        xy += shift * shape[1]
        xz += shift * shape[2]
        yx += y * bend
        zx += z * bend
        moment += mass * bend
        row += k
    work.shape[j] += xx
    work.shape[j + 1] += xy
    work.shape[j + 2] += xz
    work.shape[j + 3] -= yx
    work.shape[j + 6] -= zx
    work.moment_shape[first + a, 0] -= moment


@inner
def stretch_mass(constants, work, i):
    """Adds the axial motion of the stations to the elastic mass matrix of link i, whose constant part left it out."""
    k = constants.elastic_start[i + 1] - constants.elastic_start[i]
    square, first = constants.square_start[i], constants.station_row[i]
    count = constants.station_start[i + 1] - constants.station_start[i]
    for a in range(k):
        for b in range(a, k):
            total = 0.0
            for s in range(count):
                row = first + s * k
                mass = constants.station_mass[constants.station_start[i] + s]
                total += mass * work.stretch[row + a] * work.stretch[row + b]
            work.elastic_mass[square + a * k + b] += total
            if b > a:
                work.elastic_mass[square + b * k + a] += total


@inner
def bend_rates(constants, work, i, rates, elastic):
    """work.bend = G times the elastic part of `rates` (d,) at all stations of link i."""
    k = constants.elastic_start[i + 1] - constants.elastic_start[i]
    rows = (constants.station_start[i + 1] - constants.station_start[i]) * k
    for j in range(constants.station_row[i], constants.station_row[i] + rows):
        work.bend[j] = 0.0
    for e in range(constants.bend_start[i], constants.bend_start[i + 1]):
        work.bend[constants.bend_target[e]] += constants.bend_value[e] * rates[elastic + constants.bend_source[e]]


@inner
def shorten_forces(constants, work, i, v, elastic):
    """Adds the quadratic velocity forces of foreshortening to link i; needs `shorten_mass` at the same x."""
    start = constants.elastic_start[i]
    k = constants.elastic_start[i + 1] - start
    bend_rates(constants, work, i, v, elastic)
    w = load(work.spin, i)
    for s in range(constants.station_start[i], constants.station_start[i + 1]):
        row = constants.station_row[i] + (s - constants.station_start[i]) * k
        mass = constants.station_mass[s]
        drawn = across_y = across_z = pulled = 0.0
        for a in range(k):
            rate = v[elastic + start + a]
            shape = load(constants.station_shape, row + a)
            drawn += rate * (work.stretch[row + a] - shape[0])
            across_y += rate * shape[1]
            across_z += rate * shape[2]
            pulled -= rate * work.bend[row + a]
        work.bias[i, 0] += mass * pulled
        work.bias[i, 4] += mass * pulled * work.station[s, 2]
        work.bias[i, 5] -= mass * pulled * work.station[s, 1]
        turned = w[1] * across_z - w[2] * across_y
        for a in range(k):
            shape = load(constants.station_shape, row + a)
            stretch = work.stretch[row + a]
            coriolis = drawn * (w[2] * shape[1] - w[1] * shape[2]) + (stretch - shape[0]) * turned
            work.elastic_bias[start + a] += mass * (2.0 * coriolis + pulled * stretch)


@inner
def shorten_tip(constants, work, i, x, elastic):
    """Adds foreshortening to the tip of link i and to its shape."""
    start, stop = constants.elastic_start[i], constants.elastic_start[i + 1]
    for a in range(start, stop):
        row = constants.square_start[i] + (a - start) * (stop - start) - start
        value = 0.0
        for b in range(start, stop):
            value += constants.tip_shortening[row + b] * x[elastic + b]
        work.tip_shape[a, 0] -= value
        work.tip[i, 0] -= 0.5 * value * x[elastic + a]


@inner
def shorten_tip_bias(constants, work, i, v, elastic):
    """Acceleration along x that the elastic speeds alone give the tip of link i, - q'^T G q'."""
    start, stop = constants.elastic_start[i], constants.elastic_start[i + 1]
    bias = 0.0
    for a in range(start, stop):
        row = constants.square_start[i] + (a - start) * (stop - start) - start
        for b in range(start, stop):
            bias -= v[elastic + a] * constants.tip_shortening[row + b] * v[elastic + b]
    return bias
