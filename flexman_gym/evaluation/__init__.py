"""Evaluation of an agent: rollouts, metrics of their episodes, and tables."""

from typing import TYPE_CHECKING

from flexman_gym.common.lazy import lazy_names

if TYPE_CHECKING:
    from flexman_gym.evaluation.agent_spec import BASELINES, AgentSpec
    from flexman_gym.evaluation.agents import find_agent
    from flexman_gym.evaluation.metrics import METRICS, Metric, evaluate
    from flexman_gym.evaluation.rollouts import EpisodeRecord, Rollout, rollout
    from flexman_gym.evaluation.tables import metrics_table

__all__ = [
    "BASELINES",
    "METRICS",
    "AgentSpec",
    "EpisodeRecord",
    "Metric",
    "Rollout",
    "evaluate",
    "find_agent",
    "metrics_table",
    "rollout",
]

__getattr__, __dir__ = lazy_names(__name__)
