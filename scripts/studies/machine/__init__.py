"""Comparison of our model with measurements of a real two-link flexible arm."""
