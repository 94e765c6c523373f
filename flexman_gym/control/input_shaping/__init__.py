"""Input shaping: filters of a command against residual vibration."""
