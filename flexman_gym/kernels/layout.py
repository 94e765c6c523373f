"""The layout of the memory that the kernels share: state, constants, work space, status.

State. With n links, m flexible joints and k = k_1 + ... + k_n elastic coordinates there are d = n + m + k coordinates

    x = [joint angles (n), motor angles (m, of flexible joints in their order), elastic coordinates (k, link by link)]

and speeds v in the same order. A state is [x, v], 2 d numbers. Integrators append the ledger: two more numbers, the
work done by motors and disturbances and the energy dissipated since the start (J).

Drive. What moves the arm from outside is n + 6 numbers: the torque of each motor (N m), or its acceleration (rad/s^2)
where it is prescribed; the force on the tip (N) and the acceleration of the base (m/s^2), both in the base frame. Its
table (7, n + 6) has a column for each: offset + slope t + amplitude sin(2 pi frequency t + phase) while start <= t <
stop.

Symbols. Single capital letters stand for these and nothing else:

    A  (3, 3) rotation from a link's beam frame to the base frame
    C  (3, 3) rotation from a link's beam frame to the beam frame of the previous link
    J  (3, 3) second moment of mass (inertia) of a link about its origin
    K, M  stiffness and mass matrices
    L  length of a link
    P  (3, 3) integral of r r^T dm over a link
    R  (3,) origin of a link in the base frame
    S  shape functions; T tangent operator of the rotation vector (w = T phi')
    U  (3, 3) integral of r S_a^T dm for elastic coordinate a

Six-vectors hold the linear part first. All vectors of a link are in its beam frame. Blocks of k_i^2 entries, one per
link, are packed one after the other and start at `square_start[i]`; rows of the k elastic coordinates start at
`elastic_start[i]`.
"""

from collections.abc import Callable
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
# Arrays with two axes; the number of their columns, where it is always the same, helps the compiler (see `arms`).
Rows = Annotated[NDArray[np.float64], 0]
Vectors = Annotated[NDArray[np.float64], 3]
SixVectors = Annotated[NDArray[np.float64], 6]
IntArray = NDArray[np.int64]
PerArm = Annotated[NDArray[np.float64], "own"]  # one axis; each of several arms abreast has its own (see `arms`)

OK, DIVERGED, NOT_CONVERGED = 0, 1, 2
PAUSED = 3  # of a call that is not over, which nobody else sees
STATUS = ("ok", "diverged", "not converged")

# A coordinate or speed beyond this (rad, m, 1/s) is no motion of an arm: the run ends as diverged.
LARGEST_STATE = 1e6

LANES = 4  # neighbours that are one group; rows that are eliminated are padded to whole groups
ARMS_PER_GROUP = 8  # arms that one call moves at once

MAX_STAGES = 16  # the most stages of a method, with the evaluation at the end of the step
MAX_SEQUENCES = 8  # the most sequences of an extrapolation

OFFSET, AMPLITUDE, FREQUENCY, PHASE, START, STOP, SLOPE = 0, 1, 2, 3, 4, 5, 6

# Columns of an output row.
TIP_COLUMN, TIP_VELOCITY_COLUMN, DEFLECTION_COLUMN, DEFLECTION_RATE_COLUMN = 0, 3, 6, 9
TIP, TIP_VELOCITY, DEFLECTION, DEFLECTION_RATE = (
    slice(first, first + 3) for first in (TIP_COLUMN, TIP_VELOCITY_COLUMN, DEFLECTION_COLUMN, DEFLECTION_RATE_COLUMN)
)
KINETIC, LINK_ENERGY, JOINT_ENERGY, GRAVITATIONAL = 12, 13, 14, 15
OUTPUTS = 16

# Columns of a row of tip accelerations, see `tip`.
TIP_ACCELERATION, SPECIFIC_FORCE = slice(0, 3), slice(3, 6)
TIP_ACCELERATIONS = 6


class Constants(NamedTuple):
    """What the kernels read. n links, k elastic coordinates, q = sum of k_i^2; SI units."""

    motor: IntArray  # (n,) index of the motor coordinate in x, -1 for a rigid joint
    elastic_start: IntArray  # (n + 1,)
    square_start: IntArray  # (n + 1,)
    gravity: Array  # (3,)
    mount: Array  # (9 n,) by rows: rotation between neighbouring beam frames at zero angle and no deflection
    axis: Vectors  # (n, 3) joint axis in the frame of the link that it turns
    joint_stiffness: PerArm  # (n,)
    joint_damping: PerArm  # (n,)
    rotor_inertia: PerArm  # (n,)
    carried_inertia: PerArm  # (n,) of rotors that spin with the link that carries them, 0 of the others (Eq. 23)
    viscous_friction: PerArm  # (n,)
    coulomb_friction: PerArm  # (n,), 0 for all arms where `rubbing` is
    coulomb_rate: Array  # (n,)
    rubbing: IntArray  # (n,) 1 where a joint has Coulomb friction
    prescribed: IntArray  # (n,) 1 where the motion of a motor is prescribed; set by a run, not by a model
    length: Array  # (n,)
    mass: Array  # (n,)
    first_moment: Vectors  # (n, 3) integral of r0 dm
    second_moment: Array  # (9 n,) integral of r0 r0^T dm, by rows
    first_moment_shape: Vectors  # (k, 3) integral of S_a dm
    position_shape: Array  # (9 k,) integral of r0 S_a^T dm, by rows
    # integral of S_b S_a^T dm: number j of U gains value e times coordinate source e, for the entries e of j; most
    # vanish and are not kept
    shape_start: IntArray  # (9 k + 1,)
    shape_source: IntArray
    shape_value: Array
    # integral of S_b x S_a dm in the same way, three numbers for each a
    cross_start: IntArray  # (3 k + 1,)
    cross_source: IntArray
    cross_value: Array
    factor_start: IntArray  # (n,)
    factor_width: IntArray  # (n,) k_i + 6 in whole groups of LANES
    carrying: IntArray  # (n,) the first elastic coordinate that moves the tip; those before it do not
    turning: IntArray  # (n,) the first that does so without foreshortening; those before it move the tip along x alone
    # with LANES zeros behind, so that groups may reach past the last row
    elastic_mass: Array  # (q + LANES,) without the part of the stations
    stiffness: PerArm  # (q + LANES,)
    damping: PerArm  # (q + LANES,)
    # foreshortening of the centreline, u_x -= 1/2 q^T G q at the s_i stations of link i, tip first, in whole groups of
    # LANES; b numbers = s_i rows of station_width[i] for every link. Empty arrays without foreshortening
    station_start: IntArray  # (n + 1,)
    station_width: IntArray  # (n,) k_i in whole groups of LANES
    station_row: IntArray  # (n,) where the b numbers of each link start
    station_mass: Array  # (s,)
    station_position: Array  # (s,) along the link
    station_offset: Array  # (2 s,) of each link two rows of s_i, y and z: where lumped masses are beside the centreline
    station_shape: Rows  # (3, b) displacement of the stations per unit coordinate
    # the same without zeros: per unit of coordinate `source`, entry e moves the stations of its link by the s_i values
    # from place_row[i] + e s_i on
    place_start: IntArray  # (3 n + 1,) of x, y, z of each link
    place_row: IntArray  # (n,)
    place_source: IntArray
    place_value: Array
    # G in the same way
    bend_start: IntArray  # (k + 1,) of each row of G
    bend_row: IntArray  # (n,)
    bend_source: IntArray
    bend_value: Array
    tip_translation: Vectors  # (k, 3)
    tip_rotation: Vectors  # (k, 3)
    payload_mass: PerArm  # (1,)
    payload_offset: Vectors  # (1, 3) of its centre of mass from the tip, in the frame of a next joint
    payload_inertia: PerArm  # (9,) about its centre of mass, by rows
    payload_mount: Array  # (9,) rotation from the beam frame of the last link to that frame without deflection


class Work(NamedTuple):
    """What the kernels overwrite; one per thread. Filled by the pass that is named."""

    # positions
    rotation: Array  # (9 n,) C, by rows
    tip: Vectors  # (n, 3) tip of the link from its origin
    deflected: Vectors  # (n, 3) rotation vector S_r q of the tip
    tangent: Rows  # (n, 4) coefficients of T and their derivatives
    tip_shape: SixVectors  # (k, 6) motion of the tip per unit elastic speed: S_t and T S_r
    moment: Vectors  # (n, 3) integral of r dm
    inertia: Array  # (9 n,) J, by rows
    shape: Array  # (9 k,) U, by rows
    coupling: Vectors  # (k, 3) integral of r x S_a dm
    moment_shape: Vectors  # (k, 3) integral of S_a dm
    place: Array  # (3 s,) of each link three rows of s_i: displacement of the stations without foreshortening, along y
    # and z with their offset
    back: Array  # (s,) - 1/2 q^T G q
    bend_stations: Array  # (b,) of each link k_i rows of s_i: G q
    bend: Array  # (b,) of each link s_i rows of station_width[i]: G q
    stretch: Array  # (b,) axial displacement of the stations per unit coordinate
    weight: Array  # (4 s,) factors of a sum over stations, of each link four rows of s_i
    total: Array  # (largest 3 station_width,) such a sum; later the shares of rows in a factor
    payload_moment: Vectors  # (1, 3) first moment of the payload about the tip, in the frame of the last link
    payload_rotary: Array  # (9,) its inertia about the tip, there
    # velocities
    payload_spin: Vectors  # (1, 3) angular velocity of the payload
    payload_bias: SixVectors  # (1, 6) quadratic velocity force and torque of the payload
    spin: Vectors  # (n, 3) angular velocity
    velocity: Vectors  # (n, 3) velocity of the origin
    rotor_bias: Vectors  # (n, 3) gyroscopic torque of a carried rotor
    tip_velocity: Vectors  # (1, 3) of the last link
    joint_bias: Vectors  # (n, 3) angular acceleration of the link that no acceleration causes
    tip_bias: SixVectors  # (n, 6) acceleration of the tip that no acceleration causes
    rate: Array  # (s,) speed of the stations along x
    pulled: Array  # (s,) - q'^T G q'
    bias: SixVectors  # (n, 6) quadratic velocity force and torque, Eq. 14
    elastic_bias: Array  # (k,) quadratic velocity force on elastic coordinates, Eq. 14
    # factorisation
    articulated: Array  # (27 n,) inertia of link and everything outboard, joint free: three 3x3 blocks by rows
    carried: Array  # (6 x largest station_width,) inertia beyond the tip of one link times tip_shape, by components
    # k_i rows of factor_width[i]: R of the shifted M = R^T D^-1 R, its diagonal D inverted, then 6 columns of coupling
    factor: Array
    joint_column: SixVectors  # (n, 6) articulated inertia times joint axis
    joint_pivot: Array  # (n,) what the joint torque accelerates
    spring: Array  # (n,) implicit stiffness of the joint spring
    motor_inertia: Array  # (n,) of a rotor with its implicit spring and friction
    friction_slope: Array  # (n,) friction torque over motor rate
    # accelerations
    drive: Array  # (n + 6,)
    field: Vectors  # (1, 3) gravity less the acceleration of the base
    tip_force: Vectors  # (1, 3) in the frame of the last link
    force: Array  # (d,) generalised forces of motors, springs and dampers
    elastic_force: Array  # (k,)
    joint_force: Array  # (n,)
    motor_torque: Array  # (n,) that a prescribed motion takes
    frame_acceleration: SixVectors  # (n, 6) of the link's frame, gravity as an upward acceleration of the base
    reaction: SixVectors  # (n + 1, 6) force and moment that each link needs at its origin, the payload at the last tip
    # integrators
    stages: Rows  # (STAGES, 2 d + 2)
    stage_state: Array  # (2 d + 2,)
    shift: Array  # (2 d + 2,)
    trial: Array  # (2 d + 2,)
    rates: Array  # (d,)
    extrapolated: Rows  # (SEQUENCES, 2 d + 2)
    estimate: Rows  # (2, 2 d + 2)
    row: Array  # (2 d + 2,)
    outputs: Array  # (OUTPUTS,)
    pace: Array  # (1,) the step at which an adaptive run ended, 0 before
    progress: Array  # (3,) in the interval in which a run paused: 1, steps taken, seconds passed; zeros without a pause
    table: Rows  # (7, n + 6) of the drive, of arms abreast each of which has its own


def make_work(constants: Constants, zeros: Callable[[tuple[int, ...]], Array] = np.zeros) -> Work:
    """The work space of a model, allocated by `zeros`; every entry starts as zero."""
    n, k = len(constants.mass), len(constants.first_moment_shape)
    size = 2 * (n + int((constants.motor >= 0).sum()) + k) + 2
    rows = int((np.diff(constants.elastic_start) * constants.factor_width).sum())
    widest = int(constants.station_width.max())
    stations, rows_b = len(constants.station_mass), constants.station_shape.shape[1]
    shapes: dict[str, tuple[int, ...]] = {
        "rotation": (9 * n,), "tip": (n, 3), "deflected": (n, 3), "tangent": (n, 4), "tip_shape": (k, 6),
        "moment": (n, 3), "inertia": (9 * n,), "shape": (9 * k,), "coupling": (k, 3), "spin": (n, 3),
        "moment_shape": (k, 3), "place": (3 * stations,), "back": (stations,), "bend_stations": (rows_b,),
        "bend": (rows_b,), "stretch": (rows_b,), "weight": (4 * stations,),
        "total": (3 * widest,), "rate": (stations,), "pulled": (stations,),
        "payload_moment": (1, 3), "payload_rotary": (9,), "payload_spin": (1, 3), "payload_bias": (1, 6),
        "velocity": (n, 3), "joint_bias": (n, 3), "rotor_bias": (n, 3), "tip_velocity": (1, 3),
        "tip_bias": (n, 6), "bias": (n, 6), "elastic_bias": (k,), "articulated": (27 * n,), "carried": (6 * widest,),
        "factor": (rows,), "joint_column": (n, 6), "joint_pivot": (n,), "spring": (n,),
        "motor_inertia": (n,), "friction_slope": (n,), "drive": (n + 6,), "field": (1, 3), "tip_force": (1, 3),
        "force": (size // 2 - 1,), "elastic_force": (k,), "joint_force": (n,), "motor_torque": (n,),
        "frame_acceleration": (n, 6), "reaction": (n + 1, 6),
        "stages": (MAX_STAGES, size), "stage_state": (size,), "shift": (size,), "trial": (size,),
        "rates": (size // 2 - 1,), "extrapolated": (MAX_SEQUENCES, size), "estimate": (2, size), "row": (size,),
        "outputs": (OUTPUTS,), "pace": (1,), "progress": (3,), "table": (7, n + 6),
    }  # fmt: skip
    return Work(**{name: zeros(shape) for name, shape in shapes.items()})


class Tableau(NamedTuple):
    """Coefficients of a one-step method with s stages, as the kernels read them.

    Explicit methods: stage i starts from y + h sum a_ij k_j, the step adds h sum b_i k_i, error rows weigh k (s + 1
    columns: the last is the slope at the new state). Linearly implicit ones: in the transformed variables u of Hairer
    and Wanner (Solving ODEs II, IV.7), with the off-diagonal `c` and the diagonal `gamma`; extrapolation adds, with
    weights, the results of the method in sequence[j] parts of the step.
    """

    a: Array  # (s, s)
    b: Array  # (s,)
    c: Array  # (s, s) linearly implicit only
    abscissae: Array  # (s + 1,)
    error: Array  # (0 to 2, s + 1) explicit, (0 or 1, s) linearly implicit
    gamma: float
    order: int  # of the error estimate plus one: the exponent of step size control
    semi_implicit: bool  # places follow the new speeds
    sequence: IntArray  # (j,) ascending
    weights: Array  # (j,)
    sequence_error: Array  # (j,)


class GeneralisedAlpha(NamedTuple):
    """Coefficients of an implicit step: generalised-alpha (Chung and Hulbert 1993), or the midpoint rule."""

    mass: float  # alpha_m
    force: float  # alpha_f
    beta: float
    gamma: float
    midpoint: bool


class TimeGrid(NamedTuple):
    """When a run takes place: it starts at `time` (s) and records after every `substeps` steps of `step` (s).

    With rtol > 0 it chooses its steps by their error, beginning with `step`, and records at the same times. It pauses
    after `most` evaluations; a call that goes on has in `first` the number of steps of the clock that have passed.
    """

    time: float
    step: float
    substeps: int
    rtol: float
    atol: float
    first: int = 0
    most: int = 2**62
