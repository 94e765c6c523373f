"""Agents outside the simulation: real-time machines, C code and MATLAB."""
