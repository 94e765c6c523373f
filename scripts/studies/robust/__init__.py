"""Robust control of a published arm by H-infinity synthesis."""
