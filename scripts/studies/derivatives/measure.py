"""Exact derivatives against differences extrapolated to zero, for every parameter, method family and effect."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

import flexman_gym as fm
from flexman_gym.common.arrays import Array
from flexman_gym.evaluation.agent_spec import AgentSpec
from flexman_gym.simulation.methods import Method
from studies.derivatives import dimensions, scenes
from studies.derivatives.differences import Motions, allowed, deviations, remainder_orders
from studies.derivatives.episodes import OUTPUTS, SEED, ChangedEpisode, environment, size_of, unrounded

CONVERGED: Any = fm.METHODS["generalised_alpha"]
FAMILIES: dict[str, tuple[str | Method, float]] = {  # method and step, s
    "explicit": ("rk4", 2.5e-4), "semi-implicit": ("semi_implicit_euler", 1e-4), "linearly implicit": ("ros2", 0.005),
    "corrected midpoint": ("midpoint_corrected_3", 0.005), "Gauss, fixed iterations": ("gauss_2", 0.005),
    "converged implicit": (replace(CONVERGED, tolerance=1e-15), 0.005),
}  # fmt: skip
OF_EPISODES = ("linearly implicit", "corrected midpoint", "Gauss, fixed iterations")
OF_DIMENSIONS = "corrected midpoint"
EFFECTS = {
    "plain": (), "friction": ("friction",), "backlash and stiffness pieces": ("backlash",),
    "torque ripple": ("ripple",), "voltage motor": ("voltage",), "passive joint": ("passive",),
}  # fmt: skip
DIMENSIONS = "dimensions, all modes"
PD = {"kind": "pd", "stiffness": [10.0, 12.0], "damping": [3.0, 0.6]}
ARM = fm.catalog.vertical_2r()
VISCOUS: dict[str, Any] = {"arm": replace(ARM, joints=[replace(each, viscous_friction=0.1) for each in ARM.joints])}
OF_PLANT = ("payload_mass", "joint_stiffness[0]", "joint_damping[1]", "rotor_inertia[1]", "viscous_friction[0]",
            "link_stiffness_factor[1]", "link_damping[1]", "initial_joint_angles[1]", "initial_joint_rates[0]",
            "motor_torques[1]", "tip_force[2]", "base_acceleration[0]", "stiffness[0]", "damping[1]")  # fmt: skip
SERVO = AgentSpec("servo", None, {"actions": {**PD, "kind": "position"}})
EPISODES: dict[str, tuple[dict[str, Any], Any, str]] = {  # settings, agent, and name of an action
    "saturation": ({"torque_limit": [6.0, 2.0]}, PD, "torque_1[4]"),
    "delay and lag": ({"randomisation": {"delay": (2, 2)}, "drive_bandwidth": 20.0}, PD, "torque_2[3]"),
    "servo": ({"torque_limit": [60.0, 30.0]}, SERVO, "position_2[5]"),
}
LOW, HIGH = 1.9, 2.1  # orders of a Taylor remainder of second order


@dataclass(frozen=True)
class DerivativeRow:
    """Derivative with respect to a parameter, in a motion with one effect.

    Attributes:
        effect: effect of joints, drives or loop.
        family, method: family of methods, and the method.
        step: integration step, s.
        parameter: name of the parameter.
        output: number of the output with the largest deviation in units of the allowed one.
        difference: its deviation from differences, relative to its largest derivative.
        error: error estimate of these differences, relative as well.
        order_low, order_high: orders of the Taylor remainder over two decades of the change.
        equal: "yes" if the values have the bits of a simulation without derivatives.
    """

    effect: str
    family: str
    method: str
    step: float
    parameter: str
    output: float
    difference: float
    error: float
    order_low: float
    order_high: float
    equal: str

    @property
    def is_accurate(self) -> bool:
        """True if the deviation is at most the allowed one."""
        return self.difference <= float(allowed(np.array(self.error)))

    @property
    def is_smooth(self) -> bool:
        """True if the Taylor remainder is of second order."""
        return LOW <= self.order_low <= self.order_high <= HIGH


def rows() -> Iterator[DerivativeRow]:
    """Yield all rows."""
    for family in FAMILIES:
        for effect in EFFECTS:
            yield from scene_rows(effect, family)
    yield from dimension_rows()
    with unrounded():
        for family in OF_EPISODES:
            for effect in EPISODES:
                yield from episode_rows(effect, family)


def scene_rows(effect: str, family: str) -> Iterator[DerivativeRow]:
    """Yield the rows of a scene, for every parameter that its arm has."""
    method, step = FAMILIES[family]
    changed = scenes.ChangedScene(scenes.scene(EFFECTS[effect]), method, step)
    sizes = dict(changed.parameters())
    found = fm.sensitivities(changed.scene, scenes.OUTPUTS, tuple(sizes), method=method, step=step)
    values, plain = scenes.reduced(found.values), changed.outputs("tip_force[0]", np.zeros(1))[0]
    equal = np.array_equal(values[:, :-2], plain[:, :-2])  # the energies of a trajectory are sums
    exact = scenes.reduced(found.jacobian)
    for i, (name, size) in enumerate(sizes.items()):
        motions = partial(changed.outputs, name)
        yield _row((effect, family, step, name), (values, exact[:, :, i], motions, size), equal)


def dimension_rows() -> Iterator[DerivativeRow]:
    """Yield the rows of dimensions and materials, with all modes of the links."""
    (method, step), choice = FAMILIES[OF_DIMENSIONS], {"elements": 1, "modes": None}
    given = dimensions.scene(dimensions.arm(), **choice)
    found = fm.sensitivities(given, dimensions.OUTPUTS, tuple(dimensions.NOMINAL), method=method, step=step)
    values, exact = dimensions.reduced(found.values), dimensions.reduced(found.jacobian)

    def motions(name: str, changes: Array) -> Array:
        arms = [dimensions.arm(**{name: dimensions.NOMINAL[name] + change}) for change in changes.tolist()]
        runs = [fm.simulate(dimensions.scene(arm, **choice), method=method, step=step) for arm in arms]
        return np.array([dimensions.outputs_of(run) for run in runs])

    equal = np.array_equal(values[:, :-1], motions("link_length[0]", np.zeros(1))[0, :, :-1])
    for i, (name, size) in enumerate(dimensions.NOMINAL.items()):
        case = DIMENSIONS, OF_DIMENSIONS, step, name
        yield _row(case, (values, exact[:, :, i], partial(motions, name), size), equal)


def episode_rows(effect: str, family: str) -> Iterator[DerivativeRow]:
    """Yield the rows of an episode with an agent."""
    (settings, agent, action), (method, step) = EPISODES[effect], FAMILIES[family]
    world, names = environment(**VISCOUS, method=method, step=step, **settings), (*OF_PLANT, action)
    found = fm.sensitivities(world, OUTPUTS, names, agent=agent, seed=SEED)
    changed = ChangedEpisode(agent, world)
    equal = np.array_equal(found.values, changed.outputs("payload_mass", np.zeros(1))[0])
    for i, name in enumerate(names):
        case = effect, family, step, name
        yield _row(case, (found.values, found.jacobian[:, :, i], partial(changed.outputs, name), size_of(name)), equal)


def _row(case: tuple[str, str, float, str], motion: tuple[Array, Array, Motions, float], equal: bool) -> DerivativeRow:
    """Return the row of a case: effect, family, step, parameter; values, derivatives, changed motions, and size."""
    values, exact, motions, size = motion
    deviation, error = deviations(exact, motions, size)
    worst = int(np.argmax(deviation / allowed(error)))
    orders = sorted(remainder_orders(values, exact, motions, size).tolist())
    effect, family, step, name = case
    method = FAMILIES[family][0]
    label = method if isinstance(method, str) else method.name
    found = float(deviation[worst]), float(error[worst])
    return DerivativeRow(
        effect, family, label, step, name, worst, *found, orders[0], orders[1], "yes" if equal else "no"
    )
