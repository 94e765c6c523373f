"""Metrics of motions from arrays sampled at equal intervals, and statistics over episodes.

The metrics describe settling, vibration, deflection and control effort of one motion. The first sample is the state
after the reset, at time zero. Errors are distances between tip and target. Actions are commanded torques as fractions
of the torque limits.
"""

from flexman_gym.metrics.signals import (
    BAND,
    MOVE_BANDS,
    SETTLING_WINDOW,
    VIBRATION_WINDOW,
    attained_distances,
    damping_ratio,
    effort,
    final_error,
    high_frequency_power,
    move_band,
    overshoot,
    peak_to_peak,
    remaining_energy,
    residual_vibration,
    rms,
    roughness,
    settling_time,
    squared_acceleration,
)
from flexman_gym.metrics.statistics import (
    improvements,
    interquartile_mean,
    mean,
    median_interval,
    normalised_scores,
    paired_score,
    performance_profile,
    share_interval,
    stratified_interval,
    upper_median,
)

__all__ = [
    "BAND",
    "MOVE_BANDS",
    "SETTLING_WINDOW",
    "VIBRATION_WINDOW",
    "attained_distances",
    "damping_ratio",
    "effort",
    "final_error",
    "high_frequency_power",
    "improvements",
    "interquartile_mean",
    "mean",
    "median_interval",
    "move_band",
    "normalised_scores",
    "overshoot",
    "paired_score",
    "peak_to_peak",
    "performance_profile",
    "remaining_energy",
    "residual_vibration",
    "rms",
    "roughness",
    "settling_time",
    "share_interval",
    "squared_acceleration",
    "stratified_interval",
    "upper_median",
]
