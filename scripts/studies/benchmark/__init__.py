"""Benchmark of environment steps and training, compared with other simulators."""
