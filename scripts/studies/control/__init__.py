"""Comparison of controllers of arms with uncertain parameters, and of faults under which they fail."""
