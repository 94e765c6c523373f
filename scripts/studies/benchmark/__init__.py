"""Benchmark of environment steps, training and start-up, compared with other simulators."""
