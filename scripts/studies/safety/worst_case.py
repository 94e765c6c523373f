"""Worst case of the safety filter: search of payload, stiffness, start, goal and a pulse on the tip."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from flexman_gym.common.arrays import Array, BoolArray
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.evaluation.rollouts import rollout
from flexman_gym.simulation.batch import Batch
from flexman_gym.toolbox.league.worst_case import Box, ascend

ENVIRONMENT, SCALE = "FlexRRR-v0/unknown-lab", 0.6  # factor on the limits "study"
HORIZON, SEED, POINTS = 4.0, 9000, 128  # s; seed of noise and points; random points before the ascents
FORCE, DURATION, LATEST = 20.0, 0.1, 2.0  # N on each axis; s; largest start of the pulse on the tip, s
AGENTS = ("lqr-tracking", "random")


@dataclass(frozen=True)
class WorstRow:
    """Largest excess over the limits that a search found, as fractions of the limits.

    Attributes:
        agent: name of the agent.
        pulse: largest force of the pulse on the tip along each axis, N.
        safety: 1 with the filter, 0 without.
        evaluations: number of simulated moves.
        random: largest excess of the random points.
        excess: largest excess of all moves.
        beyond: number of moves with an excess of more than 2 %.
        payload: payload of the worst move, kg.
        stiffness: smallest factor on the stiffness of a joint in the worst move.
    """

    agent: str
    pulse: float
    safety: int
    evaluations: int
    random: float
    excess: float
    beyond: int
    payload: float
    stiffness: float


class _PulsedBatch:
    """Batch step with a pulse of force on the tip; points (b, 4) from -1 to 1 are its force and its start.

    Args:
        points: (b, 4) points.
    """

    def __init__(self, points: Array) -> None:
        self._forces, self._starts = FORCE * points[:, :3], 0.5 * LATEST * (1.0 + points[:, 3])

    def set(self, batch: Batch) -> None:
        """Add the pulse to the steps of a batch."""
        step, n = batch.step, batch.model.n_joints

        def pulsed(drive: Array, moving: BoolArray | None = None) -> None:
            now = (self._starts <= batch.time) & (batch.time < self._starts + DURATION)
            drive = drive.copy()
            drive[now, n : n + 3] += self._forces[now]
            step(drive, moving)

        batch.step = pulsed  # type: ignore[method-assign]


def search(agent: str, pulse: bool, safety: bool) -> WorstRow:
    """Search payload, stiffness, start, goal and pulse for which an agent exceeds the limits most."""
    base = Configuration.find(ENVIRONMENT).replace(limits="study", horizon=HORIZON).limits
    limits = {"strain": SCALE * np.array(base.strain), "spring_torque": SCALE * np.array(base.spring_torque)}
    given = {name: each.tolist() for name, each in limits.items()} | {"on_violation": "record"}
    environment = Configuration.find(ENVIRONMENT).replace(limits=given, horizon=HORIZON, safety=safety)
    box, values = Box(environment), list[float]()
    points: list[Array] = []

    def largest_shares(tried: Array) -> Array:
        own, force = np.split(tried, [box.size], axis=1)
        set_plant = _PulsedBatch(force).set if pulse else None
        moves = rollout(agent, environment, [SEED] * len(tried), set_plant=set_plant, options=box.options(own))
        assert moves.excess is not None
        shares = 1.0 + np.nanmax(moves.excess, axis=1)
        values.extend(shares.tolist())
        points.extend(own)
        return np.asarray(shares)

    ascend(largest_shares, np.random.default_rng(SEED).uniform(-1.0, 1.0, (POINTS, box.size + 4 * pulse)))
    worst = box.parameters(points[int(np.argmax(values))][None])
    nominal = np.array([joint.stiffness for joint in environment.arm.joints])
    return WorstRow(
        agent, FORCE * pulse, int(safety), len(values), max(values[:POINTS]) - 1.0, max(values) - 1.0,
        sum(each > 1.02 for each in values), float(worst["payload_mass"][0]),
        float((worst["joint_stiffness"][0] / nominal).min()),
    )  # fmt: skip


def worst_rows() -> Iterator[WorstRow]:
    """Yield the rows of each agent with and without filter and pulse."""
    for safety in (True, False):
        for agent in AGENTS:
            for pulse in (False, True):
                yield search(agent, pulse, safety)
