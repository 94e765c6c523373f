"""Effects: disturbances of torques, measurements, forces and initial states."""

from flexman_gym.envs.effects.effect import Effect, EffectContext, Range
from flexman_gym.envs.effects.signals import SIGNALS

__all__ = ["SIGNALS", "Effect", "EffectContext", "Range"]
