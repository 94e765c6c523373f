"""Steps: planted errors in the kernels of the methods."""

from studies.planted.change import changes

METHODS, STEP = "simulation/test_methods.py", "simulation/test_implicit_step.py"
BITS = "simulation/test_calls.py::test_a_run_in_many_calls_has_the_bits_of_the_run_in_one"
OFTEN = f"{METHODS}::test_a_stiff_spring_that_has_turned_often_does_not_stop_an_implicit_method"

STEPS = (
    *changes(
        "kernels", "kernels/linearly_implicit.py", f"{STEP} {METHODS} simulation/test_drive.py",
        ("springs do not know the stages before", "shift[k] = g * fused(g, stage[d + k], v[k] + stage[k])",
         "shift[k] = g * fused(g, stage[d + k], v[k])"),
        ("every stage takes the drive at the start", "drive_at(table, time + tableau.abscissae[i] * step, work.drive)",
         "drive_at(table, time, work.drive)"),
        ("later stages keep the kinematics of the first", "moved = p > 0 or i > 0 or j == 0",
         "moved = p > 0 or j == 0", "no method has several stages and several sequences"),
        ("dampers do not know the stages before", "shift[d + k] = g * stage[d + k]", "shift[d + k] = 0.0"),
        ("held motors cost nothing", "supplied += prescribed_power(constants, work, v)", "supplied += 0.0"),
        ("losses of later stages are forgotten", "stage[2 * d + 1] = g * (lost + stage[2 * d + 1])",
         "stage[2 * d + 1] = g * lost"),
    ),
    *changes(
        "kernels", "kernels/implicit.py", f"{METHODS} simulation/test_simulator.py simulation/test_drive.py",
        ("generalised-alpha forgets its algorithmic accelerations",
         "averages.force * true[k] - averages.mass * old[k])\n        else",
         "averages.force * true[k])\n        else"),
        ("it starts without accelerations", "n = -1  #", "n = 0  #"),
        ("Newton's method stops early", "CONVERGED = 25, 1e-10", "CONVERGED = 25, 1e-3"),
        ("its ledger takes the power at the end", "0.5 * (power + true[k])", "power"),
        ("a new drive is taken for an old one", "old[k] += w[k] - true[k]", "old[k] = 0.0"),
    ),
    *changes(
        "kernels", "kernels/implicit.py", OFTEN,
        ("Newton's method does not end at rounding", " or 0.5 * before < largest < ROUNDING", ""),
    ),
    *changes(
        "kernels", "kernels/midpoint.py", f"{METHODS} simulation/test_midpoint.py simulation/test_drive.py",
        ("the drive at the start of the step", "drive_at(table, time + g, work.drive)",
         "drive_at(table, time, work.drive)"),
        ("its ledger leaves out held motors", "step * (supplied + power)", "step * supplied"),
        ("friction is taken at the start", "friction_shift(constants, work, work.shift[:d])",
         "friction_shift(constants, work, work.stage_state[:d])"),
        ("places by the speed before", "x[k], v[k] = state[k] + step * v[k], state[d + k] + step * w[k]",
         "x[k], v[k] = state[k] + step * state[d + k], state[d + k] + step * w[k]"),
    ),
    *changes(
        "kernels", "kernels/explicit.py", METHODS,
        ("places of the semi-implicit Euler method by the old speeds", "state[k] + h * work.trial[d + k]",
         "state[k] + h * state[d + k]"),
        ("stages take the drive at the start", "table, time + tableau.abscissae[i] * h,", "table, time,"),
    ),
    *changes(
        "kernels", "kernels/pace.py", f"{METHODS} simulation/test_simulator.py simulation/test_movers.py",
        ("an adaptive method begins anew every period", "if clock.rtol > 0.0 and work.pace[0] > 0.0:", "if False:"),
        ("errors are weighed by the old state alone", "max(abs(state[k]), abs(work.trial[k]))", "abs(state[k])"),
        ("no state is too large", "if not abs(state[j]) <= LARGEST_STATE:", "if not abs(state[j]) <= 1e300:"),
        ("a step that was cut sets the pace", "    if not last:\n        return h * factor\n",
         "    return h * factor\n"),
        ("steps that fail are taken", "    if not error <= 1.0:\n        return h * (max(",
         "    if not error <= 100.0:\n        return h * (max("),
    ),
    *changes(
        "kernels", "kernels/explicit.py", f"{BITS}[dopri5-None]",
        ("a run that goes on forgets its slope", "known = 1 if paused and adaptive else 0", "known = 0"),
    ),
    *changes(
        "kernels", "kernels/pace.py", f"{BITS}[rk4-0.001] {BITS}[dopri5-None]",
        ("a run that goes on begins its drive anew", "clock.time + (clock.first + r * clock.substeps + n) * clock.step",
         "clock.time + (r * clock.substeps + n) * clock.step"),
        ("a run that goes on begins its interval anew", "work.progress[1], work.progress[2]\n", "0.0, 0.0\n"),
    ),
    *changes(
        "kernels", "kernels/arms.py", "simulation/test_movers.py",
        ("a lane that diverges goes on", "status[arm] == OK and not lane_in_bounds(state, arm - first)", "False"),
    ),
    *changes(
        "kernels", "kernels/linalg.py", "simulation/test_effects.py",
        ("a wrong term in the series of the tangent", "1 / 2520 - z * dc", "1 / 25200 - z * dc"),
        ("the tangent of large bends is wrong", "(far_b - 3.0 * far_c)", "(far_b - 2.0 * far_c)"),
        ("the moment of a linear acceleration is not transposed",
         "add(apply_back(mixed, linear), apply(moment, angular))",
         "add(apply(mixed, linear), apply(moment, angular))"),
    ),
)  # fmt: skip
