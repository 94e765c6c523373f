"""Random arms on which one policy for all arms is trained and tested, drawn in units of the arm."""

import math

import numpy as np
from numpy.random import Generator

from flexman_gym.common.arrays import Array
from flexman_gym.envs.config.arm_settings import (
    PEAK_ACCELERATION,
    SHORTEST_PERIOD,
    arm_facts,
    arm_torque_limits,
    slew_inertia,
    wanted_period,
)
from flexman_gym.model.model import build_model
from flexman_gym.model.statics import holding_torques
from flexman_gym.model.vibration import modes
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.joint import Joint
from flexman_gym.scene.link import Link
from flexman_gym.scene.rigid_body import Payload
from flexman_gym.toolbox.controllers.arm_scales import CHANGE

JOINTS = (1, 3)  # fewest and most joints
REACH = (0.3, 12.0)  # m; log-uniform
FREQUENCY = (1.2, 8.0)  # Hz m^0.5; first frequency with held motors times the root of the reach; log-uniform
GRAVITY_FREQUENCY = 2.0  # Hz m^0.5; lower end of FREQUENCY under gravity, at which an arm sags by a tenth of its reach
SLEW_PERIODS = (0.5, 5.0)  # duration of a slew at the torque limits / period of the first mode; log-uniform
PAYLOAD = (0.1, 0.6)  # mass of the payload / mass of the links; uniform
ROTOR = (0.1, 0.5)  # inertia of a rotor / inertia of the outstretched links and payload about its joint; uniform
SPRING = (1.5, 4.0)  # frequency of these on the spring of the joint / first frequency of the links; uniform
ELASTIC, GRAVITY, LIFTING = 0.6, 0.5, 0.7  # probabilities: of springs, of gravity, and of a further joint about -Y
TURNING_AXIS, LIFTING_AXIS = (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)
WEIGHTS_HELD = 1.5  # torque limit without that of the slew / torque that holds twice the payload outstretched
TAPER, WALL, SLENDERNESS = 0.8, 0.08, 0.03  # diameter / that of the link before; wall / diameter; first diameter tried


def draw_arm(seed: int) -> Arm:
    """Return a random arm with one to three joints.

    Reach, first frequency and slews are drawn as the constants of this module describe: tubes of aluminium are as
    thick as the first frequency needs, and motors as strong as the slew needs beside the weight. An arm whose motors
    cannot hold it, or that needs a control period below 2 ms, is drawn again.

    Args:
        seed: seed of the random numbers.
    """
    random = np.random.default_rng(seed)
    while True:
        arm = _draw(random)
        try:
            facts = arm_facts(arm, arm_torque_limits(arm))
        except ValueError:  # too compliant for its weight
            continue
        if wanted_period(facts) >= SHORTEST_PERIOD:
            return arm


def _draw(random: Generator) -> Arm:
    """Return a random arm, which may be too compliant or too fast."""
    n, reach = int(random.integers(JOINTS[0], JOINTS[1] + 1)), _log_uniform(random, *REACH)
    lengths = reach * random.dirichlet(np.full(n, 8.0))
    payload, weighs = random.uniform(*PAYLOAD), random.random() < GRAVITY
    axes = _axes(random, n, weighs)
    rotors, springs = random.uniform(*ROTOR, n), random.uniform(*SPRING, n) if random.random() < ELASTIC else None
    lowest = GRAVITY_FREQUENCY if weighs else FREQUENCY[0]
    frequency = _log_uniform(random, lowest, FREQUENCY[1]) / math.sqrt(reach)
    slew, damping = _log_uniform(random, *SLEW_PERIODS) / frequency, random.uniform(0.005, 0.02)

    def make(diameter: float, torques: Array | None = None) -> Arm:
        """Return the arm with a first diameter, m, whose frequencies are in proportion to it."""
        links = _tubes(lengths, diameter)
        mass = payload * sum(link.mass for link in links)
        rigid = Arm(links, [Joint(axis) for axis in axes], Payload(mass), modal_damping_ratio=damping)
        inertias = np.diag(slew_inertia(build_model(rigid, elements=2), np.zeros(n)))
        first = 2.0 * math.pi * float(modes(build_model(rigid, elements=2), motors="held").frequencies[0])
        stiffness = [None] * n if springs is None else (inertias * (springs * first) ** 2).tolist()
        joints = [
            Joint(
                axis, float(rotors[i] * inertias[i]), stiffness[i],
                0.0 if stiffness[i] is None else 2.0 * damping * math.sqrt(stiffness[i] * inertias[i]),
                torque_limit=None if torques is None else float(torques[i]),
            )
            for i, axis in enumerate(axes)
        ]  # fmt: skip
        gravity = (0.0, 0.0, -9.81 if weighs else 0.0)
        return Arm(links, joints, Payload(mass), gravity=gravity, modal_damping_ratio=damping)

    tried = SLENDERNESS * reach / n
    found = float(modes(build_model(make(tried), elements=2), motors="held").frequencies[0])
    sized = make(tried * frequency / found)
    mass = payload * sum(link.mass for link in sized.links)
    return make(tried * frequency / found, _torques(sized, mass, slew))


def _axes(random: Generator, n: int, weighs: bool) -> list[tuple[float, float, float]]:
    """Return the axes of n joints; under gravity all but the first of several lift, so that motors can undo the sag."""
    if weighs:
        return [TURNING_AXIS, *[LIFTING_AXIS] * (n - 1)] if n > 1 else [LIFTING_AXIS]
    return [TURNING_AXIS, *(LIFTING_AXIS if random.random() < LIFTING else TURNING_AXIS for _ in range(n - 1))]


def _torques(arm: Arm, payload: float, slew: float) -> Array:
    """Return the torque limits (n,), N m, for slews of a duration, s, beside the weight with a payload, kg."""
    loaded = build_model(Arm(arm.links, arm.joints, Payload(2.0 * payload), gravity=arm.gravity), elements=1,
                         flexible_links=False, flexible_joints=False)  # fmt: skip
    inertia = slew_inertia(build_model(arm, elements=2), np.full(arm.n_joints, CHANGE))
    weight = np.abs(holding_torques(loaded, np.zeros(arm.n_joints)))
    torques: Array = WEIGHTS_HELD * weight + PEAK_ACCELERATION * CHANGE * np.linalg.norm(inertia, axis=1) / slew**2
    return torques


def _tubes(lengths: Array, diameter: float) -> list[Link]:
    """Return tubes with given lengths (n,) and the outer diameter of the first, m."""
    diameters = diameter * TAPER ** np.arange(len(lengths))
    return [
        Link.tube(float(length), float(each), WALL * float(each), material="aluminium")
        for length, each in zip(lengths, diameters, strict=True)
    ]


def _log_uniform(random: Generator, low: float, high: float) -> float:
    """Return a random number whose logarithm is uniform."""
    return math.exp(random.uniform(math.log(low), math.log(high)))
