"""Co-design of an arm: thickness of its sections, gear ratios and PD gains that minimise a metric."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.checks import one_of, value_error, vector, whole_number
from flexman_gym.control.pd import stability_limit
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.tasks.slew import Slew
from flexman_gym.evaluation.optimisation import MIN_MARGINS, goal_postures
from flexman_gym.metrics import BAND, SETTLING_WINDOW
from flexman_gym.model.design_gradients import DesignLoop, DesignModel, divide_links, resized, thickness_limit
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.link import MAX_SECTIONS

DESIGN_METRICS = {"frequency": "Hz", "mass": "kg", "settling": "s"}
KEPT = ("arm", "links")
MAX_ITERATIONS = 500
FUNCTION_TOLERANCE = 1e-13  # change of the logarithm of the metric in the last iteration
MIN_GAIN = 0.01  # smallest gain as a fraction of the largest
START_GAINS = (0.3, 0.7)  # first stiffness and damping as fractions of the largest, for an arm without tuned gains
POSTURES = 2  # number of goal postures for the settling time

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
    varied for "settling" only, up to the torque limit at the start of the largest slew, and up to half the damping at
    which a sampled motor is unstable. Stress is not limited.

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
        ValueError: for an unknown metric, bounds without 1, "mass" without a load, and "settling" for a task other than
            slews.
    """
    environment = Configuration.find(environment)
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
    largest = np.minimum(high[0], np.log([thickness_limit(section) for section in design.sections]))
    bounds = [(low[0], most) for most in largest] + [(low[1], high[1]) if loop else (0.0, 0.0)] * n
    bounds += [(np.log(MIN_GAIN), 0.0)] * len(start)
    x = np.concatenate([np.zeros(count + n), start])
    objective, constraint = _functions(design, metric, keep, force, loop)
    before, (found, iterations, converged) = objective(x)[0], _minimise(objective, constraint, kind, x, bounds)
    factors, ratios = np.exp(found[:count]), np.exp(found[count : count + n])
    sign = -1.0 if metric == "frequency" else 1.0
    return ArmDesign(
        metric, float(np.exp(sign * before)), float(np.exp(sign * objective(found)[0])),
        tuple(design.link_masses(found[: count + n])[0].tolist()),
        tuple(tuple(part.tolist()) for part in np.split(factors, np.cumsum([len(link.sections) for link in arm.links])[:-1])),
        tuple(ratios.tolist()), _changed(environment, resized(arm, factors, ratios), ratios, loop, np.exp(found[count + n :])),
        iterations, converged,
    )  # fmt: skip


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
    loop = DesignLoop(slews, limits / task.slew, damping, (BAND * reach) ** 2 * SETTLING_WINDOW)
    try:
        gains = environment.pd_gains
        start = np.concatenate([gains["stiffness"] / loop.stiffness, gains["damping"] / loop.damping])
    except ValueError:  # no gains are known for this arm
        start = np.repeat(START_GAINS, arm.n_joints)
    return loop, goal_postures(environment)[0][:POSTURES], np.log(np.clip(start, MIN_GAIN, 1.0))


def _functions(
    design: DesignModel, metric: str, keep: str, force: Array, loop: DesignLoop | None
) -> tuple[Function, Function]:
    """Return the logarithm of the metric to be minimised and the constraints, >= 0, of the variables."""
    size = len(design.sections) + len(design.rotors)
    zero, guess = np.zeros(size), [1.0]
    by_link = keep == "links"

    def mass(x: Array) -> tuple[Any, Array]:
        masses, rows = design.link_masses(x[:size])
        masses, rows = (masses, rows) if by_link and metric != "mass" else (masses.sum(keepdims=True), rows.sum(axis=0, keepdims=True))
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


def _minimise(
    objective: Function, constraint: Function, kind: str, x: Array, bounds: Sequence[tuple[float, float]]
) -> tuple[Array, int, bool]:
    """Return the minimum under bounds and constraints, >= 0 ("ineq") or 0 ("eq"), iterations, and True if converged."""
    from scipy.optimize import minimize

    limits = {"type": kind, "fun": lambda x: constraint(x)[0], "jac": lambda x: constraint(x)[1]}
    found = minimize(objective, x, jac=True, method="SLSQP", bounds=bounds, constraints=limits,
                     options={"maxiter": MAX_ITERATIONS, "ftol": FUNCTION_TOLERANCE})  # fmt: skip
    return np.clip(found.x, *np.transpose(bounds)), int(found.nit), bool(found.success)


def _changed(
    environment: Configuration, arm: Arm, ratios: Array, loop: DesignLoop | None, shares: Array
) -> Configuration:
    """Return the environment with a new arm, and with gains for the metric "settling"."""
    changes: dict[str, Any] = {"arm": arm}
    if environment.fidelity == "default":
        changes["elements"] = 1
    if "torque_limit" in environment.settings:
        changes["torque_limit"] = (np.array(environment.torque_limit) * ratios).tolist()
    if loop is not None:
        stiffness, damping = np.split(shares, 2)
        gains = {"stiffness": loop.stiffness * ratios * stiffness, "damping": loop.damping * ratios**2 * damping}
        changes["gains"] = {name: gain.tolist() for name, gain in gains.items()}
    elif environment.base == "pd":
        changes["gains"] = environment.pd_gains
    return environment.replace(**changes)
