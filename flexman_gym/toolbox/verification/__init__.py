"""Verification of the simulator against closed-form solutions."""
