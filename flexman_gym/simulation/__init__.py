"""Simulation: time integration of one or many arms, and the table of integration methods."""
