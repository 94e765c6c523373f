"""Benchmark of Wie and Bernstein: probabilities of instability, slow settling and saturation over random springs.

Such probabilities are those of Stengel and Marrison, "Robustness of solutions to a benchmark control problem", J.
Guidance, Control, and Dynamics 15 (1992); the definitions are our own. They are shares of random springs. The loops are
linear: their torques are not limited, and a torque beyond the limit counts as saturation. A loop that is not stable
counts as slow, too.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.agent.base_controllers import make_base
from flexman_gym.agent.controller import EpisodeInfo
from flexman_gym.common.arrays import Array
from flexman_gym.common.markdown import markdown_table
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.fidelity import resolve_fidelity
from flexman_gym.envs.config.plant import make_plant
from flexman_gym.evaluation.shares import share_text
from flexman_gym.model.dynamics import mass_matrix
from flexman_gym.model.model import Model
from flexman_gym.model.state_space import LinearModel, discretize
from flexman_gym.simulation.linearization import linearize
from flexman_gym.simulation.physical_parameters import varied_model
from flexman_gym.toolbox.controllers.hinf import HInfinity

ENVIRONMENT = "FlexTwoMass-v0"
SPRINGS = (0.5, 2.0)  # N m/rad; range of the spring constant, uniform
DRAWS, QUICK_DRAWS, SEED = 1000, 20, 66  # numbers of springs; the weights were chosen on springs of another seed
IMPULSE = 1.0  # N m s; on mass 2 at the start
LIMIT, BAND = 1.0, 0.1  # N m, rad; largest torque, and position of mass 2 beyond which it is not settled
SETTLED, HORIZON = 15.0, 30.0  # s; time of settling, and simulated time
WEIGHTS = {"tip": 3.0, "tip_speed": 2.0, "motor": 3.0}  # m, m/s, rad; cost weights set by hand for torques below 1 N m
AGENTS: dict[str, Any] = {
    "lqg": {"kind": "lqg", "fixed": True}, "lqg, weights by hand": {"kind": "lqg", "fixed": True, "weights": WEIGHTS},
    "hinf": "hinf", "hinf, weights by hand": {"kind": "hinf", "weights": WEIGHTS},
}  # fmt: skip
DESIGNS = {"1": ENVIRONMENT, "0.5 to 2": f"{ENVIRONMENT}/stiffness"}  # springs of the design -> environment


class TwoMassLoop(NamedTuple):
    """Sampled controller from the position of mass 2 (rad) to the torque (N m), and its control period (s)."""

    controller: LinearModel
    period: float


@dataclass(frozen=True)
class TwoMassRow:
    """Results of an agent.

    Attributes:
        agent: name of the agent.
        spring: spring constants for which it is designed, N m/rad.
        unstable: share of the draws with an unstable closed loop.
        slow: share with a position of mass 2 beyond the band later than 15 s after the impulse.
        saturated: share with a torque beyond the limit after the impulse.
        settling: settling time with the nominal spring, s.
        torque: largest torque with the nominal spring, N m.
    """

    agent: str
    spring: str
    unstable: float
    slow: float
    saturated: float
    settling: float
    torque: float


def make_loop(agent: Any, environment: str = ENVIRONMENT) -> TwoMassLoop:
    """Return the linear loop of an agent "lqg" or "hinf" about zero angles.

    Args:
        agent: name, or mapping with arguments.
        environment: environment or condition for which it is designed.
    """
    configuration = Configuration.find(environment)
    plant = make_plant(configuration, resolve_fidelity(configuration).model)
    made: Any = make_base(agent, plant)
    assert made.sensors == ("link_encoders",), made.sensors
    goal, limits = np.zeros((1, 1)), np.array(plant.torque_limit)
    if isinstance(made, HInfinity):
        loop = made.design(goal[0]).loop
        return TwoMassLoop(replace(loop, C=limits[:, None] * loop.C, D=limits[:, None] * loop.D), plant.period)
    linear = made.linear_form()
    linear.reset(np.array([0]), EpisodeInfo(goal, goal, plant.period), 1)
    A, B, C, L, K = (linear.move_tables()[name] for name in "ABCLK")
    corrected, by_reading = np.eye(len(A)) - L @ C, L  # of the predicted state
    A_closed = A - B @ K
    return TwoMassLoop(LinearModel(A_closed @ corrected, A_closed @ by_reading, -K @ corrected, -K @ by_reading),
                       plant.period)  # fmt: skip


@cache
def _nominal_model() -> Model:
    return resolve_fidelity(Configuration.find(ENVIRONMENT)).model


@cache
def _sampled_plant(stiffness: float, period: float) -> tuple[Array, Array, Array]:
    """Return transition matrix, input matrix of the torque and output matrix of the position of mass 2."""
    linear = linearize(varied_model(_nominal_model(), joint_stiffness=[stiffness]), outputs=("joint_angles",))
    return *discretize(linear.A, linear.B, period), linear.C


def closed_loop(loop: TwoMassLoop, stiffness: float) -> tuple[Array, Array]:
    """Return the sampled closed loop: transition matrix (s, s), and rows (2, s) of position of mass 2 and torque."""
    transition, inputs, position = _sampled_plant(stiffness, loop.period)
    A, B, C, D = loop.controller
    closed = np.block([[transition + inputs @ D @ position, inputs @ C], [B @ position, A]])
    return closed, np.block([[position, np.zeros((1, len(A)))], [D @ position, C]])


def impulse_response(loop: TwoMassLoop, stiffness: float) -> Array:
    """Return position of mass 2 (rad) and torque (N m), (T + 1, 2), after the impulse on mass 2."""
    closed, rows = closed_loop(loop, stiffness)
    model, states = _nominal_model(), np.zeros((len(closed), 1))
    d, periods = model.n_dof, round(HORIZON / loop.period) + 1
    states[d : 2 * d, 0] = np.linalg.solve(mass_matrix(model, np.zeros(2 * d)), IMPULSE * (np.arange(d) == 0))
    while states.shape[1] < periods:  # doubles the number of periods
        states, closed = np.hstack([states, closed @ states]), closed @ closed
    return np.asarray((rows @ states[:, :periods]).T)


def measure_loop(agent: str, spring: str, loop: TwoMassLoop, draws: int = DRAWS) -> TwoMassRow:
    """Return the results of a loop over random springs."""
    counts = np.zeros((draws, 3), dtype=bool)
    for i, stiffness in enumerate(np.random.default_rng(SEED).uniform(*SPRINGS, draws).tolist()):
        unstable = np.abs(np.linalg.eigvals(closed_loop(loop, stiffness)[0])).max() >= 1.0
        position, torque = impulse_response(loop, stiffness).T
        late = np.abs(position[round(SETTLED / loop.period) :]).max()
        counts[i] = unstable, unstable or late > BAND, np.abs(torque).max() > LIMIT
    position, torque = impulse_response(loop, 1.0).T
    settling = float((np.flatnonzero(np.abs(position) > BAND)[-1] + 1) * loop.period)
    unstable, slow, saturated = counts.mean(axis=0).tolist()
    return TwoMassRow(agent, spring, unstable, slow, saturated, settling, float(np.abs(torque).max()))


def two_mass_rows(draws: int = DRAWS) -> Iterator[TwoMassRow]:
    """Yield the results of the agents that are designed from a model."""
    for name, agent in AGENTS.items():
        for spring, environment in DESIGNS.items():
            yield measure_loop(name, spring, make_loop(agent, environment), draws)


def two_mass_table(rows: Sequence[TwoMassRow]) -> str:
    """Return the table of the page of published arms as Markdown."""
    heads = ("agent", "spring of its design", "unstable", "slow", "saturated", "settles, k = 1", "torque, k = 1")
    cells = [
        (row.agent, row.spring, *(share_text(share, DRAWS) for share in (row.unstable, row.slow, row.saturated)),
         f"{row.settling:.3g} s" if row.settling <= HORIZON else "-", f"{row.torque:.2g} N m")
        for row in rows
    ]  # fmt: skip
    return "\n".join(markdown_table(heads, cells))
