"""Trial of an arm: controllers without training on a few episodes of an environment, and the choice among them."""

from collections.abc import Iterator, Mapping, Sequence
from time import process_time
from typing import Any, NamedTuple

import numpy as np

from flexman_gym.agent.base_controllers import BASES
from flexman_gym.envs.config.conditions import condition_for_arm
from flexman_gym.envs.config.configuration import Configuration
from flexman_gym.envs.config.named_environments import DEFAULT_ID
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.rollouts import EpisodeRecord, rollout

KNOWN, UNKNOWN = "known", "unknown"  # what a controller knows of payload and stiffness
TRIAL_AGENTS = {"pd-torque": KNOWN, "pd": KNOWN, "lqr-tracking": KNOWN, "adaptive-lqr": UNKNOWN}
EPISODES, FIRST_EPISODES = 20, 2  # of each controller; of the episodes by which the time of the others is estimated
TRIAL_SECONDS = 25.0  # CPU time of the episodes of a controller
TRIAL_SEED = 8000  # seed of the first episode
TRUE_STATE = "true state"  # entry of `ControllerEntry.information`
SETTLED = 0.95  # share of settled episodes of a controller that is recommended


class Trial(NamedTuple):
    """Result of a controller.

    Attributes:
        agent: its name.
        knows: KNOWN, or UNKNOWN for episodes with drawn payload and stiffness and the sensors of a laboratory.
        episodes: number of episodes.
        settled: share of episodes whose tip settled.
        settling_time: median settling time, s; infinite if most episodes did not settle.
        failures: quantity beyond its limit, the first word of the cause of a failure -> number of episodes.
        seconds: CPU time, s.
        refusal: message of the controller that cannot be designed for this arm; "" otherwise.
    """

    agent: str
    knows: str
    episodes: int = 0
    settled: float = 0.0
    settling_time: float = np.inf
    failures: Mapping[str, int] = {}
    seconds: float = 0.0
    refusal: str = ""


def unknown_settings(environment: Configuration) -> dict[str, Any]:
    """Return the settings of an environment whose payload and stiffness are unknown: those of FlexRRR-v0/unknown-lab.

    The payload is drawn from 0 to 2 times the usual one, stiffness of joints and links within 30 %; torques are delayed
    by a period, and the sensors of a laboratory have noise.
    """
    settings = condition_for_arm(DEFAULT_ID, "unknown-lab", environment.arm, environment.torque_limit)
    return {name: value for name, value in settings.items() if name != "arm"}


def try_agents(environment: Configuration, agents: Mapping[str, str] | None = None) -> Iterator[Trial]:
    """Yield the result of each controller in an environment, with fewer than 20 episodes where they take long.

    Args:
        environment: environment of the arm.
        agents: name -> KNOWN or UNKNOWN; None for TRIAL_AGENTS, and the PD with an input shaper for a hanging load.
    """
    hanging = any(joint.passive for joint in environment.arm.joints)
    usual = TRIAL_AGENTS | ({"pd-shaped": KNOWN} if hanging else {})
    for agent, knows in (usual if agents is None else agents).items():
        known = environment if knows == KNOWN else environment.replace(**unknown_settings(environment))
        start = process_time()
        try:
            records = [*rollout(agent, known, range(TRIAL_SEED, TRIAL_SEED + FIRST_EPISODES)).records]
            rest = _affordable(process_time() - start)
            if rest:
                first = TRIAL_SEED + FIRST_EPISODES
                records += rollout(agent, known, range(first, first + rest)).records
        except ValueError as error:
            yield Trial(agent, knows, seconds=process_time() - start, refusal=str(error))
            continue
        yield _result(agent, knows, records, process_time() - start)


def _affordable(seconds: float) -> int:
    """Return the number of further episodes for the CPU time (s) of the first ones, design included."""
    most = EPISODES - FIRST_EPISODES
    return most if seconds < 1.0 else int(min(most, FIRST_EPISODES * max(TRIAL_SECONDS - seconds, 0.0) / seconds))


def _result(agent: str, knows: str, records: Sequence[EpisodeRecord], seconds: float) -> Trial:
    """Return the result of the records of a controller."""
    causes = [each.failure.split()[0] for each in records if each.failure]
    return Trial(
        agent, knows, len(records), METRICS["settled"].evaluate(records), METRICS["settling_time"].evaluate(records),
        {name: causes.count(name) for name in sorted(set(causes))}, seconds,
    )  # fmt: skip


def choose(trials: Sequence[Trial]) -> tuple[Trial | None, str]:
    """Return the recommended controller, None if none settles, and the reason."""
    known = [each for each in trials if each.knows == KNOWN and not each.refusal]
    settling = [each for each in known if each.settled >= SETTLED]
    if not settling:
        best = max(known, key=lambda each: each.settled, default=None)
        if best is None or best.settled == 0.0:
            return None, "no controller settles: see the causes above and the lines marked with ! before them"
        return best, f"no controller settles {SETTLED:.0%} of the episodes; this one settles most"
    quickest = min(settling, key=lambda each: each.settling_time)
    reason = f"the quickest of those that settle at least {SETTLED:.0%} of the episodes"
    measured = [each for each in settling if each.agent not in BASES or TRUE_STATE not in BASES[each.agent].information]
    if quickest not in measured:
        reason += f"; it reads the {TRUE_STATE}, which no instrument measures"
        if measured:
            reason += f": for a real arm {min(measured, key=lambda each: each.settling_time).agent}"
    unknown = [each for each in trials if each.knows == UNKNOWN and each.settled >= SETTLED]
    if unknown:
        reason += f"; with payload and stiffness unknown take {unknown[0].agent} ({unknown[0].episodes} episodes)"
    return quickest, reason
