"""Sensors: what an agent sees of the arms."""

from flexman_gym.envs.sensors.full import FullState

__all__ = ["FullState"]
