"""Outputs of a state: tip motion, deflection, energies and tip accelerations."""

from flexman_gym.kernels.arguments import field
from flexman_gym.kernels.compile import inner, kernel
from flexman_gym.kernels.dynamics import factorise, solve
from flexman_gym.kernels.forces import applied_forces, spring_energy
from flexman_gym.kernels.foundation import base_gravity, base_spin, base_spin_rate
from flexman_gym.kernels.kinematics import compute_kinematics, tip_rotation
from flexman_gym.kernels.lanes import fma, is_zero
from flexman_gym.kernels.layout import (
    DEFLECTION_COLUMN,
    DEFLECTION_RATE_COLUMN,
    GRAVITATIONAL,
    JOINT_ENERGY,
    KINETIC,
    LINK_ENERGY,
    TIP_COLUMN,
    TIP_VELOCITY_COLUMN,
)
from flexman_gym.kernels.linalg import (
    IDENTITY,
    ZERO,
    add,
    add_scaled,
    apply,
    apply_transposed,
    copy,
    cross,
    dot,
    load,
    load_matrix,
    product,
)
from flexman_gym.kernels.rigid_arm import rigid_tip


@kernel
def compute_outputs(constants, work, x, v, out):
    """Call `set_outputs` with arrays of Python."""
    set_outputs(constants, work, field(x), field(v), field(out))


@inner
def set_outputs(constants, work, x, v, out):
    """Set out (OUTPUTS,) to the output row of `layout` at coordinates x and speeds v (d,).

    Deflection and deflection rate are relative to position and velocity of the tip of the rigid arm at the motor angles
    and rates; they vanish for an arm that does not deform.
    """
    compute_kinematics(constants, work, x, v)
    n = len(constants.mass)
    elastic = len(x) - constants.elastic_start[n]
    position, velocity, kinetic, gravitational = _chain_outputs(constants, work, v, elastic)
    if constants.rotating[0]:
        velocity = add_scaled(velocity, -1.0, cross(base_spin(constants, work), position))
    rigid, rate = rigid_tip(constants, x, v)
    for j in range(3):
        out[TIP_COLUMN + j], out[TIP_VELOCITY_COLUMN + j] = position[j], velocity[j]
        out[DEFLECTION_COLUMN + j], out[DEFLECTION_RATE_COLUMN + j] = position[j] - rigid[j], velocity[j] - rate[j]
    joints = 0.0
    for i in range(n):
        m = constants.motor[i]
        rotor_rate = v[i]
        if m >= 0:
            rotor_rate = v[m]
            joints += spring_energy(constants, i, x[m] - x[i])
        elif constants.passive[i]:
            joints += 0.5 * constants.passive_stiffness[i] * x[i] * x[i]
        if not is_zero(constants.carried_inertia[i]):
            rotor_rate += dot(load(constants.axis, i), load(work.spin, i)) - v[i]  # plus the rate of the carrying frame
        kinetic += 0.5 * constants.rotor_inertia[i] * rotor_rate * rotor_rate
    links = 0.0
    for i in range(n):
        links += 0.5 * _quadratic_form(constants.stiffness, constants, i, x, elastic)
    out[KINETIC], out[LINK_ENERGY], out[JOINT_ENERGY], out[GRAVITATIONAL] = kinetic, links, joints, gravitational


@inner
def compute_tip_accelerations(constants, work, x, v, out):
    """Set out to tip acceleration and specific force (m/s^2) at coordinates x and speeds v (d,) for inputs work.drive.

    The tip acceleration is the second time derivative of the tip position in the base frame, relative to the base. The
    specific force is the signal of an accelerometer: acceleration in inertial space minus gravity, along the axes of
    the tip section of the last link. Overwrites the first four groups of scratch arrays, work.rates and the first
    TIP_ACCELERATIONS numbers of out.
    """
    last = len(constants.mass) - 1
    compute_kinematics(constants, work, x, v)
    factorise(constants, work, (0.0, 0.0))
    applied_forces(constants, work, x, v)
    specific, _ = solve(constants, work, work.rates)
    linear = specific
    if constants.elastic_start[last + 1] > constants.elastic_start[last]:
        specific = apply_transposed(tip_rotation(work, last), specific)
    for i in range(last, -1, -1):
        linear = apply(load_matrix(work.rotation, i), linear)
    linear = add(linear, load(work.field, 0))
    if constants.rotating[0]:
        linear = add_scaled(linear, -1.0, _transport_acceleration(constants, work))
    out[0], out[1], out[2] = linear
    out[3], out[4], out[5] = specific


@inner
def _transport_acceleration(constants, work):
    """Return the acceleration of the tip minus that relative to a rotating base (m/s^2), in the base frame."""
    position, velocity = ZERO, load(work.tip_velocity, 0)
    for i in range(len(constants.mass) - 1, -1, -1):
        c = load_matrix(work.rotation, i)
        position, velocity = apply(c, add(load(work.tip, i), position)), apply(c, velocity)
    spin = base_spin(constants, work)
    turning = cross(spin, position)
    relative = add_scaled(velocity, -1.0, turning)
    result = add(cross(base_spin_rate(constants, work), position), cross(spin, turning))
    return add_scaled(result, 2.0, cross(spin, relative))


@kernel
def tip_accelerations(constants, work, x, v, drive, out):
    """Set out (TIP_ACCELERATIONS,) as `compute_tip_accelerations` for all numbers of work.drive, see `layout`."""
    copy(field(drive), work.drive)
    compute_tip_accelerations(constants, work, field(x), field(v), field(out))


@kernel
def total_energies(outputs, out):
    """Set out (b,) to kinetic + elastic + gravitational energy (J) of arms with outputs (b, OUTPUTS)."""
    for b in range(len(out)):
        moving = outputs[b, KINETIC] + outputs[b, JOINT_ENERGY]
        out[b] = moving + (outputs[b, LINK_ENERGY] + outputs[b, GRAVITATIONAL])


@kernel
def energy_residuals(rows, outputs, start, out):
    """Set out (b,) to work - dissipation - change of energy (J) of arms, from their energies (b,) at the start.

    Rows (b, 2 d + 2) are states (2 d), work and dissipation (J); outputs (b, OUTPUTS) are output rows.
    """
    total_energies(outputs, out)
    last = rows.shape[1] - 1
    for b in range(len(rows)):
        out[b] = rows[b, last - 1] - rows[b, last] - (out[b] - start[b])


@kernel
def update_energy_turnover(rows, outputs, out):
    """Raise the energy turnover out (b,) to kinetic + elastic energy, |work| or |dissipation| (J), if larger.

    The energy turnover, the largest of these magnitudes since the reset, is the scale of the energy residual.
    """
    last = rows.shape[1] - 1
    for b in range(len(rows)):
        moving = outputs[b, KINETIC] + outputs[b, JOINT_ENERGY] + outputs[b, LINK_ENERGY]
        for value in (moving, abs(rows[b, last - 1]), abs(rows[b, last])):
            if value > out[b] or value != value:  # NaN stays
                out[b] = value


@inner
def _quadratic_form(matrices, constants, i, rates, elastic):
    """Return r^T A r for matrix A (k, k) of link i in packed `matrices` and its elastic entries r of `rates` (d,)."""
    start, square = constants.elastic_start[i], constants.square_start[i]
    k = constants.elastic_start[i + 1] - start
    value = 0.0
    for a in range(k):
        for b in range(k):
            value += rates[elastic + start + a] * matrices[square + a * k + b] * rates[elastic + start + b]
    return value


@inner
def _chain_outputs(constants, work, v, elastic):
    """Return tip position and velocity (base frame), kinetic energy without rotors, and gravitational energy."""
    n = len(constants.mass)
    frame = IDENTITY
    origin = ZERO
    mass_moment = ZERO  # first moment of links and payload, base frame
    velocity = ZERO
    kinetic = 0.0
    for i in range(n):
        frame = product(frame, load_matrix(work.rotation, i))
        mass_moment = add(add_scaled(mass_moment, constants.mass[i], origin), apply(frame, load(work.moment, i)))
        kinetic += _link_energy(constants, work, i, v, elastic)
        velocity = _tip_velocity(constants, work, i, v, elastic)
        origin = add(origin, apply(frame, load(work.tip, i)))
    payload, moment, spin = constants.payload_mass[0], load(work.payload_moment, 0), load(work.payload_spin, 0)
    kinetic += 0.5 * payload * dot(velocity, velocity) + dot(velocity, cross(spin, moment))
    kinetic += 0.5 * dot(spin, apply(load_matrix(work.payload_rotary, 0), spin))
    velocity, mass_moment = apply(frame, velocity), add(mass_moment, apply(frame, moment))
    gravitational = -dot(base_gravity(constants, work), add_scaled(mass_moment, payload, origin))
    return origin, velocity, kinetic, gravitational


@inner
def _tip_velocity(constants, work, i, v, elastic):
    """Return the velocity of the tip of link i in its beam frame."""
    velocity = add(load(work.velocity, i), cross(load(work.spin, i), load(work.tip, i)))
    for a in range(constants.tip_start[i], constants.elastic_start[i + 1]):
        velocity = add_scaled(velocity, v[elastic + a], load(work.tip_shape, a))
    return velocity


@inner
def _link_energy(constants, work, i, v, elastic):
    """Return the kinetic energy of link i, 1/2 v^T M v with the blocks of M in Eq. 13 (paper: see `layout`)."""
    velocity, spin = load(work.velocity, i), load(work.spin, i)
    value = 0.5 * _quadratic_form(constants.elastic_mass, constants, i, v, elastic) + _axial_energy(constants, work, i)
    value += dot(velocity, cross(spin, load(work.moment, i))) + 0.5 * constants.mass[i] * dot(velocity, velocity)
    value += 0.5 * dot(spin, apply(load_matrix(work.inertia, i), spin))
    for a in range(constants.elastic_start[i], constants.elastic_start[i + 1]):
        momentum = dot(velocity, load(work.moment_shape, a)) + dot(spin, load(work.coupling, a))
        value = fma(v[elastic + a], momentum, value)
    return value


@inner
def _axial_energy(constants, work, i):
    """Return the kinetic energy (J) of axial station motion of link i, which elastic_mass does not contain."""
    value = 0.0
    for s in range(constants.station_start[i], constants.station_start[i + 1]):
        value += 0.5 * constants.station_mass[s] * work.axial_rate[s] * work.axial_rate[s]
    return value
