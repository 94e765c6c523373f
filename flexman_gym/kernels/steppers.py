"""Steppers: three families of one-step methods, each driven by coefficients (`layout.Tableau`, `layout.Averages`).

A run fills rows (r, 2 d + 2) with the state and the ledger after every interval of the clock, and outputs (r, OUTPUTS)
with what `observe` reads there. It returns a status, the rows that are valid and the number of evaluations. The state
that is passed in is advanced in place. `table` is that of the drive, see `layout`. Each family has its own loop, with
one call of the dynamics in it: compilers copy that call wherever it stands.
"""

from flexman_gym.kernels.dynamics import accelerate, factorise, solve
from flexman_gym.kernels.forces import applied_forces, drive_at, friction_shift, friction_slopes, structural_forces
from flexman_gym.kernels.joints import any_prescribed, prescribed_power
from flexman_gym.kernels.kinematics import positions, velocities
from flexman_gym.kernels.lanes import fused
from flexman_gym.kernels.layout import DIVERGED, NOT_CONVERGED, OK
from flexman_gym.kernels.linalg import copy, inner, kernel
from flexman_gym.kernels.outputs import observe
from flexman_gym.kernels.pace import LEAST_PACE, error_norm, first_pace, next_pace, next_step, out_of_bounds

ITERATIONS, CONVERGED = 25, 1e-10  # of an implicit step; the largest relative error that ends them
ROUNDING = 1e-7  # a change below it that no longer shrinks is rounding, of stiff springs after many turns for example


@inner
def slope(constants, work, table, time, state, out):
    """out (2 d + 2,) = time derivative of state and ledger."""
    d = len(state) // 2 - 1
    x, v = state[:d], state[d : 2 * d]
    drive_at(table, time, work.drive)
    out[2 * d], out[2 * d + 1] = accelerate(constants, work, x, v, out[d : 2 * d])
    for j in range(d):
        out[j] = v[j]


@kernel
def derivative(constants, work, table, time, state, out):
    """out (2 d + 2,) = time derivative of state and ledger, for integrators outside the kernels."""
    slope(constants, work, table, time, state, out)


@inner
def add_stages(state, step, weights, stages, count, out):
    """out = state + step * sum of weights[j] * stages[j] over the first `count` stages."""
    for k in range(len(state)):
        out[k] = state[k]
    for j in range(count):
        weight = step * weights[j]
        if weight != 0.0:
            for k in range(len(state)):
                out[k] = fused(weight, stages[j, k], out[k])


@kernel
def run_explicit(constants, work, tableau, table, clock, state, rows, outputs):
    """Steps of an explicit Runge-Kutta method, or of the semi-implicit Euler method."""
    d, s, evaluations, known = len(state) // 2 - 1, len(tableau.b), 0, 0
    adaptive = clock.rtol > 0.0
    pace = first_pace(work, clock)
    for r in range(len(rows)):
        n, done, last = 0, 0.0, clock.substeps == 0
        while not last:
            time, h, last = next_step(clock, r, n, done, pace)
            for i in range(known, s + adaptive):  # the slope after the step, if wanted, is stage s
                weights = tableau.a[i] if i < s else tableau.b
                add_stages(state, h, weights, work.stages, min(i, s), work.stage_state)
                slope(constants, work, table, time + tableau.abscissae[i] * h, work.stage_state, work.stages[i])
                evaluations += 1
            add_stages(state, h, tableau.b, work.stages, s, work.trial)
            if tableau.semi_implicit:
                for k in range(d):
                    work.trial[k] = state[k] + h * work.trial[d + k]
            if adaptive:
                for e in range(len(tableau.error)):
                    for k in range(len(state)):
                        work.estimate[e, k] = 0.0
                    add_stages(work.estimate[e], h, tableau.error[e], work.stages, s + 1, work.estimate[e])
                error = error_norm(work, len(tableau.error), clock, state)
                pace, known = next_pace(pace, h, last, error, tableau.order), 1
                if not error <= 1.0:
                    last = False
                    if pace < LEAST_PACE * clock.step * clock.substeps:
                        return (DIVERGED if out_of_bounds(work.trial) else NOT_CONVERGED), r, evaluations
                    continue
                copy(work.stages[s], work.stages[0])
            if out_of_bounds(work.trial):
                return DIVERGED, r, evaluations
            copy(work.trial, state)
            n, done = n + 1, done + h
        work.pace[0] = pace
        copy(state, rows[r])
        observe(constants, work, state[:d], state[d : 2 * d], outputs[r])
    return OK, len(rows), evaluations


@kernel
def run_linearly_implicit(constants, work, tableau, table, clock, state, rows, outputs):
    """Steps of a W-method whose approximate Jacobian holds damping and stiffness of links and joints, extrapolated."""
    d, evaluations = len(state) // 2 - 1, 0
    adaptive = clock.rtol > 0.0
    pace = first_pace(work, clock)
    for r in range(len(rows)):
        n, done, last = 0, 0.0, clock.substeps == 0
        while not last:
            time, h, last = next_step(clock, r, n, done, pace)
            evaluations += implicit_step(constants, work, tableau, table, (time, h), state)
            if adaptive:
                error = error_norm(work, 1, clock, state)
                pace = next_pace(pace, h, last, error, tableau.order)
                if not error <= 1.0:
                    last = False
                    if pace < LEAST_PACE * clock.step * clock.substeps:
                        return (DIVERGED if out_of_bounds(work.trial) else NOT_CONVERGED), r, evaluations
                    continue
            if out_of_bounds(work.trial):
                return DIVERGED, r, evaluations
            copy(work.trial, state)
            n, done = n + 1, done + h
        work.pace[0] = pace
        copy(state, rows[r])
        observe(constants, work, state[:d], state[d : 2 * d], outputs[r])
    return OK, len(rows), evaluations


@inner
def implicit_step(constants, work, tableau, table, moment, state):
    """work.trial = what follows the state; moment = (time, step). Returns the evaluations.

    Extrapolation takes the method in sequence[j] equal parts of the step, for each j, and adds the results with
    weights. All first parts start from the same state and share its kinematics.
    """
    s, parts, evaluations, (time, step) = len(tableau.b), tableau.sequence, 0, moment
    for j in range(len(parts)):
        copy(state, work.extrapolated[j])
    for p in range(parts[-1]):
        for j in range(len(parts)):
            if p >= parts[j]:
                continue
            part, start = step / parts[j], work.extrapolated[j]
            for i in range(s):
                moved = p > 0 or i > 0 or j == 0
                implicit_stage(constants, work, tableau, table, (time + p * part, part), start, i, moved)
                evaluations += 1
            add_stages(start, 1.0, tableau.b, work.stages, s, start)
    extrapolate(work, tableau, state)
    return evaluations


@inner
def extrapolate(work, tableau, state):
    """work.trial = the weighted results of all sequences; work.estimate[0] = the error that they show."""
    for k in range(len(state)):
        value = wrong = 0.0
        for j in range(len(tableau.sequence)):
            # differences from the state lose no digits to its size
            change = work.extrapolated[j, k] - state[k]
            value = fused(tableau.weights[j], change, value)
            wrong = fused(tableau.sequence_error[j], change, wrong)
        for e in range(len(tableau.error)):
            for i in range(len(tableau.b)):
                wrong += tableau.error[e, i] * work.stages[i, k]
        work.trial[k], work.estimate[0, k] = state[k] + value, wrong


@inner
def implicit_stage(constants, work, tableau, table, moment, state, i, moved):
    """Stage i of a W-method into work.stages[i]; moment = (time, step); `moved` if kinematics must be computed anew.

    With g = gamma step and r = sum of c_ij u_j / step, the stage u = (position part, speed part) solves
    u_x / g = v + u_v + r_x and M u_v / g = F(x, v) - K u_x - D u_v + M r_v. In w = u_v / g - r_v that is
    (M + g D + g^2 K) w = F with springs taken at x + g (v + r_x + g r_v) and dampers at v + g r_v: no product with M.
    D holds friction over rate at the start of the step.
    """
    d, size, (time, step) = len(state) // 2 - 1, len(state), moment
    g = tableau.gamma * step
    shift, stage = work.shift, work.stages[i]  # stage holds r until u is known
    add_stages(state, 1.0, tableau.a[i], work.stages, i, work.stage_state)
    for k in range(size):
        stage[k] = 0.0
    for j in range(i):
        weight = tableau.c[i, j] / step
        for k in range(size):
            stage[k] = fused(weight, work.stages[j, k], stage[k])
    x, v = work.stage_state[:d], work.stage_state[d : 2 * d]
    for k in range(d):
        shift[k] = g * fused(g, stage[d + k], v[k] + stage[k])
        shift[d + k] = g * stage[d + k]
    if moved:
        drive_at(table, time + tableau.abscissae[i] * step, work.drive)
        positions(constants, work, x)
        velocities(constants, work, v)
    supplied, lost = applied_forces(constants, work, x, v)
    if i == 0:
        friction_slopes(constants, work, v)
    for implicit in range(0 if any_prescribed(constants) else 1, 2):
        if implicit:
            structural_forces(constants, work, shift[:d], shift[d : 2 * d])
            friction_shift(constants, work, shift[d : 2 * d])
        factorise(constants, work, (g * implicit, g * g * implicit))
        solve(constants, work, work.rates)
        if not implicit:  # the torque of a prescribed motion needs the true accelerations
            supplied += prescribed_power(constants, work, v)
    for k in range(d):
        stage[d + k] = g * (work.rates[k] + stage[d + k])
        stage[k] = g * (v[k] + stage[k] + stage[d + k])
    stage[2 * d] = g * (supplied + stage[2 * d])
    stage[2 * d + 1] = g * (lost + stage[2 * d + 1])


@kernel
def run_implicit(constants, work, averages, table, clock, state, rows, outputs):
    """Fixed steps of the generalised-alpha method or of the implicit midpoint rule, by Newton's method.

    The Jacobian is that of a linearly implicit step, the mass matrix, damping and stiffness at the latest iterate.
    work.stages[0] and [1] hold the algorithmic and the true accelerations, followed by the two powers; zero at first.
    They outlive the run, so that the next one only adds what a new drive changes.
    """
    d, evaluations = len(state) // 2 - 1, 0
    ready = averages.midpoint  # otherwise the accelerations at the start come first, by a step of no length
    for r in range(len(rows)):
        n = 0 if ready or clock.substeps == 0 else -1
        while n < clock.substeps:
            h = clock.step if n >= 0 else 0.0
            time = clock.time + (r * clock.substeps + max(n, 0)) * clock.step
            drive_at(table, time + (0.5 * h if averages.midpoint else h), work.drive)
            by_rate, by_place = predict(averages, work, h, state)
            count = implicit_solution(constants, work, by_rate, by_place, state)
            evaluations += abs(count)
            correct(averages, work, h, by_rate, by_place, state)
            if out_of_bounds(work.trial):
                return DIVERGED, r, evaluations
            if count < 0:
                return NOT_CONVERGED, r, evaluations
            copy(work.trial, state)
            n += 1
        ready = True
        copy(state, rows[r])
        observe(constants, work, state[:d], state[d : 2 * d], outputs[r])
    return OK, len(rows), evaluations


@inner
def predict(averages, work, h, state):
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
def implicit_solution(constants, work, by_rate, by_place, state):
    """work.rates = accelerations w that the stage has by itself; returns the iterations, negative without success.

    work.trial = the stage that they lead to, with the two powers there in place of the ledger.
    """
    d = len(state) // 2 - 1
    place, speed, shift, w = work.trial[:d], work.trial[d : 2 * d], work.shift, work.rates
    count, largest, ratio, converged = 0, 1.0, 1.0, False
    while count < ITERATIONS and largest < 1e30 and not converged:
        count, before, ratio_before = count + 1, largest, ratio
        for k in range(d):
            place[k] = work.stage_state[k] + by_place * w[k]
            speed[k] = work.stage_state[d + k] + by_rate * w[k]
            shift[k], shift[d + k] = -by_place * w[k], -by_rate * w[k]
        positions(constants, work, place)
        velocities(constants, work, speed)
        supplied, lost = applied_forces(constants, work, place, speed)
        friction_slopes(constants, work, speed)
        structural_forces(constants, work, shift[:d], shift[d : 2 * d])
        friction_shift(constants, work, shift[d : 2 * d])
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
        small = count > 2 and rest < 0.5 and rest * largest <= (1.0 - rest) * CONVERGED
        converged = small or largest <= CONVERGED or 0.5 * before < largest < ROUNDING
    work.trial[2 * d] = supplied + prescribed_power(constants, work, speed)
    work.trial[2 * d + 1] = lost
    return count if converged else -count


@inner
def correct(averages, work, h, by_rate, by_place, state):
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
