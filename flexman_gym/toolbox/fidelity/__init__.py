"""Fidelity: selection of the smallest model and the longest step within a tolerance."""
