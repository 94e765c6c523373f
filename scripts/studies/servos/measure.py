"""Gain limits of joint servos, without and with friction."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from flexman_gym.agent.pd import stability_limit
from flexman_gym.common.arrays import Array
from flexman_gym.envs.config.named_environments import NAMED_ENVIRONMENTS
from flexman_gym.envs.env import FlexManEnv
from flexman_gym.kernels.layout import OK, TIP_VELOCITY
from flexman_gym.model.dynamics import mass_matrix
from flexman_gym.model.model import Model, build_model
from flexman_gym.model.statics import rest_state
from flexman_gym.model.vibration import modes
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.joint import Joint
from flexman_gym.scene.link import Link
from flexman_gym.scene.rigid_body import Payload
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.linearization import linearize
from flexman_gym.simulation.methods import DEFAULT_METHOD
from flexman_gym.toolbox.controllers.margins import STABLE_RADIUS, SampledLoop, sampled_loops

ENVIRONMENTS = ("FlexRRR-v0", "FlexPlanar-v0", "FlexOne-v0")
PERIODS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.04)  # s; control periods of the servo
DELAYS = (0, 1, 2, 4)  # periods
BANDWIDTHS = (0.0, 100.0, 30.0, 10.0)  # Hz; bandwidths of the drives; 0: ideal drives
SPRINGS = (1.0, 10.0, 100.0)  # factors of the joint stiffness
LARGEST, STEADY_RADIUS = 1e4, 1.0 + 1e-7  # largest examined factor; largest spectral radius of a stable loop
CHECKED, APART = 24, 0.1  # number of limits checked by simulation; relative distance below and above
LEAST, MOST, GROWN = (
    10.0,
    10000,
    1e20,
)  # shortest simulation, s; most control periods; energy growth of a visible instability
SMALL = 1e-4  # rad; initial joint angles of the simulations
METHODS = (DEFAULT_METHOD, "gauss_3")


@dataclass(frozen=True)
class ServoRow:
    """Gain limit: factor of both gains at which the loop becomes unstable, 0 if it is unstable with any gains.

    Attributes:
        environment: environment of the arm and the gains.
        springs: factor of the joint stiffness.
        period: control period, s.
        delay: delay, periods.
        bandwidth: bandwidth of the drives, Hz; 0 for ideal drives.
        factor: limit of the factor of both gains.
        below, above: final energy in simulations with gains 10 % below and above the limit, relative to the largest
            energy below it; infinite if the arm exceeded its limits, None if not simulated.
        method, step: integration method and step (s) of the simulations.
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


def _arm_of(name: str, springs: float) -> Arm:
    """Return the arm of a named environment without gravity and with scaled joint stiffness."""
    arm = NAMED_ENVIRONMENTS[name].arm
    joints = [replace(each, stiffness=each.stiffness and springs * each.stiffness) for each in arm.joints]
    return replace(arm, joints=joints, gravity=(0.0, 0.0, 0.0))


def limit(loop: SampledLoop, stiffness: Array, damping: Array) -> float:
    """Return the smallest factor of both gains with an unstable loop, to 0.1 %; 0 if small gains are unstable."""

    def grows(factor: float) -> bool:
        return loop.spectral_radius(factor * stiffness, factor * damping) > STEADY_RADIUS

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


def rows() -> Iterator[ServoRow]:
    """Yield all limits; some of them are checked by simulation."""
    found = [row for name in ENVIRONMENTS for row in limits(name)]
    order = np.random.default_rng(0).permutation(len(found)).tolist()
    shown = [i for i in order if 0.0 < found[i].factor < LARGEST and rounds_of(found[i]) <= MOST]
    chosen = set(shown[:CHECKED])
    for i, row in enumerate(found):
        yield tried_by_environment(row, METHODS[i % 2]) if i in chosen else row


def limits(name: str, quick: bool = False) -> Iterator[ServoRow]:
    """Yield the limits of an environment, or a few of them."""
    gains = {each: np.array(values) for each, values in NAMED_ENVIRONMENTS[name].pd.items()}
    for springs in SPRINGS[-1:] if quick else SPRINGS:
        model = build_model(_arm_of(name, springs), 2, 4)
        for period in PERIODS[1:6:2] if quick else PERIODS:
            for delay in DELAYS[::2] if quick else DELAYS:
                for bandwidth in BANDWIDTHS[::3] if quick else BANDWIDTHS:
                    loop = sampled_loops(model, np.zeros(model.n_joints), period, delay, bandwidth or None)[0]
                    yield ServoRow(name, springs, period, delay, bandwidth, limit(loop, **gains))


def tried_by_environment(row: ServoRow, method: str) -> ServoRow:
    """Return the row with the results of simulations with gains 10 % below and above the limit."""
    rounds = rounds_of(row)
    step = float(row.period / np.ceil(row.period / NAMED_ENVIRONMENTS[row.environment].longest_step))
    ends, largest = [], 0.0
    for part in (1.0 - APART, 1.0 + APART):
        gains = {
            name: part * row.factor * np.array(each) for name, each in NAMED_ENVIRONMENTS[row.environment].pd.items()
        }
        energies = _energies(row, {"kind": "position", **gains}, (method, step), rounds)
        largest = largest or max(energies)
        ends.append(max(energies[3 * len(energies) // 4 :]) / largest)
    return replace(row, below=ends[0], above=ends[1], method=method, step=step)


def rounds_of(row: ServoRow) -> int:
    """Return the number of control periods after which an instability at gains 10 % above the limit is visible."""
    model = build_model(_arm_of(row.environment, row.springs), 2, 4)
    gains = [(1.0 + APART) * row.factor * np.array(each) for each in NAMED_ENVIRONMENTS[row.environment].pd.values()]
    loop = sampled_loops(model, np.zeros(model.n_joints), row.period, int(row.delay), row.bandwidth or None)[0]
    growth = np.log(max(loop.spectral_radius(*gains), STEADY_RADIUS))
    return int(max(LEAST / row.period, np.log(GROWN) / (2.0 * growth)))


def _energies(row: ServoRow, actions: object, moved: tuple[str, float], rounds: int) -> list[float]:
    """Return the energy after each period of a small motion with a servo holding zero angles."""
    delay = {"delay": (int(row.delay), int(row.delay))} if row.delay else None
    env = FlexManEnv(
        name=row.environment, arm=_arm_of(row.environment, row.springs), modes=4, method=moved[0], step=moved[1],
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


LOOPS = 200  # number of simulated stable loops
DURATION = 10.0  # s; duration of a simulation
DECAYED = 0.01  # largest remaining amplitude of the slowest mode of a stable loop
AT_REST = 0.02  # share of the largest tip speed; a smaller vibration in the last second counts as rest
RUNAWAY = 1e3  # m/s; tip speed at which a simulation stops
LONGEST_STEP = 0.0025  # s
SPAN = 0.2  # rad; largest initial offset


@dataclass(frozen=True)
class FrictionRow:
    """Random servo loop with friction.

    Attributes:
        seed: random seed.
        joints: number of joints.
        period: control period, s.
        delay: delay, periods.
        radius: largest spectral radius over all combinations of sliding and sticking motors.
        sliding: spectral radius with all motors sliding.
        smoothed: spectral radius of the linearisation of the smoothed friction at rest.
        left: largest deviation of the tip velocity from its mean in the last second, relative to the largest speed;
            infinite if the loop diverges. The mean is the creep of smoothed friction, of the order of `coulomb_rate`.
    """

    seed: float
    joints: float
    period: float
    delay: float
    radius: float
    sliding: float
    smoothed: float
    left: float

    @property
    def is_stable(self) -> bool:
        """True if no eigenvalue lies outside the unit circle."""
        return self.radius < STABLE_RADIUS


class FrictionCase(NamedTuple):
    """PD loop (gains (n,) in N m/rad and N m s/rad) about a posture (n,) rad, started at an offset (n,) rad from it."""

    model: Model
    period: float
    delay: int
    stiffness: Array
    damping: Array
    posture: Array
    offset: Array

    def loops(self) -> list[SampledLoop]:
        """Return the sampled loops of all combinations of sliding and sticking motors."""
        return sampled_loops(self.model, self.posture, self.period, self.delay)


def friction_rows(count: int = LOOPS) -> Iterator[FrictionRow]:
    """Yield random loops until `count` of them are stable; stable loops that decay slowly are skipped."""
    seed = 0
    while count > 0:
        row = _friction_row(seed)
        seed += 1
        if row is not None:
            count -= row.is_stable
            yield row


def _friction_row(seed: int) -> FrictionRow | None:
    """Return the row of a seed; None without Coulomb friction or for a stable loop that decays slowly."""
    case = _draw_case(np.random.default_rng(seed))
    radii = [loop.spectral_radius(case.stiffness, case.damping) for loop in case.loops()]
    held = float(
        modes(case.model, case.posture).eigenvalues.real.max(initial=-np.inf)
    )  # 1/s; slowest decay rate with all motors sticking
    left = max(min(max(radii), 1.0) ** (DURATION / case.period), np.exp(held * DURATION))
    if (max(radii) < STABLE_RADIUS and left > DECAYED) or not case.model.constants.coulomb_friction.any():
        return None
    smoothed = smoothed_loop(case).spectral_radius(case.stiffness, case.damping)
    vibration = remaining_vibration(case)
    return FrictionRow(seed, case.model.n_joints, case.period, case.delay, max(radii), radii[0], smoothed, vibration)


def _draw_case(random: np.random.Generator) -> FrictionCase:
    """Draw a random arm of one to three strips, a sampled PD near its stability limit, and an initial offset.

    The initial torque is 2 to 20 times the Coulomb friction of each motor, within its torque limit.
    """
    n = int(random.integers(1, 4))

    def spread(low: float, high: float) -> float:
        return float(np.exp(random.uniform(np.log(low), np.log(high))))

    links = [Link.strip(random.uniform(0.3, 1.0), 0.05, random.uniform(0.002, 0.008)) for _ in range(n)]
    joints = [
        Joint(
            axis=((0.0, 0.0, 1.0), (0.0, 1.0, 0.0))[int(random.random() < 0.4)], rotor_inertia=spread(0.01, 0.3),
            stiffness=None if random.random() < 0.3 else spread(30.0, 2000.0),
            viscous_friction=max(random.uniform(-0.2, 0.2), 0.0),
            coulomb_friction=0.0 if random.random() < 0.2 else spread(0.02, 2.0),
            coulomb_rate=(0.01, 0.001)[int(random.random() < 0.5)],
        )
        for _ in range(n)
    ]  # fmt: skip
    damping = spread(2e-3, 3e-2)
    arm = Arm(links, joints, Payload(random.uniform(0.05, 1.0)), stiffness_proportional_damping=damping)
    model = build_model(arm, elements=1, modes=2)
    period, delay = (0.002, 0.005, 0.01, 0.02)[int(random.integers(4))], int(random.integers(3))
    inertia = 1.0 / np.diag(np.linalg.inv(mass_matrix(model, np.zeros(2 * model.n_dof))))[model.motor_columns]
    gain = stability_limit(delay) * inertia / period * np.exp(random.uniform(np.log(0.02), np.log(1.1), n))
    stiffness = gain * np.exp(random.uniform(np.log(1e-3), np.log(0.5), n)) / period
    asked = np.maximum(model.constants.coulomb_friction, 0.05) * np.exp(random.uniform(np.log(2.0), np.log(20.0), n))
    offset = np.minimum(asked / stiffness, SPAN) * random.choice([-1.0, 1.0], n)
    posture = np.append(0.0, random.uniform(-1.2, 1.2, n - 1))
    return FrictionCase(model, period, delay, stiffness, gain, posture, offset)


def smoothed_loop(case: FrictionCase) -> SampledLoop:
    """Return the loop linearised with the smoothed friction at rest, which is no valid basis for a stability margin."""
    linear = linearize(case.model, case.posture, friction="at rest").discrete(case.period, case.delay * case.period)
    motors = case.model.motor_columns
    return SampledLoop(linear.A, linear.B, motors, case.model.n_dof + motors)


def remaining_vibration(case: FrictionCase) -> float:
    """Simulate a loop and return the remaining vibration, see `FrictionRow.left`."""
    model, n, d, motors = case.model, case.model.n_joints, case.model.n_dof, case.model.motor_columns
    batch = Batch(model, "gauss_3", min(case.period, LONGEST_STEP), case.period)
    batch.reset(np.arange(1), rest_state(model, (case.posture + case.offset)[None]))
    torques, drive, velocities = np.zeros((case.delay + 1, n)), np.zeros((1, n + 6)), []
    for _ in range(round(DURATION / case.period)):
        state = batch.state[0]
        torque = case.stiffness * (case.posture - state[motors]) - case.damping * state[d + motors]
        torques = np.vstack([torques[1:], torque])
        drive[0, :n] = torques[0]
        batch.step(drive)
        velocities.append(batch.outputs[0, TIP_VELOCITY].copy())
        if batch.status[0] != OK or not np.abs(velocities[-1]).max() < RUNAWAY:
            return float("inf")
    last = np.array(velocities[-round(1.0 / case.period) :])
    return float(np.abs(last - last.mean(axis=0)).max() / np.abs(velocities).max())
