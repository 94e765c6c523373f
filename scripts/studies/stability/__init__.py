"""Stability limits and numerical damping of the integration methods."""
