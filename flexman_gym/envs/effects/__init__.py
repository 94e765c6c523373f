"""Effects: disturbances of torques, measurements, forces and initial states."""

from flexman_gym.common.renamed import deprecated_names
from flexman_gym.envs.effects.effect import HOOKS, Effect, EffectContext, Range
from flexman_gym.envs.effects.signals import SIGNALS

__all__ = ["HOOKS", "SIGNALS", "Effect", "EffectContext", "Range"]

__getattr__ = deprecated_names(__name__)
