"""Evaluation of an agent: rollouts, metrics of their episodes, tables, and tuning of controllers."""

from typing import TYPE_CHECKING

from flexman_gym.common.lazy import lazy_names

if TYPE_CHECKING:
    from flexman_gym.evaluation.agent import BASELINES, AgentSpec, find_agent
    from flexman_gym.evaluation.arm_design import ArmDesign, optimise_arm
    from flexman_gym.evaluation.episode_sensitivities import sensitivities
    from flexman_gym.evaluation.live import live
    from flexman_gym.evaluation.metrics import METRICS, Metric, evaluate, metrics_table
    from flexman_gym.evaluation.optimisation import TunedGains, tune
    from flexman_gym.evaluation.rollout import EpisodeRecord, Rollout, rollout

__all__ = [
    "BASELINES",
    "METRICS",
    "AgentSpec",
    "ArmDesign",
    "EpisodeRecord",
    "Metric",
    "Rollout",
    "TunedGains",
    "evaluate",
    "find_agent",
    "live",
    "metrics_table",
    "optimise_arm",
    "rollout",
    "sensitivities",
    "tune",
]

__getattr__, __dir__ = lazy_names(__name__)
