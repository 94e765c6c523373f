"""Observers: Kalman filter, output-error estimator, oracle."""
