"""Servos: where the loop of a servo becomes unstable."""
