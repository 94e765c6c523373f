"""Memory layout shared by the kernels: state, drive, constants, scratch arrays (work space), status; units SI, radians.

State. With n links, m flexible joints and k = k_1 + ... + k_n elastic coordinates there are d = n + m + k coordinates

    x = [joint angles (n), motor angles (m, flexible joints in ascending order), elastic coordinates (k, link by link)]

and speeds v = dx/dt in this order. A state is [x, v] (2 d,). A row (2 d + 2,) is a state with its energy ledger of two
numbers: the work done by motors and disturbances, and the energy dissipated, since the start (J).

Drive. The n + 6 inputs of the arm are n motor torques (N m), or accelerations (rad/s^2) of motors with prescribed
motion; 3 components of a force on the tip (N) and 3 of the acceleration of the base (m/s^2), both in the base frame. A
drive table (7, n + 6) gives the inputs as functions of time t: column j has the offset, amplitude, frequency (Hz),
phase (rad), start (s), stop (s) and slope of input j, which is offset + slope t + amplitude sin(2 pi frequency t +
phase) while start <= t < stop, and zero otherwise. Offset and amplitude have the unit of the input, slope that per s.

Rotating base. Gravity (m/s^2), angular velocity (rad/s) and angular acceleration of the base, all in the base frame,
follow the inputs in `Work.drive` (n + 15,). They are polynomials of time, given by a foundation row (FOUNDATION,): the
start of its interval (s), the length of the interval (s), and for the three components of gravity and then of the
angular velocity the coefficients of (t - start)^0 to (t - start)^FOUNDATION_DEGREE; the angular acceleration is the
derivative. Rows of inputs end with a foundation row (n + 6 + FOUNDATION,), drive tables with its numbers, by rows, in
FOUNDATION / 7 columns.

Equation numbers are those of the paper "Dynamic modeling and simulation of spatial manipulator with flexible links and
joints".

Symbols. Single capital letters have only these meanings:

    A  (3, 3) rotation from a link's beam frame to the base frame
    C  (3, 3) rotation from a link's beam frame to the beam frame of the previous link
    J  (3, 3) inertia tensor of a link about its origin
    K, M  stiffness and mass matrices
    L  length of a link
    P  (3, 3) integral of r r^T dm over a link
    R  (3,) origin of a link in the base frame
    S  (3, k) translation of a point of a link per unit elastic coordinate (shape functions), with columns S_a; S_t at
       the tip, and S_r rotation vector of the tip
    T  (3, 3) tangent operator of the rotation vector phi of the tip: angular velocity T phi'
    U  (3, 3) integral of r S_a^T dm for elastic coordinate a

In formulas, r is the position of a point of a link relative to its origin at the joint, r0 that without deformation, q
the elastic coordinates, w (`spin`) the angular velocity of a link, and ' a time derivative. A bias is the part of an
acceleration or force that depends on x and v only (velocity-product term). A moment is a torque; first and second
moments are those of mass.

Six-vectors begin with the linear part. All vectors of a link are in its beam frame, whose x axis is the undeformed
centreline. Matrices (k_i, k_i) of links are stored by rows one after the other and begin at `square_start[i]`; in
shapes, q is their number of entries, the sum of k_i^2. Rows of the k elastic coordinates begin at `elastic_start[i]`.
"""

from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
# Arrays with two axes, annotated with the number of columns, or 0 if it is not fixed; for faster code, see `arguments`.
Rows = Annotated[NDArray[np.float64], 0]
Vectors = Annotated[NDArray[np.float64], 3]
SixVectors = Annotated[NDArray[np.float64], 6]
IntArray = NDArray[np.int64]
Flags = NDArray[np.bool_]
SingleRows = Annotated[NDArray[np.float32], 0]
PerArm = Annotated[NDArray[np.float64], "per arm"]  # one axis; arms of a batch may differ in these constants

OK, DIVERGED, NOT_CONVERGED = 0, 1, 2  # status of an integration; index into STATUS
PAUSED = 3  # status between two kernel calls of a long integration; internal
STATUS = ("ok", "diverged", "not converged")

LARGEST_STATE = 1e6  # rad, m, rad/s, m/s; an integration with a larger coordinate or speed ends as diverged

LANES = 4  # neighbouring numbers in a SIMD group; rows of a factorisation are padded to whole groups
ARMS_PER_GROUP = 8  # number of arms that the kernels integrate at once, one in each lane

MAX_STAGES = 16  # largest number of stages of a method, including the evaluation at the end of the step
MAX_SEQUENCES = 8  # largest number of sequences of an extrapolation method

# Rotating base above.
FOUNDATION_DEGREE = 12
FOUNDATION_PART = FOUNDATION_DEGREE + 1  # coefficients of a polynomial
FOUNDATION = 84  # 2 + 6 FOUNDATION_PART, rounded up to a multiple of the 7 rows of a drive table
FOUNDATION_COLUMNS = FOUNDATION // 7

# Rows of a drive table, see Drive above.
OFFSET, AMPLITUDE, FREQUENCY, PHASE, START, STOP, SLOPE = 0, 1, 2, 3, 4, 5, 6

# Columns of an output row (OUTPUTS,): first column and slice of tip position and deflection (m), tip velocity and
# deflection rate (m/s), all in the base frame; kinetic energy, elastic energy of links and of joints, and gravitational
# energy (J).
TIP_COLUMN, TIP_VELOCITY_COLUMN, DEFLECTION_COLUMN, DEFLECTION_RATE_COLUMN = 0, 3, 6, 9
TIP, TIP_VELOCITY, DEFLECTION, DEFLECTION_RATE = (
    slice(first, first + 3) for first in (TIP_COLUMN, TIP_VELOCITY_COLUMN, DEFLECTION_COLUMN, DEFLECTION_RATE_COLUMN)
)
KINETIC, LINK_ENERGY, JOINT_ENERGY, GRAVITATIONAL = 12, 13, 14, 15
OUTPUTS = 16

# Columns of a row (TIP_ACCELERATIONS,) of tip accelerations (m/s^2), see `outputs.compute_tip_accelerations`.
TIP_ACCELERATION, SPECIFIC_FORCE = slice(0, 3), slice(3, 6)
TIP_ACCELERATIONS = 6


class Constants(NamedTuple):
    """Constants of a model with n links and k elastic coordinates; symbols as in the module, SI units."""

    motor: IntArray  # (n,) index of the motor angle in x, -1 for a rigid joint
    elastic_start: IntArray  # (n + 1,) first elastic coordinate of each link, then k
    square_start: IntArray  # (n + 1,) first entry of each link in packed matrices, then q
    gravity: Array  # (3,) acceleration of gravity, base frame
    mount: Array  # (9 n,) rotation between neighbouring beam frames at zero angle and deflection, by rows
    axis: Vectors  # (n, 3) joint axis in the frame of the outboard link
    joint_stiffness: PerArm  # (n,) beyond all knees of the torque-twist curve
    joint_damping: PerArm  # (n,)
    passive: IntArray  # (n,) 1 for a joint without motor, whose spring and damper join its link to the inboard link
    passive_stiffness: Array  # (n,) stiffness of this spring, relaxed at a joint angle of 0; 0 for joints with motor
    rotor_inertia: PerArm  # (n,)
    carried_inertia: PerArm  # (n,) rotor inertia if the rotor also turns with the inboard link, else 0 (Eq. 23)
    rotor_damping: PerArm  # (n,)
    coulomb_friction: PerArm  # (n,) zero in all arms where `has_coulomb_friction` is zero
    coulomb_rate: PerArm  # (n,) motor rate r in the Coulomb friction c tanh(rate / r)
    static_excess: PerArm  # (n,) static friction / Coulomb friction - 1
    stribeck_rate: PerArm  # (n,) motor rate at which half of this excess is left
    has_coulomb_friction: IntArray  # (n,) 1 for a joint with Coulomb friction, else 0
    # torque-twist curve of the joint springs, see `forces.spring_torque`; a linear spring has no knees
    knee_start: IntArray  # (n + 1,) first knee of each joint, then their number e
    knee_twist: PerArm  # (e,) rad; the first of a joint is half of its backlash
    knee_share: PerArm  # (e,) increase of the stiffness at the knee / joint_stiffness
    knee_width: Array  # (n,) rad; twist on either side of a knee over which the stiffness changes
    ripple_torque: PerArm  # (n,) amplitude of the torque ripple at the joint
    ripple_cycles: Array  # (n,) its radians per radian of the motor angle at the joint, gear ratio included
    ripple_phase: Array  # (n,) rad
    has_ripple: IntArray  # (n,) 1 for a motor with torque ripple, else 0
    prescribed: IntArray  # (n,) 1 for a motor with prescribed motion, else 0; set by a simulation, not by a model
    rotating: IntArray  # (1,) 1 for a base with prescribed rotation, else 0; set by a simulation, not by a model
    length: Array  # (n,)
    mass: Array  # (n,)
    first_moment: Vectors  # (n, 3) integral of r0 dm
    second_moment: Array  # (9 n,) integral of r0 r0^T dm, by rows
    first_moment_shape: Vectors  # (k, 3) integral of S_a dm
    position_shape: Array  # (9 k,) integral of r0 S_a^T dm, by rows
    # integral of S_b S_a^T dm as a sparse matrix: entry j of U increases by shape_value[e] times coordinate
    # shape_source[e], for shape_start[j] <= e < shape_start[j + 1]
    shape_start: IntArray  # (9 k + 1,)
    shape_source: IntArray
    shape_value: Array
    # integral of S_b x S_a dm as a sparse matrix like that of U, three numbers for each a
    cross_start: IntArray  # (3 k + 1,)
    cross_source: IntArray
    cross_value: Array
    factor_start: IntArray  # (n,) first entry of each link in `Work.factor`
    factor_width: IntArray  # (n,) k_i + 6, rounded up to a multiple of LANES
    tip_start: IntArray  # (n,) first elastic coordinate that moves the tip
    tip_linear_start: IntArray  # (n,) first one that moves it to first order; those before only by foreshortening
    # the next three end with LANES zeros, so that the last group may extend beyond the last row
    elastic_mass: Array  # (q + LANES,) without the contribution of the stations
    stiffness: PerArm  # (q + LANES,)
    damping: PerArm  # (q + LANES,)
    coupled: IntArray  # (n,) 1 for a link whose stiffness or damping matrix is not diagonal, else 0
    # foreshortening of the centreline, u_x -= 1/2 q^T G q at the s_i stations of link i, tip first; s_i is a multiple
    # of LANES, s = sum of s_i, b = sum of s_i station_width[i]. Empty arrays without foreshortening
    station_start: IntArray  # (n + 1,)
    station_width: IntArray  # (n,) k_i, rounded up to a multiple of LANES
    station_row: IntArray  # (n,) first of the b numbers of each link
    station_mass: Array  # (s,) mass of each station
    station_position: Array  # (s,) undeformed x of each station
    station_offset: Array  # (2 s,) for each link s_i values of y, then z: offset of lumped masses from the centreline
    station_shape: Rows  # (3, b) displacement of the stations per unit coordinate, rows x, y, z
    # these displacements as a sparse matrix: per unit of coordinate displacement_source[e], the stations of link i move
    # by the s_i values from displacement_row[i] + e s_i on
    displacement_start: IntArray  # (3 n + 1,) entries of x, y, z of each link
    displacement_row: IntArray  # (n,)
    displacement_source: IntArray
    displacement_value: Array
    # G as a sparse matrix: entry e of row a acts on coordinate bend_source[e], s_i values from bend_row[i] + e s_i on
    bend_start: IntArray  # (k + 1,) entries of each row of G
    bend_row: IntArray  # (n,)
    bend_source: IntArray
    bend_value: Array
    tip_translation: Vectors  # (k, 3) S_t
    tip_rotation: Vectors  # (k, 3) S_r
    payload_mass: PerArm  # (1,)
    payload_offset: Vectors  # (1, 3) centre of mass relative to the tip, in the payload frame
    payload_inertia: PerArm  # (9,) about the centre of mass, in the payload frame, by rows
    payload_mount: Array  # (9,) rotation from the payload frame to the beam frame of the undeformed last link, by rows


class Work(NamedTuple):
    """Work space of the kernels, one for each thread; symbols as in the module. Comments name the kernel of a group."""

    # positions (kinematics.compute_kinematics)
    rotation: Array  # (9 n,) C, by rows
    tip: Vectors  # (n, 3) position of the tip relative to the origin of the link
    rotation_vector: Vectors  # (n, 3) rotation vector phi = S_r q of the tip
    tangent: Rows  # (n, 4) two coefficients of T and their derivatives with respect to phi . phi
    tip_shape: SixVectors  # (k, 6) velocity and angular velocity of the tip per unit elastic speed: S_t and T S_r
    moment: Vectors  # (n, 3) first moment, integral of r dm
    inertia: Array  # (9 n,) J, by rows
    shape: Array  # (9 k,) U, by rows
    coupling: Vectors  # (k, 3) integral of r x S_a dm
    moment_shape: Vectors  # (k, 3) integral of S_a dm
    displacement: Array  # (3 s,) for each link s_i values of x, y, z: displacement of the stations without
    # foreshortening; y and z include station_offset
    foreshortening: Array  # (s,) - 1/2 q^T G q
    bend_stations: Array  # (b,) G q, for each link k_i rows of s_i
    bend: Array  # (b,) G q, for each link s_i rows of station_width[i]
    stretch: Array  # (b,) axial displacement of the stations per unit coordinate
    weight: Array  # (4 s,) weights of sums over stations, for each link four rows of s_i
    row_sums: Array  # (3 x largest station_width,) sums over stations; in a factorisation multipliers of rows
    payload_moment: Vectors  # (1, 3) first moment of the payload about the tip, in the frame of the last link
    payload_rotary: Array  # (9,) inertia of the payload about the tip, in the frame of the last link
    # velocities (kinematics.compute_kinematics)
    payload_spin: Vectors  # (1, 3) angular velocity of the payload
    payload_bias: SixVectors  # (1, 6) quadratic velocity force and torque of the payload
    spin: Vectors  # (n, 3) angular velocity
    velocity: Vectors  # (n, 3) velocity of the origin of the link
    rotor_bias: Vectors  # (n, 3) gyroscopic torque of a carried rotor
    tip_velocity: Vectors  # (1, 3) velocity of the tip of the last link
    joint_bias: Vectors  # (n, 3) bias of the angular acceleration of the link at its joint
    tip_bias: SixVectors  # (n, 6) bias of the acceleration of the tip relative to the link frame, Eq. 32, 33
    axial_rate: Array  # (s,) elastic velocity of the stations along x
    axial_bias: Array  # (s,) - q'^T G q', bias of the acceleration of the stations along x
    bias: SixVectors  # (n, 6) quadratic velocity force and torque, Eq. 14
    elastic_bias: Array  # (k,) quadratic velocity force on elastic coordinates, Eq. 14
    # factorisation (dynamics.factorise)
    articulated: Array  # (27 n,) articulated-body inertia of each link, joint free: three 3x3 blocks by rows
    carried: Array  # (6 x largest station_width,) inertia outboard of the tip of a link times tip_shape, by components
    # for each link k_i rows of factor_width[i]: R of the shifted M = R^T D^-1 R with its diagonal D inverted, then six
    # columns of the coupling with the frame
    factor: Array
    joint_column: SixVectors  # (n, 6) U = I^A S of Featherstone: articulated-body inertia times joint axis
    joint_pivot: Array  # (n,) D = S^T U of Featherstone: inertia about the joint axis, with the rotor
    spring: Array  # (n,) g damping + h stiffness of the joint for a shift (g, h) of the factorisation
    spring_slope: Array  # (n,) tangent stiffness of a joint spring with knees, N m/rad
    spring_offset: Array  # (n,) torque of its tangent at zero twist, N m
    motor_inertia: Array  # (n,) rotor inertia plus `spring` plus g friction_slope
    friction_slope: Array  # (n,) friction torque divided by motor rate (secant), N m s/rad
    # accelerations (forces and dynamics.solve)
    drive: Array  # (n + 6,) inputs at a time; (n + 15,) with a rotating base
    foundation: Array  # (FOUNDATION,) foundation row of a rotating base, else (0,)
    base_moment: Vectors  # (1, 3) moment on the first link about the base origin without acceleration of the base
    field: Vectors  # (1, 3) gravity minus the acceleration of the base, base frame
    tip_force: Vectors  # (1, 3) force on the tip, in the frame of the last link
    force: Array  # (d,) generalised forces of motors, friction, springs and dampers
    elastic_force: Array  # (k,) right-hand side of the elastic coordinates during the elimination
    joint_force: Array  # (n,) right-hand side of the joint angles during the elimination
    motor_torque: Array  # (n,) torque that produces a prescribed motion
    frame_acceleration: SixVectors  # (n, 6) of the link frame, with gravity as an upward acceleration of the base
    reaction: SixVectors  # (n + 1, 6) force and moment on each link at its origin, then on the payload at the last tip
    # integrators (implicit, runge_kutta)
    stages: Rows  # (MAX_STAGES, 2 d + 2) stages of a step
    stage_state: Array  # (2 d + 2,) state and ledger at which a stage is evaluated
    shift: Array  # (2 d + 2,) changes of x and v for the implicit parts of a stage
    new_state: Array  # (2 d + 2,) state and ledger at the end of the step
    rates: Array  # (d,) accelerations
    extrapolated: Rows  # (MAX_SEQUENCES, 2 d + 2) result of each sequence of an extrapolation
    error_estimate: Rows  # (2, 2 d + 2) one or two estimates of the local error
    row: Array  # (2 d + 2,) state and ledger of the arms of a batch
    outputs: Array  # (OUTPUTS,) outputs of the arms of a batch
    next_step: Array  # (1,) s; step size with which an adaptive integration continues, 0 before the first step
    progress: Array  # (2,) 1 and the seconds completed in the interval of a paused integration; else zeros
    drive_table: Rows  # (7, n + 6) drive table of the arms of a batch; with a rotating base and its foundation row


def make_work(constants: Constants, zeros: Callable[[tuple[int, ...]], Array] = np.zeros) -> Work:
    """Return new scratch arrays for a model, filled with zeros.

    Args:
        constants: constants of the model.
        zeros: function: shape -> array of zeros; for a batch an array with one number for each lane.
    """
    n, k, rotating = len(constants.mass), len(constants.first_moment_shape), int(constants.rotating[0])
    size = 2 * (n + int((constants.motor >= 0).sum()) + k) + 2
    rows = int((np.diff(constants.elastic_start) * constants.factor_width).sum())
    widest = int(constants.station_width.max())
    stations, rows_b = len(constants.station_mass), constants.station_shape.shape[1]
    shapes: dict[str, tuple[int, ...]] = {
        "rotation": (9 * n,), "tip": (n, 3), "rotation_vector": (n, 3), "tangent": (n, 4), "tip_shape": (k, 6),
        "moment": (n, 3), "inertia": (9 * n,), "shape": (9 * k,), "coupling": (k, 3), "spin": (n, 3),
        "moment_shape": (k, 3), "displacement": (3 * stations,), "foreshortening": (stations,),
        "bend_stations": (rows_b,), "bend": (rows_b,), "stretch": (rows_b,), "weight": (4 * stations,),
        "row_sums": (3 * widest,), "axial_rate": (stations,), "axial_bias": (stations,),
        "payload_moment": (1, 3), "payload_rotary": (9,), "payload_spin": (1, 3), "payload_bias": (1, 6),
        "velocity": (n, 3), "joint_bias": (n, 3), "rotor_bias": (n, 3), "tip_velocity": (1, 3),
        "tip_bias": (n, 6), "bias": (n, 6), "elastic_bias": (k,), "articulated": (27 * n,), "carried": (6 * widest,),
        "factor": (rows,), "joint_column": (n, 6), "joint_pivot": (n,), "spring": (n,),
        "spring_slope": (n,), "spring_offset": (n,), "motor_inertia": (n,), "friction_slope": (n,),
        "drive": (n + 6 + 9 * rotating,), "foundation": (FOUNDATION * rotating,), "base_moment": (1, 3),
        "field": (1, 3), "tip_force": (1, 3),
        "force": (size // 2 - 1,), "elastic_force": (k,), "joint_force": (n,), "motor_torque": (n,),
        "frame_acceleration": (n, 6), "reaction": (n + 1, 6),
        "stages": (MAX_STAGES, size), "stage_state": (size,), "shift": (size,), "new_state": (size,),
        "rates": (size // 2 - 1,), "extrapolated": (MAX_SEQUENCES, size), "error_estimate": (2, size), "row": (size,),
        "outputs": (OUTPUTS,), "next_step": (1,), "progress": (2,),
        "drive_table": (7, n + 6 + FOUNDATION_COLUMNS * rotating),
    }  # fmt: skip
    return Work(**{name: zeros(shape) for name, shape in shapes.items()})


class Period(NamedTuple):
    """Arrays of an environment with a single arm (b = 1) that change in a control period or decide it.

    They are those of the batch, the view, the sensors and the agent; see `control_period.finish_period`.
    """

    # action
    action: Rows  # (1, n) requested by the agent
    command: Rows  # (1, n) set to the action
    torque_limits: Rows  # (1, n) N m
    active: Flags  # (1,) True
    drive: Rows  # (1, n + 6)
    requested: Rows  # (1, n) commanded torques as fractions of the limits
    efforts: Array  # (1,) mean square of these
    # batch
    periods: Array  # (1,) control periods since the reset
    last_drive: Rows  # (1, n + 6)
    turnover: Array  # (1,) J
    # view
    start_energy: Array  # (1,) J
    target: Rows  # (1, 3) m
    reading_start: IntArray  # sparse matrix of the readings, see `control_period.sparse_product`
    reading_source: IntArray
    reading_value: Array
    motion: Rows  # (1, m)
    vectors: Rows  # (1, 6)
    scalars: Rows  # (5, 1)
    # sensors and agent
    motor_angles: Rows  # (1, n) rad
    tip_velocity: Rows  # (1, 3) m/s
    goal_angles: Rows  # (1, n) rad
    target_error: Rows  # (1, 3) m
    tip_error: Array  # (1,) m
    tip_vibration: Array  # (1,) m/s
    nearness_offset: Array  # (1,) m
    readings: Rows  # (1, s)
    observations: SingleRows  # (1, s)
    # end of an episode
    limits: Array  # (m,)
    bound: Array  # (s,)
    violated: Flags  # (1,)
    ages: IntArray  # (1,) control periods of the episode
    # reward
    reward: IntArray  # (1,) kind
    reward_parameters: Array
    reward_terms: Rows  # (REWARD_TERMS, 1)


class Tableau(NamedTuple):
    """Coefficients of a one-step method with s stages, explicit or linearly implicit.

    Explicit methods for y' = f(y): stage i evaluates k_i = f(y + h sum_j a_ij k_j), and the step adds h sum_i b_i k_i.
    Rows of `error` are weights of the k_i, with s + 1 columns, the last for f at the new state. Linearly implicit
    methods use the transformed variables u_i, with a_ij, b_i, c_ij and gamma as in Hairer and Wanner, Solving ODEs II,
    IV.7 (there m_i for b_i). An extrapolation is the weighted sum of the results with sequence[j] substeps in a step.
    """

    a: Array  # (s, s)
    b: Array  # (s,)
    c: Array  # (s, s) linearly implicit methods only
    abscissae: Array  # (s + 1,) times of the stages and of the end of the step, as fractions of the step
    error: Array  # (0 to 2, s + 1) explicit, (0 or 1, s) linearly implicit
    gamma: float
    order: int  # order of the error estimate plus 1, the inverse exponent of the step size control
    semi_implicit: bool  # True: coordinates advance with the new speeds
    sequence: IntArray  # (j,) numbers of substeps, ascending; (1,) without extrapolation
    weights: Array  # (j,) weights of the results of the sequences
    sequence_error: Array  # (j,) weights of the results in the error estimate


class GeneralisedAlpha(NamedTuple):
    """Coefficients of the generalised-alpha method (Chung and Hulbert 1993) or of the implicit midpoint rule."""

    mass: float  # alpha_m
    force: float  # alpha_f
    beta: float
    gamma: float
    midpoint: bool
    tolerance: float  # largest relative error of the solution of a step


def step_method(
    explicit: Tableau | None = None,
    linearly_implicit: Tableau | None = None,
    sequences: tuple[Tableau, Any, IntArray] | None = None,
    midpoint: tuple[int, float] | None = None,
    gauss: int | None = None,
    converged: GeneralisedAlpha | None = None,
) -> tuple[Any, ...]:
    """Return the argument `method` of the kernels: the argument of the step of one family, and None for the others.

    Args:
        explicit: tableau, see `runge_kutta.explicit_step`.
        linearly_implicit: tableau, see `runge_kutta.linearly_implicit_step`.
        sequences: tableau, address tables and schedule, see `runge_kutta.sequences_step`.
        midpoint: number of Newton iterations and correction, see `implicit.midpoint_step`.
        gauss: number of Newton iterations, see `implicit.gauss_step`.
        converged: coefficients, see `implicit.converged_step`.
    """
    return explicit, linearly_implicit, sequences, midpoint, gauss, converged


class StepGrid(NamedTuple):
    """Output times of an integration by fixed steps: a row after every interval of `substeps` steps.

    Attributes:
        time: start of step 0, s.
        step: length of a step, s.
        substeps: steps between two rows; 0 for the outputs at the start, without a step.
        row: index of the row at the end of the first interval.
    """

    time: float
    step: float
    substeps: int
    row: int = 0


class TimeGrid(NamedTuple):
    """Output times and step size control of an integration.

    The integration starts at `time` (s) and records the state after every interval of `substeps` steps of `step` (s).
    The step size follows the error estimated for tolerances rtol > 0 and atol, from `step` on; the output times do not
    change. A call returns after `max_evaluations` evaluations with status PAUSED; the next call passes the number of
    completed intervals, `first_row`.
    """

    time: float
    step: float
    substeps: int
    rtol: float
    atol: float
    first_row: int = 0
    max_evaluations: int = 2**62
