"""Random sampled loops of a PD with Coulomb friction: what the eigenvalues predict, and what a simulation does."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from flexman_gym.arrays import Array
from flexman_gym.control.margins import STEADY, Loop, sampled_loops, spectral_radius
from flexman_gym.control.pd import stability_limit
from flexman_gym.kernels.layout import OK, TIP_VELOCITY
from flexman_gym.model.instant import mass_matrix
from flexman_gym.model.linear import linearize
from flexman_gym.model.model import Model, build_model
from flexman_gym.model.statics import rest_states
from flexman_gym.model.vibration import modes
from flexman_gym.scene.arm import Arm, Payload
from flexman_gym.scene.joint import Joint
from flexman_gym.scene.link import Link
from flexman_gym.simulation.batch import Batch

LOOPS = 200  # stable ones that are simulated
DURATION = 10.0  # s, of a simulation
DECAYED = 0.01  # of an amplitude, below which the slowest mode of a stable loop has decayed in that time
AT_REST = 0.02  # of the largest speed of the tip: what vibrates less in the last second is at rest
RUNAWAY = 1e3  # m/s of the tip, which ends a simulation
LONGEST_STEP = 0.0025  # s
SPAN = 0.2  # rad, largest start


@dataclass(frozen=True)
class FrictionRow:
    """A random loop with friction.

    Attributes:
        seed: of the random numbers.
        joints: number of joints.
        period: s.
        delay: periods.
        radius: largest spectral radius of the loops whose motors slide or stick.
        sliding: spectral radius of the loop whose motors all slide.
        smoothed: spectral radius of the loop with the slope of the smoothed friction at rest.
        left: vibration of the tip in the last second, its largest velocity about the mean, over the largest speed;
            infinite for a runaway. The mean is the creep of smoothed friction, of the size of its `coulomb_rate`.
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
        """Whether no eigenvalue is outside the unit circle, so that the loop is called stable."""
        return self.radius < STEADY


class Case(NamedTuple):
    """A PD (gains (n,) in N m/rad and N m s/rad) about a posture (n,) rad, started `offset` (n,) rad away from it."""

    model: Model
    period: float
    delay: int
    stiffness: Array
    damping: Array
    posture: Array
    offset: Array

    def loops(self) -> list[Loop]:
        """Return the loops of the motors that slide or stick."""
        return sampled_loops(self.model, self.posture, self.period, self.delay)


def friction_rows(count: int = LOOPS) -> Iterator[FrictionRow]:
    """Yield random loops until `count` of them are stable; stable ones that decay slowly are passed over."""
    seed = 0
    while count > 0:
        row = friction_row(seed)
        seed += 1
        if row is not None:
            count -= row.is_stable
            yield row


def friction_row(seed: int) -> FrictionRow | None:
    """Return the row of a seed, None for a loop without Coulomb friction or one that is stable and decays slowly."""
    case = draw_case(np.random.default_rng(seed))
    radii = [spectral_radius(loop, case.stiffness, case.damping) for loop in case.loops()]
    held = float(modes(case.model, case.posture).eigenvalues.real.max(initial=-np.inf))  # 1/s, while all motors stick
    left = max(min(max(radii), 1.0) ** (DURATION / case.period), np.exp(held * DURATION))
    if (max(radii) < STEADY and left > DECAYED) or not case.model.constants.coulomb_friction.any():
        return None
    smoothed = spectral_radius(smoothed_loop(case), case.stiffness, case.damping)
    vibration = remaining_vibration(case)
    return FrictionRow(seed, case.model.n_joints, case.period, case.delay, max(radii), radii[0], smoothed, vibration)


def draw_case(random: np.random.Generator) -> Case:
    """Draw an arm of one to three strips, a sampled PD about as stiff and damped as it may be, and a start.

    The start asks for 2 to 20 times the Coulomb friction of each motor, which its torque limit allows.
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
    return Case(model, period, delay, stiffness, gain, posture, offset)


def smoothed_loop(case: Case) -> Loop:
    """Return the loop with the slope of the smoothed friction at rest, which is no basis for a margin."""
    linear = linearize(case.model, case.posture, friction="at rest").discrete(case.period, case.delay * case.period)
    motors = case.model.motor_columns
    return Loop(linear.A, linear.B, motors, case.model.n_dof + motors)


def remaining_vibration(case: Case) -> float:
    """Simulate a case; return the vibration that is left, see `FrictionRow`."""
    model, n, d, motors = case.model, case.model.n_joints, case.model.n_dof, case.model.motor_columns
    batch = Batch(model, "gauss_3_sweeps", min(case.period, LONGEST_STEP), case.period)
    batch.reset(np.arange(1), rest_states(model, (case.posture + case.offset)[None]))
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
