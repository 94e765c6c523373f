"""Evaluation of the training recipes on test episodes, and ablations."""
