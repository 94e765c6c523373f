"""Benchmark: what steps, training and starts cost beside peers."""
