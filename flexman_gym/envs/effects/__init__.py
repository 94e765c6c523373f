"""Effects: what a randomisation does to arms and to what passes between them and an agent, a room each."""

from flexman_gym.envs.effects.effect import HOOKS, Effect, Range, Stage
from flexman_gym.envs.effects.signals import SIGNALS

__all__ = ["HOOKS", "SIGNALS", "Effect", "Range", "Stage"]
