"""Residual vibration after shaped trajectories: simulated arms under servos, and records of a real arm."""
