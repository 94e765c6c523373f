"""Evaluation: what judges controllers and policies: one loop, figures of what happened, and a table."""

from flexman_gym.evaluation.entrants import BASELINES, Entrant, find_entrant
from flexman_gym.evaluation.figures import FIGURES, Figure, evaluate
from flexman_gym.evaluation.rollout import Record, Rollout, rollout
from flexman_gym.evaluation.table import table
from flexman_gym.evaluation.tuning import Tuned, tune

__all__ = [
    "BASELINES",
    "FIGURES",
    "Entrant",
    "Figure",
    "Record",
    "Rollout",
    "Tuned",
    "evaluate",
    "find_entrant",
    "rollout",
    "table",
    "tune",
]
