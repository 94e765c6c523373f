"""Policy for all arms beside controllers without training, on random arms that its training has not drawn."""

from dataclasses import asdict, dataclass
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from flexman_agents.drawn_arms import draw_arm
from flexman_gym.envs.config.arm_settings import arm_facts
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import DEFAULT_ID
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.rollouts import rollout
from flexman_gym.toolbox.league.arm_trial import unknown_settings

POLICY, LAW, PLANNED = "generalist", "adaptive-lqr", "adaptive-planned"
AGENTS = (POLICY, LAW, PLANNED, "pd-torque")
ARMS = range(2_000_000, 2_000_020)  # seeds of the arms; the training draws those from 1,000,000 on
SEEDS = range(30_000, 30_020)  # seeds of the episodes
NEEDED = 15  # arms on which the policy must beat the adaptive law to become the choice of `flexman arm --try`
FOLDER = Path(__file__).parent / "policy"  # exported policy


@dataclass(frozen=True)
class GeneralistRow:
    """Result of an agent on an arm with unknown payload and stiffness.

    Attributes:
        arm: seed of the arm, see `draw_arm`.
        joints: number of joints.
        reach: length of the stretched arm, m.
        slew_periods: median duration of a slew / period of the first mode with held motors.
        agent: name of the agent.
        settled: share of episodes whose tip settled.
        settling_time: median settling time, s; infinite if most episodes did not settle.
        failed: share of failed episodes.
        seconds: CPU time of design and episodes, s.
    """

    arm: float
    joints: float
    reach: float
    slew_periods: float
    agent: str
    settled: float
    settling_time: float
    failed: float
    seconds: float


def environment_of(arm: int) -> Configuration:
    """Return the environment of a random arm with unknown payload and stiffness, given the seed of the arm."""
    known = Configuration(DEFAULT_ID, {"arm": draw_arm(arm)})
    return known.replace(**unknown_settings(known))


def rows_of(cell: tuple[int, str]) -> list[dict[str, Any]]:
    """Return the row of an arm (its seed) and an agent as a mapping; a task for `parallel_map`."""
    arm, agent = cell
    environment, start = environment_of(arm), process_time()
    records = rollout(str(FOLDER) if agent == POLICY else agent, environment, SEEDS).records
    settled, time, failed = (METRICS[name].evaluate(records) for name in ("settled", "settling_time", "failed"))
    facts = arm_facts(environment.arm, environment.torque_limit, environment.slew_span)
    periods = float(np.median(facts.durations)) / facts.first_period
    seconds = process_time() - start
    row = GeneralistRow(arm, environment.arm.n_joints, facts.reach, periods, agent, settled, time, failed, seconds)
    return [asdict(row)]
