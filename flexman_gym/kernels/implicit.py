"""Implicit methods: generalised-alpha, implicit midpoint rule, two-stage Gauss method, all by Newton's method.

Generalised-alpha and the midpoint rule iterate until convergence (`layout.GeneralisedAlpha`). The midpoint rule and the
Gauss method of order 4 are also available with a fixed number of Newton iterations and without a test of convergence.
Steps are repeated by `batch.run_steps`.

Gauss method: with its matrix A, the stages x = x0 + h A v, v = v0 + h A w have accelerations w that solve M w = F(x,
v), one linear system of twice the size. A differs from the lower triangular matrix T below by the same number in all
entries. With T in place of A the stages are solved one after the other, each at the cost of a linearly implicit stage;
A - T multiplies the values of the previous iteration. An iteration then reduces the error by at least 87 % for a free
vibration of any frequency, and to zero for a stiff one (van der Houwen and Swart, Triangularly implicit iteration
methods for ODE-IVP solvers, SIAM J. Sci. Comput. 18, 41, 1997).
"""

from flexman_gym.kernels.compile import inner
from flexman_gym.kernels.dynamics import factorise, prescribed_power, solve
from flexman_gym.kernels.forces import (
    applied_forces,
    evaluate_drive,
    secant_friction,
    shift_forces,
    stage_forces,
    tangent_springs,
)
from flexman_gym.kernels.kinematics import compute_kinematics
from flexman_gym.kernels.lanes import fma, number_of


@inner
def midpoint_step(constants, work, method, table, span, state):
    """Set work.new_state to state (2 d,) and ledger (work, dissipation, J) after a step; return the evaluations.

    span = (start time, step), s; method = (number of iterations, correction), see `batch.fixed_step`.

    With g = step / 2 the accelerations w at the midpoint solve M w = F(x, v) at v = v0 + g w and x = x0 + g v. A Newton
    iteration evaluates M and F at the latest x and v, but springs and dampers at the unknown w, like a linearly
    implicit step. The first iteration starts from w = 0, so that a step depends on no earlier one, and a jump of the
    drive or a new start needs no special case. Accelerations of the previous step would reduce the error of the tip
    after a release by a third at most: they are a good guess for slow modes, but not for modes with omega h > 1 rad per
    step h.

    With a `correction` > 0, iterations after the first one add the force of `_corrected_springs`, scaled by it.
    """
    if method is None:
        return 0
    d, (time, step), (iterations, correction) = len(state) // 2 - 1, span, method
    g, w, x, v = 0.5 * step, work.rates, work.new_state[:d], work.new_state[d : 2 * d]
    springs = work.stage_state[:d]
    evaluate_drive(work, table, time + g)
    for k in range(d):
        work.stage_state[k], work.stage_state[d + k] = state[k] + g * state[d + k], state[d + k]
        w[k] = 0.0
    _update_midpoint(work, g, x, v)
    for n in range(iterations):
        _newton_iteration(constants, work, g, x, v, springs)
        if n == 0 and correction > 0.0:
            _corrected_springs(constants, work, g, correction, v)
            springs = work.stages[0][:d]
        _update_midpoint(work, g, x, v)
    # the ledger needs the power at the final x and v, not at those of the last iteration
    power = prescribed_power(constants, work, v)
    supplied, dissipated = applied_forces(constants, work, x, v)
    if correction > 0.0:
        dissipated -= _correction_power(constants, work, v)
    work.new_state[2 * d] = state[2 * d] + step * (supplied + power)
    work.new_state[2 * d + 1] = state[2 * d + 1] + step * dissipated
    for k in range(d):
        x[k], v[k] = state[k] + step * v[k], state[d + k] + step * w[k]
    return iterations


@inner
def _corrected_springs(constants, work, g, correction, v):
    """Set the coordinates (d,) at which springs act in the corrected midpoint rule, work.stages[0].

    The midpoint rule turns the phase of a vibration by 2 atan(omega h / 2) a step. It has order 4 in a linear system
    M w + C v + K x = 0 with the force (h^2 / 6) K w + (h^2 / 12) C j added, j the jerk: Numerov's rule, in the form of
    Stormer and Cowell (Hairer, Norsett and Wanner, Solving ODEs I, III.10). By itself this force is unstable for fast
    modes. With S = M + g C + g^2 K and g = h / 2, w is replaced by S^-1 M S^-1 (M w - C v / 2): the filters S^-1 M are
    one for slow modes and vanish for fast ones, which thereby move as with the midpoint rule, and half of C v takes the
    place of the jerk. work.rates (d,) are the accelerations w of the first iteration, whose factors are used again.
    """
    d = len(v)
    springs, w, position, speed = work.stages[0][:d], work.stages[1], work.stages[2][:d], work.stages[3][:d]
    for k in range(d):
        w[k] = work.rates[k]
        position[k] = fma(g * g, w[k], work.stage_state[k])
        speed[k] = 1.5 * fma(g, w[k], work.stage_state[d + k])
        work.shift[k] = fma(g, w[k], work.shift[k])
    stage_forces(constants, work, work.new_state[:d], v, position, speed, work.shift[:d])
    solve(constants, work, work.rates)
    for k in range(d):
        position[k], speed[k] = g * g * work.rates[k], g * work.rates[k]
    shift_forces(constants, work, position, speed)
    solve(constants, work, work.rates)
    for k in range(d):
        springs[k] = fma(-4.0 * correction * g * g, work.rates[k], work.stage_state[k])
        work.rates[k] = w[k]


@inner
def _correction_power(constants, work, v):
    """Return the power (W) of the force that `_corrected_springs` adds, at the speeds v (d,)."""
    d, power = len(v), 0.0
    change, zero = work.stages[2][:d], work.stages[3][:d]
    for k in range(d):
        change[k], zero[k], work.force[k] = work.stages[0][k] - work.stage_state[k], 0.0, 0.0
    shift_forces(constants, work, change, zero)
    for k in range(d):
        power = fma(work.force[k], v[k], power)
    return power


@inner
def _update_midpoint(work, g, x, v):
    """Set x and v (d,) at the midpoint from the accelerations work.rates, and work.shift[:d] to v0 - v."""
    d = len(x)
    for k in range(d):
        change = g * work.rates[k]
        x[k], v[k] = work.stage_state[k] + g * change, work.stage_state[d + k] + change
        work.shift[k] = -change


@inner
def _newton_iteration(constants, work, g, x, v, springs):
    """Set work.rates to the accelerations at the midpoint by one Newton iteration from x and v (d,).

    Springs act at the coordinates `springs` (d,) plus the displacement by the accelerations.
    """
    compute_kinematics(constants, work, x, v)
    tangent_springs(constants, work, x)
    secant_friction(constants, work, v)
    factorise(constants, work, (g, g * g))
    _solve_stage(constants, work, v, springs)


@inner
def _solve_stage(constants, work, v, springs):
    """Set work.rates to the accelerations at the speeds v (d,), springs at `springs` (d,), dampers at work.stage_state.

    Friction is evaluated at the speeds v + work.shift[:d], to first order.
    """
    d = len(v)
    stage_forces(constants, work, work.new_state[:d], v, springs, work.stage_state[d : 2 * d], work.shift[:d])
    solve(constants, work, work.rates)


GAUSS_NODE = 12.0**-0.5  # distance of a stage from the middle of the step, in steps
# T = (DIAGONAL, 0; LOWER, DIAGONAL); all entries of A - T are REMAINDER
DIAGONAL, LOWER, REMAINDER = GAUSS_NODE, 2.0 * GAUSS_NODE, 0.25 - GAUSS_NODE
FROZEN_ITERATIONS = 2  # iterations with the mass matrix of the first guess
RELAXATION = 1.03  # factor on their changes; least growth of an undamped vibration, see the tests


@inner
def gauss_step(constants, work, iterations, table, span, state):
    """Set work.new_state to the state and ledger after a step; return the evaluations, see `midpoint_step`.

    The first guess solves the stages with the mass matrix and forces at positions half a step ahead. A Newton iteration
    evaluates both anew at each stage. Rows of work.stages: rates of x and v of the two stages, then their sums.
    """
    if iterations is None:
        return 0
    d, (time, step) = len(state) // 2 - 1, span
    x, v, first, second = work.new_state[:d], work.new_state[d : 2 * d], work.stages[0], work.stages[1]
    evaluate_drive(work, table, time + 0.5 * step)
    _predict_stages(constants, work, step, state)
    g = DIAGONAL * step
    for n in range(iterations):
        _sum_stages(work, d)
        for i in range(2):
            evaluate_drive(work, table, time + (0.5 + (2 * i - 1) * GAUSS_NODE) * step)
            _explicit_part(work, i, step, state)
            _update_midpoint(work, g, x, v)
            _newton_iteration(constants, work, g, x, v, work.stage_state[:d])
            _relax_stage(work, i, g, 1.0)
            if n == iterations - 1:
                power = prescribed_power(constants, work, work.stages[i][:d])
                supplied, dissipated = applied_forces(constants, work, x, work.stages[i][:d])
                work.stages[i][2 * d], work.stages[i][2 * d + 1] = supplied + power, dissipated
    for k in range(len(state)):
        work.new_state[k] = state[k] + 0.5 * step * (first[k] + second[k])
    return 2 * iterations + 1


@inner
def _predict_stages(constants, work, step, state):
    """Set work.stages[:2] to the stages for the mass matrix and forces half a step ahead along the speeds."""
    d, g = len(state) // 2 - 1, 0.5 * step
    x, v, w = work.new_state[:d], work.new_state[d : 2 * d], work.rates
    for k in range(d):
        x[k], v[k] = state[k] + g * state[d + k], state[d + k]
        work.stage_state[k], work.stage_state[d + k] = x[k], v[k]
    compute_kinematics(constants, work, x, v)
    tangent_springs(constants, work, x)
    secant_friction(constants, work, v)
    factorise(constants, work, (g, g * g))
    _solve_frozen(constants, work, v)
    for i in range(2):
        for k in range(d):
            work.stages[i][k] = v[k] + (0.5 + (2 * i - 1) * GAUSS_NODE) * step * w[k]
            work.stages[i][d + k] = w[k]
    g = DIAGONAL * step
    factorise(constants, work, (g, g * g))
    for _ in range(FROZEN_ITERATIONS):
        _sum_stages(work, d)
        for i in range(2):
            _explicit_part(work, i, step, state)
            _solve_frozen(constants, work, v)
            _relax_stage(work, i, g, RELAXATION)


@inner
def _solve_frozen(constants, work, v):
    """Set work.rates to the accelerations at x, v of the last kinematics and springs at work.stage_state."""
    d = len(v)
    for k in range(d):
        work.shift[k] = work.stage_state[d + k] - v[k]
    _solve_stage(constants, work, v, work.stage_state[:d])


@inner
def _sum_stages(work, d):
    """Set work.stages[2] to the sums of the rates of both stages, d of x and d of v."""
    for k in range(2 * d):
        work.stages[2][k] = work.stages[0][k] + work.stages[1][k]


@inner
def _explicit_part(work, i, step, state):
    """Set work.stage_state to stage i without its own accelerations, and work.rates to its latest accelerations."""
    d, remainder, lower = len(state) // 2 - 1, REMAINDER * step, LOWER * step * i
    for k in range(d):
        speed = fma(remainder, work.stages[2][d + k], state[d + k])
        speed = fma(lower, work.stages[0][d + k], speed)
        work.stage_state[d + k] = speed
        position = fma(remainder, work.stages[2][k], state[k])
        position = fma(lower, work.stages[0][k], position)
        work.stage_state[k] = fma(DIAGONAL * step, speed, position)
        work.rates[k] = work.stages[i][d + k]


@inner
def _relax_stage(work, i, g, factor):
    """Set the rates of stage i to rates + factor (new - rates), with the rates `new` of the latest solution."""
    stage, d = work.stages[i], len(work.rates)
    for k in range(d):
        stage[k] = fma(factor, fma(g, work.rates[k], work.stage_state[d + k]) - stage[k], stage[k])
        stage[d + k] = fma(factor, work.rates[k] - stage[d + k], stage[d + k])


MAX_ITERATIONS = 25  # iterations per step
STAGNATION = 1e-7  # a smaller change that has stopped decreasing is rounding, e.g. of stiff springs after many turns


@inner
def converged_step(constants, work, method, table, span, state):
    """Set work.new_state to the state and ledger after a step; return the evaluations, see `midpoint_step`.

    `method` is a `layout.GeneralisedAlpha`. The Jacobian has the form of a linearly implicit step: mass matrix, damping
    and stiffness at the latest iterate. work.stages[0] and [1] hold the algorithmic and the true accelerations, then
    the two powers, initially zero. They are kept between steps, and a step of length zero adds the effect of a new
    drive. The number of evaluations is negative if the iterations do not converge.
    """
    if method is None:
        return 0
    time, h = span
    evaluate_drive(work, table, time + (0.5 * h if method.midpoint else h))
    speed_gain, position_gain = _predict(method, work, h, state)
    count = _newton_solution(constants, work, method.tolerance, (speed_gain, position_gain), len(state) // 2 - 1)
    _correct(method, work, h, speed_gain, position_gain, state)
    return count


@inner
def _predict(method, work, h, state):
    """Set work.stage_state to the stage without its accelerations w, and work.rates to the first guess of w.

    Returns the changes of speeds and coordinates of the stage per w. Generalised-alpha as in Arnold and Bruls (2007).
    """
    d = len(state) // 2 - 1
    algorithmic, true = work.stages[0], work.stages[1]
    if method.midpoint:
        for k in range(d):
            work.stage_state[k], work.stage_state[d + k] = state[k] + 0.5 * h * state[d + k], state[d + k]
            work.rates[k] = true[k]
        return 0.5 * h, 0.25 * h * h
    share = 1.0 / (1.0 - method.mass)
    for k in range(d):
        known_part = share * (method.force * true[k] - method.mass * algorithmic[k])
        offset = (0.5 - method.beta) * algorithmic[k] + method.beta * known_part
        work.stage_state[k] = state[k] + h * state[d + k] + h * h * offset
        work.stage_state[d + k] = state[d + k] + h * ((1.0 - method.gamma) * algorithmic[k] + method.gamma * known_part)
        work.rates[k] = true[k]
    weight = (1.0 - method.force) * share
    return h * method.gamma * weight, h * h * method.beta * weight


@inner
def _newton_solution(constants, work, tolerance, gains, d):
    """Solve for the accelerations work.rates of the stage; return the number of iterations, negative if not converged.

    Sets work.new_state to the stage, with the power supplied and dissipated in place of the ledger. `gains` are those
    of `_predict`. Derivatives do not take part in the test of convergence.
    """
    speed_gain, position_gain = gains
    x, v, shift, w = work.new_state[:d], work.new_state[d : 2 * d], work.shift, work.rates
    count, largest, ratio, converged = 0, 1.0, 1.0, False
    while count < MAX_ITERATIONS and largest < 1e30 and not converged:
        count, previous, previous_ratio = count + 1, largest, ratio
        for k in range(d):
            x[k] = work.stage_state[k] + position_gain * w[k]
            v[k] = work.stage_state[d + k] + speed_gain * w[k]
            shift[k], shift[d + k] = -position_gain * w[k], -speed_gain * w[k]
        compute_kinematics(constants, work, x, v)
        supplied, dissipated = applied_forces(constants, work, x, v)
        tangent_springs(constants, work, x)
        secant_friction(constants, work, v)
        shift_forces(constants, work, shift[:d], shift[d : 2 * d])
        factorise(constants, work, (speed_gain, position_gain))
        solve(constants, work, w)
        largest = 0.0
        for k in range(d):
            change = abs(number_of(position_gain * w[k] + shift[k])) / (1.0 + abs(number_of(x[k])))
            rate_change = abs(number_of(speed_gain * w[k] + shift[d + k])) / (1.0 + abs(number_of(v[k])))
            largest = max(largest, change, rate_change)
        # The remaining error is a geometric series of changes (Hairer and Wanner, Solving ODEs II, IV.8). After a large
        # first change, dominated by linear terms, the ratio is not yet reliable; therefore two ratios are compared.
        ratio = largest / previous
        largest_ratio = max(ratio, previous_ratio)
        small = count > 2 and largest_ratio < 0.5 and largest_ratio * largest <= (1.0 - largest_ratio) * tolerance
        converged = small or largest <= tolerance or 0.5 * previous < largest < STAGNATION
    work.new_state[2 * d] = supplied + prescribed_power(constants, work, v)
    work.new_state[2 * d + 1] = dissipated
    return count if converged else -count


@inner
def _correct(method, work, h, speed_gain, position_gain, state):
    """Set work.new_state to the state and ledger after the step, and store the accelerations for the next step."""
    d = len(state) // 2 - 1
    algorithmic, true, w = work.stages[0], work.stages[1], work.rates
    share = 1.0 / (1.0 - method.mass)
    for k in range(d):
        work.new_state[k] = work.stage_state[k] + position_gain * w[k]
        work.new_state[d + k] = work.stage_state[d + k] + speed_gain * w[k]
        if method.midpoint:
            work.new_state[k], work.new_state[d + k] = state[k] + h * work.new_state[d + k], state[d + k] + h * w[k]
        elif h > 0.0:
            algorithmic[k] = share * (
                (1.0 - method.force) * w[k] + method.force * true[k] - method.mass * algorithmic[k]
            )
        else:
            algorithmic[k] += w[k] - true[k]
        true[k] = w[k]
    for k in range(2 * d, 2 * d + 2):
        power = work.new_state[k]
        work.new_state[k] = state[k] + h * (power if method.midpoint else 0.5 * (power + true[k]))
        true[k] = power
