"""Implicit methods by Newton's method: generalised-alpha, implicit midpoint rule, Gauss method with two stages.

Generalised-alpha and the midpoint rule iterate to convergence (`layout.GeneralisedAlpha`); the midpoint rule and the
Gauss method of order 4 also with a fixed number of iterations and no test of convergence. Runs are as in `runge_kutta`.

Gauss method: with its matrix A, stages x = x0 + h A v, v = v0 + h A w have accelerations w that solve M w = F(x, v),
one linear system of twice the size. A differs from the lower triangular matrix T below by the same number in all
entries; with T in place of A the stages are solved one after the other, each at the cost of a linearly implicit stage,
and the missing part A - T is taken from the iteration before. A free vibration then loses at least 87 % of its error
in an iteration, whatever its frequency, and a stiff one all of it (van der Houwen and Swart, Triangularly implicit
iteration methods for ODE-IVP solvers, SIAM J. Sci. Comput. 18, 41, 1997).
"""

from flexman_gym.kernels.compile import inner, kernel
from flexman_gym.kernels.dynamics import factorise, prescribed_power, solve
from flexman_gym.kernels.forces import (
    applied_forces,
    apply_disturbance,
    evaluate_drive,
    motor_forces,
    secant_friction,
    shift_friction,
    structural_forces,
)
from flexman_gym.kernels.kinematics import positions, velocities
from flexman_gym.kernels.lanes import fma
from flexman_gym.kernels.layout import DIVERGED, NOT_CONVERGED, OK, PAUSED
from flexman_gym.kernels.linalg import copy
from flexman_gym.kernels.outputs import compute_outputs
from flexman_gym.kernels.runge_kutta import out_of_bounds, pause, resume, step_start


@inner
def _midpoint_step(constants, work, sweeps, table, moment, state):
    """work.trial = what follows the state and its ledger; moment = (time, step).

    With g = step / 2 the accelerations w in the middle solve M w = F(x, v) at v = v0 + g w and x = x0 + g v. A sweep
    takes M and F at the latest x and v, but springs and dampers at the w that it solves for, as a linearly implicit
    step does. The first one starts from w = 0: a step keeps nothing of those before it, so that a jump of the drive or
    a new start needs no care. Accelerations of the step before bring the tip at most a third nearer after a release:
    they are a good guess in slow modes, but none in those that turn by more than a radian in a step.
    """
    d, (time, step) = len(state) // 2 - 1, moment
    g, w, x, v = 0.5 * step, work.rates, work.trial[:d], work.trial[d : 2 * d]
    evaluate_drive(table, time + g, work.drive)
    for k in range(d):
        work.stage_state[k], work.stage_state[d + k] = state[k] + g * state[d + k], state[d + k]
        w[k] = 0.0
    _update_midpoint(work, g, x, v)
    for _ in range(sweeps):
        _newton_iteration(constants, work, g, x, v)
        _update_midpoint(work, g, x, v)
    # the ledger counts the power at the x and v that the step really takes, not at those of the last sweep
    power = prescribed_power(constants, work, v)
    supplied, lost = applied_forces(constants, work, x, v)
    work.trial[2 * d] = state[2 * d] + step * (supplied + power)
    work.trial[2 * d + 1] = state[2 * d + 1] + step * lost
    for k in range(d):
        x[k], v[k] = state[k] + step * v[k], state[d + k] + step * w[k]


@inner
def _update_midpoint(work, g, x, v):
    """x and v (d,) = the middle of the step for the accelerations work.rates; work.shift[:d] = what v lacks without."""
    d = len(x)
    for k in range(d):
        gained = g * work.rates[k]
        x[k], v[k] = work.stage_state[k] + g * gained, work.stage_state[d + k] + gained
        work.shift[k] = -gained


@inner
def _newton_iteration(constants, work, g, x, v):
    """work.rates = the accelerations in the middle of the step, from its latest x and v (d,)."""
    positions(constants, work, x)
    velocities(constants, work, v)
    secant_friction(constants, work, v)
    factorise(constants, work, (g, g * g))
    _solve_stage(constants, work, v)


@inner
def _solve_stage(constants, work, v):
    """work.rates = accelerations at the speeds v (d,) in work space, with springs and dampers at work.stage_state.

    Friction is that of the speeds v + work.shift[:d], to first order.
    """
    d = len(v)
    motor_forces(constants, work, v)
    shift_friction(constants, work, work.shift[:d])
    structural_forces(constants, work, work.stage_state[:d], work.stage_state[d : 2 * d])
    apply_disturbance(constants, work, v)
    solve(constants, work, work.rates)


GAUSS_NODE = 12.0**-0.5  # from the middle of a step to its stages, in steps
DIAGONAL, LOWER, REMAINDER = (
    GAUSS_NODE,
    2.0 * GAUSS_NODE,
    0.25 - GAUSS_NODE,
)  # T = (DIAGONAL, 0; LOWER, DIAGONAL), and all entries of A - T
FROZEN_ITERATIONS = 2  # iterations with the mass matrix of the first guess
RELAXATION = 1.03  # their changes are taken so many times, with which an undamped vibration grows least; see the tests


@inner
def _gauss_step(constants, work, sweeps, table, moment, state):
    """work.trial = what follows the state and its ledger; moment = (time, step).

    The first guess takes mass matrix and forces at positions half a step ahead, and solves the stages with these. A
    sweep takes them at each stage anew. Rows of work.stages: the rates of x and v in the stages, then sums of both.
    """
    d, (time, step) = len(state) // 2 - 1, moment
    x, v, first, second = work.trial[:d], work.trial[d : 2 * d], work.stages[0], work.stages[1]
    evaluate_drive(table, time + 0.5 * step, work.drive)
    _predict_stages(constants, work, step, state)
    g = DIAGONAL * step
    for n in range(sweeps):
        _sum_stages(work, d)
        for i in range(2):
            evaluate_drive(table, time + (0.5 + (2 * i - 1) * GAUSS_NODE) * step, work.drive)
            _explicit_part(work, i, step, state)
            _update_midpoint(work, g, x, v)
            _newton_iteration(constants, work, g, x, v)
            _relax_stage(work, i, g, 1.0)
            if n == sweeps - 1:
                power = prescribed_power(constants, work, work.stages[i][:d])
                supplied, lost = applied_forces(constants, work, x, work.stages[i][:d])
                work.stages[i][2 * d], work.stages[i][2 * d + 1] = supplied + power, lost
    for k in range(len(state)):
        work.trial[k] = state[k] + 0.5 * step * (first[k] + second[k])


@inner
def _predict_stages(constants, work, step, state):
    """work.stages[:2] = the stages with the mass matrix and forces half a step ahead along the speeds."""
    d, g = len(state) // 2 - 1, 0.5 * step
    x, v, w = work.trial[:d], work.trial[d : 2 * d], work.rates
    for k in range(d):
        x[k], v[k] = state[k] + g * state[d + k], state[d + k]
        work.stage_state[k], work.stage_state[d + k] = x[k], v[k]
    positions(constants, work, x)
    velocities(constants, work, v)
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
    """work.rates = accelerations at the positions and speeds v (d,) in work space, but springs at work.stage_state."""
    d = len(v)
    for k in range(d):
        work.shift[k] = work.stage_state[d + k] - v[k]
    _solve_stage(constants, work, v)


@inner
def _sum_stages(work, d):
    """work.stages[2] = the sums of the rates in both stages, d of x and d of v."""
    for k in range(2 * d):
        work.stages[2][k] = work.stages[0][k] + work.stages[1][k]


@inner
def _explicit_part(work, i, step, state):
    """work.stage_state = stage i for no accelerations of its own; work.rates = its latest accelerations."""
    d, rest, lower = len(state) // 2 - 1, REMAINDER * step, LOWER * step * i
    for k in range(d):
        before = fma(rest, work.stages[2][d + k], state[d + k])
        before = fma(lower, work.stages[0][d + k], before)
        work.stage_state[d + k] = before
        place = fma(rest, work.stages[2][k], state[k])
        place = fma(lower, work.stages[0][k], place)
        work.stage_state[k] = fma(DIAGONAL * step, before, place)
        work.rates[k] = work.stages[i][d + k]


@inner
def _relax_stage(work, i, g, relaxed):
    """Moves the rates of stage i by so many times the change to those of work.rates."""
    stage, d = work.stages[i], len(work.rates)
    for k in range(d):
        stage[k] = fma(relaxed, fma(g, work.rates[k], work.stage_state[d + k]) - stage[k], stage[k])
        stage[d + k] = fma(relaxed, work.rates[k] - stage[d + k], stage[d + k])


@kernel
def run_fixed_newton(constants, work, sweeps, table, clock, state, rows, outputs):
    """Fixed steps, each of a number of sweeps; `sweeps` as in `fixed_newton_step`."""
    d, evaluations = len(state) // 2 - 1, 0
    _, n, done = resume(work)
    for r in range(len(rows)):
        while n < clock.substeps:
            if evaluations >= clock.most:
                pause(work, n, done, 0.0)
                return PAUSED, r, evaluations
            evaluations += fixed_newton_step(
                constants, work, sweeps, table, (step_start(clock, r, n), clock.step), state
            )
            if out_of_bounds(work.trial):
                return DIVERGED, r, evaluations
            copy(work.trial, state)
            n += 1
        n = 0
        copy(state, rows[r])
        compute_outputs(constants, work, state[:d], state[d : 2 * d], outputs[r])
    return OK, len(rows), evaluations


@inner
def fixed_newton_step(constants, work, sweeps, table, moment, state):
    """work.trial = what follows the state and its ledger; moment = (time, step). Returns the evaluations.

    `sweeps` is their number and None for the midpoint rule, or a number for a pair of stages.
    """
    count, pair = sweeps
    return _dispatch_step(constants, work, count, pair, table, moment, state)


@inner
def _dispatch_step(constants, work, sweeps, pair, table, moment, state):
    """The same; Numba compiles one branch, as it looks for None among arguments only."""
    if pair is None:
        _midpoint_step(constants, work, sweeps, table, moment, state)
        evaluations = sweeps
    else:
        _gauss_step(constants, work, sweeps, table, moment, state)
        evaluations = 2 * sweeps + 1
    return evaluations


MOST_ITERATIONS, NEWTON_TOLERANCE = 25, 1e-10  # of an implicit step; the largest relative error that ends them
ROUNDING = 1e-7  # a change below it that no longer shrinks is rounding, of stiff springs after many turns for example


@kernel
def run_implicit(constants, work, averages, table, clock, state, rows, outputs):
    """Fixed steps of the generalised-alpha method or of the implicit midpoint rule, by Newton's method.

    The Jacobian is that of a linearly implicit step, the mass matrix, damping and stiffness at the latest iterate.
    work.stages[0] and [1] hold the algorithmic and the true accelerations, followed by the two powers; zero at first.
    They outlive the run, so that the next one only adds what a new drive changes.
    """
    d, evaluations = len(state) // 2 - 1, 0
    paused, n, done = resume(work)
    if not (paused or averages.midpoint or clock.substeps == 0):
        n = -1  # the accelerations at the start come first, by a step of no length
    for r in range(len(rows)):
        while n < clock.substeps:
            if evaluations >= clock.most:
                pause(work, n, done, 0.0)
                return PAUSED, r, evaluations
            h = clock.step if n >= 0 else 0.0
            time = step_start(clock, r, max(n, 0))
            evaluate_drive(table, time + (0.5 * h if averages.midpoint else h), work.drive)
            by_rate, by_place = _predict(averages, work, h, state)
            count = _newton_solution(constants, work, by_rate, by_place, state)
            evaluations += abs(count)
            _correct(averages, work, h, by_rate, by_place, state)
            if out_of_bounds(work.trial):
                return DIVERGED, r, evaluations
            if count < 0:
                return NOT_CONVERGED, r, evaluations
            copy(work.trial, state)
            n += 1
        n = 0
        copy(state, rows[r])
        compute_outputs(constants, work, state[:d], state[d : 2 * d], outputs[r])
    return OK, len(rows), evaluations


@inner
def _predict(averages, work, h, state):
    """work.stage_state = where the stage is without its accelerations w; returns what rates and places gain per w.

    work.rates gets the first guess of w. Generalised-alpha as Arnold and Bruls (2007) have it.
    """
    d = len(state) // 2 - 1
    old, true = work.stages[0], work.stages[1]
    if averages.midpoint:
        for k in range(d):
            work.stage_state[k], work.stage_state[d + k] = state[k] + 0.5 * h * state[d + k], state[d + k]
            work.rates[k] = true[k]
        return 0.5 * h, 0.25 * h * h
    share = 1.0 / (1.0 - averages.mass)
    for k in range(d):
        rest = share * (averages.force * true[k] - averages.mass * old[k])
        place = (0.5 - averages.beta) * old[k] + averages.beta * rest
        work.stage_state[k] = state[k] + h * state[d + k] + h * h * place
        work.stage_state[d + k] = state[d + k] + h * ((1.0 - averages.gamma) * old[k] + averages.gamma * rest)
        work.rates[k] = true[k]
    weight = (1.0 - averages.force) * share
    return h * averages.gamma * weight, h * h * averages.beta * weight


@inner
def _newton_solution(constants, work, by_rate, by_place, state):
    """work.rates = accelerations w that the stage has by itself; returns the iterations, negative without success.

    work.trial = the stage that they lead to, with the two powers there in place of the ledger.
    """
    d = len(state) // 2 - 1
    place, speed, shift, w = work.trial[:d], work.trial[d : 2 * d], work.shift, work.rates
    count, largest, ratio, converged = 0, 1.0, 1.0, False
    while count < MOST_ITERATIONS and largest < 1e30 and not converged:
        count, before, ratio_before = count + 1, largest, ratio
        for k in range(d):
            place[k] = work.stage_state[k] + by_place * w[k]
            speed[k] = work.stage_state[d + k] + by_rate * w[k]
            shift[k], shift[d + k] = -by_place * w[k], -by_rate * w[k]
        positions(constants, work, place)
        velocities(constants, work, speed)
        supplied, lost = applied_forces(constants, work, place, speed)
        secant_friction(constants, work, speed)
        structural_forces(constants, work, shift[:d], shift[d : 2 * d])
        shift_friction(constants, work, shift[d : 2 * d])
        factorise(constants, work, (by_rate, by_place))
        solve(constants, work, w)
        largest = 0.0
        for k in range(d):
            moved = abs(by_place * w[k] + shift[k]) / (1.0 + abs(place[k]))
            largest = max(largest, moved, abs(by_rate * w[k] + shift[d + k]) / (1.0 + abs(speed[k])))
        # What is left is a geometric series of changes (Hairer and Wanner, Solving ODEs II, IV.8). A first change that
        # is large by what is linear tells nothing of its ratio, therefore two ratios count.
        ratio = largest / before
        rest = max(ratio, ratio_before)
        small = count > 2 and rest < 0.5 and rest * largest <= (1.0 - rest) * NEWTON_TOLERANCE
        converged = small or largest <= NEWTON_TOLERANCE or 0.5 * before < largest < ROUNDING
    work.trial[2 * d] = supplied + prescribed_power(constants, work, speed)
    work.trial[2 * d + 1] = lost
    return count if converged else -count


@inner
def _correct(averages, work, h, by_rate, by_place, state):
    """work.trial = the state and ledger after the step; keeps the accelerations for the next one."""
    d = len(state) // 2 - 1
    old, true, w = work.stages[0], work.stages[1], work.rates
    share = 1.0 / (1.0 - averages.mass)
    for k in range(d):
        work.trial[k] = work.stage_state[k] + by_place * w[k]
        work.trial[d + k] = work.stage_state[d + k] + by_rate * w[k]
        if averages.midpoint:
            work.trial[k], work.trial[d + k] = state[k] + h * work.trial[d + k], state[d + k] + h * w[k]
        elif h > 0.0:
            old[k] = share * ((1.0 - averages.force) * w[k] + averages.force * true[k] - averages.mass * old[k])
        else:
            old[k] += w[k] - true[k]
        true[k] = w[k]
    for k in range(2 * d, 2 * d + 2):
        power = work.trial[k]
        work.trial[k] = state[k] + h * (power if averages.midpoint else 0.5 * (power + true[k]))
        true[k] = power
