"""Implicit methods: generalised-alpha and the midpoint rule, solved by Newton's method (`layout.Averages`).

Runs are as in `explicit`.
"""

from flexman_gym.kernels.compile import inner, kernel
from flexman_gym.kernels.dynamics import factorise, solve
from flexman_gym.kernels.forces import applied_forces, drive_at, friction_shift, friction_slopes, structural_forces
from flexman_gym.kernels.joints import prescribed_power
from flexman_gym.kernels.kinematics import positions, velocities
from flexman_gym.kernels.layout import DIVERGED, NOT_CONVERGED, OK, PAUSED
from flexman_gym.kernels.linalg import copy
from flexman_gym.kernels.outputs import observe
from flexman_gym.kernels.pace import out_of_bounds, pause, resume, step_time

ITERATIONS, CONVERGED = 25, 1e-10  # of an implicit step; the largest relative error that ends them
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
            time = step_time(clock, r, max(n, 0))
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
        n = 0
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
