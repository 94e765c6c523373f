"""Effects: the table of all that a randomisation may switch on beside physical parameters."""

from typing import Any

from flexman_gym.envs.effects.base_sway import BaseSway
from flexman_gym.envs.effects.delay import Delay
from flexman_gym.envs.effects.initial_vibration import InitialVibration
from flexman_gym.envs.effects.sensor_noise import SensorNoise
from flexman_gym.envs.effects.tip_impulse import TipImpulse
from flexman_gym.envs.effects.tip_load import TipLoad
from flexman_gym.envs.effects.torque_limit import TorqueLimit

SIGNALS: dict[str, Any] = {
    "torque_limit": TorqueLimit,
    "sensor_noise": SensorNoise,
    "delay": Delay,
    "initial_vibration": InitialVibration,
    "tip_impulse": TipImpulse,
    "tip_load": TipLoad,
    "base_sway": BaseSway,
}
"""Effects on signals: attribute of a `Randomisation` -> class."""
