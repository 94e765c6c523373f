"""Tables of the README, computed from the stored rows."""

from collections.abc import Iterable
from functools import cache

import numpy as np

from flexman_gym.common.formatting import millimetres
from flexman_gym.common.markdown import markdown_table
from flexman_gym.envs.config.named_environments import DEFAULT_ID
from flexman_gym.evaluation.agent_info import describe_agent
from flexman_gym.evaluation.metrics import METRICS
from flexman_gym.evaluation.shares import intervals_text
from flexman_gym.toolbox.league.standings import Standings
from studies.environments.overview import environments
from studies.markdown import replaced_part
from studies.sentences import updated, window_and_episodes
from studies.sources import Sources

UNKNOWN = f"{DEFAULT_ID}/unknown"  # scenario with unknown payload and stiffness, and a delay
SHOWN = ("adaptive-lqr", "lab-flexrrr", "lqg", "lqr-tracking", "pd", "ppo-flexrrr")  # agents of the table
# information of `describe_agent` -> words of the README; a training is no information about the arm
INFORMATION = {
    "true state": "true state",
    "true parameters": "true parameters",
    "model": "nominal model",
    "structure of the model": "structure of the model",
    "data sheets": "data sheets",
    "payload class": "class of the payload",
    "its episodes": "the episodes in advance",
}
MOTOR_CONTROLLERS = ("pd", "pd-shaped")  # they read motor angles only
POLICY = "a policy trained by "  # first words of the description of a policy
TITLES = {
    "adaptive-lqr": "adaptive LQR that tracks a slew",
    "adaptive-planned": "adaptive LQR, slews optimised in motion",
    "lqg": "Kalman filter and LQR that tracks a slew",
    "lqr": "LQR at the target",
    "lqr-tracking": "LQR that tracks a slew",
    "mpc": "model predictive control",
    "optimised": "fastest slews found by optimisation",
    "pd": "PD of the motors, tuned",
    "pd-torque": "PD with joint-torque feedback",
    "pd-shaped": "the PD with input shaping (ZVD)",
    "planned": "LQR, slews optimised before they start",
    "privileged-lqr": "LQR that tracks a slew",
    "privileged-planned": "LQR, slews optimised in motion",
}


@cache
def _information(agent: str) -> tuple[str, tuple[str, ...], bool]:
    """Return the description of an agent, its information, and whether it does without oracle information."""
    info = describe_agent(agent)
    return info.description, info.information, info.realisable


def readme(text: str, sources: Sources) -> str:
    """Return the README with its generated parts and the numbers of its sentences.

    Args:
        text: the README.
        sources: stored rows.

    Returns:
        The README.

    Raises:
        ValueError: if the markers of a generated part are missing.
    """
    parts = {
        "results": [*results(sources.standings), "", intervals_text(int(window_and_episodes(sources)[1]))],
        "environments": environments(),
    }
    for name, lines in parts.items():
        text = replaced_part(text, name, lines)
    return updated(text, sources)


def results(standings: Standings) -> list[str]:
    """Return the table of six agents in the default environment, with known and with unknown parameters.

    Agents without oracle information come first, then the agents with the largest share and the shortest time of
    settling for unknown parameters. An agent without rows in one of the two scenarios has no row.
    """
    agents = [each for each in SHOWN if not standings.why(each, DEFAULT_ID) + standings.why(each, UNKNOWN)]
    agents.sort(key=lambda each: (_information(each)[2], standings.settled(each, UNKNOWN)), reverse=True)
    heads = ("agent", "given", "known arm: settled", "vibration", "unknown arm: settled", "vibration")
    return markdown_table(heads, ([f"`{each}`: {title(each)}", given(each), *_cells(standings, each, DEFAULT_ID),
                                   *_cells(standings, each, UNKNOWN)] for each in agents))  # fmt: skip


def title(agent: str) -> str:
    """Return the kind of an agent: method of the training and base controller for a policy."""
    description = _information(agent)[0]
    trained, _, base = description.removeprefix(POLICY).partition(", with the base controller ")
    if description.startswith(POLICY):
        return f"{trained} on `{base}`" if base else trained
    return TITLES.get(agent) or description.partition(",")[0]


def given(agent: str) -> str:
    """Return the information that an agent is given: its sensors first."""
    information = _information(agent)[1]
    names = [each for each in INFORMATION if each in information]
    if "true parameters" in names:
        names.remove("model")  # its parameters are the true ones
    sensors = "laboratory sensors" if information and agent not in MOTOR_CONTROLLERS else "motor angles"
    return ", ".join([*([] if "true state" in names else [sensors]), *(INFORMATION[each] for each in names)])


def _cells(standings: Standings, agent: str, scenario: str) -> Iterable[str]:
    """Return share of settled episodes with the median settling time, and the median vibration."""
    values = np.array([*standings.values(agent, scenario, "vibration").values()])
    return standings.settling_text(agent, scenario), millimetres(METRICS["vibration"].aggregate(values))
