"""Observers: Kalman filter, output-error estimator, oracle, and their internal models."""
