"""Metrics: how well an arm slewed, settled and stopped vibrating, from plain arrays sampled at equal intervals.

Times begin with the first sample, which is that of the reset. Errors are distances of tip and target.
"""

from flexman_gym.metrics.actions import effort, power_above, roughness
from flexman_gym.metrics.comparison import (
    improvements,
    interquartile_mean,
    mean,
    normalised_scores,
    paired_score,
    performance_profile,
    stratified_interval,
)
from flexman_gym.metrics.intervals import median_interval, upper_median
from flexman_gym.metrics.settling import (
    BAND,
    MOVE_BANDS,
    STAY,
    attained_distances,
    band_of_move,
    final_error,
    overshoot,
    settling_time,
)
from flexman_gym.metrics.sizes import rms, squared_acceleration
from flexman_gym.metrics.vibration import VIBRATING, damping_ratio, energy_left, peak_to_peak, residual_vibration

__all__ = [
    "BAND",
    "MOVE_BANDS",
    "STAY",
    "VIBRATING",
    "attained_distances",
    "band_of_move",
    "damping_ratio",
    "effort",
    "energy_left",
    "final_error",
    "improvements",
    "interquartile_mean",
    "mean",
    "median_interval",
    "normalised_scores",
    "overshoot",
    "paired_score",
    "peak_to_peak",
    "performance_profile",
    "power_above",
    "residual_vibration",
    "rms",
    "roughness",
    "settling_time",
    "squared_acceleration",
    "stratified_interval",
    "upper_median",
]
