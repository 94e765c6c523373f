"""Effects: what a randomisation does to arms and to what passes between them and an agent, a room each."""

from flexman_gym.common.renamed import deprecated_names
from flexman_gym.envs.effects.effect import HOOKS, Effect, EffectContext, Range
from flexman_gym.envs.effects.signals import SIGNALS

__all__ = ["HOOKS", "SIGNALS", "Effect", "EffectContext", "Range"]

__getattr__ = deprecated_names(__name__)
