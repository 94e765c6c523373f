"""Co-design of an arm: thickness of its sections, gear ratios and PD gains that minimise a metric."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from flexman_gym.agent.pd import stability_limit
from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import one_of, vector, whole_number
from flexman_gym.common.errors import value_error
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.tasks.slew import Slew
from flexman_gym.metrics import BAND, SETTLING_WINDOW
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.link import MAX_SECTIONS
from flexman_gym.toolbox.controllers.margins import MIN_MARGINS
from flexman_gym.toolbox.controllers.pd_design import goal_postures
from flexman_gym.toolbox.sensitivity.design_gradients import DesignLoop, DesignModel, divide_links, resized

DESIGN_METRICS = {"frequency": "Hz", "mass": "kg", "settling": "s"}
KEPT = ("arm", "links")
MAX_ITERATIONS, STARTS = 200, 10  # iterations of a start, and starts
FUNCTION_TOLERANCE, START_TOLERANCE = 1e-11, 1e-8  # changes of the logarithm of the metric in the last iteration, start
MIN_GAIN = 0.01  # smallest gain as a fraction of the largest
START_GAINS = (0.3, 0.7)  # first stiffness and damping as fractions of the largest, for an arm without PD gains
POSTURES = 2  # number of goal postures for the settling time
SATURATION = 3.0  # largest stiffness times the largest slew / torque limit; the linear model has no saturation

Function = Callable[[Array], tuple[float, Array]]  # of the variables, with gradient


@dataclass(frozen=True)
class ArmDesign:
    """Arm of the smallest metric.

    Attributes:
        metric: name in DESIGN_METRICS.
        before: value of the metric for the given arm, with the best gains for "settling", in the unit of
            DESIGN_METRICS.
        after: value for the new arm.
        masses: masses of the links (n,) of the new arm without lumped masses, kg.
        thickness: thickness of the sections of each link, as factors of the given thickness.
        gears: (n,) factors of the gear ratios.
        environment: environment with the new arm, torque limits and gains.
        iterations: number of iterations.
        converged: True if the optimiser converged.
    """

    metric: str
    before: float
    after: float
    masses: tuple[float, ...]
    thickness: tuple[tuple[float, ...], ...]
    gears: tuple[float, ...]
    environment: Configuration
    iterations: int
    converged: bool


def optimise_arm(
    environment: str | Configuration,
    metric: str = "frequency",
    sections: int = 8,
    thickness: Vector = (0.5, 2.0),
    gears: Vector = (1.0, 1.0),
    keep: str = "arm",
    tip_force: Vector = (0.0, 0.0, 0.0),
) -> ArmDesign:
    """Optimise the arm of an environment by sequential quadratic programming with exact gradients.

    The metrics are those of the linear model about the undeformed arm: "frequency", the largest first natural frequency
    with held motors at zero joint angles, at the mass of the given arm; "mass", the least mass at the static deflection
    of the given arm at zero joint angles, under gravity and a tip force; "settling", the shortest settling time of the
    PD loop over slews of single joints to two goals of the environment, at the mass of the given arm. PD gains are
    varied for "settling" only, up to three times the torque limit at the start of the largest slew, and up to half the
    damping at which a sampled motor is unstable. Saturation and stress are not modelled.

    Args:
        environment: id, path of a file, or Configuration.
        metric: "frequency", "mass" or "settling".
        sections: number of equal sections into which each uniform link is divided, one finite element each.
        thickness: (2,) smallest and largest thickness of a section, as factors of the given thickness.
        gears: (2,) smallest and largest gear ratio, as factors of the given ratio, for "settling".
        keep: "arm" keeps the mass of the arm, "links" that of each link; "mass" ignores it.
        tip_force: (3,) force on the tip for "mass", N, base frame.

    Returns:
        The design and its environment.

    Raises:
        ValueError: for an unknown metric, bounds without 1, "mass" without a load, "settling" for a task other than
            slews, and for an arm with a rigid link, a passive joint or a motor driven by a voltage.
    """
    environment = Configuration.find(environment)
    motors = [joint.motor for joint in environment.arm.joints if joint.motor]
    if not all(link.flexible for link in environment.arm.links) or any(motor.resistance for motor in motors) or any(
        joint.passive for joint in environment.arm.joints
    ):  # fmt: skip
        allowed = "one whose links are flexible, whose joints have motors, and whose motors have no resistance"
        raise value_error("environment", environment.id, allowed)
    arm = divide_links(environment.arm, whole_number("sections", sections, 1, MAX_SECTIONS))
    force = np.array(vector("tip_force", tip_force, 3, "N"))
    low, high = np.log([_factors("thickness", thickness), _factors("gears", gears)]).T
    one_of("keep", keep, KEPT)
    loop, postures, start = None, np.zeros((1, arm.n_joints)), np.zeros(0)
    if one_of("metric", metric, DESIGN_METRICS) == "settling":
        loop, postures, start = _loop(environment)
    elif metric == "mass" and not force.any() and not np.any(arm.gravity):
        raise value_error("tip_force", tip_force, "a force (N) for an arm without gravity")
    design, kind = DesignModel(arm, postures), "eq" if keep == "links" and metric != "mass" else "ineq"
    count, n = len(design.sections), arm.n_joints
    largest = np.minimum(high[0], np.log(design.thickness_limits))
    gear_bounds, gain_bounds = (low[1], high[1]) if loop else (0.0, 0.0), (np.log(MIN_GAIN), 0.0)
    bounds = np.array([*((low[0], most) for most in largest), *[gear_bounds] * n, *[gain_bounds] * len(start)]).T
    x = np.concatenate([np.zeros(count + n), start])
    objective, constraint = _functions(design, metric, keep, force, loop)
    before, (found, iterations, converged) = objective(x)[0], _minimise(objective, constraint, kind, x, bounds)
    factors, ratios, shares = np.split(np.exp(found), (count, count + n))
    ends, sign = np.cumsum([len(link.sections) for link in arm.links])[:-1], -1.0 if metric == "frequency" else 1.0
    return ArmDesign(
        metric=metric,
        before=float(np.exp(sign * before)),
        after=float(np.exp(sign * objective(found)[0])),
        masses=tuple(design.link_masses(found[: count + n])[0].tolist()),
        thickness=tuple(tuple(part.tolist()) for part in np.split(factors, ends)),
        gears=tuple(ratios.tolist()),
        environment=_changed(environment, resized(arm, factors, ratios), ratios, loop, shares),
        iterations=iterations,
        converged=converged,
    )


def _factors(name: str, value: Vector) -> tuple[float, float]:
    """Return the smallest and the largest factor of a design variable."""
    low, high = vector(name, value, 2)
    if not 0.01 <= low <= 1.0 <= high <= 100.0:
        raise value_error(name, value, "the smallest factor, 0.01 to 1, and the largest, 1 to 100")
    return low, high


def _loop(environment: Configuration) -> tuple[DesignLoop, Array, Array]:
    """Return the PD loop of an environment, goal postures (r, n), rad, and logarithms (2 n,) of its gains."""
    arm, task, limits = environment.arm, environment.task, np.array(environment.torque_limit)
    if not isinstance(task, Slew):
        raise value_error("metric", "settling", "frequency or mass: the environment has no slews")
    rotors = np.array([joint.rotor_inertia for joint in arm.joints])
    if not rotors.all() or not (arm.stiffness_proportional_damping or all(arm.damping_ratios)):
        allowed = "frequency or mass: the arm lacks rotor inertia or damping of its links"
        raise value_error("metric", "settling", allowed)
    damping = stability_limit(environment.max_delay) * rotors / (MIN_MARGINS.gain * environment.control_period)
    reach = sum(link.length for link in arm.links)
    slews = np.full(arm.n_joints, task.slew / np.sqrt(3.0))  # root mean square of uniform slews
    loop = DesignLoop(slews, SATURATION * limits / task.slew, damping, (BAND * reach) ** 2 * SETTLING_WINDOW)
    try:
        gains = environment.pd_gains
        start = np.concatenate([gains["stiffness"] / loop.stiffness, gains["damping"] / loop.damping])
    except ValueError:  # no gains have the margins at this control period
        start = np.repeat(START_GAINS, arm.n_joints)
    return loop, goal_postures(environment)[0][:POSTURES], np.log(np.clip(start, MIN_GAIN, 1.0))


def _functions(
    design: DesignModel, metric: str, keep: str, force: Array, loop: DesignLoop | None
) -> tuple[Function, Function]:
    """Return the logarithm of the metric to be minimised and the constraints, >= 0, of the variables."""
    size = len(design.sections) + len(design.rotors)
    zero, guess = np.zeros(size), [1.0]
    links = np.eye(len(design.rotors)) if keep == "links" and metric != "mass" else np.ones((1, len(design.rotors)))

    def mass(x: Array) -> tuple[Any, Array]:
        masses, rows = (links @ each for each in design.link_masses(x[:size]))
        return np.log(masses), np.hstack([rows, np.zeros((len(rows), len(x) - size))]) / masses[:, None]

    def value(x: Array) -> tuple[float, Array]:
        if loop is not None:
            guess[0], slope = design.settling_time(x, loop, guess[0])
            return np.log(guess[0]), slope / guess[0]
        if metric == "mass":
            logarithm, rows = mass(x)
            return float(logarithm[0]), rows[0]
        hertz, slope = design.frequency(x)
        return -np.log(hertz), -slope / hertz

    def margin(x: Array) -> tuple[Any, Array]:
        if metric == "mass":
            metres, slope = design.deflection(x, force)
            return np.log([given / metres]), -slope[None] / metres
        logarithm, rows = mass(x)
        return given - logarithm, -rows

    given = design.deflection(zero, force)[0] if metric == "mass" else mass(zero)[0]
    return value, margin


def _minimise(objective: Function, constraint: Function, kind: str, x: Array, bounds: Array) -> tuple[Array, int, bool]:
    """Return the minimum, the number of iterations, and True if converged.

    Args:
        objective: function to be minimised, with gradient.
        constraint: functions that are 0 ("eq") or >= 0 ("ineq"), with Jacobian; they depend on the sections.
        kind: "eq" or "ineq".
        x: first guess.
        bounds: (2, v) smallest and largest variables; a variable with equal bounds is fixed.
    """
    from scipy.optimize import minimize

    free, low, high = bounds[0] < bounds[1], *bounds
    if not free.any():
        return x, 0, True

    def full(part: Array) -> Array:
        result = x.copy()
        result[free] = np.clip(part, low[free], high[free])
        return result

    def restricted(function: Function, part: Array) -> tuple[Any, Array]:
        value, slopes = function(full(part))
        return value, slopes[..., free]

    limits = {"type": kind, "fun": lambda part: restricted(constraint, part)[0],
              "jac": lambda part: restricted(constraint, part)[1]}  # fmt: skip
    best, iterations, converged = np.inf, 0, False
    for _ in range(STARTS):  # a start from the last result forgets the estimate of the curvature
        found = minimize(partial(restricted, objective), x[free], jac=True, method="SLSQP",
                         bounds=bounds[:, free].T, constraints=limits if free[0] else (),
                         options={"maxiter": MAX_ITERATIONS, "ftol": FUNCTION_TOLERANCE})  # fmt: skip
        x, iterations, gain = full(found.x), iterations + int(found.nit), best - found.fun
        best, converged = min(best, found.fun), bool(found.success)
        if gain < START_TOLERANCE:
            break
    return x, iterations, converged


def _changed(
    environment: Configuration, arm: Arm, ratios: Array, loop: DesignLoop | None, shares: Array
) -> Configuration:
    """Return the environment with a new arm, and with gains for the metric "settling"."""
    changes: dict[str, Any] = {"arm": arm}
    if environment.fidelity == "default":
        changes["elements"] = 1
    if "torque_limit" in environment.given:
        changes["torque_limit"] = (np.array(environment.torque_limit) * ratios).tolist()
    if loop is not None:
        stiffness, damping = np.split(shares, 2)
        gains = {"stiffness": loop.stiffness * ratios * stiffness, "damping": loop.damping * ratios**2 * damping}
        changes["gains"] = {name: gain.tolist() for name, gain in gains.items()}
    elif environment.base == "pd":
        changes["gains"] = environment.pd_gains
    return environment.replace(**changes)
