"""Servo limits: by how much the tuned gains of a servo may be multiplied, over period, delay, drive and springs."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.control.margins import Loop, sampled_loop, spectral_radius
from flexman_gym.envs.catalog import NAMED
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.model.model import build_model
from flexman_gym.scene.arm import Arm

ENVIRONMENTS = ("FlexRRR-v0", "FlexPlanar-v0", "FlexOne-v0")
PERIODS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.04)  # s, of the servo
DELAYS = (0, 1, 2, 4)  # whole periods
BANDWIDTHS = (0.0, 100.0, 30.0, 10.0)  # Hz, of the drives; 0 where these follow at once
SPRINGS = (1.0, 10.0, 100.0)  # times as stiff joints
LARGEST, STEADY = 1e4, 1.0 + 1e-7  # factor that is looked at; spectral radius of what does not grow
CHECKED, APART = 24, 0.1  # limits that environments try, and by which part below and above
LEAST, MOST, GROWN = 10.0, 10000, 1e20  # s; control periods; what the energy of the first growing vibration grows by
SMALL = 1e-4  # rad, from which they start
METHODS = ("midpoint_3_sweeps", "gauss_3_sweeps")


@dataclass(frozen=True)
class Row:
    """A limit: the factor of both gains at which the loop becomes unstable, 0 where it is so with any.

    Attributes:
        environment: whose arm and gains.
        springs: times as stiff joints.
        period: s.
        delay: periods.
        bandwidth: Hz, 0 for a drive that follows at once.
        factor: of the gains.
        below, above: energy at the end in environments with gains a tenth below and above, parts of the largest with
            those below; infinite where the arm left its limits, None untried.
        method, step: by which that one was simulated; s.
    """

    environment: str
    springs: float
    period: float
    delay: float
    bandwidth: float
    factor: float
    below: float | None = None
    above: float | None = None
    method: str = ""
    step: float | None = None


def arm_of(name: str, springs: float) -> Arm:
    """The arm of a named environment without weight, with joints that many times as stiff."""
    arm = NAMED[name].arm()
    joints = [replace(each, stiffness=each.stiffness and springs * each.stiffness) for each in arm.joints]
    return replace(arm, joints=joints, gravity=(0.0, 0.0, 0.0))


def limit(loop: Loop, stiffness: Array, damping: Array) -> float:
    """The least factor of both gains with which a loop grows, to a thousandth; 0 where it does with small ones."""

    def grows(factor: float) -> bool:
        return spectral_radius(loop, factor * stiffness, factor * damping) > STEADY

    factors = np.geomspace(1e-2, LARGEST, 121)
    first = next((i for i, factor in enumerate(factors.tolist()) if grows(factor)), None)
    if first is None:
        return float(LARGEST)
    if first == 0:
        return 0.0
    low, high = factors[first - 1], factors[first]
    while high / low > 1.001:
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if grows(middle) else (middle, high)
    return float(low)


def rows() -> Iterator[Row]:
    """All limits, some of which environments have tried."""
    found = [row for name in ENVIRONMENTS for row in limits(name)]
    order = np.random.default_rng(0).permutation(len(found)).tolist()
    shown = [i for i in order if 0.0 < found[i].factor < LARGEST and rounds_of(found[i]) <= MOST]
    chosen = set(shown[:CHECKED])
    for i, row in enumerate(found):
        yield tried_by_environment(row, METHODS[i % 2]) if i in chosen else row


def limits(name: str, quick: bool = False) -> Iterator[Row]:
    """The limits of an environment, or a few of them."""
    gains = {each: np.array(values) for each, values in NAMED[name].pd.items()}
    for springs in SPRINGS[-1:] if quick else SPRINGS:
        model = build_model(arm_of(name, springs), 2, 4)
        for period in PERIODS[1:6:2] if quick else PERIODS:
            for delay in DELAYS[::2] if quick else DELAYS:
                for bandwidth in BANDWIDTHS[::3] if quick else BANDWIDTHS:
                    loop = sampled_loop(model, np.zeros(model.n_joints), period, delay, bandwidth or None)
                    yield Row(name, springs, period, delay, bandwidth, limit(loop, **gains))


def tried_by_environment(row: Row, method: str) -> Row:
    """The row with the energies in environments whose gains are a little below and above the limit."""
    rounds = rounds_of(row)
    step = float(row.period / np.ceil(row.period / NAMED[row.environment].longest_step))
    ends, largest = [], 0.0
    for part in (1.0 - APART, 1.0 + APART):
        gains = {name: part * row.factor * np.array(each) for name, each in NAMED[row.environment].pd.items()}
        energies = _energies(row, {"kind": "position", **gains}, (method, step), rounds)
        largest = largest or max(energies)
        ends.append(max(energies[3 * len(energies) // 4 :]) / largest)
    return replace(row, below=ends[0], above=ends[1], method=method, step=step)


def rounds_of(row: Row) -> int:
    """Control periods in which a vibration shows that grows by gains a tenth above a limit."""
    model = build_model(arm_of(row.environment, row.springs), 2, 4)
    gains = [(1.0 + APART) * row.factor * np.array(each) for each in NAMED[row.environment].pd.values()]
    loop = sampled_loop(model, np.zeros(model.n_joints), row.period, int(row.delay), row.bandwidth or None)
    growth = np.log(max(spectral_radius(loop, *gains), STEADY))
    return int(max(LEAST / row.period, np.log(GROWN) / (2.0 * growth)))


def _energies(row: Row, actions: object, moved: tuple[str, float], rounds: int) -> list[float]:
    """The energy after each period of a small motion under a servo that should hold zero angles."""
    delay = {"delay": (int(row.delay), int(row.delay))} if row.delay else None
    env = FlexManEnv(
        name=row.environment, arm=arm_of(row.environment, row.springs), modes=4, method=moved[0], step=moved[1],
        control_period=row.period, horizon=2.0 * rounds * row.period, actions=actions, randomisation=delay,
        drive_bandwidth=row.bandwidth or None, torque_limit=1e6,
    )  # fmt: skip
    n, energies = env.simulator.model.n_joints, []
    env.reset(options={"start": [SMALL * (-1.0) ** i for i in range(n)], "goal_angles": [0.0] * n})
    for _ in range(rounds):
        _, _, ended, _, _ = env.step(np.zeros(n, dtype=np.float32))
        energies.append(env.simulator.energy)
        if ended:
            return [*energies, float("inf")]
    return energies
